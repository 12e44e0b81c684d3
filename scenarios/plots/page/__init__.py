"""Figures as they stand within a page."""
