"""Reports of surrogate flights: terminal, study folder and pages."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exam.options import exam_reproduction
from exam.repeated import FlownCampaign
from exam.scores.report import scores_sections
from exam.surrogates.campaign import DERIVATIVES as BY_DERIVATIVE
from exam.surrogates.campaign import (
    EFFECTS,
    SHARES,
    TITLE,
    Judged,
    derivative_rows,
    effect_rows,
    false_lines,
    scores_of,
    share_rows,
    shares,
    verdict_counts,
)
from exam.surrogates.declaration import Surrogate
from exam.surrogates.fitting import declared_model, left_over
from exam.surrogates.flights.drawing import Dominant
from exam.surrogates.flights.drawing import Drawn as DrawnFlight
from exam.surrogates.flights.flight import Flight, write_flight
from exam.surrogates.study import Moved, SurrogateStudy
from ident.tracing.diagnosis import Quantity
from scenarios.diagnosis.text import bounded, details_text, diagnosis_summary, positive
from scenarios.diagnosis.wording import DECLARED, is_unexplained
from scenarios.files.sources import versions
from scenarios.report.document import (
    BY_ROW,
    Bullets,
    Cell,
    Column,
    Page,
    Table,
    as_sentence,
    brief_estimate,
    capital,
    formatted,
    now,
    section,
    table,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.quantities import quantity_text
from scenarios.report.summary import BELOW, WIDTH, Summary, summary_lines
from scenarios.report.terminal import rows_table, table_as_lines
from scenarios.trials.planted_report import write_trial

# ---- A surrogate flight's study in words and tables for the terminal


def surrogate_text(study: SurrogateStudy, width: int = WIDTH, details: str = BELOW) -> str:
    """Return a summary, the tables before and after as in `flightid diagnose`, the truth, and the
    score of the verdict.
    """
    blocks = [
        summary_lines(surrogate_summary(study, details), width),
        [
            f"{study.surrogate.name}: {study.surrogate.title}",
            *flight_lines(study.flight),
            f"seed {study.seed}",
        ],
        details_text(study.tracing, width).rstrip().split("\n"),
        table_as_lines(against_nominal(study), width),
        [
            f"truth: {hidden_text(study.flight.drawn)}",
            f"verdict: {study.tracing.diagnosis.verdict.value}; {score_text(study)}",
        ],
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def surrogate_summary(study: SurrogateStudy, details: str = BELOW) -> Summary:
    """Return the summary of the diagnosis with the score by the truth."""
    told = diagnosis_summary(study.tracing, details)
    return replace(
        told,
        study=f"{study.surrogate.name}: {study.surrogate.title}; {told.study}",
        outcome=f"{told.outcome}; truth: {score_text(study)}",
    )


def flight_lines(flight: Flight) -> list[str]:
    """Describe the aircraft, the recording, and the residuals of a fit to each record."""
    drawn = flight.drawn
    rest = left_over(
        flight.records,
        declared_model(drawn.declared, drawn.starts),
        drawn.surrogate.causes.noise_std,
    )
    correlation = ", ".join(
        f"{name} {value:.2f}"
        for name, value in zip(drawn.axis.measured, rest["correlation"], strict=True)
    )
    excess = ", ".join(
        f"{name} {value:.1f}"
        for name, value in zip(drawn.axis.measured, rest["excess"], strict=True)
    )
    return [
        *flown_lines(flight),
        "the declared model fitted to each record leaves residuals of lag-one correlation "
        f"{correlation}; over the sensor noise {excess}",
        f"derivatives scatter from record to record {float(np.median(rest['inflation'])):.1f} "
        "times as far as sigmas of white residuals say",
    ]


def flown_lines(flight: Flight) -> list[str]:
    """Describe the aircraft and the recording."""
    drawn = flight.drawn
    return [
        f"{drawn.vehicle}, {len(flight.records)} records of {drawn.surrogate.flight.duration:g} s "
        f"at {drawn.rate:g} Hz: {', '.join(drawn.kinds)}",
        f"channels {', '.join(drawn.channels)}",
    ]


def hidden_text(drawn: DrawnFlight) -> str:
    """Describe the dominant effects with their parameters."""
    return (
        "hidden was " + " and ".join(_dominant(item, len(drawn.maneuvers)) for item in drawn.hidden)
        if drawn.hidden
        else "nothing dominates"
    )


def score_text(study: SurrogateStudy) -> str:
    """Describe the claims by the truth."""
    said = [f"{name} is {how.value}" for name, how in study.named]
    said += [f"{name} is claimed and is not there" for name in study.false]
    said += [f"{name} is claimed, a small cause that acts" for name in study.small]
    return "; ".join(said) or "nothing is claimed, rightly"


def _dominant(item: Dominant, records: int) -> str:
    units = {parameter.name: parameter.unit for parameter in item.effect.parameters}
    values = ", ".join(
        f"{name} {quantity_text(value, units.get(name, ''), name)}"
        for name, value in item.values.items()
    )
    where = (
        ""
        if len(item.records) == records
        else f" in record {', '.join(str(number + 1) for number in item.records)}"
    )
    return f"{item.name} ({values}){where}"


def against_nominal(study: SurrogateStudy) -> Table:
    """Return the derivatives before and after the search; only those of the declared model if no
    effect is added.
    """
    rows, alone = study.derivatives, is_unexplained(study.tracing.diagnosis)

    def values(quantity: Callable[[Moved], Quantity]) -> list[Cell]:
        return [brief_estimate(quantity(row).value, quantity(row).std) for row in rows]

    def percent(quantity: Callable[[Moved], Quantity]) -> list[Cell]:
        return [
            formatted(100.0 * (quantity(row).value - row.nominal) / abs(row.nominal), "+.1f")
            for row in rows
        ]

    before = DECLARED if alone else "before"
    return table(
        "derivatives against the nominal ones",
        (Column("derivative"), [row.name for row in rows]),
        (Column("nominal", BY_ROW), [formatted(row.nominal, ".4g") for row in rows]),
        (Column(before, BY_ROW, together=True), values(lambda row: row.before)),
        None if alone else (Column("after", BY_ROW, together=True), values(lambda row: row.after)),
        (Column(before, "%"), percent(lambda row: row.before)),
        None if alone else (Column("after", "%"), percent(lambda row: row.after)),
        units=[row.after.unit for row in rows],
    )


# ---- What was true of a surrogate flight, on the page of its diagnosis; and the page of a campa


def scored_page(study: SurrogateStudy, page: Page) -> Page:
    """Return the page of the diagnosis with the title of the scenario and the truth before the
    result of the loop.
    """
    surrogate = study.surrogate
    told = as_sentence(f"truth: {hidden_text(study.flight.drawn)}; {score_text(study)}")
    truth = section(
        "Against the truth",
        against_nominal(study),
        Bullets(tuple(map(as_sentence, flown_lines(study.flight)))),
    )
    again = exam_reproduction(
        ("surrogate", surrogate.name, "--seed", str(study.seed)), f"Seed {study.seed}."
    )
    again = replace(again, inputs=page.reproduction.inputs)
    kind = f"Study {surrogate.name}: {page.kind}"
    return replace(
        page,
        title=capital(surrogate.title),
        kind=kind,
        summary=(*page.summary, told),
        sections=(*truth, *page.sections),
        reproduction=again,
    )


def campaign_page(surrogate: Surrogate, done: FlownCampaign, drawn: Sequence[Drawn] = ()) -> Page:
    """Return the page of a campaign with the figures ``drawn``: shares with intervals, tables by
    effect and by derivative, names, probabilities, sigmas.
    """
    judged: Sequence[Judged] = done.found
    found, false = shares(judged), false_lines(judged)
    named = found["named"]
    told = (
        f"{named.count} of {named.of} hidden effects are named" if named.of else "nothing is hidden"
    )
    command = ("surrogates", surrogate.name, "--runs", str(done.ended), "--seed", str(done.root))
    return Page(
        title=f"{capital(surrogate.title)}: {len(judged)} flights",
        kind=f"Campaign of {surrogate.name}",
        verdict="false claims" if false else "no false claim",
        tone="fair" if false else "good",
        sentence=as_sentence(told),
        summary=(as_sentence(verdict_counts(judged)),),
        warnings=tuple(map(as_sentence, [*false, *([done.failed] if done.failed else [])])),
        sections=(
            *section(
                "How often the loop is right",
                rows_table("Shares with their 95 % intervals", SHARES, share_rows(judged)),
            ),
            *section(
                "Effect by effect", rows_table("Hidden effects", EFFECTS, effect_rows(judged))
            ),
            *section(
                "Derivative by derivative",
                rows_table(capital(TITLE), BY_DERIVATIVE, derivative_rows(judged)),
            ),
            *scores_sections(scores_of(judged), drawn),
        ),
        reproduction=exam_reproduction(command, as_sentence(done.words)),
        created=now(),
    )


# ---- The study folder of a surrogate flight


def write_surrogate(study: SurrogateStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write records, vehicle file, diagnosis, truth and ``comparison.json`` (last); return the
    folder.
    """
    given, dressed = partial(write_flight, study.flight), partial(scored_page, study)
    return write_trial(
        study.tracing,
        given,
        truth_content(study.flight),
        comparison(study),
        folder,
        figures=figures,
        dressed=dressed,
    )


