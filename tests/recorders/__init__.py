"""Small files as recorders write them, made from one record: what the readers of formats are tried
on.
"""
