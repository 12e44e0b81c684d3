"""Readers of record files: one module for each format, chosen by the first bytes of the file or by
its suffix.
"""
