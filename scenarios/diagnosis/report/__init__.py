"""A diagnosis in words, tables, figures and files.

A new piece of the report is a function that takes a `Tracing`; `text.py` (terminal and
``diagnosis.json``) and `files.py` (study folder and page) both call it.
"""
