"""Scenarios with hidden effects: simulated, diagnosed from files alone, compared with the truth.

A new one is a file in `scenarios/catalog` with ``kind = "trace"``.
"""
