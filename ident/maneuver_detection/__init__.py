"""Maneuvers in long records: what a pilot or a program flew on purpose, found in inputs and motion.

Arrays in, maneuvers out: no file, no vehicle. It imports NumPy and SciPy only. To add a kind: its
recognition in `signals.py` or `search.py`, its name in `KINDS`, its least strength in `ACCEPT`, and
flights with it in `tests/long_flights.py`: thresholds are chosen on the flights 0 to 19 and judged
on the flights 100 to 119.
"""

from ident.maneuver_detection.search import active_share, find_maneuvers
from ident.maneuver_detection.signals import (
    AXES,
    KINDS,
    LONGEST_GAP,
    DetectedManeuver,
    FlightSignals,
)

__all__ = [
    "AXES",
    "KINDS",
    "LONGEST_GAP",
    "DetectedManeuver",
    "FlightSignals",
    "active_share",
    "find_maneuvers",
]
