"""The folder of a survey: document, derivatives, figures and page."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.tracing.diagnosis import Verdict
from scenarios.files.writing import file_stems, study_folder, write_json, write_text
from scenarios.plots import draw_into
from scenarios.report.document import (
    Bullets,
    Page,
    Prose,
    as_sentence,
    capital,
    now,
    reproduction,
    section,
)
from scenarios.report.figure_formats import USUAL as USUAL_FORMATS
from scenarios.report.figure_formats import Drawn, Formats
from scenarios.report.folder import figures, write_page
from scenarios.survey.flights import FOLDER
from scenarios.survey.growing import MAIN
from scenarios.survey.recurring import LIBRARY_SIZE, Derivative
from scenarios.survey.report import (
    belongs_phrase,
    counts_phrase,
    derivatives_table,
    derivatives_text,
    drift_phrases,
    effects_table,
    flights_table,
    listed,
    new_flight_phrases,
    other_cause_phrases,
    outlying_table,
    rivals_phrase,
    single_phrases,
    survey_content,
    verdict_of,
    verdicts_phrase,
)
from scenarios.survey.survey import SurveyResult

if TYPE_CHECKING:
    from scenarios.plots.drawing import Named
    from scenarios.plots.maneuvers import OverCondition


# ---- What the figures of a survey are given

# what arms are drawn over, the first that varies
USUAL = ("airspeed", "reference_airspeed", "mach", "Mach", "mass", "altitude")


def survey_figures(survey: SurveyResult) -> Iterator[Named]:
    """Yield the effects by flight; shared values over the condition; derivatives over the condition
    with which they change.
    """
    from scenarios.plots.maneuvers import (
        Shared,
        figure_effects,
        figure_over_condition,
        figure_shared,
    )

    title = survey.flights.title
    if survey.recurs:
        flights = survey.recurs[0].flights
        probabilities = {each.name: each.recurrence.probability for each in survey.recurs}
        yield (
            "effects",
            partial(
                figure_effects, flights, probabilities, f"{title}: which flight has which effect"
            ),
        )
    condition = next(
        (name for name in (*USUAL, *survey.conditions) if name in survey.conditions), None
    )
    if condition is None:
        return
    at, unit = survey.conditions[condition], survey.condition_units[condition]
    rows = []
    for each in survey.recurs:
        here = [number for number, name in enumerate(each.flights) if name in at]
        has = np.array([each.flights[number] in each.has for number in here])
        where = np.array([at[each.flights[number]] for number in here])
        sigma = float(np.sqrt(each.recurrence.covariance[0, 0]))
        (local, own), *_ = each.parameters.items()
        rows.append(
            Shared(
                f"{each.name} {local}",
                own,
                where,
                each.values[here, 0],
                each.sigmas[here, 0],
                has,
                float(each.recurrence.value[0]),
                sigma,
            )
        )
    if rows:
        yield (
            "shared",
            partial(
                figure_shared,
                rows,
                condition,
                unit,
                f"{title}: each flight by itself, and the common value",
            ),
        )
    stems = file_stems(list(survey.conditions))
    for name in dict.fromkeys(_condition(each, condition) for each in survey.derivatives):
        mine = [
            _over_condition(each, survey, name)
            for each in survey.derivatives
            if _condition(each, condition) == name
        ]
        yield (
            f"over_{stems[name]}",
            partial(
                figure_over_condition,
                mine,
                name,
                survey.condition_units[name],
                f"{title}: derivatives over {name}",
            ),
        )


def _condition(each: Derivative, usual: str) -> str:
    """Return the condition that a derivative is drawn over: the one with which it changes."""
    return each.drifts[0] if each.drifts is not None else usual


def _over_condition(each: Derivative, survey: SurveyResult, condition: str) -> OverCondition:
    from scenarios.plots.maneuvers import Line, OverCondition

    at = survey.conditions[condition]
    here = [number for number, name in enumerate(each.flights) if name in at]
    where = np.array([at[each.flights[number]] for number in here])
    along = np.linspace(where.min(), where.max(), 60) if len(where) else np.zeros(0)
    drift = each.drifts
    if drift is not None:
        middle, sigma = drift[1].band(along)
        between = drift[1].scatter
    else:
        middle = np.full_like(along, each.common.value)
        sigma, between = np.full_like(along, each.common.sigma), each.common.scatter
    return OverCondition(
        each.name,
        each.unit,
        where,
        each.values[here],
        each.sigmas[here],
        each.out[here],
        Line(along, middle, sigma, between),
    )


# ---- The page of a survey: opened each morning, what is new first

HOW = (
    "Each flight was fitted with every combination of the effects that several flights name. An "
    "effect recurs if the flights agree on one value of it more than chance explains, even without "
    "the flight that shows it most. A flight has it, or does not have it, at 95 % probability. "
    "The derivatives of a flight are estimated with its own effects; shared values are known from "
    "the other flights"
)


def survey_page(
    survey: SurveyResult, figure_files: Sequence[Drawn] = (), linked: Collection[str] = ()
) -> Page:
    """The page of a survey with its figures; flights in ``linked`` have a page of their own."""
    word, rest = verdict_of(survey)
    texts = [
        f"{each.name}: {part}"
        for each in survey.recurs
        for part in (belongs_phrase(each, survey), rivals_phrase(each))
        if part
    ]
    alone = single_phrases(survey)
    return Page(
        title=f"{survey.flights.title}: survey",
        kind=f"{survey.flights.model} model, {len(survey.survey_files.diagnoses)} flights",
        verdict=capital(word.lower()),
        tone=_tone(survey),
        sentence=as_sentence(rest),
        summary=tuple(
            map(
                as_sentence,
                map(
                    capital,
                    filter(
                        None,
                        [counts_phrase(survey), verdicts_phrase(survey), *drift_phrases(survey)],
                    ),
                ),
            )
        ),
        warnings=tuple(map(as_sentence, survey.warnings)),
        sections=(
            *section("Figures", *figures(figure_files)),
            *section(
                "New since the last survey",
                Bullets(tuple(map(as_sentence, map(capital, new_flight_phrases(survey))))),
            ),
            *section(
                "Recurring effects",
                effects_table(survey),
                Bullets(tuple(map(as_sentence, texts))),
                Prose(as_sentence(HOW), "note"),
            ),
            *section(
                "Derivatives",
                derivatives_table(survey),
                Bullets(tuple(map(as_sentence, other_cause_phrases(survey)))),
            ),
            *section("Flights that stand out", outlying_table(survey)),
            *section(
                "Flights", flights_table(survey, linked), Bullets(tuple(map(as_sentence, alone)))
            ),
            *section(
                "Assumptions", Bullets(tuple(map(as_sentence, (*_rests(survey), *survey.notes))))
            ),
        ),
        reproduction=reproduction(
            ["flightid", "survey", str(survey.flights.path)],
            "",
            [("survey", survey.flights.path.name, survey.flights.sha256)],
        ),
        created=now(),
    )


def _tone(survey: SurveyResult) -> str:
    if not survey.survey_files.diagnoses:
        return "open"
    return (
        "fair"
        if survey.recurs or survey.warnings or survey.verdicts.get(Verdict.UNEXPLAINED.value)
        else "good"
    )


def _rests(survey: SurveyResult) -> list[str]:
    tried = listed(survey.tried, 10) or "none, since no two flights name the same"
    return [
        f"Effects tested on all flights: {tried}",
        f"The chance of a false recurrence is corrected for {LIBRARY_SIZE} candidates "
        "(Bonferroni); trends and differences are tested at a false discovery rate of 5 %",
        "Sigmas of common values and trends include the scatter between flights (restricted "
        "maximum likelihood, Hartung and Knapp)",
        "Flights are combined by their estimates and covariances, which equals a joint fit where "
        "each likelihood is quadratic",
        "A trend is fitted with one condition at a time: where two conditions are correlated, "
        "either may be the cause",
    ]


# ---- The folder of a survey


def write_survey(
    survey: SurveyResult, folder: str | Path, *, figures: Formats = USUAL_FORMATS
) -> Path:
    """Write ``derivatives.csv``, figures, the page and ``survey.json``, whole or not at all; the
    folder. ``flights/`` is left as it is.
    """
    with study_folder(folder, MAIN) as scratch:
        write_text(scratch / "derivatives.csv", derivatives_text(survey))
        figure_files = draw_into(scratch, survey_figures(survey), figures)
        linked = [
            name
            for name in survey.survey_files.diagnoses
            if (Path(folder) / FOLDER / name / "report.html").is_file()
        ]
        write_page(scratch, survey_page(survey, figure_files, linked))
        write_json(scratch / MAIN, survey_content(survey, now()))
    return Path(folder)
