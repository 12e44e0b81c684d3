"""Campaigns of the tracing loop in Python."""
