"""How long it takes: scripts, and the comparison with peers."""
