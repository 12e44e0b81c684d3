"""Causes that no effect of the library names."""
