"""How far a condensed aircraft is from the flexible one at one frequency."""

from __future__ import annotations

from sim.vehicles.data import VehicleData
from sim.vehicles.flexibility.degree import _error, _pair


def quasi_static_error(data: VehicleData, omega: float, modes: int | None = None) -> float:
    """max over alpha and q of |Y_flexible / Y_condensed - 1| at ``omega``, rad/s, Y the response to the elevator."""
    flexible, condensed = _pair(data, modes)
    return _error(flexible, condensed, omega)
