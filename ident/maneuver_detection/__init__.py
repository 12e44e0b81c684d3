"""Maneuvers in long records: what a pilot or a program flew on purpose, found in inputs and motion."""

from ident.maneuver_detection.search import find_maneuvers
from ident.maneuver_detection.signals import KINDS, Maneuver, Signals

__all__ = ["KINDS", "Maneuver", "Signals", "find_maneuvers"]
