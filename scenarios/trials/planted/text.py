"""A tracing study in words and tables for the terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from scenarios.diagnosis.report.declared_only import nothing_stands, shown_columns
from scenarios.diagnosis.report.text import details_text, diagnosis_summary
from scenarios.terminal.display_units import shown_in, told, unit_cell
from scenarios.terminal.paragraphs import WIDTH, wrapped
from scenarios.terminal.quantities import value_text
from scenarios.terminal.summary import BELOW, Summary, summary_lines
from scenarios.terminal.tables import Column, columns_of, table_lines
from scenarios.trials.planted.hiding import hidden_units
from scenarios.trials.planted.study import Grade, Scored, TraceStudy

DERIVATIVES = ("derivative", "unit", "true", "before", "after", "error, sigmas")
EFFECTS = ("effect", "unit", "true", "estimate", "error, sigmas")


def trace_text(study: TraceStudy, width: int = WIDTH, details: str = BELOW) -> str:
    """A summary, before and after as `flightid diagnose` shows them, then what the truth says of it."""
    scenario = study.scenario
    blocks = [
        summary_lines(trace_summary(study, details), width),
        [f"{scenario.name}: {scenario.title}", f"truth and model: {scenario.distance}; seed {study.seed}"],
        details_text(study.tracing, width).rstrip().split("\n"),
        table_lines(against_truth(study), title=table_title(study), width=width),
        table_lines(columns_of(EFFECTS, effect_rows(study), left=2), width=width),
        wrapped(scored_sentence(study), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def trace_summary(study: TraceStudy, details: str = BELOW) -> Summary:
    """The diagnosis, and whether it is right."""
    told = diagnosis_summary(study.tracing, details)
    named = f"{study.scenario.name}: {study.scenario.title}; {told.study}"
    return replace(told, study=named, outcome=f"{told.outcome}; the diagnosis is {_verdict(study.grade)}")


def scored_sentence(study: TraceStudy) -> str:
    """What was hidden, what was expected, and what the diagnosis is worth."""
    return f"scored with the truth: {_hidden(study)}; expected {_expected(study)}; the diagnosis is {_verdict(study.grade)}"


def effect_rows(study: TraceStudy) -> list[tuple[str, ...]]:
    """Cells below ``EFFECTS``."""
    return [(*row[:3], *row[4:]) for row in _rows(study.effects)]


def against_truth(study: TraceStudy) -> list[Column]:
    """The derivatives before and after; of the declared model alone where no effect stands beside it."""
    d, rows = study.tracing.diagnosis, _rows(study.derivatives)
    if nothing_stands(d):
        headings = (*shown_columns(d, DERIVATIVES[:-1]),)
        return columns_of(headings, [row[:4] for row in rows], left=2)
    return columns_of(DERIVATIVES, rows, left=2)


def table_title(study: TraceStudy) -> str:
    """What the derivatives are held against."""
    if study.scenario.model == "loes":
        return "derivatives; true are those of the equivalent system that fits the linear loop's frequency response"
    return "derivatives against the truth"


def _rows(scored: Sequence[Scored]) -> list[tuple[str, ...]]:
    out: list[tuple[str, ...]] = []
    for row in scored:
        factor, unit = shown_in(row.unit, row.name)
        before, after = (value_text(factor * q.value, factor * q.std) if q else "-" for q in (row.before, row.after))
        out.append((row.name, unit_cell(unit), f"{factor * row.true:.5g}", before, after, f"{row.sigmas:+.1f}"))
    return out


def _hidden(study: TraceStudy) -> str:
    flight, terms = study.scenario.flight, []
    for name, values in study.flown.hidden.items():
        units = hidden_units(name, flight.own if flight.own is not None else flight.vehicle, name)
        said = ", ".join(f"{key} {told(value, units.get(key, ''), key)}" for key, value in values.items())
        terms.append(f"{name} ({said})")
    if study.scenario.flight.modes and study.scenario.model == "rigid":
        terms.insert(0, f"{study.scenario.flight.modes} elastic mode{'s' if study.scenario.flight.modes > 1 else ''}")
    return f"hidden was {' and '.join(terms)}" if terms else "nothing was hidden"


def _expected(study: TraceStudy) -> str:
    expect = study.scenario.expect
    sets = " or ".join(" + ".join(names) for names in expect.effects)
    return " or ".join(expect.verdicts) + (f": {sets}" if sets else "")


def _verdict(grade: Grade) -> str:
    return grade.value
