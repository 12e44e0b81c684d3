"""A measured record's file: its cells, its columns, the JSON beside it."""
