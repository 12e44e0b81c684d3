"""Scenarios as data, and the example of a model of one's own."""
