"""Flights that look measured: filtered, coloured, scattered, drifting; on top one dominant effect,
two, or none.
"""
