"""Isolated wrong samples: found, set aside, claimed."""
