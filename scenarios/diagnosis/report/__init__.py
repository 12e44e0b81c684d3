"""A diagnosis in words, tables, figures and files."""
