"""Flights that have not been flown, in Python."""
