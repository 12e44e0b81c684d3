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
from scenarios.report.document import MISSING, PURE, Cell, Column, Number, counted, formatted

RATES = (
    Column("hidden"),
    Column("flights", PURE),
    Column("right", PURE),
    Column("95 % interval", right=True),
    *(
        Column(heading, PURE)
        for heading in ("named", "among several", "unexplained", "nothing missing", "wrong")
    ),
)
SAID = (
    Column("probability said, %"),
    Column("names", PURE),
    Column("mean said", "%"),
    Column("right", "%"),
    Column("95 % interval, %", right=True),
)
COVERED = (
    Column("hidden"),
    Column("parameters", PURE),
    *(Column(f"within {k} sigma", PURE) for k in SIGMAS),
    Column("95 % interval of 2 sigma", right=True),
)
CONFUSED = (Column("hidden"), Column("concluded"), Column("flights", PURE))
# columns of ``share_cells``
SHARED = (Column("count", PURE), Column("percent", PURE), Column("95 % interval", right=True))
_TOLD = (
    (Standing.RIGHT,),
    (Standing.AMONG,),
    (Standing.UNEXPLAINED,),
    (Standing.NOTHING,),
    (Standing.BESIDE, Standing.WRONG),
)


def rate_rows(scores: Scores) -> list[tuple[Cell, ...]]:
    """Cells below ``RATES``, by label and for all flights."""
    return [_rates(label, group) for label, group in scores.groups_and_all.items()]


def confusion_rows(scores: Scores) -> list[tuple[Cell, ...]]:
    """Cells below ``CONFUSED``."""
    return [
        (label, said, counted(count))
        for label, row in scores.confusion.items()
        for said, count in row.items()
    ]


def said_rows(flights: Sequence[ScoredFlight]) -> list[tuple[Cell, ...]]:
    """Cells below ``SAID``: names by the probability that they were given."""
    rows: list[tuple[Cell, ...]] = []
    for item in reliability_of(flights):
        low, high = item.interval
        right: tuple[Cell, Cell] = (MISSING, MISSING)
        if item.count:
            share = formatted(100.0 * item.right / item.count, ".0f")
            right = (share, f"{100.0 * low:.0f} to {100.0 * high:.0f}")
        rows.append(
            (
                f"{100 * item.low:.0f} to {100 * item.high:.0f}",
                counted(item.count),
                formatted(100.0 * item.said if item.count else None, ".1f"),
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


def covered_rows(scores: Scores) -> list[tuple[Cell, ...]]:
    """Cells below ``COVERED``."""
    rows: list[tuple[Cell, ...]] = []
    for label, shares in coverage_of(scores).items():
        rows.append(
            (
                label,
                counted(shares[0].of),
                *(percent_cell(share) for share in shares),
                percent(shares[1])[1],
            )
        )
    return rows


def percent_cell(share: Share) -> Cell:
    """A share as a number."""
    if not share.of:
        return MISSING
    return Number(100.0 * share.count / share.of, unit="%", shown=percent(share)[0])


def share_cells(share: Share) -> tuple[Cell, ...]:
    """A count, its share in per cent, and the 95 % interval."""
    low, high = share.interval
    part = 100.0 * share.count / share.of
    return (
        Number(share.count, shown=f"{share.count} of {share.of}"),
        Number(part, unit="%", shown=f"{part:.1f} %"),
        f"{100.0 * low:.1f} to {100.0 * high:.1f} %",
    )


def percent(share: Share) -> tuple[str, str]:
    """A share, and its interval."""
    low, high = share.interval
    return (
        (f"{100.0 * share.count / share.of:.0f} %", f"{100.0 * low:.0f} to {100.0 * high:.0f} %")
        if share.of
        else ("-", "-")
    )


def _rates(label: str, flights: Sequence[ScoredFlight]) -> tuple[Cell, ...]:
    found, right = standings(flights), right_share(flights)
    return (
        label,
        counted(len(flights)),
        percent_cell(right),
        percent(right)[1],
        *(counted(sum(found[each].count for each in told)) for told in _TOLD),
    )
