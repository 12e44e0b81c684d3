"""Scenarios with hidden effects: simulated here, diagnosed from files alone, scored with the
truth.
"""
