"""Readers of record files: one module for each format, found by the bytes of the file or by its
suffix.
"""
