"""Scores of trials: names that count as one, shares with intervals, and the reliability of
probabilities.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np

from ident.statistics.intervals import clopper_pearson, clustered_share
from sim.effects.library import traits_of

# ---- How trials are scored

RESAMPLING_SEED = 1  # the same flights give the same interval


@dataclass(frozen=True)
class Share:
    """A count out of a total, with its 95 % interval."""

    count: int
    of: int
    interval: tuple[float, float]


@cache  # asks the whole library
def same_fault(name: str) -> frozenset[str]:
    """Return the names that count as naming an effect right: a lag and a delay of one sensor count
    as one.
    """
    return frozenset({name, *traits_of(name).twins})


def share_of_flights(hits: Iterable[bool]) -> Share:
    """Return the share of flights with a property (Clopper and Pearson); flights are
    independent.
    """
    seen = [bool(hit) for hit in hits]
    return Share(sum(seen), len(seen), clopper_pearson(sum(seen), len(seen)))


def share_within_flights(hits: Iterable[Iterable[bool]]) -> Share:
    """Return the share over all items of all flights.

    Items of one flight are correlated, so that whole flights are resampled for the interval.
    """
    flights = [[bool(hit) for hit in flight] for flight in hits]
    counts, of = (
        np.array([sum(flight) for flight in flights]),
        np.array([len(flight) for flight in flights]),
    )
    return Share(
        int(counts.sum()),
        int(of.sum()),
        clustered_share(counts, of, np.random.default_rng(RESAMPLING_SEED)),
    )


# ---- Probabilities of names held against the truth

EDGES = (0.05, 0.2, 0.5, 0.8, 0.95, 1.0)


@dataclass(frozen=True)
class Statement:
    """A name of a claim, the probability that was given, and whether it is right."""

    name: str
    probability: float
    right: bool


@dataclass(frozen=True)
class Bin:
    """Names with a probability from ``low`` to ``high``: their number, the mean probability, and
    the number of right ones.
    """

    low: float
    high: float
    count: int
    said: float
    right: int

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the share of right names; names of one claim count as independent."""
        return clopper_pearson(self.right, self.count)


def reliability(statements: Sequence[Statement]) -> tuple[Bin, ...]:
    """Return how often names are right, by the probability that was given; those less likely than
    ``EDGES[0]`` are left out.
    """
    return binned(
        [(each.probability, each.right) for each in statements if each.probability > EDGES[0]]
    )


def binned(pairs: Sequence[tuple[float, bool]]) -> tuple[Bin, ...]:
    """Count pairs of a probability and whether the name is right in bins between ``EDGES``."""
    bins = []
    for low, high in pairwise(EDGES):
        inside = [(p, right) for p, right in pairs if low < p <= high]
        said = float(np.mean([p for p, _ in inside])) if inside else 0.5 * (low + high)
        bins.append(Bin(low, high, len(inside), said, sum(right for _, right in inside)))
    return tuple(bins)
