"""Recursive filters with runs on an axis."""
