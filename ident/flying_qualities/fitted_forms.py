"""Flying-qualities parameters of low-order forms fitted to frequency responses, and their levels.

The forms are those of the short period, the roll mode and the Dutch roll. For the form ``pitch`` at
constant speed, n/alpha = V / (g T_theta2) (MIL-STD-1797A, 4.2.1.2).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ident.flying_qualities.attitude_criteria import propagated
from ident.flying_qualities.levels import (
    UNITS,
    Quality,
    QualityLevel,
    criteria_in_category,
    levels,
)
from ident.frequency_response.transfer_function import DELAY, FittedResponse
from sim.maths import G0

FormParameters = Mapping[str, float]


def form_qualities(
    function: FittedResponse, airspeed: float | None = None, *, dutch_roll: bool = True
) -> tuple[Quality, ...]:
    """Return the flying-qualities parameters of a fitted low-order form, with standard deviations
    by linearisation; empty for a transfer function declared by its orders instead of a form.

    Parameters
    ----------
    airspeed : m/s, for n/alpha and CAP of the form ``pitch``; None leaves them out.
    dutch_roll : whether a function of the form ``dutch-roll`` describes a Dutch roll. False if the
        form was fitted to an angle of attack.
    """
    out = []
    for name, value in _quantities_of_form(
        function.form.name, airspeed, dutch_roll=dutch_roll
    ).items():
        result = propagated(function, value)
        if result is not None:
            out.append(Quality(name, *result, UNITS[name]))
    return tuple(out)


def form_levels(
    quality_values: tuple[Quality, ...], aircraft_class: str, category: str
) -> tuple[QualityLevel, ...]:
    """Return the levels of parameters for an aircraft class and a flight-phase category."""
    return levels(quality_values, criteria_in_category(aircraft_class, category))


def _quantities_of_form(
    form: str, airspeed: float | None, *, dutch_roll: bool
) -> dict[str, Callable[[FormParameters], float]]:
    """Return quantity -> function of the parameters of a form that returns the quantity."""
    delay_function: dict[str, Callable[[FormParameters], float]] = {
        "total_delay": lambda p: p[DELAY]
    }
    dutch_roll_functions: dict[str, Callable[[FormParameters], float]] = {
        "dutch_roll_frequency": lambda p: p["frequency"],
        "dutch_roll_damping": lambda p: p["damping"],
        "dutch_roll_damping_rate": lambda p: p["damping"] * p["frequency"],
    }
    roll_functions: dict[str, Callable[[FormParameters], float]] = {
        "roll_time_constant": lambda p: 1.0 / p["inv_T_roll"]
    }
    if form == "pitch":
        out: dict[str, Callable[[FormParameters], float]] = {
            "natural_frequency": lambda p: p["frequency"],
            "damping_ratio": lambda p: p["damping"],
        }
        if airspeed is not None:
            inverse_time = G0 / airspeed  # 1/s, g/V
            out["load_factor_slope"] = lambda p: p["inv_T_theta2"] / inverse_time
            out["control_anticipation"] = lambda p: (
                p["frequency"] ** 2 * inverse_time / p["inv_T_theta2"]
            )
        return {**out, **delay_function}
    if form == "roll":
        return {**roll_functions, **delay_function}
    if form == "roll-and-dutch-roll":
        return {**roll_functions, **dutch_roll_functions, **delay_function}
    return {**dutch_roll_functions, **delay_function} if form == "dutch-roll" and dutch_roll else {}
