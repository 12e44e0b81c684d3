"""Detection of intentional maneuvers in the inputs and the motion of long records.

The package imports only NumPy and SciPy, and knows no files and no vehicles. A new kind of maneuver
needs its recognition in `shapes.py`, its name in `KINDS`, its limits in
`ACCEPTANCE_LIMITS`, and flights with it in `tests/long_flights.py`. Limits are chosen on the
flights 0 to 19 and tested on the flights 100 to 119.
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
