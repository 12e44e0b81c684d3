"""A survey in lines for the terminal: five of summary, then tables."""

from __future__ import annotations

from scenarios.survey.report.words import (
    belongs_phrase,
    derivative_rows,
    drifts,
    effect_rows,
    flight_rows,
    hints,
    listed,
    news,
    outstanding,
    rivals_phrase,
    single_phrases,
    verdict_of,
    verdicts_phrase,
)
from scenarios.survey.survey import Survey
from scenarios.terminal.paragraphs import WIDTH, wrapped
from scenarios.terminal.summary import BELOW, Summary, summary_lines
from scenarios.terminal.tables import columns_of, table_lines


def survey_text(survey: Survey, width: int = WIDTH, details: str = BELOW) -> str:
    """What a terminal of this width shows."""
    lines = [*summary_lines(summary_of(survey, details), width), ""]
    lines += table_lines(columns_of(*effect_rows(survey), left=3), title="what recurs", width=width)
    for each in survey.recurs:
        told = "; ".join(part for part in (belongs_phrase(each, survey), rivals_phrase(each)) if part)
        lines += wrapped(f"{each.name}: {told}", width)
    lines += ["", *table_lines(columns_of(*derivative_rows(survey), left=2, words=("changes",)), title="derivatives over the flights", width=width)]
    far = [[flight, name, f"{off:+.1f}"] for flight, name, off in outstanding(survey)]
    lines += (
        ["", *table_lines(columns_of(["flight", "derivative", "off, sigmas"], far, left=2), title="flights that stand out", width=width)]
        if far
        else []
    )
    names, rows = flight_rows(survey)
    lines += ["", *table_lines(columns_of(names, rows, left=len(names)), title="flights, the newest first", width=width)]
    for told in (*survey.warnings, *(f"note: {note}" for note in survey.notes), *hints(survey), *single_phrases(survey)):
        lines += wrapped(told, width)
    return "\n".join(lines) + "\n"


def summary_of(survey: Survey, details: str = BELOW) -> Summary:
    """The survey; what recurs; what changes; flights that stand out."""
    word, rest = verdict_of(survey)
    changes = "; ".join(drifts(survey)) or "no derivative changes with a condition beyond chance"
    far = outstanding(survey)
    stands = f"stand out: {listed(list(dict.fromkeys(flight for flight, _, _ in far)))}" if far else "no flight stands out"
    stands = "; ".join(filter(None, (stands, verdicts_phrase(survey))))
    return Summary(f"{survey.flights.title}: {news(survey)}", f"{word}: {rest}", changes, stands, details)
