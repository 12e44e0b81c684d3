"""Functions on many flights at once."""
