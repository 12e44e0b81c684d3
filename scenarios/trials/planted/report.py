"""A tracing study in the terminal, on its page and in its folder."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from scenarios.diagnosis.report.content import bounded, positive, test_content
from scenarios.diagnosis.report.declared_only import (
    DECLARED,
    nothing_stands,
    shown_columns,
    shown_rows,
)
from scenarios.diagnosis.report.files import write_diagnosis, write_prediction
from scenarios.diagnosis.report.tables import short
from scenarios.diagnosis.report.text import details_text, diagnosis_summary
from scenarios.diagnosis.tracing import Tracing
from scenarios.files.sources import versions
from scenarios.files.user_models import channel_units
from scenarios.files.writing import study_folder, write_json, write_record
from scenarios.pages.model import Page, Prose, as_sentence, capital, reproduction, section
from scenarios.pages.tables import columns_table, rows_table
from scenarios.plots.formats import USUAL, Formats
from scenarios.terminal.quantities import quantity_text, shown_in, unit_cell, value_text
from scenarios.terminal.summary import BELOW, Summary, summary_lines
from scenarios.terminal.tables import WIDTH, TableColumn, columns_of, table_lines, wrapped
from scenarios.trials.planted.declaration import hidden_units
from scenarios.trials.planted.flights import write_flown
from scenarios.trials.planted.study import TRUE, Grade, Scored, TraceStudy

# ---- A tracing study in words and tables for the terminal

DERIVATIVES = (
    "derivative",
    "unit",
    "true",
    "condensed",
    "comparable",
    "before",
    "after",
    "error, sigmas",
)
EFFECTS = ("effect", "unit", "true", "comparable", "estimate", "error, sigmas")
MODES = ("mode", "unit", "true", "comparable", "estimate", "error, sigmas")
THIRD = ("error", "unit", "before", "after", "sensor noise")
THIRD_TITLE = (
    "simulation error (rms) on a third record, test.csv, which took no part in fitting or in "
    "choosing effects"
)


def trace_text(study: TraceStudy, width: int = WIDTH, details: str = BELOW) -> str:
    """A summary, before and after as `flightid diagnose` shows them, then what the truth says of
    it.
    """
    scenario = study.scenario
    blocks = [
        summary_lines(trace_summary(study, details), width),
        [
            f"{scenario.name}: {scenario.title}",
            f"truth and model: {scenario.distance}; seed {study.seed}",
        ],
        details_text(study.tracing, width).rstrip().split("\n"),
        table_lines(
            columns_of(third_headings(study), third_rows(study), left=2),
            title=THIRD_TITLE,
            width=width,
        ),
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
    return replace(
        told, study=named, outcome=f"{told.outcome}; the diagnosis is {_verdict(study.grade)}"
    )


def scored_sentence(study: TraceStudy) -> str:
    """What was hidden, what was expected, and what the diagnosis is worth."""
    return (
        f"scored with the truth: {_hidden(study)}; expected {_expected(study)}; the diagnosis is "
        f"{_verdict(study.grade)}"
    )


def effect_rows(study: TraceStudy) -> list[tuple[str, ...]]:
    """Cells below ``EFFECTS``."""
    return [_estimate_cells(row) for row in study.effects]


def mode_rows(study: TraceStudy) -> list[tuple[str, ...]]:
    """Cells below ``MODES``: frequencies and damping ratios of the whole aircraft."""
    return [_estimate_cells(row) for row in study.modes]


def against_truth(study: TraceStudy) -> list[TableColumn]:
    """The derivatives before and after, against what the fitted model should find; without a column
    that says nothing new.

    Of the declared model alone where no effect was added to it.
    """
    alone = nothing_stands(study.tracing.diagnosis)
    rows = [_derivative_cells(_of_declared(row) if alone else row) for row in study.derivatives]
    shown = [
        name
        for name in DERIVATIVES
        if name != "condensed" or any(row.condensed is not None for row in study.derivatives)
    ]
    shown = [name for name in shown if not alone or name != "before"]
    headings = [DECLARED if alone and name == "after" else name for name in shown]
    return columns_of(
        headings, [tuple(row[DERIVATIVES.index(name)] for name in shown) for row in rows], left=2
    )


def _of_declared(row: Scored) -> Scored:
    """The estimate of the declared model alone, against what that should find."""
    if row.before is None or row.comparable_before is None:
        return row
    return replace(row, after=row.before, comparable=row.comparable_before, open=False)


def table_title(study: TraceStudy) -> str:
    """What the derivatives are compared with."""
    if study.scenario.model == "loes":
        return (
            "derivatives; true are those of the equivalent system that fits the linear loop's "
            "frequency response"
        )
    return "derivatives against the truth"


def comparable_sentences(study: TraceStudy) -> list[str]:
    """Where the comparable values come from, and why they differ from the true ones."""
    told = [f"comparable, what the fitted model should find: {study.basis}", *study.reasons]
    if study.basis == TRUE:
        told.append(
            "third record: gusts are not known beforehand, so that turbulence does not lower the "
            "error of a free simulation"
        )
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
        rows.append(
            (
                name,
                unit_cell(unit),
                *("-" if cell is None else short(factor * cell) for cell in cells),
            )
        )
    return [tuple(row) for row in shown_rows(d, THIRD, rows)]


def _estimate_cells(row: Scored) -> tuple[str, ...]:
    factor, unit = shown_in(row.unit, row.name)
    true = "-" if row.true is None else f"{factor * row.true:.5g}"
    estimate = value_text(factor * row.after.value, factor * row.after.std)
    return row.name, unit_cell(unit), true, _comparable(row, factor), estimate, f"{row.sigmas:+.1f}"


def _derivative_cells(row: Scored) -> tuple[str, ...]:
    factor, unit = shown_in(row.unit, row.name)
    true, condensed = (
        "-" if value is None else f"{factor * value:.5g}" for value in (row.true, row.condensed)
    )
    before, after = (
        value_text(factor * q.value, factor * q.std) if q else "-" for q in (row.before, row.after)
    )
    return (
        row.name,
        unit_cell(unit),
        true,
        condensed,
        _comparable(row, factor),
        before,
        after,
        f"{row.sigmas:+.1f}",
    )


def _comparable(row: Scored, factor: float) -> str:
    """The comparable value; in brackets where this flight leaves the parameter open."""
    value = f"{factor * row.comparable:.5g}"
    return f"({value})" if row.open else value


def _hidden(study: TraceStudy) -> str:
    flight, terms = study.scenario.flight, []
    for name, values in study.flown.hidden.items():
        units = hidden_units(name, flight.own if flight.own is not None else flight.vehicle, name)
        said = ", ".join(
            f"{key} {quantity_text(value, units.get(key, ''), key)}"
            for key, value in values.items()
        )
        terms.append(f"{name} ({said})")
    if study.scenario.flight.modes and study.scenario.model == "rigid":
        terms.insert(
            0,
            f"{study.scenario.flight.modes} elastic "
            f"mode{'s' if study.scenario.flight.modes > 1 else ''}",
        )
    return f"hidden was {' and '.join(terms)}" if terms else "nothing was hidden"


def _expected(study: TraceStudy) -> str:
    expect = study.scenario.expect
    sets = " or ".join(" + ".join(names) for names in expect.effects)
    return " or ".join(expect.verdicts) + (f": {sets}" if sets else "")


def _verdict(grade: Grade) -> str:
    return grade.value


# ---- What the truth says of a diagnosis, on its page


def scored_page(study: TraceStudy, page: Page) -> Page:
    """The page of the diagnosis with the scenario's title, and the truth before what the loop says
    of itself.
    """
    scenario = study.scenario
    scored = as_sentence(scored_sentence(study))
    truth = section(
        "Against the truth",
        columns_table(capital(table_title(study)), against_truth(study)),
        rows_table("Parameters of the effects", EFFECTS, effect_rows(study)),
        rows_table("Frequencies and damping ratios of the whole aircraft", MODES, mode_rows(study)),
        *(Prose(as_sentence(capital(told))) for told in comparable_sentences(study)),
        rows_table(capital(THIRD_TITLE), third_headings(study), third_rows(study)),
        Prose(f"Truth and model: {scenario.distance}.", "note"),
    )
    again = reproduction(
        ("flightid", "run", scenario.name, "--seed", str(study.seed)),
        f"Seed {study.seed}.",
        page.reproduction.inputs,
    )
    kind = f"Study {scenario.name}: {page.kind}"
    return replace(
        page,
        title=capital(scenario.title),
        kind=kind,
        summary=(*page.summary, scored),
        sections=(*truth, *page.sections),
        reproduction=again,
    )


# ---- The study folder of a tracing scenario

MAIN = "comparison.json"


def write_trace(study: TraceStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write records, vehicle file, diagnosis, truth and ``comparison.json`` (last); returns the
    folder.
    """
    dressed = partial(scored_page, study)
    given = partial(_write_records, study)
    return write_trial(
        study.tracing,
        given,
        truth_content(study),
        trace_comparison(study),
        folder,
        figures=figures,
        dressed=dressed,
    )


