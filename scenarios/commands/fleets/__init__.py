"""Commands on many flights at once."""
