"""A tracing study in the terminal, on its page and in its folder."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ident.tracing.diagnosis import Quantity
from scenarios.diagnosis.diagnose import Tracing
from scenarios.diagnosis.files import write_diagnosis, write_prediction
from scenarios.diagnosis.tables import level_cell
from scenarios.diagnosis.text import (
    bounded,
    details_text,
    diagnosis_summary,
    positive,
    test_content,
)
from scenarios.diagnosis.wording import DECLARED, declared_alone, shown_table
from scenarios.files.sources import versions
from scenarios.files.user_models import channel_units
from scenarios.files.writing import study_folder, write_json, write_record
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    SIGMAS,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Table,
    as_sentence,
    brief_estimate,
    capital,
    formatted,
    known,
    reproduction,
    section,
    table,
)
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.report.quantities import quantity_text, shown_in
from scenarios.report.summary import BELOW, WIDTH, Summary, summary_lines, wrapped
from scenarios.report.terminal import table_as_lines
from scenarios.studies.comparison import distance_text
from scenarios.trials.planted_declaration import hidden_units
from scenarios.trials.planted_flights import write_simulated
from scenarios.trials.planted_study import TRUE, Scored, TraceStudy

# ---- A tracing study in words and tables for the terminal

THIRD_TITLE = (
    "simulation error (rms) on a third record, test.csv, which took no part in fitting or in "
    "choosing effects"
)


def trace_text(study: TraceStudy, width: int = WIDTH, details: str = BELOW) -> str:
    """Return the printed text: summary, diagnosis as in `flightid diagnose`, true values."""
    scenario = study.scenario
    blocks = [
        summary_lines(trace_summary(study, details), width),
        [
            f"{scenario.name}: {scenario.title}",
            f"flight and model: {distance_text(scenario.distance)}; seed {study.seed}",
        ],
        details_text(study.tracing, width).rstrip().split("\n"),
        table_as_lines(third_table(study), width),
        table_as_lines(against_truth(study), width),
        table_as_lines(effects_table(study), width, titled=False),
        table_as_lines(modes_table(study), width, titled=False),
        [line for sentence in comparable_sentences(study) for line in wrapped(sentence, width)],
        wrapped(scored_sentence(study), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def trace_summary(study: TraceStudy, details: str = BELOW) -> Summary:
    """Return the diagnosis, and whether it is right."""
    text = diagnosis_summary(study.tracing, details)
    named = f"{study.scenario.name}: {study.scenario.title}; {text.study}"
    return replace(
        text, study=named, outcome=f"{text.outcome}; the diagnosis is {study.grade.value}"
    )


def scored_sentence(study: TraceStudy) -> str:
    """Return the sentence on the hidden effect, the expectation and the grade of the diagnosis."""
    return (
        f"scored with the truth: {_hidden(study)}; expected: {_expected(study)}; the diagnosis is "
        f"{study.grade.value}"
    )


def effects_table(study: TraceStudy) -> Table:
    """Return the parameters of the effects."""
    return _estimates("Parameters of the effects", "effect", study.effects)


def modes_table(study: TraceStudy) -> Table:
    """Return the frequencies and damping ratios of the whole aircraft."""
    caption = "Frequencies and damping ratios of the whole aircraft"
    modes = [replace(row, name=row.name.replace("_", " ")) for row in study.modes]
    return _estimates(caption, "mode", modes)


def _estimates(caption: str, heading: str, rows: Sequence[Scored]) -> Table:
    shown = [(row, shown_in(row.unit, row.name).factor) for row in rows]
    return table(
        caption,
        (Column(heading), [row.name for row in rows]),
        (Column("true", BY_ROW), [_exact(row.true, factor) for row, factor in shown]),
        (Column("comparable", BY_ROW), [_comparable(row, factor) for row, factor in shown]),
        (Column("estimate", BY_ROW, together=True), [_value(row.after, f) for row, f in shown]),
        (Column("error", SIGMAS), [formatted(row.sigmas, "+.1f") for row in rows]),
        units=[shown_in(row.unit, row.name).unit for row in rows],
    )


def against_truth(study: TraceStudy) -> Table:
    """Return the table of derivatives before and after, against their expected values.

    Without redundant columns; if no effect was added, only the declared model.
    """
    alone = declared_alone(study.tracing.diagnosis)
    rows = [_of_declared(row) if alone else row for row in study.derivatives]
    shown = [(row, shown_in(row.unit, row.name).factor) for row in rows]
    condensed = any(row.condensed is not None for row in rows)
    return table(
        table_title(study),
        (Column("derivative"), [row.name for row in rows]),
        (Column("true", BY_ROW), [_exact(row.true, factor) for row, factor in shown]),
        (Column("condensed", BY_ROW), [_exact(row.condensed, factor) for row, factor in shown])
        if condensed
        else None,
        (Column("comparable", BY_ROW), [_comparable(row, factor) for row, factor in shown]),
        None
        if alone
        else (Column("before", BY_ROW, together=True), [_value(r.before, f) for r, f in shown]),
        (
            Column(DECLARED if alone else "after", BY_ROW, together=True),
            [_value(row.after, factor) for row, factor in shown],
        ),
        (Column("error", SIGMAS), [formatted(row.sigmas, "+.1f") for row in rows]),
        units=[shown_in(row.unit, row.name).unit for row in rows],
    )


def _of_declared(row: Scored) -> Scored:
    """Return the row with the estimate of the declared model and its reference value."""
    if row.before is None or row.comparable_before is None:
        return row
    return replace(row, after=row.before, comparable=row.comparable_before, open=False)


def table_title(study: TraceStudy) -> str:
    """Return the title that names the reference values of the derivatives."""
    if study.scenario.model == "loes":
        return (
            "derivatives; true are those of the equivalent system that fits the linear loop's "
            "frequency response"
        )
    return "derivatives against the truth"


def comparable_sentences(study: TraceStudy) -> list[str]:
    """Return the source of the reference values, and why they differ from the true ones."""
    sentences = [
        f"comparable: the value that the fitted model should find, from {study.basis}",
        *study.reasons,
    ]
    if study.basis == TRUE:
        sentences.append(
            "third record: gusts are not known beforehand, so that turbulence does not lower the "
            "error of a free simulation"
        )
    return sentences


def third_table(study: TraceStudy) -> Table:
    """Return the prediction errors on the third record; without effects, those before alone."""
    d, units = study.tracing.diagnosis, channel_units(study.tracing.model)
    names = list(study.test.before.rmse)
    shown = {name: shown_in(units.get(name, ""), name) for name in names}

    def cells(levels: Mapping[str, float]) -> list[Cell]:
        return [level_cell(shown[name].factor * levels.get(name, math.nan)) for name in names]

    full = table(
        THIRD_TITLE,
        (Column("channel", printed="error"), names),
        (Column("before", BY_ROW), cells(study.test.before.rmse)),
        (Column("after", BY_ROW), cells(study.test.after.rmse if study.test.finite else {})),
        (Column("sensor noise", BY_ROW), cells(study.simulated.noise_std)),
        units=[shown[name].unit for name in names],
    )
    return shown_table(d, full)


def _exact(value: float | None, factor: float) -> Cell:
    return known(None if value is None else factor * value)


def _value(quantity: Quantity | None, factor: float) -> Cell:
    if quantity is None:
        return MISSING
    return brief_estimate(factor * quantity.value, factor * quantity.std)


def _comparable(row: Scored, factor: float) -> Cell:
    """Return the reference value; in brackets if this flight does not determine the parameter."""
    value = factor * row.comparable
    return Number(value, shown=f"({value:.5g})" if row.open else f"{value:.5g}")


def _hidden(study: TraceStudy) -> str:
    flight, terms = study.scenario.flight, []
    for name, values in study.simulated.hidden.items():
        units = hidden_units(name, flight.own if flight.own is not None else flight.vehicle, name)
        values_text = ", ".join(
            f"{key} {quantity_text(value, units.get(key, ''), key)}"
            for key, value in values.items()
        )
        terms.append(f"{name} ({values_text})")
    if flight.modes and study.scenario.model == "rigid":
        terms.insert(0, f"{flight.modes} elastic mode{'s' * (flight.modes > 1)}")
    return f"hidden was {' and '.join(terms)}" if terms else "nothing was hidden"


def _expected(study: TraceStudy) -> str:
    expect = study.scenario.expect
    sets = " or ".join(" + ".join(names) for names in expect.effects)
    return " or ".join(expect.verdicts) + (f", {sets}" if sets else "")


# ---- Comparison with the truth on the page of a diagnosis


def scored_page(study: TraceStudy, page: Page) -> Page:
    """Return the page of a diagnosis with the scenario's title and the true values.

    The true values come first: the summary is long, and on paper no figure fits below it.
    """
    scenario = study.scenario
    scored = as_sentence(scored_sentence(study))
    truth = section(
        "Against the truth",
        against_truth(study),
        effects_table(study),
        modes_table(study),
        *(Prose(as_sentence(capital(sentence))) for sentence in comparable_sentences(study)),
        third_table(study),
        Prose(f"Flight and model: {distance_text(scenario.distance)}.", "note"),
    )
    return replace(
        page,
        title=capital(scenario.title),
        kind=f"Study {scenario.name}: {page.kind}",
        summary=(*page.summary, scored),
        sections=(*truth, *page.sections),
        reproduction=reproduction(
            ("flightid", "run", scenario.name, "--seed", str(study.seed)),
            f"Seed {study.seed}.",
            page.reproduction.inputs,
        ),
    )


# ---- The study folder of a tracing scenario

MAIN = "comparison.json"


def write_trace(study: TraceStudy, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write records, vehicle file, diagnosis, truth and ``comparison.json`` (last).

    Returns the folder.
    """
    return write_trial(
        study.tracing,
        partial(_write_records, study),
        truth_content(study),
        trace_comparison(study),
        folder,
        figures=figures,
        dressed=partial(scored_page, study),
    )


