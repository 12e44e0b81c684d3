"""Scenario files: their schema, their numbers, and the way to a Scenario."""
