"""Campaigns of hidden-effect scenarios."""
