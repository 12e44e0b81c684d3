"""Which maneuver tells apart what a record could not."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.diagnosis.report.wording import Wording

_ANY = "a record with inputs of other sizes and other frequencies"


def separating_maneuver(name: str, other: str, wording: Wording | None = None) -> str:
    """What to fly so that two effects can be told apart: as either of them says, else what may help
    with any.
    """
    wording = wording or Wording()
    for one, two in ((name, other), (other, name)):
        base = two.partition(":")[0].partition("#")[0]
        maneuvers = wording.traits(one).separating
        if base in maneuvers:
            return maneuvers[base]
    return _ANY


def separating_maneuvers(
    name: str, others: Sequence[str], wording: Wording | None = None
) -> list[tuple[tuple[str, ...], str]]:
    """The same for several alternatives, those that need the same maneuver together."""
    grouped: dict[str, list[str]] = {}
    for other in others:
        grouped.setdefault(separating_maneuver(name, other, wording), []).append(other)
    return [(tuple(names), maneuver) for maneuver, names in grouped.items()]
