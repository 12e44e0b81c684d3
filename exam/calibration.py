"""Probabilities of names held against the truth: how often what is said to be so likely is
right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ident.statistics.intervals import clopper_pearson

EDGES = (0.05, 0.2, 0.5, 0.8, 0.95, 1.0)


@dataclass(frozen=True)
class Statement:
    """A name that a claim gives, the probability that was said, and whether it is right."""

    name: str
    probability: float
    right: bool


@dataclass(frozen=True)
class Bin:
    """Names said to be right with a probability from ``low`` to ``high``: how many, the mean of
    what was said, how many are right.
    """

    low: float
    high: float
    count: int
    said: float
    right: int

    @property
    def interval(self) -> tuple[float, float]:
        """Of the share that is right, at 95 %; names of one claim count as if each stood alone."""
        return clopper_pearson(self.right, self.count)


def reliability(statements: Sequence[Statement]) -> tuple[Bin, ...]:
    """How often names are right, by the probability that was said; those less likely than
    ``EDGES[0]`` are left out.
    """
    return binned(
        [(each.probability, each.right) for each in statements if each.probability > EDGES[0]]
    )


def binned(pairs: Sequence[tuple[float, bool]]) -> tuple[Bin, ...]:
    """Probabilities that were said, and whether what they were said of is right, counted between
    ``EDGES``.
    """
    bins = []
    for low, high in pairwise(EDGES):
        inside = [(p, right) for p, right in pairs if low < p <= high]
        said = float(np.mean([p for p, _ in inside])) if inside else 0.5 * (low + high)
        bins.append(Bin(low, high, len(inside), said, sum(right for _, right in inside)))
    return tuple(bins)
