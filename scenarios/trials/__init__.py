"""Simulated flights that are diagnosed or estimated from files, and compared with their truth."""
