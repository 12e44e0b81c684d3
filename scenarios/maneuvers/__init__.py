"""Maneuvers in a long record."""
