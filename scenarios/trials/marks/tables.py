"""Rates, names, their probabilities and sigmas of a campaign of the loop, as headings and rows of cells."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from scenarios.trials.marks.marked import Marked, Standing
from scenarios.trials.marks.rates import confusion, grouped, right_share, standings
from scenarios.trials.scoring import Share

ALL = "all"
RATES = (
    "hidden",
    "flights",
    "right",
    "95 % interval",
    "named",
    "among several",
    "unexplained",
    "nothing missing",
    "not among several",
    "wrong",
)
CONFUSED = ("hidden", "concluded", "flights")
_ORDER = (Standing.RIGHT, Standing.AMONG, Standing.UNEXPLAINED, Standing.NOTHING, Standing.BESIDE, Standing.WRONG)


def rate_rows(flights: Sequence[Marked], labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Cells below ``RATES``, by label and for all flights."""
    groups: dict[str, Sequence[Marked]] = {**grouped(flights, labels)}
    rows = [_rates(label, group) for label, group in groups.items()]
    return rows if len(groups) < 2 else [*rows, _rates(ALL, flights)]


def confusion_rows(flights: Sequence[Marked], labels: Sequence[str]) -> list[tuple[str, ...]]:
    """Cells below ``CONFUSED``."""
    found: Mapping[str, Mapping[str, int]] = confusion(flights, labels)
    return [(label, said, str(count)) for label, row in found.items() for said, count in row.items()]


def percent(share: Share) -> tuple[str, str]:
    """A share, and its interval."""
    low, high = share.interval
    return (f"{100.0 * share.count / share.of:.0f} %", f"{100.0 * low:.0f} to {100.0 * high:.0f} %") if share.of else ("-", "-")


def _rates(label: str, flights: Sequence[Marked]) -> tuple[str, ...]:
    found = standings(flights)
    return label, str(len(flights)), *percent(right_share(flights)), *(str(found[each].count) for each in _ORDER)