def write_trial(
    tracing: Tracing,
    given: Callable[[Path], object],
    truth: dict[str, Any],
    comparison: dict[str, Any],
    folder: str | Path,
    *,
    figures: Formats,
    dressed: Callable[[Page], Page],
) -> Path:
    """Write the diagnosis with what ``dressed`` adds to its page, what was ``given`` to the loop
    (records and vehicle file), the truth and ``comparison.json`` (last); returns the folder."""
    write_diagnosis(tracing, folder, figures=figures, dressed=dressed)
    with study_folder(folder, MAIN) as scratch:
        given(scratch)
        write_json(scratch / "truth.json", truth)
        write_json(scratch / MAIN, comparison)
    return Path(folder)


def _write_records(study: TraceStudy, folder: Path) -> None:
    """All three records, the vehicle file, and the prediction of the third record,
    ``before_CHANNEL`` and ``after_CHANNEL``.
    """
    write_flown(study.flown, folder)
    write_record(folder, study.flown.test, "test", simulated=True)
    write_prediction(folder / "test_prediction.csv", study.test.predictions[0])


def truth_content(study: TraceStudy) -> dict[str, Any]:
    """Derivatives, hidden terms, noise and distance."""
    flown = study.flown
    return {
        "schema": "flightid/truth/1",
        "parameters": {
            row.name: {"value": row.true, "unit": row.unit} for row in study.derivatives
        },
        "modes": {
            row.name: {"value": row.true, "unit": row.unit}
            for row in study.modes
            if row.true is not None
        },
        "effects": list(flown.hidden),
        "hidden": {name: dict(values) for name, values in flown.hidden.items()},
        "noise_std": dict(flown.noise_std),
        "distance": study.scenario.distance,
        "step": flown.step,
    }


