"""Frequency responses of records."""
