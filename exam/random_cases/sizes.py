"""How parameters of what is hidden are drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from exam.random_cases.case import Draw, Setting


def uniform(low: float, high: float, local: str) -> Draw:
    """Even in the logarithm."""
    return lambda rng, s: {local: float(np.exp(rng.uniform(math.log(low), math.log(high))))}


def share(low: float, high: float, local: str) -> Draw:
    """A share of the largest deflection."""
    return lambda rng, s: {local: float(s.peak * rng.uniform(low, high))}


def signed(low: float, high: float, local: str) -> Draw:
    """Of either sign."""
    return lambda rng, s: {local: either(rng) * float(rng.uniform(low, high))}


def either(rng: np.random.Generator) -> float:
    """One or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def pulse(
    rng: np.random.Generator, s: Setting, shortest: float, longest: float, last: float = 0.7
) -> tuple[float, float]:
    """Begin and length of something that happens in a record, s; it begins at ``last`` of the
    record at the latest.
    """
    return float(rng.uniform(0.1, last) * s.duration), float(rng.uniform(shortest, longest))


def several(rng: np.random.Generator, **spans: tuple[float, float]) -> Mapping[str, float]:
    """Every parameter evenly between its ends."""
    return {name: float(rng.uniform(*span)) for name, span in spans.items()}
