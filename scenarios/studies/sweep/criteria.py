"""From which degree of flexibility on a rigid model no longer serves: three criteria along a sweep.

Two say when a record shows the structure, one when the structure spoils what a rigid model is for.

- whiteness: the residual of the rigid whole-record fit is no longer white (Ljung and Box), at the level of all residual tests here.
- likelihood: the Bayesian information criterion (Schwarz 1978) prefers the rigid model with one elastic mode to the rigid one,
  2 (ln L_mode - ln L_rigid) > k ln n. A model with s states that moves alpha and q from one input shows 3 s numbers, whatever
  parameters it is written in, and has s initial states: k = 8 for two more states.
- misfit: what no rigid model explains is larger than the noise in rms (`sim.vehicles.flexibility`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from scenarios.studies.sweep.sweep import SweepPoint, SweptMethod
from sim.vehicles.flexibility import LARGEST_MISFIT

WHITE = 1e-3  # smallest probability of a white residual: that of `ident.statistics.residuals`
NUMBERS_PER_STATE = 3 + 1  # one for each coefficient of the denominator and of two numerators, one initial state
FIT = "output-error"


@dataclass(frozen=True)
class Criterion:
    """One criterion along a sweep.

    ``values``: one a point, NaN where it cannot be told. A rigid model fails where the value is beyond ``limit``, below it if ``below``.
    ``degree`` and ``frequency_factor``: where that begins, interpolated; None where it does not within the sweep.
    """

    name: str
    sentence: str
    limit: float
    below: bool
    values: tuple[float, ...]
    degree: float | None
    frequency_factor: float | None


def criteria_of(points: Sequence[SweepPoint]) -> tuple[Criterion, ...]:
    """The criteria in the order in which they usually fail; those that the scenario's methods do not allow are left out."""
    found = [
        _criterion("likelihood", "a model with one elastic mode is likelier (BIC)", 0.0, False, points, _preference),
        _criterion("whiteness", "the residual of the rigid fit is no longer white", math.log10(WHITE), True, points, _whiteness),
        _criterion(
            "misfit",
            "what no rigid model explains exceeds the noise",
            math.log10(LARGEST_MISFIT),
            False,
            points,
            lambda p: math.log10(p.figures.misfit),
        ),
    ]
    return tuple(each for each in found if any(map(math.isfinite, each.values)))


def _criterion(name: str, sentence: str, limit: float, below: bool, points: Sequence[SweepPoint], value: Callable[[SweepPoint], float]) -> Criterion:
    values = tuple(float(value(point)) for point in points)
    degree = _begins([math.log(point.figures.degree) for point in points], values, limit, below)
    factor = _begins([math.log(point.frequency_factor) for point in points], values, limit, below)
    return Criterion(name, sentence, limit, below, values, None if degree is None else math.exp(degree), None if factor is None else math.exp(factor))


def _begins(places: Sequence[float], values: Sequence[float], limit: float, below: bool) -> float | None:
    """Where a series passes its limit for good, between two points; None where it never does, or has from the first point on."""
    beyond = [(value < limit) is below and value != limit and math.isfinite(value) for value in values]
    first = next((i for i in range(len(beyond)) if all(beyond[i:])), 0)
    if first == 0:
        return None
    share = (limit - values[first - 1]) / (values[first] - values[first - 1])
    return places[first - 1] + float(np.clip(share, 0.0, 1.0)) * (places[first] - places[first - 1])


def _fit(point: SweepPoint, elastic: bool) -> SweptMethod | None:
    """The whole-record fit of the rigid model, or of the one with the fewest modes."""
    fits = [each for each in point.methods if each.estimation.method == FIT and bool(each.estimation.modes) is elastic]
    return min(fits, key=lambda each: each.estimation.modes, default=None)


def _whiteness(point: SweepPoint) -> float:
    """Logarithm to ten of the probability of the least white channel, for as many channels as there are."""
    fit = _fit(point, False)
    tests = [test.p_value for test in fit.tests if test.name == "ljung-box"] if fit is not None else []
    return math.log10(max(min(1.0, len(tests) * min(tests)), 1e-300)) if tests else math.nan


def _preference(point: SweepPoint) -> float:
    """By how much the information criterion prefers the model with modes to the rigid one."""
    rigid, elastic = _fit(point, False), _fit(point, True)
    if rigid is None or elastic is None:
        return math.nan
    states = 2 * (elastic.estimation.modes - rigid.estimation.modes)
    return 2.0 * (elastic.log_likelihood - rigid.log_likelihood) - NUMBERS_PER_STATE * states * math.log(point.samples)
