"""Model structure from records: the terms of each coefficient that the maneuvers support."""
