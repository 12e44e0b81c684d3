"""A stream of rows identified as it arrives: lines, rows, the bank, what is shown and what is
written.
"""
