"""The statistics of a campaign of the loop on its page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from exam.scores.rates import Scores
from exam.scores.tables import (
    CONFUSED,
    COVERED,
    RATES,
    SAID,
    brier_sentence,
    confusion_rows,
    covered_rows,
    rate_rows,
    said_rows,
)
from exam.scores.text import CONCLUDED, NAMES, PARAMETERS, RIGHT, clean_sentence
from scenarios.report.document import Prose, Section, as_sentence, capital, section
from scenarios.report.figure_formats import Drawn, Formats
from scenarios.report.folder import figures
from scenarios.report.terminal import rows_table

_RATES, _CONFUSION, _RELIABILITY, _COVERAGE = (
    "verdicts",
    "confusion",
    "reliability",
    "effect_coverage",
)


def drawn_scores(scores: Scores, name: str, folder: Path, formats: Formats) -> tuple[Drawn, ...]:
    """The figures of a campaign, drawn into a folder and for its page; none without a format.
    ``name`` : of the campaign.
    """
    if not formats or not scores.flights:
        return ()
    from exam.scores.figures import scores_figures
    from scenarios.plots.drawing import draw_for_page

    return draw_for_page(scores_figures(scores, name), folder, formats)


def scores_sections(scores: Scores, drawn: Sequence[Drawn] = ()) -> tuple[Section, ...]:
    """Verdicts, names, their probabilities and the coverage of parameters, each with its figure if
    that is ``drawn``.
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
