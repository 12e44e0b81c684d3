"""Maneuvers in long records: what a pilot or a program flew on purpose, found in inputs and motion."""

from ident.maneuver_detection.search import active_share, find_maneuvers
from ident.maneuver_detection.signals import AXES, KINDS, PAUSE, FlightSignals, Maneuver

__all__ = ["AXES", "KINDS", "PAUSE", "Maneuver", "FlightSignals", "active_share", "find_maneuvers"]
