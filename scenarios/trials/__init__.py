"""Flights whose answer is known."""
