"""Simulated flights that are diagnosed or estimated from files, and compared with their truth.

They may import everything in `scenarios` but `api`, `commands` and `cli`. Truth is read only here
and in `studies`. `exam`, which is not installed, counts how often the tracing loop is right.
"""
