"""Equations, effects, maneuvers, sensors and truth generation; knows nothing of the rooms above."""
