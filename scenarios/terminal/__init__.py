"""Numbers, tables and progress on the terminal."""
