"""Maximum likelihood where random forces act on the states."""
