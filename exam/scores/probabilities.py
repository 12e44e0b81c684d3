"""The probabilities that the loop gives to names, held against how many of them are right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from exam.calibration import EDGES, Bin, binned
from exam.scores.scored_flight import ScoredFlight

DRAWS = 2000  # of the bootstrap
SEED = 1  # the same flights give the same interval
TAILS = (0.025, 0.975)


@dataclass(frozen=True)
class Brier:
    """Brier score of the names that are given: the mean square of probability minus one where the
    name is right, zero where it is not.

    ``count`` names in all; ``interval`` at 95 %, flights resampled whole; ``constant`` : the score
    of giving each name the share of them that is right, which says nothing of the single name.
    """

    count: int
    score: float
    interval: tuple[float, float]
    constant: float


def reliability_of(flights: Sequence[ScoredFlight]) -> tuple[Bin, ...]:
    """How often names are right by the probability that was given, alternatives among them; those
    less likely than ``EDGES[0]`` are left out.
    """
    return binned(
        [
            (each.probability, each.right)
            for flight in flights
            for each in flight.stated
            if each.probability > EDGES[0]
        ]
    )


def brier(flights: Sequence[ScoredFlight]) -> Brier | None:
    """The score of the names that are given, one a claim; None where there is none."""
    given = [
        [(each.probability, each.right) for each in flight.stated if each.first]
        for flight in flights
    ]
    given = [each for each in given if each]
    if not given:
        return None
    squares = np.array([sum((p - right) ** 2 for p, right in each) for each in given])
    counts = np.array([len(each) for each in given])
    right = float(sum(right for each in given for _, right in each)) / int(counts.sum())
    rng = np.random.default_rng(SEED)
    rows = rng.integers(len(given), size=(DRAWS, len(given)))
    low, high = np.quantile(squares[rows].sum(axis=1) / counts[rows].sum(axis=1), TAILS)
    return Brier(
        int(counts.sum()),
        float(squares.sum() / counts.sum()),
        (float(low), float(high)),
        right * (1.0 - right),
    )
