"""How far a condensed aircraft is from the flexible one at one frequency."""

from __future__ import annotations

from sim.vehicles.flexibility import _error, _pair
from sim.vehicles.library import VehicleData


def quasi_static_error(data: VehicleData, omega: float, modes: int | None = None) -> float:
    """max over alpha and q of |Y_flexible / Y_condensed - 1| at ``omega``, rad/s, Y the response to
    the elevator.
    """
    flexible, condensed = _pair(data, modes)
    return _error(flexible, condensed, omega)
