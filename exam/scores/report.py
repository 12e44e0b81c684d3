"""The statistics of a campaign of the tracing loop as tables, in the terminal, in ``campaign.json``
and on its page.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from exam.scores.rates import (
    SIGMAS,
    Scores,
    brier,
    coverage_of,
    false_share,
    outcomes,
    reliability_of,
    right_share,
    standings,
)
from exam.scores.scored_flight import ScoredFlight, Standing
from exam.scoring import Share
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.report.document import (
    MISSING,
    PURE,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Section,
    as_sentence,
    capital,
    counted,
    formatted,
    section,
)
from scenarios.report.figure_formats import Drawn, Formats
from scenarios.report.folder import figures, write_page
from scenarios.report.summary import WIDTH, wrapped
from scenarios.report.terminal import rows_table, table_as_lines

# ---- Rates, names, their probabilities and sigmas of a campaign of the loop, as headings and ro

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
    """Return the cells of the columns ``RATES``, by label and for all flights."""
    return [_rates(label, group) for label, group in scores.groups_and_all.items()]


def confusion_rows(scores: Scores) -> list[tuple[Cell, ...]]:
    """Return the cells of the columns ``CONFUSED``."""
    return [
        (label, said, counted(count))
        for label, row in scores.confusion.items()
        for said, count in row.items()
    ]


def said_rows(flights: Sequence[ScoredFlight]) -> list[tuple[Cell, ...]]:
    """Return the cells of the columns ``SAID``: names by the probability that was given."""
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
    """Return a sentence on the Brier score of the claimed names; empty without any."""
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
    """Return the cells of the columns ``COVERED``."""
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
    """Return a share as a number in per cent."""
    if not share.of:
        return MISSING
    return Number(100.0 * share.count / share.of, unit="%", shown=percent(share)[0])


def share_cells(share: Share) -> tuple[Cell, ...]:
    """Return a count, its share in per cent, and the 95 % interval."""
    low, high = share.interval
    part = 100.0 * share.count / share.of
    return (
        Number(share.count, shown=f"{share.count} of {share.of}"),
        Number(part, unit="%", shown=f"{part:.1f} %"),
        f"{100.0 * low:.1f} to {100.0 * high:.1f} %",
    )


def percent(share: Share) -> tuple[str, str]:
    """Return a share and its interval as a text."""
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


# ---- The statistics of a campaign of the loop in the terminal

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
    """Return the blocks of lines for the terminal; empty blocks are left out."""
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
    """Return a sentence on false names in flights with nothing hidden; empty without any."""
    share = false_share([each for each in flights if not each.hidden])
    if not share.of:
        return ""
    return (
        f"false names on the {share.of} flights with nothing hidden: {share.count}, "
        f"{percent(share)[0]} (95 % interval {percent(share)[1]})"
    )


# ---- The statistics of a campaign of the loop for ``campaign.json``


def scores_content(scores: Scores) -> dict[str, Any]:
    """Return the content of ``campaign.json``: rates by label, conclusions, false names,
    probabilities and coverage. A share is a count, a total and an interval.
    """
    flights = scores.flights
    score = brier(flights)
    return {
        "rates": {label: _rates_content(group) for label, group in scores.groups.items()},
        "all": _rates_content(flights),
        "concluded": {label: dict(row) for label, row in scores.confusion.items()},
        "false_names_on_clean": share_content(
            false_share([each for each in flights if not each.hidden])
        ),
        "reliability": [
            {**asdict(item), "interval": list(item.interval)} for item in reliability_of(flights)
        ],
        **({} if score is None else {"brier": {**asdict(score), "interval": list(score.interval)}}),
        "coverage": {
            label: {
                f"within_{k}_sigma": share_content(share)
                for k, share in zip(SIGMAS, shares, strict=True)
            }
            for label, shares in coverage_of(scores).items()
        },
    }


def score_cells(flight: ScoredFlight) -> dict[str, Any]:
    """Return the cells of a row for a flight; None for a cell without a value.

    ``error_sigmas`` is the largest error of a parameter.
    """
    errors, first = (
        [*flight.errors.values()],
        next((each for each in flight.stated if each.first), None),
    )
    return {
        **{
            "hidden": " + ".join(flight.hidden),
            "verdict": flight.verdict,
            "outcome": flight.outcome.value,
            "right": flight.right,
        },
        **{
            "name": " + ".join(flight.given),
            "false": " + ".join(flight.false),
            "probability": first.probability if first else None,
        },
        **{
            "error_sigmas": max(errors, key=abs) if errors else None,
            "errors": json.dumps(dict(flight.errors)),
        },
        **{"held_out_before": flight.held_out_before, "held_out_after": flight.held_out_after},
    }


def share_content(share: Share) -> dict[str, Any]:
    """Return a share as plain data."""
    return {"count": share.count, "of": share.of, "interval": list(share.interval)}


def _rates_content(flights: Sequence[ScoredFlight]) -> dict[str, Any]:
    return {
        "right": share_content(right_share(flights)),
        "false": share_content(false_share(flights)),
        "outcomes": {
            outcome.value: share_content(share) for outcome, share in outcomes(flights).items()
        },
        "standings": {
            standing.value: share.count for standing, share in standings(flights).items()
        },
    }


# ---- The statistics of a campaign of the loop on its page

_RATES, _CONFUSION, _RELIABILITY, _COVERAGE = (
    "verdicts",
    "confusion",
    "reliability",
    "effect_coverage",
)


def drawn_scores(scores: Scores, name: str, folder: Path, formats: Formats) -> tuple[Drawn, ...]:
    """Draw the figures of the campaign ``name`` into a folder and for its page; none without a
    format.
    """
    if not formats or not scores.flights:
        return ()
    from exam.scores.figures import scores_figures
    from scenarios.plots.drawing import draw_for_page

    return draw_for_page(scores_figures(scores, name), folder, formats)


def scores_sections(scores: Scores, drawn: Sequence[Drawn] = ()) -> tuple[Section, ...]:
    """Return the sections on verdicts, names, their probabilities and the coverage of parameters,
    with the figures that are ``drawn``.
    """

    def shown(stem: str) -> list[Drawn]:
        return [each for each in drawn if each.stem == stem]

    clean, score = clean_sentence(scores.flights), brier_sentence(scores.flights)
    return (
        *section(
            "Answers by what was hidden",
            Prose(as_sentence(RIGHT), "note"),
            *figures(shown(_RATES)),
            rows_table("Rates of each verdict", RATES, rate_rows(scores)),
            Prose(as_sentence(clean)) if clean else None,
        ),
        *section(
            "What is named",
            *figures(shown(_CONFUSION)),
            rows_table(capital(CONCLUDED), CONFUSED, confusion_rows(scores)),
        ),
        *section(
            "How reliable the probabilities of names are",
            *figures(shown(_RELIABILITY)),
            rows_table(capital(NAMES), SAID, said_rows(scores.flights)),
            Prose(as_sentence(score)) if score else None,
        ),
        *section(
            "How often sigmas of effects hold",
            *figures(shown(_COVERAGE)),
            rows_table(
                "Parameters of effects within so many sigmas of the truth",
                COVERED,
                covered_rows(scores),
            ),
            Prose(as_sentence(PARAMETERS), "note")
            if any(flight.errors for flight in scores.flights)
            else None,
        ),
    )


def write_campaign_folder(
    out: str | Path,
    name: str,
    scores: Scores,
    columns: Sequence[str],
    rows: Iterable[Sequence[Any]],
    content: Mapping[str, Any],
    paged: Callable[[Sequence[Drawn]], Page],
    formats: Formats,
) -> Path:
    """Write the folder of a campaign and return it.

    It has ``flights.csv`` with ``columns`` and ``rows``, the figures, the page that ``paged`` makes
    with them, and ``campaign.json`` (last) with ``content``, scores and versions.
    """
    with study_folder(out, "campaign.json") as scratch:
        text = io.StringIO(newline="")
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows([columns, *rows])
        write_text(scratch / "flights.csv", text.getvalue())
        write_page(scratch, paged(drawn_scores(scores, name, scratch, formats)))
        write_json(
            scratch / "campaign.json",
            {**content, "marks": scores_content(scores), "versions": versions()},
        )
    return Path(out)
