"""Levels of flying qualities of low-order forms fitted to frequency responses.

The forms are those of the short period, the roll mode and the Dutch roll. Their limits are those of
the modes of a model. For the form ``pitch`` at constant speed,
n/alpha = V / (g T_theta2) and CAP = omega^2 / (n/alpha) (MIL-STD-1797A, 4.2.1.2; Bihrle,
AFFDL-TR-65-198, 1966).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np

from ident.flying_qualities.levels import Quality, QualityLevel, criteria, levels
from ident.frequency_response.transfer_function import DELAY, FittedResponse

GRAVITY = 9.80665
EVERY = "all"  # category of a criterion that applies to all flight phases
UNITS_OF_FORMS = {
    "natural_frequency": "rad/s",
    "damping_ratio": "1",
    "load_factor_slope": "g/rad",
    "control_anticipation": "1/(g s2)",
    "roll_time_constant": "s",
    "dutch_roll_frequency": "rad/s",
    "dutch_roll_damping": "1",
    "dutch_roll_damping_rate": "rad/s",
    "total_delay": "s",
}
Values = Mapping[str, float]


def form_qualities(
    function: FittedResponse, airspeed: float | None = None, *, dutch_roll: bool = True
) -> tuple[Quality, ...]:
    """Return the flying-qualities parameters of a fitted low-order form, with standard deviations
    by linearisation; none for a transfer function that is given by its orders.

    Parameters
    ----------
    airspeed : m/s, for n/alpha and CAP of the form ``pitch``; None leaves them out.
    dutch_roll : whether the form ``dutch-roll`` describes a Dutch roll, and not an angle of attack.
    """
    out = []
    for name, value in _quantities_of_form(
        function.form.name, airspeed, dutch_roll=dutch_roll
    ).items():
        result = _propagated(function, value)
        if result is not None:
            out.append(Quality(name, *result, UNITS_OF_FORMS[name]))
    return tuple(out)


def form_levels(
    quality_values: tuple[Quality, ...], aircraft_class: str, category: str
) -> tuple[QualityLevel, ...]:
    """Return the levels of parameters for an aircraft class and a flight-phase category."""
    chosen = [each for each in criteria(aircraft_class) if each.category in (category, EVERY)]
    return levels(quality_values, chosen)


def _quantities_of_form(
    form: str, airspeed: float | None, *, dutch_roll: bool
) -> dict[str, Callable[[Values], float]]:
    """Return quantity -> function that returns it for the parameters of a form."""
    delay: dict[str, Callable[[Values], float]] = {"total_delay": lambda p: p[DELAY]}
    dutch: dict[str, Callable[[Values], float]] = {
        "dutch_roll_frequency": lambda p: p["frequency"],
        "dutch_roll_damping": lambda p: p["damping"],
        "dutch_roll_damping_rate": lambda p: p["damping"] * p["frequency"],
    }
    roll: dict[str, Callable[[Values], float]] = {
        "roll_time_constant": lambda p: 1.0 / p["inv_T_roll"]
    }
    if form == "pitch":
        out: dict[str, Callable[[Values], float]] = {
            "natural_frequency": lambda p: p["frequency"],
            "damping_ratio": lambda p: p["damping"],
        }
        if airspeed is not None:
            inverse_time = GRAVITY / airspeed  # 1/s, g/V
            out["load_factor_slope"] = lambda p: p["inv_T_theta2"] / inverse_time
            out["control_anticipation"] = lambda p: (
                p["frequency"] ** 2 * inverse_time / p["inv_T_theta2"]
            )
        return {**out, **delay}
    if form == "roll":
        return {**roll, **delay}
    if form == "roll-and-dutch-roll":
        return {**roll, **dutch, **delay}
    return {**dutch, **delay} if form == "dutch-roll" and dutch_roll else {}


def _propagated(
    function: FittedResponse, value: Callable[[Values], float]
) -> tuple[float, float] | None:
    """Return the value and standard deviation of a function of estimates; None if not finite."""
    p = dict(function.values)
    slopes = []
    try:
        centre = value(p)
        for name in function.std:
            step = 1e-6 * max(abs(p[name]), 1e-3)
            ends = [value({**p, name: p[name] + sign * step}) for sign in (1.0, -1.0)]
            slopes.append((ends[0] - ends[1]) / (2.0 * step))
    except ZeroDivisionError:
        return None
    row = np.array(slopes)
    std = math.sqrt(max(float(row @ function.covariance @ row), 0.0))
    return (centre, std) if math.isfinite(centre) and math.isfinite(std) else None
