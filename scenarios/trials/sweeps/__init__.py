"""Sweeps of a loop whose response and margins are known."""
