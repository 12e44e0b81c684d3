"""Maximum likelihood over whole records by Gauss-Newton."""
