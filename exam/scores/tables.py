"""Rates, names, their probabilities and sigmas of a campaign of the loop, as headings and rows of
cells.
"""

from __future__ import annotations

from collections.abc import Sequence

from exam.scores.coverage import SIGMAS, coverage_of
from exam.scores.probabilities import brier, reliability_of
from exam.scores.rates import Scores, right_share, standings
from exam.scores.scored_flight import ScoredFlight, Standing
from exam.scoring import Share

RATES = (
    "hidden",
    "flights",
    "right",
    "95 % interval",
    "named",
    "among several",
    "unexplained",
    "nothing missing",
    "wrong",
)
SAID = ("probability said, %", "names", "mean said, %", "right, %", "95 % interval, %")
COVERED = (
    "hidden",
    "parameters",
    *(f"within {k} sigma" for k in SIGMAS),
    "95 % interval of 2 sigma",
)
CONFUSED = ("hidden", "concluded", "flights")
_TOLD = (
    (Standing.RIGHT,),
    (Standing.AMONG,),
    (Standing.UNEXPLAINED,),
    (Standing.NOTHING,),
    (Standing.BESIDE, Standing.WRONG),
)


def rate_rows(scores: Scores) -> list[tuple[str, ...]]:
    """Cells below ``RATES``, by label and for all flights."""
    return [_rates(label, group) for label, group in scores.groups_and_all.items()]


def confusion_rows(scores: Scores) -> list[tuple[str, ...]]:
    """Cells below ``CONFUSED``."""
    return [
        (label, said, str(count))
        for label, row in scores.confusion.items()
        for said, count in row.items()
    ]


def said_rows(flights: Sequence[ScoredFlight]) -> list[tuple[str, ...]]:
    """Cells below ``SAID``: names by the probability that they were given."""
    rows: list[tuple[str, ...]] = []
    for item in reliability_of(flights):
        low, high = item.interval
        right = (
            (f"{100.0 * item.right / item.count:.0f}", f"{100.0 * low:.0f} to {100.0 * high:.0f}")
            if item.count
            else ("-", "-")
        )
        rows.append(
            (
                f"{100 * item.low:.0f} to {100 * item.high:.0f}",
                str(item.count),
                f"{100.0 * item.said:.1f}" if item.count else "-",
                *right,
            )
        )
    return rows if any(flight.stated for flight in flights) else []


def brier_sentence(flights: Sequence[ScoredFlight]) -> str:
    """The score of the names that are given; empty where there is none."""
    score = brier(flights)
    if score is None:
        return ""
    low, high = score.interval
    told = (
        f"Brier score of the {score.count} names given: {score.score:.3f} (95 % interval {low:.3f} "
        f"to {high:.3f})"
    )
    return (
        f"{told}; one probability for all would have {score.constant:.3f}, certainty that holds 0"
    )


def covered_rows(scores: Scores) -> list[tuple[str, ...]]:
    """Cells below ``COVERED``."""
    rows = []
    for label, shares in coverage_of(scores).items():
        rows.append(
            (
                label,
                str(shares[0].of),
                *(percent(share)[0] for share in shares),
                percent(shares[1])[1],
            )
        )
    return rows


def percent(share: Share) -> tuple[str, str]:
    """A share, and its interval."""
    low, high = share.interval
    return (
        (f"{100.0 * share.count / share.of:.0f} %", f"{100.0 * low:.0f} to {100.0 * high:.0f} %")
        if share.of
        else ("-", "-")
    )


def _rates(label: str, flights: Sequence[ScoredFlight]) -> tuple[str, ...]:
    found = standings(flights)
    return (
        label,
        str(len(flights)),
        *percent(right_share(flights)),
        *(str(sum(found[each].count for each in told)) for told in _TOLD),
    )
