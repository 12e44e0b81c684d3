"""What the parameters of a user's own model multiply, found by trial: a function does not say what it is made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sim.declaration.own_equations import OwnEquations
from sim.declaration.own_trial import ASIDE, Starts, beside, changed, evaluated
from sim.errors import FlightidError
from sim.maths.elementary import COMPLEX_STEP

Answer = tuple[str, str]  # "rates" or "readings", and the name
APART = 1e-9  # of the largest slope: below it two slopes are one, but for rounding


def multiplying(equations: OwnEquations, starts: Starts, names: Sequence[str]) -> tuple[str, ...]:
    """Those parameters of ``names`` that multiply signals: what they do to the rates and readings changes with these.

    A parameter that is only added, as a constant load, does the same wherever the motion is; so does one that is in no equation.
    """
    places = [Starts(beside(starts, side).signals, starts.parameters) for side in (0.0, 1.0, -0.6)]
    found = []
    for name in names:
        slopes = [_slopes(equations, at, False, name) for at in places]
        if all(slopes) and any(_apart([each[answer] for each in slopes]) for answer in slopes[0]):
            found.append(name)
    return tuple(found)


def products(equations: OwnEquations, starts: Starts, names: Sequence[str]) -> tuple[tuple[str, str, str], ...]:
    """Port, signal and parameter, where one of the parameters ``names`` multiplies the signal in a rate to which the port adds.

    The second derivative of a rate by parameter and signal tells: a complex step of the parameter, at two values of the signal.
    """
    here = beside(starts, 1.0)
    fed = _rates_fed(equations, here)
    base = {name: _slopes(equations, here, False, name) for name in names}
    found = []
    for signal in (*equations.states, *equations.inputs):
        value = here.signals[signal.name]
        moved = changed(here, True, signal.name, value + ASIDE * (abs(value) or 1.0))
        for name in names:
            there = _slopes(equations, moved, False, name)
            rates = {a for a, slope in base[name].items() if a in there and a[0] == "rates" and _apart([slope, there[a]])}
            found += [(port, signal.name, name) for port, reached in fed.items() if rates & reached]
    return tuple(found)


def _rates_fed(equations: OwnEquations, at: Starts) -> dict[str, set[Answer]]:
    """The rates that each port adds to."""
    if equations.rate_ports:
        return {port: {("rates", state.name)} for port, state in zip(equations.rate_ports, equations.states, strict=True)}
    slopes = {port.name: _slopes(equations, at, True, port.name) for port in equations.ports}
    return {port: {answer for answer, slope in found.items() if answer[0] == "rates" and slope != 0.0} for port, found in slopes.items()}


def _slopes(equations: OwnEquations, at: Starts, of_signal: bool, name: str) -> dict[Answer, float]:
    """Slopes of all rates and readings by one signal or parameter; none where they cannot be formed."""
    value = (at.signals if of_signal else at.parameters)[name]
    try:
        found = evaluated(equations, changed(at, of_signal, name, complex(value, COMPLEX_STEP)))
    except FlightidError:
        return {}
    return {answer: float(np.imag(each)) / COMPLEX_STEP for answer, each in found.items()}


def _apart(slopes: Sequence[float]) -> bool:
    return bool(np.ptp(slopes) > APART * np.max(np.abs(slopes)))
