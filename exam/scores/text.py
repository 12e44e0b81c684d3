"""The statistics of a campaign of the loop in the terminal."""

from __future__ import annotations

from collections.abc import Sequence

from exam.scores.rates import Scores, false_share
from exam.scores.scored_flight import ScoredFlight
from exam.scores.tables import (
    CONFUSED,
    COVERED,
    RATES,
    SAID,
    brier_sentence,
    confusion_rows,
    covered_rows,
    percent,
    rate_rows,
    said_rows,
)
from scenarios.report.summary import WIDTH, wrapped
from scenarios.report.terminal import rows_table, table_as_lines

RIGHT = (
    "rates of each verdict; right: what is hidden is named, or among the names of an ambiguous "
    "verdict, and nothing that does not act"
)
CONCLUDED = "what was concluded in place of what was hidden"
NAMES = "names by the probability that they were given, alternatives among them"
PARAMETERS = (
    "parameters of effects that are named right, within so many reported sigmas of the truth; 68, "
    "95 and 99.7 % where sigmas are right"
)


def scores_blocks(scores: Scores, width: int = WIDTH) -> list[list[str]]:
    """Blocks of lines; those in which there is nothing are left out."""
    blocks = [
        table_as_lines(rows_table(RIGHT, RATES, rate_rows(scores)), width),
        table_as_lines(rows_table(CONCLUDED, CONFUSED, confusion_rows(scores)), width, keys=2),
        wrapped(clean_sentence(scores.flights), width),
        table_as_lines(rows_table(NAMES, SAID, said_rows(scores.flights)), width),
        wrapped(brier_sentence(scores.flights), width),
        table_as_lines(rows_table(PARAMETERS, COVERED, covered_rows(scores)), width),
    ]
    return [block for block in blocks if block and any(block)]


def clean_sentence(flights: Sequence[ScoredFlight]) -> str:
    """False names where nothing is hidden; empty where something always is."""
    share = false_share([each for each in flights if not each.hidden])
    if not share.of:
        return ""
    return (
        f"false names on the {share.of} flights with nothing hidden: {share.count}, "
        f"{percent(share)[0]} (95 % interval {percent(share)[1]})"
    )
