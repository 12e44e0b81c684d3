"""How often each verdict is given, what is named in place of what, and how often a name is false
where nothing is hidden.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from exam.scores.scored_flight import Outcome, ScoredFlight, Standing
from exam.scoring import Share, share_of_flights

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
