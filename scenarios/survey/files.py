"""The folder of a survey: document, derivatives, figures and page."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
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
from scenarios.survey.recurring import LIBRARY_SIZE
from scenarios.survey.report import (
    belongs_phrase,
    counts_phrase,
    derivatives_table,
    derivatives_text,
    drift_phrases,
    effects_table,
    flights_table,
    names_and_count,
    new_flight_phrases,
    other_cause_phrases,
    outlying_table,
    rivals_phrase,
    single_phrases,
    survey_content,
    verdict_of,
    verdicts_phrase,
)
from scenarios.survey.survey import Derivative, SurveyResult

if TYPE_CHECKING:
    from scenarios.plots.drawing import Named
    from scenarios.plots.maneuvers import OverCondition


# ---- Figures

# Conditions on the horizontal axis of figures; the first that differs between flights is taken.
USUAL_CONDITIONS = ("airspeed", "reference_airspeed", "mach", "Mach", "mass", "altitude")


def survey_figures(survey: SurveyResult) -> Iterator[Named]:
    """Yield the figures: effects by flight, and effects and derivatives over conditions."""
    from scenarios.plots.maneuvers import (
        Shared,
        figure_effects,
        figure_over_condition,
        figure_shared,
    )

    title = survey.flights.title
    if survey.recurs:
        flights = survey.recurs[0].flights
        probabilities = {effect.name: effect.recurrence.probability for effect in survey.recurs}
        yield (
            "effects",
            partial(
                figure_effects, flights, probabilities, f"{title}: which flight has which effect"
            ),
        )
    condition = next(
        (name for name in (*USUAL_CONDITIONS, *survey.conditions) if name in survey.conditions),
        None,
    )
    if condition is None:
        return
    by_flight, unit = survey.conditions[condition], survey.condition_units[condition]
    rows = []
    for effect in survey.recurs:
        names, places, where = _flights_at(effect.flights, by_flight)
        (parameter, parameter_unit), *_ = effect.parameters.items()
        rows.append(
            Shared(
                f"{effect.name} {parameter}",
                parameter_unit,
                where,
                effect.values[places, 0],
                effect.sigmas[places, 0],
                np.array([name in effect.has for name in names]),
                float(effect.recurrence.value[0]),
                float(np.sqrt(effect.recurrence.covariance[0, 0])),
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
    for name in dict.fromkeys(_condition(item, condition) for item in survey.derivatives):
        shown = [
            _over_condition(item, survey, name)
            for item in survey.derivatives
            if _condition(item, condition) == name
        ]
        yield (
            f"over_{stems[name]}",
            partial(
                figure_over_condition,
                shown,
                name,
                survey.condition_units[name],
                f"{title}: derivatives over {name}",
            ),
        )


def _flights_at(
    flights: Sequence[str], by_flight: Mapping[str, float]
) -> tuple[list[str], list[int], np.ndarray]:
    """Return the flights with a known condition: names, places among all flights, conditions."""
    places = [place for place, name in enumerate(flights) if name in by_flight]
    names = [flights[place] for place in places]
    return names, places, np.array([by_flight[name] for name in names])


def _condition(derivative: Derivative, usual: str) -> str:
    """Return the condition with which a derivative changes, else the ``usual`` one."""
    return derivative.drifts[0] if derivative.drifts is not None else usual


def _over_condition(derivative: Derivative, survey: SurveyResult, condition: str) -> OverCondition:
    """Return a derivative for its figure: the flights, and the trend or the common value."""
    from scenarios.plots.maneuvers import Line, OverCondition

    _, places, where = _flights_at(derivative.flights, survey.conditions[condition])
    grid = np.linspace(where.min(), where.max(), 60) if len(where) else np.zeros(0)
    if derivative.drifts is not None:
        trend = derivative.drifts[1]
        middle, sigma = trend.band(grid)
        scatter = trend.scatter
    else:
        middle = np.full_like(grid, derivative.common.value)
        sigma = np.full_like(grid, derivative.common.sigma)
        scatter = derivative.common.scatter
    return OverCondition(
        derivative.name,
        derivative.unit,
        where,
        derivative.values[places],
        derivative.sigmas[places],
        derivative.out[places],
        Line(grid, middle, sigma, scatter),
    )


# ---- The page of a survey

METHOD = (
    "Each flight was fitted with every combination of the effects that several flights name. An "
    "effect recurs if the flights agree on one value of it more than chance explains, even without "
    "the flight that shows it most. A flight has it, or does not have it, at 95 % probability. "
    "The derivatives of a flight are estimated with its own effects; shared values are known from "
    "the other flights"
)


def survey_page(
    survey: SurveyResult, figure_files: Sequence[Drawn] = (), linked: Collection[str] = ()
) -> Page:
    """Return the page of a survey with its figures; ``linked`` flights have pages of their own."""
    word, rest = verdict_of(survey)
    effect_phrases = [
        f"{effect.name}: {phrase}"
        for effect in survey.recurs
        for phrase in (belongs_phrase(effect, survey), rivals_phrase(effect))
        if phrase
    ]
    summary = filter(None, [counts_phrase(survey), verdicts_phrase(survey), *drift_phrases(survey)])
    return Page(
        title=f"{survey.flights.title}: survey",
        kind=f"{survey.flights.model} model, {len(survey.survey_files.diagnoses)} flights",
        verdict=capital(word.lower()),
        tone=_tone(survey),
        sentence=as_sentence(rest),
        summary=_sentences(map(capital, summary)),
        warnings=_sentences(survey.warnings),
        sections=(
            *section("Figures", *figures(figure_files)),
            *section(
                "New since the last survey",
                Bullets(_sentences(map(capital, new_flight_phrases(survey)))),
            ),
            *section(
                "Recurring effects",
                effects_table(survey),
                Bullets(_sentences(effect_phrases)),
                Prose(as_sentence(METHOD), "note"),
            ),
            *section(
                "Derivatives",
                derivatives_table(survey),
                Bullets(_sentences(other_cause_phrases(survey))),
            ),
            *section("Flights that stand out", outlying_table(survey)),
            *section(
                "Flights",
                flights_table(survey, linked),
                Bullets(_sentences(single_phrases(survey))),
            ),
            *section("Assumptions", Bullets(_sentences((*_assumptions(survey), *survey.notes)))),
        ),
        reproduction=reproduction(
            ["flightid", "survey", str(survey.flights.path)],
            "",
            [("survey", survey.flights.path.name, survey.flights.sha256)],
        ),
        created=now(),
    )


def _sentences(phrases: Iterable[str]) -> tuple[str, ...]:
    return tuple(map(as_sentence, phrases))


def _tone(survey: SurveyResult) -> str:
    if not survey.survey_files.diagnoses:
        return "open"
    unexplained = survey.verdicts.get(Verdict.UNEXPLAINED.value)
    return "fair" if survey.recurs or survey.warnings or unexplained else "good"


def _assumptions(survey: SurveyResult) -> list[str]:
    tried = names_and_count(survey.tried, 10) or "none, since no two flights name the same"
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
    """Write ``derivatives.csv``, figures, the page and ``survey.json``, and return the folder.

    All files are written, or none. ``flights/`` is left as it is.
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
