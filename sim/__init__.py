"""Equations, effects, maneuvers, sensors and truth generation, apart from estimation."""
