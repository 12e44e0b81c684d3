"""A tracing study in words and tables for the terminal."""

from __future__ import annotations

from dataclasses import replace

from scenarios.diagnosis.report.declared_only import DECLARED, nothing_stands, shown_columns, shown_rows
from scenarios.diagnosis.report.tables import short
from scenarios.diagnosis.report.text import details_text, diagnosis_summary
from scenarios.files.user_models import channel_units
from scenarios.terminal.quantities import shown_in, told, unit_cell, value_text
from scenarios.terminal.summary import BELOW, Summary, summary_lines
from scenarios.terminal.tables import WIDTH, TableColumn, columns_of, table_lines, wrapped
from scenarios.trials.planted.comparable import TRUE
from scenarios.trials.planted.hiding import hidden_units
from scenarios.trials.planted.study import Grade, Scored, TraceStudy

DERIVATIVES = ("derivative", "unit", "true", "condensed", "comparable", "before", "after", "error, sigmas")
EFFECTS = ("effect", "unit", "true", "comparable", "estimate", "error, sigmas")
MODES = ("mode", "unit", "true", "comparable", "estimate", "error, sigmas")
THIRD = ("error", "unit", "before", "after", "sensor noise")
THIRD_TITLE = "simulation error (rms) on a third record, test.csv, which took no part in fitting or in choosing effects"


def trace_text(study: TraceStudy, width: int = WIDTH, details: str = BELOW) -> str:
    """A summary, before and after as `flightid diagnose` shows them, then what the truth says of it."""
    scenario = study.scenario
    blocks = [
        summary_lines(trace_summary(study, details), width),
        [f"{scenario.name}: {scenario.title}", f"truth and model: {scenario.distance}; seed {study.seed}"],
        details_text(study.tracing, width).rstrip().split("\n"),
        table_lines(columns_of(third_headings(study), third_rows(study), left=2), title=THIRD_TITLE, width=width),
        table_lines(against_truth(study), title=table_title(study), width=width),
        table_lines(columns_of(EFFECTS, effect_rows(study), left=2), width=width),
        table_lines(columns_of(MODES, mode_rows(study), left=2), width=width),
        [line for told in comparable_sentences(study) for line in wrapped(told, width)],
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
    return [_estimate_cells(row) for row in study.effects]


def mode_rows(study: TraceStudy) -> list[tuple[str, ...]]:
    """Cells below ``MODES``: frequencies and damping ratios of the whole aircraft."""
    return [_estimate_cells(row) for row in study.modes]


def against_truth(study: TraceStudy) -> list[TableColumn]:
    """The derivatives before and after, against what the fitted model should find; without a column that says nothing new.

    Of the declared model alone where no effect was added to it.
    """
    alone = nothing_stands(study.tracing.diagnosis)
    rows = [_derivative_cells(_of_declared(row) if alone else row) for row in study.derivatives]
    shown = [name for name in DERIVATIVES if name != "condensed" or any(row.condensed is not None for row in study.derivatives)]
    shown = [name for name in shown if not alone or name != "before"]
    headings = [DECLARED if alone and name == "after" else name for name in shown]
    return columns_of(headings, [tuple(row[DERIVATIVES.index(name)] for name in shown) for row in rows], left=2)


def _of_declared(row: Scored) -> Scored:
    """The estimate of the declared model alone, against what that should find."""
    if row.before is None or row.comparable_before is None:
        return row
    return replace(row, after=row.before, comparable=row.comparable_before, open=False)


def table_title(study: TraceStudy) -> str:
    """What the derivatives are compared with."""
    if study.scenario.model == "loes":
        return "derivatives; true are those of the equivalent system that fits the linear loop's frequency response"
    return "derivatives against the truth"


def comparable_sentences(study: TraceStudy) -> list[str]:
    """Where the comparable values come from, and why they differ from the true ones."""
    told = [f"comparable, what the fitted model should find: {study.basis}", *study.reasons]
    if study.basis == TRUE:
        told.append("third record: gusts are not known beforehand, so that turbulence does not lower the error of a free simulation")
    return told


def third_headings(study: TraceStudy) -> tuple[str, ...]:
    """``THIRD`` with the column of the effects left out where none was added."""
    return tuple(shown_columns(study.tracing.diagnosis, THIRD))


def third_rows(study: TraceStudy) -> list[tuple[str, ...]]:
    """Cells below ``third_headings``."""
    d, units = study.tracing.diagnosis, channel_units(study.tracing.model)
    rows = []
    for name, error in study.test.before.rmse.items():
        factor, unit = shown_in(units.get(name, ""), name)
        noise = study.flown.noise_std.get(name)
        cells = (error, study.test.after.rmse[name] if study.test.finite else None, noise)
        rows.append((name, unit_cell(unit), *("-" if cell is None else short(factor * cell) for cell in cells)))
    return [tuple(row) for row in shown_rows(d, THIRD, rows)]


def _estimate_cells(row: Scored) -> tuple[str, ...]:
    factor, unit = shown_in(row.unit, row.name)
    true = "-" if row.true is None else f"{factor * row.true:.5g}"
    estimate = value_text(factor * row.after.value, factor * row.after.std)
    return row.name, unit_cell(unit), true, _comparable(row, factor), estimate, f"{row.sigmas:+.1f}"


def _derivative_cells(row: Scored) -> tuple[str, ...]:
    factor, unit = shown_in(row.unit, row.name)
    true, condensed = ("-" if value is None else f"{factor * value:.5g}" for value in (row.true, row.condensed))
    before, after = (value_text(factor * q.value, factor * q.std) if q else "-" for q in (row.before, row.after))
    return row.name, unit_cell(unit), true, condensed, _comparable(row, factor), before, after, f"{row.sigmas:+.1f}"


def _comparable(row: Scored, factor: float) -> str:
    """The comparable value; in brackets where this flight leaves the parameter open."""
    value = f"{factor * row.comparable:.5g}"
    return f"({value})" if row.open else value


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
