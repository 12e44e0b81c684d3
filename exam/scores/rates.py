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
    """Return the hidden effects in words."""
    return " + ".join(flight.hidden) or NOTHING


def standings(flights: Sequence[ScoredFlight]) -> dict[Standing, Share]:
    """Return the share of each outcome against the truth, with its exact interval."""
    return {
        standing: share_of_flights(flight.standing is standing for flight in flights)
        for standing in Standing
    }


def outcomes(flights: Sequence[ScoredFlight]) -> dict[Outcome, Share]:
    """Return the share of each outcome, with its exact interval."""
    return {
        outcome: share_of_flights(flight.outcome is outcome for flight in flights)
        for outcome in Outcome
    }


def right_share(flights: Sequence[ScoredFlight]) -> Share:
    """Return the share of flights in which all hidden effects, and nothing else, are named."""
    return share_of_flights(flight.right for flight in flights)


def false_share(flights: Sequence[ScoredFlight]) -> Share:
    """Return the share of flights with a claim that does not correspond to any true cause."""
    return share_of_flights(bool(flight.false) for flight in flights)


@dataclass(frozen=True, eq=False)
class Scores:
    """Flights of a campaign, each with the label under which it is counted.

    ``by_kind`` : whether conclusions are counted by kinds of effects, for campaigns with very many
    hidden effects.
    """

    flights: Sequence[ScoredFlight]
    labels: Sequence[str]
    by_kind: bool = False

    @cached_property
    def groups(self) -> Mapping[str, Sequence[ScoredFlight]]:
        """Flights by label, in the order in which labels occur first."""
        found: dict[str, list[ScoredFlight]] = {label: [] for label in self.labels}
        for label, flight in zip(self.labels, self.flights, strict=True):
            found[label].append(flight)
        return found

    @cached_property
    def groups_and_all(self) -> Mapping[str, Sequence[ScoredFlight]]:
        """The groups and, if there are several, all flights."""
        return self.groups if len(self.groups) < 2 else {**self.groups, ALL: self.flights}

    @cached_property
    def confusion(self) -> Mapping[str, Mapping[str, int]]:
        """Label -> conclusion -> number of flights, the most frequent conclusion first."""
        said = said_by_kind if self.by_kind else said_in_full
        return {
            label: dict(Counter(map(said, group)).most_common())
            for label, group in self.groups.items()
        }


def said_in_full(flight: ScoredFlight) -> str:
    """Return the conclusion of a flight: the names of the claims, or why there are none."""
    return " + ".join(flight.given) or NO_NAME[flight.outcome]


def said_by_kind(flight: ScoredFlight) -> str:
    """Return the conclusion by kind of effect.

    The hidden kind is named only if the claim is right. Several claims are not listed one by one.
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
    """Return an effect's name without channel, input or number: ``"sensor-lag"`` for
    ``"sensor-lag:q"``.
    """
    return name.partition(":")[0].partition("#")[0]


# ---- The probabilities that the loop gives to names, held against how many of them are right

DRAWS = 2000  # bootstrap samples
SEED = 1  # the same flights give the same interval
TAILS = (0.025, 0.975)


@dataclass(frozen=True)
class Brier:
    """Brier score of the claimed names: mean of (probability - 1)^2 for right names and
    probability^2 for wrong ones.

    ``count`` is the number of names, and ``interval`` the 95 % interval by resampling whole
    flights. ``constant`` is the score of a constant probability, the share of right names.
    """

    count: int
    score: float
    interval: tuple[float, float]
    constant: float


def reliability_of(flights: Sequence[ScoredFlight]) -> tuple[Bin, ...]:
    """Return how often names are right, by the probability that was given.

    Alternatives of claims are included. Names less likely than ``EDGES[0]`` are left out.
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
    """Return the Brier score of the claimed names; None without any."""
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
    """Return, by label and for all flights, the shares of effect parameters within one, two and
    three sigmas of the truth.

    Only effects that are named right count. Parameters of one flight are correlated, so that
    intervals are over flights. Labels without a parameter are left out.
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
    """Return the shares of errors (in sigmas, by flight) within one, two and three sigmas."""
    flights = [[abs(value) for value in each] for each in errors]
    return tuple(
        share_within_flights([value < k for value in flight] for flight in flights) for k in SIGMAS
    )
