"""Functions that broadcast and survive a complex step."""
