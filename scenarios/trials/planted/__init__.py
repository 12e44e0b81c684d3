"""Scenarios with hidden effects: simulated here, diagnosed from files alone, scored with the
truth.

A new one is a file in `scenarios/catalog` with ``kind = "trace"``.
"""
