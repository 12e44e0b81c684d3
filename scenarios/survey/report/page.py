"""The page of a survey: opened each morning, what is new first."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from ident.tracing.diagnosis import Verdict
from scenarios.pages.folder import figures
from scenarios.pages.model import Bullets, Page, Prose, Table, section
from scenarios.pages.numbers import Link
from scenarios.pages.printed import rows_table
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import capital, sentence
from scenarios.plots.page.named import Drawn
from scenarios.survey.one_flight import FOLDER
from scenarios.survey.recurring import LIBRARY
from scenarios.survey.report.words import (
    belongs_phrase,
    derivative_rows,
    drifts,
    effect_rows,
    flight_rows,
    fresh,
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

HOW = (
    "Each flight was fitted with every set of the effects that several flights name. An effect recurs where all flights together, the loudest "
    "left out, show one value of it beyond chance; a flight has it, or has it not, from 95 % probability on. Derivatives are those of each "
    "flight's own set, with shared values known from the other flights"
)


def survey_page(survey: Survey, drawn: Sequence[Drawn] = (), linked: Collection[str] = ()) -> Page:
    """The page of a survey with the figures ``drawn``; flights in ``linked`` have a page of their own beside it."""
    word, rest = verdict_of(survey)
    far = [[flight, name, f"{off:+.1f}"] for flight, name, off in outstanding(survey)]
    told = [f"{each.name}: {part}" for each in survey.recurs for part in (belongs_phrase(each, survey), rivals_phrase(each)) if part]
    alone = single_phrases(survey)
    return Page(
        title=f"{survey.flights.title}: survey",
        kind=f"{survey.flights.model} model, {len(survey.grown.kept)} flights",
        verdict=capital(word.lower()),
        tone=_tone(survey),
        sentence=sentence(rest),
        summary=tuple(map(sentence, map(capital, filter(None, [news(survey), verdicts_phrase(survey), *drifts(survey)])))),
        warnings=tuple(map(sentence, survey.warnings)),
        sections=(
            *section("New since the last survey", Bullets(tuple(map(sentence, map(capital, fresh(survey)))))),
            *section("What recurs", rows_table("Effects", *effect_rows(survey)), Bullets(tuple(map(sentence, told))), Prose(sentence(HOW), "note")),
            *section("Derivatives", rows_table("Over all flights", *derivative_rows(survey)), Bullets(tuple(map(sentence, hints(survey))))),
            *section("Flights that stand out", rows_table("Beyond the scatter of the others", ["flight", "derivative", "off, sigmas"], far)),
            *section("Figures", *figures(drawn)),
            *section(
                "Flights",
                _with_links(rows_table("The newest first", *flight_rows(survey)), linked),
                Bullets(tuple(map(sentence, alone))),
            ),
            *section("What it rests on", Bullets(tuple(map(sentence, (*_rests(survey), *survey.notes))))),
        ),
        reproduction=reproduction(
            ["flightid", "survey", str(survey.flights.path)], "", [("survey", survey.flights.path.name, survey.flights.sha256)]
        ),
        created=now(),
    )


def _tone(survey: Survey) -> str:
    if not survey.grown.kept:
        return "open"
    return "fair" if survey.recurs or survey.warnings or survey.verdicts.get(Verdict.UNEXPLAINED.value) else "good"


def _with_links(table: Table, linked: Collection[str]) -> Table:
    """The name of each flight leads to its own page."""
    rows = tuple((Link(str(row[0]), f"{FOLDER}/{row[0]}/report.html") if row[0] in linked else row[0], *row[1:]) for row in table.rows)
    return replace(table, rows=rows)


def _rests(survey: Survey) -> list[str]:
    tried = listed(survey.tried, 10) or "none, since no two flights name the same"
    return [
        f"Effects that were asked of all flights: {tried}",
        f"The chance of a false recurrence counts {LIBRARY} candidates (Bonferroni); trends and differences have a false discovery rate of 5 %",
        "Sigmas of common values and trends hold the scatter between flights (restricted maximum likelihood, Hartung and Knapp)",
        "Flights are combined by their estimates with covariances, which is the joint fit as far as each likelihood is quadratic",
        "A trend is told with one condition at a time: where conditions go together, either may be the cause",
    ]