def truth_content(flight: Flight) -> dict[str, Any]:
    """Return nominal derivatives, dominant effects, levels of the small causes, and the true
    constants of each record.
    """
    drawn = flight.drawn
    return {
        "schema": "flightid/truth/1",
        "vehicle": drawn.vehicle,
        "parameters": {
            name: {
                "value": drawn.declared.parameters[name].value,
                "unit": drawn.declared.parameters[name].unit,
            }
            for name in drawn.starts
        },
        "effects": [item.name for item in drawn.hidden],
        "hidden": {item.name: dict(item.values) for item in drawn.hidden},
        "hidden_records": {
            item.name: [number + 1 for number in item.records] for item in drawn.hidden
        },
        "records": {
            flown.record.name: {"maneuver": kind, **flown.constants}
            for flown, kind in zip(flight.flown, drawn.kinds, strict=True)
        },
        "filters": dict(drawn.corners),
        "causes": asdict(drawn.surrogate.causes),
        "distance": "effect missing" if drawn.hidden else "small causes missing",
        "step": drawn.surrogate.flight.step,
    }


def comparison(study: SurrogateStudy) -> dict[str, Any]:
    """Return the content of ``comparison.json``.

    ``true`` are the nominal derivatives. The small causes change the limits of the estimates, too.
    """
    d = study.tracing.diagnosis
    rows = study.derivatives

    def entry(nominal: float, value: float, std: float, unit: str) -> dict[str, Any]:
        return {"true": nominal, "estimate": bounded(value), "std": positive(std), "unit": unit}

    return {
        "schema": "flightid/comparison/1",
        "scenario": study.surrogate.name,
        "title": study.surrogate.title,
        "seed": study.seed,
        "parameters": {
            row.name: entry(row.nominal, row.after.value, row.after.std, row.after.unit)
            for row in rows
        },
        "fixed": {
            item.name: {"value": item.value, "unit": item.unit}
            for item in study.tracing.model.parameters
            if not item.free
        },
        "derived": {},
        "outcome": d.verdict.value,
        "outcome_sentence": d.verdict.sentence,
        "named": {name: how.name.lower().replace("_", "-") for name, how in study.named},
        "false_claims": list(study.false),
        "small_claims": list(study.small),
        "held_out_ratio": study.held_out_ratio,
        "residual_tests": [],
        "methods": {
            "declared-model": {
                "parameters": {
                    row.name: entry(row.nominal, row.before.value, row.before.std, row.before.unit)
                    for row in rows
                }
            }
        },
        "versions": versions(),
    }
