"""Faults of a recorder, put into a record after sampling and noise."""