def write_trial(
    tracing: Tracing,
    write_inputs: Callable[[Path], object],
    truth: dict[str, Any],
    comparison: dict[str, Any],
    folder: str | Path,
    *,
    figures: Formats,
    dressed: Callable[[Page], Page],
) -> Path:
    """Write a diagnosis, the files it used, the truth and ``comparison.json`` (last).

    Parameters
    ----------
    write_inputs : writes records and vehicle file into a folder.
    truth, comparison : content of ``truth.json`` and ``comparison.json``.
    dressed : returns the page of the diagnosis with additions.

    Returns
    -------
    The folder.
    """
    write_diagnosis(tracing, folder, figures=figures, dressed=dressed)
    with study_folder(folder, MAIN) as scratch:
        write_inputs(scratch)
        write_json(scratch / "truth.json", truth)
        write_json(scratch / MAIN, comparison)
    return Path(folder)


def _write_records(study: TraceStudy, folder: Path) -> None:
    write_simulated(study.simulated, folder)
    write_record(folder, study.simulated.test, "test", simulated=True)
    write_prediction(folder / "test_prediction.csv", study.test.predictions[0])


def truth_content(study: TraceStudy) -> dict[str, Any]:
    """Return the content of ``truth.json``: derivatives, hidden terms, noise and distance."""
    simulated = study.simulated
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
        "effects": list(simulated.hidden),
        "hidden": {name: dict(values) for name, values in simulated.hidden.items()},
        "noise_std": dict(simulated.noise_std),
        "distance": study.scenario.distance,
        "step": simulated.step,
    }


