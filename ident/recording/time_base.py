"""A time base that runs grossly fast or slow: the one factor of time that makes the kinematics hold."""

from __future__ import annotations

import math

from ident.recording.control import control_power, sure
from ident.recording.finding import Certainty, Expectations, Finding, Kind, Number
from ident.recording.motion import Columns, disagreement

SUSPECT, SUITS = 0.12, 0.06  # unexplained: a clock at twice its rate leaves 0.2, the right one as little as noise does
CLEARLY = 4.0  # times less than as read
GROSS = 0.7  # of ln 2: scales of a sensor are nearer to one, and a clock that is less wrong is an effect for the fit
PER_OCTAVE, OCTAVES = 4, 4
CLOSE = 0.7  # of a logarithm: starting values of a vehicle file and effects make up to a factor of two


def wrong_clock(columns: Columns, as_read: float, expected: Expectations) -> Finding | None:
    """Certain where the control's power, or pitch attitude, tell it from a scale of a sensor, else likely; None where time is right."""
    factors = [2.0 ** (step / PER_OCTAVE) for step in range(-PER_OCTAVE * OCTAVES, PER_OCTAVE * OCTAVES + 1) if step]
    left = {factor: max(disagreement(columns.times({"time": factor})).values()) for factor in factors}
    best = min(left, key=lambda factor: left[factor])
    if left[best] > SUITS or left[best] * CLEARLY > as_read or abs(math.log2(best)) < GROSS:
        return None
    numbers = {"factor": Number(best, "1"), "unexplained": Number(as_read, "1"), "unexplained_otherwise": Number(left[best], "1")}
    what = f"disagrees with the kinematics: they hold if time runs {best:.2g} times as long as the column says"
    # Attitude rules out a scale of alpha; one of the pitch rate does the same to it as the clock, and is told by nz alone.
    attitude = {"theta", "alpha"} <= set(columns.outputs)
    by_rate = min(max(disagreement(columns.times({"q": factor})).values()) for factor in factors)
    if (attitude and CLEARLY * left[best] < by_rate) or _control_agrees(columns, best, expected):
        return Finding("time", Kind.TIME_BASE, Certainty.CERTAIN, what, "mend the time column, or say its unit in a channel map", numbers=numbers)
    what += f", or if the {'pitch rate' if attitude else 'angle of attack'} has a scale of its own"
    return Finding("time", Kind.TIME_BASE, Certainty.LIKELY, what, "check the sample rate and the units of the columns", numbers=numbers)


def _control_agrees(columns: Columns, factor: float, expected: Expectations) -> bool:
    """Whether the control's power is that of the vehicle's data only with the other clock: accelerations go with its square."""
    if expected.control_power is None or not expected.control_power or not expected.angular_control:
        return False
    apart = []
    for some in (columns, columns.times({"time": factor})):
        found = control_power(some)
        if found is None or not sure(found) or found.value * expected.control_power <= 0.0:
            return False
        apart.append(abs(math.log(found.value / expected.control_power)))
    return apart[1] < min(CLOSE, 0.5 * apart[0])