def trace_comparison(study: TraceStudy) -> dict[str, Any]:
    """Content of ``comparison.json``: the fit with what was found, and under ``methods`` the
    declared model's.
    """
    d = study.tracing.diagnosis
    derived = {
        when: {
            name: {"estimate": bounded(q.value), "std": positive(q.std), "unit": q.unit}
            for name, q in some.items()
        }
        for when, some in (("before", d.derived_before), ("after", d.derived_after))
    }
    for when, some in (("before", d.before), ("after", d.after)):
        if "delay" in some:
            derived[when]["delay"] = {
                "estimate": bounded(some["delay"].value),
                "std": positive(some["delay"].std),
                "unit": "s",
            }
    for row in study.modes:
        of_mode = derived["after"].setdefault(
            row.name,
            {"estimate": row.after.value, "std": positive(row.after.std), "unit": row.unit},
        )
        of_mode |= {**_common(row), "error_sigmas": bounded(row.sigmas)}
    before = {
        row.name: {
            "estimate": row.before.value,
            "std": positive(row.before.std),
            **_common(row),
            "comparable": bounded(row.comparable_before),
        }
        for row in study.derivatives
        if row.before and row.comparable_before is not None
    }
    return {
        "schema": "flightid/comparison/1",
        "scenario": study.scenario.name,
        "title": study.scenario.title,
        "seed": study.seed,
        "distance": study.scenario.distance,
        "parameters": {row.name: _after(row) for row in (*study.derivatives, *study.effects)},
        "fixed": {
            item.name: {"value": item.value, "unit": item.unit}
            for item in study.tracing.model.parameters
            if not item.free
        },
        "derived": derived["after"],
        "outcome": d.verdict.value,
        "outcome_sentence": d.verdict.sentence,
        "expected": {
            "verdicts": list(study.scenario.expect.verdicts),
            "effects": [list(names) for names in study.scenario.expect.effects],
        },
        "grade": study.grade.name.lower(),
        "comparable": {"basis": study.basis, "reasons": list(study.reasons)},
        "third_record": _third(study),
        "residual_tests": [test_content(test) for test in d.tests_after],
        "methods": {"declared-model": {"parameters": before, "derived": derived["before"]}},
        "versions": versions(),
    }


def _third(study: TraceStudy) -> dict[str, Any]:
    """Errors before and after on the record that took no part in fitting or in choosing effects, in
    the channels' units.
    """
    found, units = study.test, channel_units(study.tracing.model)
    return {
        "record": "test.csv",
        "used_in_fit": False,
        "used_to_choose": False,
        "unit": {name: units.get(name, "") for name in found.predictions[0].channels},
        "before": {"rmse": dict(found.before.rmse)},
        "after": {"rmse": {name: bounded(value) for name, value in found.after.rmse.items()}},
        "noise_std": {
            name: value
            for name, value in study.flown.noise_std.items()
            if name in found.predictions[0].channels
        },
        "finite": found.finite,
    }


def _after(row: Scored) -> dict[str, Any]:
    return {
        "estimate": bounded(row.after.value),
        "std": positive(row.after.std),
        **_common(row),
        "error_sigmas": bounded(row.sigmas),
    }


def _common(row: Scored) -> dict[str, Any]:
    return {
        **({"true": row.true} if row.true is not None else {}),
        "comparable": bounded(row.comparable),
        **({"condensed": row.condensed} if row.condensed is not None else {}),
        **({"open": True} if row.open else {}),
        "unit": row.unit,
    }
