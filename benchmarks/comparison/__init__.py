"""Times contenders for one job beside each other, cold and warm, checks that they agree, and writes
the page.
"""
