"""How often each verdict is given, what is named in place of what, and how often a name is false where nothing is hidden."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from scenarios.trials.marks.marked import Marked, Outcome, Standing
from scenarios.trials.scoring import Share, share_of_flights

NOTHING = "nothing"
NO_NAME = {Outcome.UNEXPLAINED: "unexplained", Outcome.NOTHING: "nothing missing"}


def grouped(flights: Sequence[Marked], labels: Sequence[str]) -> dict[str, list[Marked]]:
    """Flights by the label of each, in the order in which labels come first."""
    groups: dict[str, list[Marked]] = {label: [] for label in labels}
    for label, flight in zip(labels, flights, strict=True):
        groups[label].append(flight)
    return groups


def hidden_label(flight: Marked) -> str:
    """What was hidden, in words."""
    return " + ".join(flight.hidden) or NOTHING


def standings(flights: Sequence[Marked]) -> dict[Standing, Share]:
    """The share of each outcome against the truth, with its exact interval."""
    return {standing: share_of_flights(flight.standing is standing for flight in flights) for standing in Standing}


def outcomes(flights: Sequence[Marked]) -> dict[Outcome, Share]:
    """The share of each outcome, with its exact interval."""
    return {outcome: share_of_flights(flight.outcome is outcome for flight in flights) for outcome in Outcome}


def right_share(flights: Sequence[Marked]) -> Share:
    """The share of flights in which all that is hidden is named, and nothing else."""
    return share_of_flights(flight.right for flight in flights)


def false_share(flights: Sequence[Marked]) -> Share:
    """The share of flights with a claim behind which nothing true stands."""
    return share_of_flights(bool(flight.false) for flight in flights)


def said(flight: Marked) -> str:
    """What was concluded: the names of the claims, or why there is none."""
    return " + ".join(flight.given) or NO_NAME[flight.outcome]


def confusion(flights: Sequence[Marked], labels: Sequence[str]) -> Mapping[str, Mapping[str, int]]:
    """Label of a flight -> what was concluded -> in how many flights; conclusions by how often they come."""
    return {label: dict(Counter(said(flight) for flight in group).most_common()) for label, group in grouped(flights, labels).items()}
