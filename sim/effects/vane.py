"""What a vane away from the centre of gravity reads of the turning of the aircraft."""

from __future__ import annotations

from typing import Any


def at_arm(s: Any, vehicle: Any, arm: Any, rate: str, speed: str) -> Any:
    """(arm/V) rate, rad: V the airspeed at the time, or the declared one of equations without; ``arm`` in m, ``rate`` and ``speed`` by name."""
    V = s.V if hasattr(s, "V") else getattr(vehicle, speed)
    return arm / V * getattr(s, rate)
