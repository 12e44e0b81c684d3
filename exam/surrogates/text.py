"""A surrogate flight's study in words and tables for the terminal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from exam.surrogates.fitting import declared_model, left_over
from exam.surrogates.flights.drawing import Dominant, Drawn
from exam.surrogates.flights.flight import Flight
from exam.surrogates.study import Moved, SurrogateStudy
from ident.tracing.diagnosis import Quantity
from scenarios.diagnosis.text import details_text, diagnosis_summary
from scenarios.diagnosis.wording import DECLARED, is_unexplained
from scenarios.report.document import (
    BY_ROW,
    Cell,
    Column,
    Table,
    brief_estimate,
    formatted,
    table,
)
from scenarios.report.quantities import quantity_text
from scenarios.report.summary import BELOW, WIDTH, Summary, summary_lines
from scenarios.report.terminal import table_as_lines


def surrogate_text(study: SurrogateStudy, width: int = WIDTH, details: str = BELOW) -> str:
    """A summary, before and after as `flightid diagnose` shows them, then what was true and what
    the verdict is worth.
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
    """The diagnosis, and what the truth says of it."""
    told = diagnosis_summary(study.tracing, details)
    return replace(
        told,
        study=f"{study.surrogate.name}: {study.surrogate.title}; {told.study}",
        outcome=f"{told.outcome}; truth: {score_text(study)}",
    )


def flight_lines(flight: Flight) -> list[str]:
    """What flew, how it was recorded, and what a fit of each record leaves."""
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
    """What flew, and how it was recorded."""
    drawn = flight.drawn
    return [
        f"{drawn.vehicle}, {len(flight.records)} records of {drawn.surrogate.flight.duration:g} s "
        f"at {drawn.rate:g} Hz: {', '.join(drawn.kinds)}",
        f"channels {', '.join(drawn.channels)}",
    ]


def hidden_text(drawn: Drawn) -> str:
    """What dominates, with its parameters."""
    return (
        "hidden was " + " and ".join(_dominant(item, len(drawn.maneuvers)) for item in drawn.hidden)
        if drawn.hidden
        else "nothing dominates"
    )


def score_text(study: SurrogateStudy) -> str:
    """What the truth says of the claims."""
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
    """The derivatives before and after; of the declared model alone where no effect stands beside
    it.
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
