"""Numbers, tables and progress on the terminal.

It may import `files`, `ident` and `sim`. What speaks of one kind of study belongs to the text of
that study, not here.
"""
