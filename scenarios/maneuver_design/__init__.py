"""Design of maneuvers."""