def trace_comparison(study: TraceStudy) -> dict[str, Any]:
    """Return the content of ``comparison.json``; the declared model is under ``methods``."""
    d = study.tracing.diagnosis
    derived = {"before": _derived(d.derived_before, d.before)}
    derived["after"] = _derived(d.derived_after, d.after)
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


def _derived(
    derived: Mapping[str, Quantity], parameters: Mapping[str, Quantity]
) -> dict[str, dict[str, Any]]:
    """Return derived quantities, and the delay if it is a parameter."""
    delay = {"delay": replace(parameters["delay"], unit="s")} if "delay" in parameters else {}
    return {
        name: {"estimate": bounded(q.value), "std": positive(q.std), "unit": q.unit}
        for name, q in {**derived, **delay}.items()
    }


def _third(study: TraceStudy) -> dict[str, Any]:
    test, units = study.test, channel_units(study.tracing.model)
    channels = test.predictions[0].channels
    return {
        "record": "test.csv",
        "used_in_fit": False,
        "used_to_choose": False,
        "unit": {name: units.get(name, "") for name in channels},
        "before": {"rmse": dict(test.before.rmse)},
        "after": {"rmse": {name: bounded(value) for name, value in test.after.rmse.items()}},
        "noise_std": {
            name: value for name, value in study.simulated.noise_std.items() if name in channels
        },
        "finite": test.finite,
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
