"""A stand-in's study in words and tables for the terminal."""

from __future__ import annotations

import numpy as np

from scenarios.diagnosis.report.text import diagnosis_text
from scenarios.terminal.paragraphs import WIDTH
from scenarios.terminal.quantities import value_text
from scenarios.terminal.tables import columns_of, table_lines
from scenarios.trials.standin.fitting import declared_model, left_over
from scenarios.trials.standin.flights.drawing import Dominant, Drawn
from scenarios.trials.standin.flights.flight import Flight
from scenarios.trials.standin.study import StandInStudy

DERIVATIVES = ("derivative", "nominal", "before", "after", "before, %", "after, %")


def standin_text(study: StandInStudy, width: int = WIDTH) -> str:
    """Before and after as `flightid diagnose` shows them, then what was true and what the verdict is worth."""
    blocks = [
        [f"{study.standin.name}: {study.standin.title}", *flight_lines(study.flight), f"seed {study.seed}"],
        diagnosis_text(study.tracing, width).rstrip().split("\n"),
        table_lines(columns_of(DERIVATIVES, nominal_rows(study)), title="derivatives against the nominal ones", width=width),
        [f"truth: {hidden_text(study.flight.drawn)}", f"verdict: {study.tracing.diagnosis.verdict.value}; {score_text(study)}"],
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def flight_lines(flight: Flight) -> list[str]:
    """What flew, how it was recorded, and what a fit of each record leaves."""
    drawn = flight.drawn
    rest = left_over(flight.records, declared_model(drawn.declared, drawn.starts), drawn.standin.causes.noise_std)
    correlation = ", ".join(f"{name} {value:.2f}" for name, value in zip(drawn.axis.measured, rest["correlation"], strict=True))
    excess = ", ".join(f"{name} {value:.1f}" for name, value in zip(drawn.axis.measured, rest["excess"], strict=True))
    return [
        *flown_lines(flight),
        f"the declared model fitted to each record leaves residuals of lag-one correlation {correlation}; over the sensor noise {excess}",
        f"derivatives scatter from record to record {float(np.median(rest['inflation'])):.1f} times as far as sigmas of white residuals say",
    ]


def flown_lines(flight: Flight) -> list[str]:
    """What flew, and how it was recorded."""
    drawn = flight.drawn
    return [
        f"{drawn.vehicle}, {len(flight.records)} records of {drawn.standin.flight.duration:g} s at {drawn.rate:g} Hz: {', '.join(drawn.kinds)}",
        f"channels {', '.join(drawn.channels)}",
    ]


def hidden_text(drawn: Drawn) -> str:
    """What dominates, with its parameters."""
    return "hidden was " + " and ".join(_dominant(item, len(drawn.maneuvers)) for item in drawn.hidden) if drawn.hidden else "nothing dominates"


def score_text(study: StandInStudy) -> str:
    """What the truth says of the claims."""
    said = [f"{name} is {how.value}" for name, how in study.named]
    said += [f"{name} is claimed and is not there" for name in study.false]
    said += [f"{name} is claimed, a small cause that acts" for name in study.small]
    return "; ".join(said) or "nothing is claimed, rightly"


def _dominant(item: Dominant, records: int) -> str:
    values = ", ".join(f"{name} {value:.4g}" for name, value in item.values.items())
    where = "" if len(item.records) == records else f" in record {', '.join(str(number + 1) for number in item.records)}"
    return f"{item.name} ({values}){where}"


def nominal_rows(study: StandInStudy) -> list[tuple[str, ...]]:
    """Cells below ``DERIVATIVES``."""

    def percent(value: float, nominal: float) -> str:
        return f"{100.0 * (value - nominal) / abs(nominal):+.1f}"

    return [
        (
            row.name,
            f"{row.nominal:.4g}",
            value_text(row.before.value, row.before.std),
            value_text(row.after.value, row.after.std),
            percent(row.before.value, row.nominal),
            percent(row.after.value, row.nominal),
        )
        for row in study.derivatives
    ]
