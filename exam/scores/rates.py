"""Statistics of a campaign of the tracing loop: rates of verdicts and names, reliability of the
probabilities of names, and coverage of the intervals of effects' parameters.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from exam.scores.scored_flight import Outcome, ScoredFlight, Standing
from exam.scoring import EDGES, Bin, Share, binned, share_of_flights, share_within_flights

# ---- How often each verdict is given, what is named in place of what, and how often a name is f

ALL = "all"
NOTHING = "nothing"
NO_NAME = {Outcome.UNEXPLAINED: "unexplained", Outcome.NOTHING: "nothing missing"}


def hidden_label(flight: ScoredFlight) -> str:
    """What was hidden, in words."""
    return " + ".join(flight.hidden) or NOTHING


def standings(flights: Sequence[ScoredFlight]) -> dict[Standing, Share]:
    """The share of each outcome against the truth, with its exact interval."""
    return {
        standing: share_of_flights(flight.standing is standing for flight in flights)
        for standing in Standing
    }


def outcomes(flights: Sequence[ScoredFlight]) -> dict[Outcome, Share]:
    """The share of each outcome, with its exact interval."""
    return {
        outcome: share_of_flights(flight.outcome is outcome for flight in flights)
        for outcome in Outcome
    }


def right_share(flights: Sequence[ScoredFlight]) -> Share:
    """The share of flights in which all that is hidden is named, and nothing else."""
    return share_of_flights(flight.right for flight in flights)


def false_share(flights: Sequence[ScoredFlight]) -> Share:
    """The share of flights with a claim behind which nothing true stands."""
    return share_of_flights(bool(flight.false) for flight in flights)


@dataclass(frozen=True, eq=False)
class Scores:
    """Flights of a campaign with the label of each, under which they are counted together.

    ``by_kind`` : conclusions are told by kinds of effects, for campaigns in which very many effects
    are hidden.
    """

    flights: Sequence[ScoredFlight]
    labels: Sequence[str]
    by_kind: bool = False

    @cached_property
    def groups(self) -> Mapping[str, Sequence[ScoredFlight]]:
        """Flights by label, in the order in which labels come first."""
        found: dict[str, list[ScoredFlight]] = {label: [] for label in self.labels}
        for label, flight in zip(self.labels, self.flights, strict=True):
            found[label].append(flight)
        return found

    @cached_property
    def groups_and_all(self) -> Mapping[str, Sequence[ScoredFlight]]:
        """The same, and where there are several all flights."""
        return self.groups if len(self.groups) < 2 else {**self.groups, ALL: self.flights}

    @cached_property
    def confusion(self) -> Mapping[str, Mapping[str, int]]:
        """Label -> what was concluded -> in how many flights; the commonest first."""
        said = said_by_kind if self.by_kind else said_in_full
        return {
            label: dict(Counter(map(said, group)).most_common())
            for label, group in self.groups.items()
        }


def said_in_full(flight: ScoredFlight) -> str:
    """What was concluded: the names of the claims, or why there is none."""
    return " + ".join(flight.given) or NO_NAME[flight.outcome]


def said_by_kind(flight: ScoredFlight) -> str:
    """The same by the kind of effect: that which was hidden only where it is right, and no more
    where there are several claims.
    """
    if len(flight.given) > 1:
        return "several names"
    if not flight.given:
        return NO_NAME[flight.outcome]
    kind = kind_of(flight.given[0])
    return (
        f"{kind} elsewhere"
        if not flight.right and any(kind_of(name) == kind for name in flight.hidden)
        else kind
    )


def kind_of(name: str) -> str:
    """An effect's name without its channel, input or number: ``"sensor-lag"`` of
    ``"sensor-lag:q"``.
    """
    return name.partition(":")[0].partition("#")[0]


# ---- The probabilities that the loop gives to names, held against how many of them are right

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


# ---- How often the intervals of effects' parameters hold the truth, at one, two and three sigma

SIGMAS = (1, 2, 3)
NORMAL = tuple(100.0 * math.erf(k / math.sqrt(2.0)) for k in SIGMAS)  # % of a normal distribution


def coverage_of(scores: Scores) -> dict[str, tuple[Share, ...]]:
    """By label, and of all flights: the share of parameters of effects named right that are within
    one, two and three sigmas of the truth.

    Parameters of one flight are correlated: intervals count flights. Labels without a parameter are
    left out.
    """
    groups = {
        label: [each.errors.values() for each in group if each.errors]
        for label, group in scores.groups.items()
    }
    groups = {label: errors for label, errors in groups.items() if errors}
    if len(groups) > 1:
        groups[ALL] = [errors for group in groups.values() for errors in group]
    return {label: shares_of(errors) for label, errors in groups.items()}


def shares_of(errors: Sequence[Iterable[float]]) -> tuple[Share, ...]:
    """Of errors in sigmas, flight by flight, the shares within one, two and three."""
    flights = [[abs(value) for value in each] for each in errors]
    return tuple(
        share_within_flights([value < k for value in flight] for flight in flights) for k in SIGMAS
    )
