"""A measured record's file: its cells, its columns, the JSON beside it.

It may import `formats` and the files beside this folder, but not `records.py`, which is made of it.
"""
