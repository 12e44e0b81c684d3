"""A pilot who holds the height while the airspeed changes, by a slow elevator that keeps lift and
weight equal.
"""

from __future__ import annotations

import numpy as np

from exam.surrogates.flights.drawing import SPEED, Drawn
from exam.surrogates.flights.maneuvers import Table


def steered(drawn: Drawn, number: int) -> Table:
    """Return the elevator of one record, rad: its maneuver and, for a ``level`` flight, the
    correction for a hidden change of speed.
    """
    maneuver, speed = drawn.maneuvers[number], speed_rate(drawn, number)
    if not (drawn.surrogate.flight.level and speed):
        return maneuver
    times = maneuver.start + maneuver.spacing * np.arange(len(maneuver.values))
    return Table(
        maneuver.values + level_elevator(drawn, speed * times), maneuver.spacing, maneuver.start
    )


def speed_rate(drawn: Drawn, number: int) -> float:
    """Return the thrust above drag over the mass, m/s2, of a hidden change of speed on this
    record.
    """
    return sum(
        dominant.values["rate"]
        for dominant in drawn.hidden
        if dominant.name == SPEED and number in dominant.records
    )


def level_elevator(drawn: Drawn, change: np.ndarray) -> np.ndarray:
    """Return the elevator (rad) at which lift is weight and the moment is zero, at the declared
    airspeed plus ``change`` (m/s).

    Steady flight: Cm_alpha alpha + Cm_de de = 0 and CL_alpha alpha + CL_de de = CL_0 ((V0/V)^2 -
    1), where CL_0 is the trim lift that depends on the speed.
    """
    p = {item.name: item.value for item in drawn.model.parameters}
    wanted = p["trim_lift"] * ((p["airspeed"] / (p["airspeed"] + change)) ** 2 - 1.0)
    return np.asarray(wanted / (p["CL_de"] - p["CL_alpha"] * p["Cm_de"] / p["Cm_alpha"]))
