"""An identification in the terminal, in comparison.json and on its page."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console

from ident.flying_qualities.levels import FlightPhase, mode_levels
from ident.recording.series import measurable_noise
from ident.statistics.noise_levels import sensor_noise, used_runs
from ident.statistics.profile_likelihood import LEVEL, ProfileInterval
from ident.tracing.diagnosis import Quantity
from scenarios.files.sources import InputFile
from scenarios.files.user_models import Constraints
from scenarios.identification.assessment import (
    SETTLED,
    AtBound,
    IdentificationResult,
    RecordFit,
    reading_table,
)
from scenarios.identification.cautions import advice, innovations_phrase
from scenarios.identification.conditions import METHOD as FREQUENCY
from scenarios.identification.conditions import PATH
from scenarios.identification.methods import uses_attitude
from scenarios.identification.model_checks import considered_table
from scenarios.preparation.plan import LIFT, SPEED, Plan
from scenarios.preparation.recording import record_lines, record_table
from scenarios.report.document import (
    BY_ROW,
    Block,
    Bullets,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Table,
    as_sentence,
    capital,
    now,
    reproduction,
    section,
    summary_sentences,
    table,
    warning_lines,
)
from scenarios.report.figure_formats import Drawn
from scenarios.report.folder import first_figure
from scenarios.report.quantities import (
    console,
    derived_line,
    determined,
    displayed,
    number_text,
    shown_in,
    spaced,
    test_line,
)
from scenarios.report.summary import (
    BELOW,
    Summary,
    first_clauses,
    levels_line,
    print_caution,
    print_paragraph,
    print_summary,
    residual_phrase,
    result_phrase,
)
from scenarios.report.terminal import (
    FITS,
    NO_FIT,
    derived_table,
    estimates_table,
    fit_cells,
    fixed_table,
    levels_of_noise,
    rows_table,
    show_blocks,
    show_table,
    tests_table,
)
from scenarios.stored_study import IDENTIFY, StoredModel, StoredReading
from scenarios.studies.declaration import Row
from sim.record import extent

# ---- Additional content of comparison.json


def constraints_content(
    constraints: Constraints, tied: Sequence[Row], at_bounds: Sequence[AtBound]
) -> dict[str, Any]:
    """Return the constraints of the vehicle file and their results; empty if there are none."""
    out: dict[str, Any] = {}
    if constraints.fixed:
        out["held"] = list(constraints.fixed)
    if constraints.bounds:
        out["bounds"] = {name: _pair(low, high) for name, (low, high) in constraints.bounds.items()}
    if constraints.ties:
        rows = {row.name: row for row in tied}
        out["tied"] = {
            tie.name: {
                "estimate": rows[tie.name].estimate,
                "std": rows[tie.name].std,
                "unit": rows[tie.name].unit,
                "tie": tie.words,
            }
            for tie in constraints.ties
            if tie.name in rows
        }
    if at_bounds:
        out["at_bound"] = {
            each.name: {"value": each.value, "unit": each.unit, "bound": each.side}
            for each in at_bounds
        }
    return {"constraints": out} if out else {}


def intervals_content(intervals: Sequence[ProfileInterval]) -> dict[str, Any]:
    """Return the profile-likelihood intervals by parameter; an end that is left out is open."""
    if not intervals:
        return {}
    return {
        "intervals": {
            "level": LEVEL,
            "parameters": {each.name: _interval(each) for each in intervals},
        }
    }


def fits_content(fits: Sequence[RecordFit]) -> dict[str, Any]:
    """Return the errors of the free simulations, record by record."""
    return {"records_fitted": [_fit(each) for each in fits]} if fits else {}


def _pair(low: float, high: float) -> dict[str, float]:
    return {
        key: value for key, value in (("low", low), ("high", high)) if abs(value) != float("inf")
    }


def _interval(each: ProfileInterval) -> dict[str, Any]:
    ends = {
        key: value for key, value in (("low", each.low), ("high", each.high)) if value is not None
    }
    bounds = [key for key, at in (("low", each.low_bound), ("high", each.high_bound)) if at]
    return {**ends, **({"at_bound": bounds} if bounds else {}), "agrees_with_sigma": each.agrees}


def _fit(each: RecordFit) -> dict[str, Any]:
    content: dict[str, Any] = {"record": each.record.name, "held_out": each.held_out}
    if each.figures is not None:
        figures = each.figures
        content["channels"] = {
            name: {
                "rms_error": figures.rmse[name],
                "fit_percent": figures.fit_percent(name),
                "r2": figures.r2[name],
                "theil": figures.theil[name],
            }
            for name in figures.rmse
        }
    return content


# ---- Additional lines on the terminal

PROFILED = f"profile likelihood, {100.0 * LEVEL:.0f} % intervals"
SIMULATED = (
    "simulation with the estimated parameters held fixed; only initial states and biases are "
    "fitted to each record"
)
NOTABLE_REFIT_GAIN = 0.1  # gain in log likelihood above which a better refit is reported


def bound_lines(at_bounds: Sequence[AtBound], tied: Sequence[Row]) -> list[str]:
    """Return a line for each parameter at a bound and each that follows others."""
    # Parameters tied to fixed ones have no sigma.
    sigmas = [f" +- {number_text(row.std, row.std)}" if row.std > 0.0 else "" for row in tied]
    followed = [
        f"{row.name} {number_text(row.estimate, row.std)}{sigma}{spaced(row.unit)}, tied"
        for row, sigma in zip(tied, sigmas, strict=True)
    ]
    return [*(each.words for each in at_bounds), *followed]


def intervals_table(intervals: Sequence[ProfileInterval], units: Mapping[str, str]) -> Table:
    """Return the ends of the intervals, and how they compare with two sigmas."""
    shown = [shown_in(units.get(each.name, ""), each.name) for each in intervals]
    pairs = list(zip(intervals, (unit.factor for unit in shown), strict=True))
    return table(
        PROFILED,
        (Column("parameter"), [each.name for each in intervals]),
        (Column("from", BY_ROW), [_end(each, -1, factor) for each, factor in pairs]),
        (Column("to", BY_ROW), [_end(each, 1, factor) for each, factor in pairs]),
        (Column("in sigmas", right=True), [_sides(each) for each in intervals]),
        (Column("as sigma says", right=True), ["" if each.agrees else "no" for each in intervals]),
        units=[unit.unit for unit in shown],
    )


def interval_sentences(intervals: Sequence[ProfileInterval]) -> list[str]:
    """Return sentences on open ends and asymmetry of intervals, and on likelier values in them."""
    sentences: list[str] = []
    odd = [each for each in intervals if not each.agrees]
    open_ends = [f"{each.name} is open {' and '.join(_open(each))}" for each in odd if _open(each)]
    if open_ends:
        sentences.append(f"not determined on that side by these data: {'; '.join(open_ends)}")
    skewed = [each.name for each in odd if not _open(each)]
    if skewed:
        sentences.append(f"the interval is not +- 2 sigma: {', '.join(skewed)}; quote the interval")
    better = [each.name for each in intervals if each.better > NOTABLE_REFIT_GAIN]
    if better:
        sentences.append(
            f"likelier values than the estimate were found along {', '.join(better)}: the fit was "
            "not at its best"
        )
    return sentences


def fits_table(fits: Sequence[RecordFit]) -> Table:
    """Return the errors of the free simulations, a row for each record and channel."""
    rows: list[list[Cell]] = []
    for each in fits:
        head: list[Cell] = [each.record.name, "held out" if each.held_out else "fitted"]
        if each.figures is None:
            rows.append([*head, *NO_FIT])
            continue
        for name, error in each.figures.rmse.items():
            cells = fit_cells(
                name,
                Quantity(error, 0.0, each.record[name].unit),
                each.figures.fit_percent(name),
                each.figures.r2[name],
                each.figures.theil[name],
            )
            rows.append([*head, *cells])
    return rows_table(SIMULATED, (Column("record"), Column("use", printed=" "), *FITS), rows)


def _end(each: ProfileInterval, side: int, factor: float) -> Cell:
    end, at_bound = (each.low, each.low_bound) if side < 0 else (each.high, each.high_bound)
    if end is None:
        return "open"
    text = number_text(factor * end, factor * each.sigma)
    return Number(factor * end, shown=f"{text} (bound)" if at_bound else text)


def _sides(each: ProfileInterval) -> str:
    """Return the ends of an interval in sigmas from the estimate: ``"-1.8 to +2.6"``."""
    low, high = (
        "open" if end is None else f"{(end - each.value) / each.sigma:+.2g}"
        for end in (each.low, each.high)
    )
    return f"{low} to {high}"


def _open(each: ProfileInterval) -> list[str]:
    return [word for word, end in (("below", each.low), ("above", each.high)) if end is None]


# ---- Residuals that are not white

UNMEASURABLE = "not measurable from this record"


def estimated_noise(found: IdentificationResult) -> dict[str, float]:
    """Return the sensor noise (SI) of each output with coloured residuals, estimated from the high
    frequencies of the residuals of simulations.
    """
    return {name: level for name, level in _levels(found).items() if level is not None}


def _levels(found: IdentificationResult) -> dict[str, float | None]:
    """Return the same, None for short records and for samples smoother than a sensor's; never below
    the rounding of a converter.
    """
    coloured = {test.channel.partition(",")[0] for test in found.tests if not test.passed}
    out: dict[str, float | None] = {}
    for name in found.estimate.output_names:
        runs, values = [], []
        for fit in found.fits:
            if (
                fit.held_out
                or fit.figures is None
                or name not in coloured
                or name not in fit.record.output_names
            ):
                continue
            channel = fit.record[name]
            residual = channel.values - fit.simulated[fit.outputs.index(name)]
            runs += used_runs(fit.record.time, residual, channel.valid & np.isfinite(residual))
            values.append(channel.values[channel.valid])
        if values:
            out[name] = measurable_noise(sensor_noise(runs), values)
    return out


def noise_phrase(found: IdentificationResult) -> str:
    """Return ``"sensor noise (estimated, 1 sigma): q 0.09 deg/s"``; empty if all residuals are
    white.
    """
    levels = []
    for name, level in _levels(found).items():
        if level is None:
            levels.append(f"{name} {UNMEASURABLE}")
            continue
        factor, shown = shown_in(found.units[name], name)
        levels.append(f"{name} {factor * level:.3g}{spaced(shown)}")
    return (
        f"sensor noise (estimated from high frequencies, 1 sigma): {', '.join(levels)}"
        if levels
        else ""
    )


# ---- The model of an identification in its study folder


def stored_identification(found: IdentificationResult, plan: Plan) -> StoredModel | None:
    """Return the model of an identification; None if its numbers are not finite."""
    trained, vehicle, first = found.trained, found.vehicle, found.record
    if trained is None or not np.all(
        np.isfinite([*trained.shared.values(), *trained.own[0].values()])
    ):
        return None
    by_own_filter = vehicle.model == "loes" and found.method == "ekf"
    measured = set(first.input_names)
    reading = StoredReading(
        first.hold.value,
        plan.hold is not None,
        weight=SPEED not in measured or LIFT in measured,
        flow=not by_own_filter and found.method != FREQUENCY,
        attitude=uses_attitude(vehicle, found.method),
        rate=plan.rate or 0.0,
        lowpass=plan.lowpass or 0.0,
        trusted=plan.trusted,
    )
    identity = vehicle.identity if vehicle.text else None
    biases = tuple(name.removeprefix("bias_") for name in trained.own[0])
    return StoredModel(
        IDENTIFY,
        vehicle.model,
        identity,
        vehicle.text,
        vehicle.own_file,
        reading,
        biases,
        trained,
        weighed=PATH in trained.shared,
    )


# ---- An identification in the terminal


def print_identification(
    found: IdentificationResult,
    flown: FlightPhase,
    out: Console | None = None,
    details: str = BELOW,
) -> None:
    """Print an identification; ``details``: place of the full text."""
    out = out or console()
    records = (found.record, *found.others)
    print_summary(out, identification_summary(found, details))
    for record in records:
        told = (
            f"; {found.vehicle.model} model, {found.method}: {found.estimate.outcome.value}"
            if record is records[-1]
            else ""
        )
        print_paragraph(
            out,
            f"{record.name}: {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} "
            f"s{told}",
            0,
        )
    if found.engine:
        print_paragraph(out, f"engine: {found.engine['sentence']}", 0)
    sentences, rest = list[str](), list[str]()
    for kind, lines in (("warning", found.doubts), ("caution", found.cautions)):
        for each in lines:
            short, more = first_clauses(each)
            sentences.append(f"{kind}: {short}")
            rest += [f'more on "{short.partition(":")[0]}": {more}'] if more else []
    for line in (*sentences, *record_lines(found.look), *bound_lines(found.at_bounds, found.tied)):
        print_caution(out, line)
    show_table(out, _estimates("", found, (*found.rows, *found.biases)))
    show_blocks(out, [*_considered(found), *_intervals(found)])
    if found.reading:
        print_paragraph(out, f"caution: {found.reading.sentence}", 0)
        show_table(out, reading_table("", found.reading))
    print_paragraph(out, f"residual (1 sigma): {_residual(found)}", 0)
    show_table(out, fits_table(found.fits))
    for line in (
        derived_line(found.derived),
        _levels_reached(found, flown),
        test_line(found.tests),
        noise_phrase(found),
        *rest,
        *(f"note: {note}" for note in found.notes),
    ):
        if line:
            print_paragraph(out, line, 0)


def identification_summary(found: IdentificationResult, details: str = BELOW) -> Summary:
    """Return the summary: records, model, method, outcome, main cautions, residual."""
    records = (found.record, *found.others)
    named = found.record.name + (f" and {len(found.others)} more" if found.others else "")
    samples = sum(len(record) for record in records)
    rows = [(row.name, row.estimate, row.std, row.unit) for row in found.rows]
    vague = [row.name for row in found.rows if not determined(row.estimate, row.std)]
    outcome = found.estimate.outcome.value + (
        f"; not determined: {', '.join(vague)}" if vague else ""
    )
    counts = ((len(found.doubts), "warning"), (len(found.cautions), "caution"))
    counted = [f"{n} {word}{'s' if n > 1 else ''}" for n, word in counts if n]
    outcome += f"; {' and '.join(counted)} below" if counted else ""
    return Summary(
        f"{named}, {samples} samples; {found.vehicle.name}, {found.vehicle.model} model, "
        f"{found.method}",
        outcome,
        result_phrase(rows, found.derived),
        innovations_phrase(found.method, records, found.estimate) + residual_phrase(found.tests),
        details,
    )


def _estimates(caption: str, found: IdentificationResult, rows: Sequence[Row]) -> Table:
    starts = {
        **found.vehicle.derivatives,
        **{name: value for _, mode in found.vehicle.modes for name, value in mode.items()},
    }
    return estimates_table(caption, rows, starts)


def _levels_reached(found: IdentificationResult, flown: FlightPhase) -> str:
    if found.modes is None:
        return ""
    return levels_line(mode_levels(found.modes, flown), flown, found.tests)


def _considered(found: IdentificationResult) -> list[Block]:
    """Return the contribution of uncertain constants to the sigmas; empty if there is none."""
    if found.considered is None or not found.considered.constants:
        return []
    return [considered_table(found.considered, tuple(row.name for row in found.rows))]


def _intervals(found: IdentificationResult) -> list[Block]:
    if not found.intervals:
        return []
    units = {row.name: row.unit for row in found.rows}
    sentences = map(Prose, interval_sentences(found.intervals))
    return [intervals_table(found.intervals, units), *sentences]


def _residual(found: IdentificationResult) -> str:
    levels = zip(found.estimate.output_names, found.estimate.noise_std, strict=True)
    shown = [
        (name, displayed(Quantity(float(std), 0.0, found.units.get(name, ""))))
        for name, std in levels
    ]
    return ", ".join(f"{name} {value:.3g}{spaced(unit)}" for name, (value, _, unit) in shown)


# ---- The page of an identification from measured records


def identification_page(
    found: IdentificationResult,
    flown: FlightPhase,
    files: Sequence[InputFile],
    validation: Sequence[InputFile] = (),
    drawn: Sequence[Drawn] = (),
) -> Page:
    """Return the page of an identification: ``files`` were fitted, those of ``validation``
    predicted.
    """
    estimate, records = found.estimate, (found.record, *found.others)
    settled = estimate.outcome in SETTLED
    white = all(test.passed for test in found.tests)
    inputs = [("fitted", file.name, file.sha256) for file in files] + [
        ("predicted", file.name, file.sha256) for file in validation
    ]
    inputs += [
        (use, file.name, file.sha256)
        for use, file in (("vehicle", found.vehicle.identity), ("model", found.vehicle.own_file))
        if file
    ]
    several = f" of {len(records)} records" if len(records) > 1 else ""
    samples = f"{sum(map(len, records))} samples{several}"
    reading = (found.reading.sentence,) if found.reading else ()
    hint = advice(found.vehicle.model, estimate)
    return Page(
        title=f"{capital(found.vehicle.name)}: {_model(found)} model",
        kind=(
            f"Identification from {', '.join(dict.fromkeys(record.name for record in records))}, "
            f"{found.method}"
        ),
        verdict=estimate.outcome.value.partition(":")[0].partition(",")[0],
        tone="open" if not settled else "good" if white and not found.cautions else "fair",
        sentence=as_sentence(
            f"{len(found.rows)} parameters from {samples}" + (f". {capital(hint)}" if hint else "")
        ),
        summary=summary_sentences(identification_summary(found)),
        warnings=warning_lines(found.doubts, (*found.cautions, *reading)),
        sections=(
            *section("Recorded and estimated", *first_figure(drawn)[0]),
            *section("Estimates", *_found(found, flown)),
            *section("Prediction", fits_table(found.fits)),
            *section("Further figures", *first_figure(drawn)[1]),
            *section("Residuals and noise", *_evidence(found)),
            *section("The record as it was recorded", record_table(found.look)),
            *section("How it was made", *_made(found)),
        ),
        reproduction=reproduction(_command(found, files), "", inputs),
        created=now(),
    )


def _found(found: IdentificationResult, flown: FlightPhase) -> list[Block]:
    blocks: list[Block] = [_estimates("Parameters", found, found.rows)]
    blocks += [estimates_table("Biases of the sensors", found.biases)] if found.biases else []
    blocks += [derived_table("Derived quantities", found.derived)] if found.derived else []
    lines = (*bound_lines(found.at_bounds, found.tied), _levels_reached(found, flown))
    blocks += [Prose(as_sentence(line)) for line in lines if line]
    blocks += [*_considered(found), *_intervals(found)]
    if found.reading:
        caption = "If the inputs were read otherwise between samples"
        blocks += [reading_table(caption, found.reading)]
    return blocks


def _evidence(found: IdentificationResult) -> list[Block]:
    estimate = found.estimate
    noise = {
        name: (float(std), found.units.get(name, "1"))
        for name, std in zip(estimate.output_names, estimate.noise_std, strict=True)
    }
    blocks: list[Block] = [tests_table("Residual tests", found.tests)] if found.tests else []
    phrase = noise_phrase(found)
    return [
        *blocks,
        levels_of_noise("Residual, one sigma", noise),
        *([Prose(as_sentence(phrase))] if phrase else []),
    ]


def _made(found: IdentificationResult) -> list[Block]:
    parts = tuple(f"{r.name}: {extent(r)}" for r in (found.record, *found.others))
    notes = tuple(as_sentence(note) for note in found.notes)
    blocks: list[Block] = [Bullets(parts), Bullets(notes)]
    blocks += [Prose(as_sentence(f"engine: {found.engine['sentence']}"))] if found.engine else []
    return [*blocks, *([fixed_table("Constants", found.fixed)] if found.fixed else [])]


def _model(found: IdentificationResult) -> str:
    return (
        found.vehicle.own_file.name if found.vehicle.own_file is not None else found.vehicle.model
    )


def _command(found: IdentificationResult, files: Sequence[InputFile]) -> list[str]:
    vehicle = found.vehicle.identity
    given = ["--vehicle", os.fspath(vehicle.name)] if vehicle is not None else []
    return [
        "flightid",
        "identify",
        *(file.name for file in files),
        "--model",
        _model(found),
        *given,
        "--method",
        found.method,
    ]
