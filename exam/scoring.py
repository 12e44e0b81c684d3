"""How trials are scored: names that count as one, and shares with their intervals."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np

from ident.statistics.intervals import clopper_pearson, clustered_share
from sim.effects.library import traits_of

RESAMPLING_SEED = 1  # the same flights give the same interval


@dataclass(frozen=True)
class Share:
    """So many of so many, with an interval at 95 %."""

    count: int
    of: int
    interval: tuple[float, float]


@cache  # asks the whole library
def same_fault(name: str) -> frozenset[str]:
    """The names that count as naming an effect right: a lag and a delay of one sensor are one."""
    return frozenset({name, *traits_of(name).twins})


def share_of_flights(hits: Iterable[bool]) -> Share:
    """The share of flights in which something is so; flights are independent (Clopper and
    Pearson).
    """
    seen = [bool(hit) for hit in hits]
    return Share(sum(seen), len(seen), clopper_pearson(sum(seen), len(seen)))


def share_within_flights(hits: Iterable[Iterable[bool]]) -> Share:
    """The share over all that is counted in flights; the findings of one flight are correlated, so
    that whole flights are resampled.
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
