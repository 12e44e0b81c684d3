"""Frequency responses in the terminal, on a page, and in a study folder."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console

from ident.flying_qualities.attitude_criteria import step_response
from ident.frequency_response.transfer_function import Form
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    Block,
    Bullets,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Table,
    as_sentence,
    formatted,
    now,
    reproduction,
    section,
    table,
    value_and_width,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats, caption_of
from scenarios.report.folder import figures, write_page
from scenarios.report.quantities import console, number_text
from scenarios.report.summary import BELOW, Summary, print_paragraph, print_summary
from scenarios.report.terminal import show_blocks, show_table
from scenarios.responses.analysis import ResponseEstimates, pairs
from scenarios.responses.fitting import (
    SMALLEST_SIZE,
    Fits,
    cost_sentence,
    envelope_sentence,
    model_content,
    model_lines,
    model_table,
    percent_cell,
    transfer_text,
)
from scenarios.responses.loops import loop_tables, margin_lines, margins_content
from scenarios.responses.qualities import levels_content, quality_lines, quality_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# ---- Frequency responses in the terminal

PRINTED_FREQUENCIES = 12  # frequencies of a printed table
MOST_NAMED_FILES = 3  # parts or files that are named in a heading


def print_responses(
    estimates: ResponseEstimates, out: Console | None = None, details: str = BELOW
) -> None:
    """Print summary, notes, and a table for each response and for what was computed from it."""
    out = out or console()
    print_summary(out, responses_summary(estimates, details))
    for line in estimates.cautions:
        print_paragraph(out, f"warning: {line}", indent=0)
    for line in estimates.notes:
        print_paragraph(out, line, indent=0)
    for row, column, _ in pairs(estimates):
        show_table(
            out,
            response_table(estimates, row, column, f": {band_sentence(estimates, row, column)}"),
        )
    show_blocks(out, quality_tables(estimates.qualities))
    for line in quality_lines(estimates.qualities):
        print_paragraph(out, line, indent=0)
    if estimates.loop is not None:
        show_blocks(out, loop_tables(estimates.loop))
        for line in margin_lines(estimates.loop):
            print_paragraph(out, line, indent=0)
    for row, column, _ in pairs(estimates):
        for line in fit_lines(estimates, row, column):
            print_paragraph(out, line, indent=0)
        show_blocks(out, fit_tables(estimates, row, column))
    if estimates.model is not None:
        for line in model_lines(estimates.model):
            print_paragraph(out, line, indent=0)
        show_table(out, model_table(estimates.model))


def name_pair(estimates: ResponseEstimates, row: int, column: int) -> tuple[str, str]:
    """Return the names of output and input of a response."""
    return estimates.names.outputs[row], estimates.names.inputs[column]


def responses_summary(estimates: ResponseEstimates, details: str = BELOW) -> Summary:
    """Return the summary: parts of records, kind of the estimate, and usable bands."""
    duration = sum(estimates.durations)
    number = len(pairs(estimates))
    method = "joint input-output" if estimates.responses.joint else "direct"
    bands = [
        f"{name} {band_sentence(estimates, row, column)}" for row, column, name in pairs(estimates)
    ]
    return Summary(
        f"{_first_names(estimates.parts)}, {duration:.4g} s in {len(estimates.parts)} "
        f"part{'s' * (len(estimates.parts) > 1)}",
        f"{number} frequency response{'s' * (number > 1)}, {method} estimate",
        "; ".join(bands),
        "",
        details,
    )


def _first_names(names: Sequence[str]) -> str:
    more = ", ..." if len(names) > MOST_NAMED_FILES else ""
    return ", ".join(names[:MOST_NAMED_FILES]) + more


def fit_lines(estimates: ResponseEstimates, row: int, column: int) -> list[str]:
    """Return the fitted transfer function of a response, its cost, and whether a pilot would notice
    its mismatch.
    """
    fitted = estimates.fits.of(row, column) if estimates.fits is not None else None
    if fitted is None:
        return []
    function, mismatch = fitted
    lines = [
        f"{function.name} = {transfer_text(function)} ({function.form.name})",
        cost_sentence(function),
    ]
    if sentence := envelope_sentence(function, mismatch):
        lines.append(sentence)
    return lines


def _unit_of(estimates: ResponseEstimates, row: int, column: int, form: Form, name: str) -> str:
    """Return the unit of a parameter of a form."""
    names = estimates.names
    unit = form.units.get(name, "")
    return estimates.parameter_unit(names.outputs[row], names.inputs[column], name, unit)


def fit_tables(
    estimates: ResponseEstimates, row: int, column: int, caption: str = ""
) -> list[Table]:
    """Return a table of the parameters of a fitted transfer function; none without a fit."""
    fitted = estimates.fits.of(row, column) if estimates.fits is not None else None
    if fitted is None or estimates.fits is None:
        return []
    function, _ = fitted
    names = list(function.form.parameters)

    def value_cell(name: str) -> Cell:
        value = function.values[name]
        return Number(value, shown=number_text(value, function.std.get(name)))

    def percent(name: str, numbers: Mapping[str, float]) -> Cell:
        value = function.values[name]
        determined = function.std.get(name, math.inf) < max(abs(value), SMALLEST_SIZE)
        return percent_cell(numbers[name] if determined else math.inf, value)

    def std_cell(name: str) -> Cell:
        return value_and_width(0.0, function.std[name])[1] if name in function.std else "fixed"

    shared = ["shared" if name in estimates.fits.fit.shared else "" for name in names]
    insensitivity = [percent(name, function.insensitivity) for name in names]
    return [
        table(
            caption,
            (Column("parameter"), names),
            (Column("value", BY_ROW), [value_cell(name) for name in names]),
            (Column("std", BY_ROW, beside=True), [std_cell(name) for name in names]),
            (Column("std", "%"), [percent(name, function.std) for name in names]),
            (Column("insensitivity", "%"), insensitivity),
            (Column("note"), shared) if any(shared) else None,
            units=[_unit_of(estimates, row, column, function.form, name) for name in names],
        )
    ]


def band_sentence(estimates: ResponseEstimates, row: int, column: int) -> str:
    """Return the usable band: ``"usable from 0.1 to 4.2 Hz (coherence 0.6 or more)"``."""
    band = estimates.responses.bands()[row][column]
    kind = "partial coherence" if len(estimates.names.inputs) > 1 else "coherence"
    limit = f"{kind} {estimates.responses.spectra.least_coherence:g} or more"
    if band is None:
        return f"nowhere usable ({limit})"
    return f"usable from {band[0]:.3g} to {band[1]:.3g} Hz ({limit})"


def shown_rows(count: int) -> np.ndarray:
    """Return the positions of at most ``PRINTED_FREQUENCIES`` frequencies, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, PRINTED_FREQUENCIES)).round().astype(int))


def response_table(
    estimates: ResponseEstimates, row: int, column: int, sentence: str = ""
) -> Table:
    """Return a table of a response at some frequencies; ``sentence`` ends the caption."""
    responses = estimates.responses
    rows = shown_rows(responses.frequency.size)
    unit = estimates.unit(*name_pair(estimates, row, column))
    label = next(text for i, j, text in pairs(estimates) if (i, j) == (row, column))
    frequency = responses.frequency
    magnitude = np.abs(responses.response[row, column])
    decibels = 20.0 * np.log10(np.maximum(magnitude, SMALLEST_SIZE))
    phase = np.degrees(responses.phase()[row, column])
    phase_half_width = np.degrees(responses.phase_half_width()[row, column])
    usable = responses.usable[row, column]

    def cells(values: np.ndarray, form: str) -> list[Cell]:
        return [formatted(float(values[k]), form) for k in rows]

    half_width = responses.half_width()[row, column]
    sizes = [value_and_width(float(magnitude[k]), float(half_width[k])) for k in rows]
    size_unit = unit or PURE
    partial_coherence = None
    if len(estimates.names.inputs) > 1:
        partial_coherence = (
            Column("partial coherence", PURE),
            cells(responses.partial_coherence[row, column], ".3f"),
        )
    return table(
        f"{label}{f', {unit}' if unit else ''}{sentence}",
        (Column("frequency", "Hz", printed="Hz"), cells(frequency, ".3g")),
        (Column("frequency", "rad/s", printed="rad/s"), cells(2.0 * np.pi * frequency, ".3g")),
        (Column("magnitude", size_unit, printed="magnitude"), [size for size, _ in sizes]),
        (Column("+-", size_unit, printed="+-"), [width for _, width in sizes]),
        (Column("magnitude", "dB", printed="dB"), cells(decibels, ".1f")),
        (Column("phase", "deg"), cells(phase, ".1f")),
        (Column("+-", "deg", printed="+-"), cells(phase_half_width, ".1f")),
        (Column("coherence", PURE), cells(responses.coherence[row], ".3f")),
        partial_coherence,
        (Column("random error", PURE), cells(responses.random_error[row, column], ".3f")),
        (Column("usable"), ["yes" if usable[k] else MISSING for k in rows]),
    )


# ---- The page of an estimate

READING = (
    "The bands hold the response with a probability of 95 % at each frequency by itself. They "
    "cover random errors; an error of a sensor's scale or delay is not among them.",
    "The coherence is the share of the output's power that follows the inputs linearly. The "
    "partial coherence of an input leaves the other inputs out.",
    "The random error is the standard deviation of the magnitude over the magnitude.",
    "If the output acts back on the input through a controller or a pilot, name an excitation with "
    "--reference: without one the estimate is biased towards the negative inverse of the feedback.",
)


def responses_page(estimates: ResponseEstimates, figure_files: Sequence[Drawn] = ()) -> Page:
    """Return the page of an estimate with the figures ``figure_files``."""
    summary = responses_summary(estimates)
    files = [file.name for file in estimates.identities]
    number = len(pairs(estimates))
    tables: list[Block] = []
    functions: list[Block] = []
    for row, column, name in pairs(estimates):
        tables.append(response_table(estimates, row, column))
        if number > 1:  # the summary has the band of one
            tables.append(Prose(f"{name}: {band_sentence(estimates, row, column)}.", "note"))
        functions += [Prose(as_sentence(line)) for line in fit_lines(estimates, row, column)]
        functions += fit_tables(estimates, row, column, f"Parameters of {name}")
    qualities: list[Block] = [*quality_tables(estimates.qualities)]
    if sentences := quality_lines(estimates.qualities):
        qualities.append(Bullets(tuple(map(as_sentence, sentences))))
    margins: list[Block] = []
    if estimates.loop is not None:
        margins += loop_tables(estimates.loop)
        margins.append(Bullets(tuple(map(as_sentence, margin_lines(estimates.loop)))))
    usable = sum(band is not None for row in estimates.responses.bands() for band in row)
    verdict = "usable" if usable else "not usable"
    if number > 1:
        verdict = f"{usable} of {number} usable"
    inputs = [("used", file.name, file.sha256) for file in estimates.identities]
    vehicle = estimates.model.file if estimates.model is not None else None
    if vehicle is not None:
        inputs.append(("vehicle", vehicle.name, vehicle.sha256))
    return Page(
        title=f"{_first_names(files)}: frequency responses",
        kind="Frequency responses",
        verdict=verdict,
        tone="plain",
        sentence=as_sentence(summary.outcome),
        summary=(as_sentence(summary.result),),
        warnings=tuple(map(as_sentence, estimates.cautions)),
        sections=(
            *section("Bode diagrams", *figures(figure_files)),
            *section("Transfer functions", *functions),
            *section("Derivatives", *model_blocks(estimates)),
            *section("Flying qualities", *qualities),
            *section("Stability margins", *margins),
            *section("Numbers", *tables),
            *section("How they were estimated", Bullets(tuple(map(as_sentence, estimates.notes)))),
            *section("How the numbers are read", Bullets(READING)),
        ),
        reproduction=reproduction(_command(estimates, files), "", inputs),
        created=now(),
    )


def _command(estimates: ResponseEstimates, files: Sequence[str]) -> list[str]:
    """Return the command line of an estimate with its main options."""
    names = estimates.names
    command = ["flightid", "response", *files]
    command += [word for name in names.inputs for word in ("--input", name)]
    command += [word for name in names.outputs for word in ("--output", name)]
    command += [word for name in names.references for word in ("--reference", name)]
    if estimates.loop is not None:
        command += ["--margins", estimates.loop.sign]
    if estimates.model is not None:
        command += ["--model", estimates.model.model]
        if estimates.model.file is not None:
            command += ["--vehicle", estimates.model.file.name]
    return command


# ---- The study folder of an estimate

MAIN = "responses.json"  # written last
TABLE = "responses.csv"
SCHEMA = "flightid/responses/1"


def write_responses(
    estimates: ResponseEstimates, folder: str | Path, *, figures: Formats = USUAL
) -> Path:
    """Write an estimate into ``folder``, completely or not at all; return the folder."""
    with study_folder(folder, MAIN) as scratch:
        figure_files = _draw(estimates, scratch, figures) if figures else ()
        write_text(scratch / TABLE, responses_csv(estimates))
        write_page(scratch, responses_page(estimates, figure_files))
        write_json(scratch / MAIN, responses_content(estimates))
    return Path(folder)


def _draw(estimates: ResponseEstimates, folder: Path, formats: Formats) -> tuple[Drawn, ...]:
    """Draw all figures of an estimate; captions of one response of several begin with its name."""
    from scenarios.plots.drawing import draw_for_page
    from scenarios.plots.flying_qualities import (
        figure_bandwidth,
        figure_margins,
        figure_mismatch,
        figure_response,
    )

    several = len(pairs(estimates)) > 1
    places = [(row, column) for row, column, _ in pairs(estimates)]

    def stem(kind: str, number: int) -> str:
        return f"{kind}_{number}" if several else kind

    drawings = [
        (stem("response", n), partial(figure_response, estimates, *place))
        for n, place in enumerate(places, start=1)
    ]
    if estimates.fits is not None:
        drawings += [
            (stem("mismatch", n), partial(figure_mismatch, estimates, *place))
            for n, place in enumerate(places, start=1)
            if place in estimates.fits.places
        ]
    drawings += quality_figures(estimates)
    if any(qualities.curve is not None for qualities in estimates.qualities):
        drawings += [
            (stem("bandwidth", n), partial(figure_bandwidth, estimates, n - 1))
            for n in range(1, len(estimates.qualities) + 1)
        ]
    if estimates.loop is not None:
        drawings.append(("loop", partial(figure_margins, estimates)))
    response_names = {
        f"{kind}_{n}": name
        for n, (_, _, name) in enumerate(pairs(estimates), start=1)
        for kind in ("response", "mismatch")
    }

    def captioned(drawn: Drawn) -> Drawn:
        if drawn.stem not in response_names:
            return drawn
        caption = caption_of(drawn.stem.rstrip("_0123456789"))
        return replace(drawn, caption=f"{response_names[drawn.stem]}: {caption}")

    return tuple(map(captioned, draw_for_page(drawings, folder, formats)))


def model_blocks(estimates: ResponseEstimates) -> list[Block]:
    """Return the blocks of the page on a fitted model; empty without one."""
    if estimates.model is None:
        return []
    title = f"Parameters of {estimates.model.model}"
    return [
        *(Prose(as_sentence(line)) for line in model_lines(estimates.model)),
        model_table(estimates.model, title),
    ]


def quality_figures(estimates: ResponseEstimates) -> list[tuple[str, partial[Figure]]]:
    """Return stem and drawing function of each chart of flying qualities, and of each figure of
    step responses.
    """
    from scenarios.plots.flying_qualities import charts_of, figure_qualities, figure_steps

    count = sum(bool(charts_of(qualities)) for qualities in estimates.qualities)
    drawings: list[tuple[str, partial[Figure]]] = [
        (
            f"qualities_{n}" if count > 1 else "qualities",
            partial(figure_qualities, estimates, n - 1),
        )
        for n in range(1, count + 1)
    ]
    if estimates.fits is None:
        return drawings
    steady = [  # places of the responses with a steady value after a step
        place
        for place, function in zip(estimates.fits.places, estimates.fits.fit.functions, strict=True)
        if step_response(function) is not None
    ]
    drawings += [
        (f"step_{n}" if len(steady) > 1 else "step", partial(figure_steps, estimates, *place))
        for n, place in enumerate(steady, start=1)
    ]
    return drawings


def response_columns(estimates: ResponseEstimates, row: int, column: int) -> dict[str, np.ndarray]:
    """Return the numbers of one response, each ``(F,)``, by the names of their columns.

    The magnitude is in the unit of output over input. Phases are in degrees and without jumps. Low
    and high are limits of 95 %; a magnitude that is not determined has the lower limit zero.
    """
    responses = estimates.responses
    response, half_width = responses.response[row, column], responses.half_width()[row, column]
    magnitude = np.abs(response)
    phase = np.degrees(responses.phase()[row, column])
    phase_half_width = np.degrees(responses.phase_half_width()[row, column])
    columns = {
        "frequency_Hz": responses.frequency,
        "real": response.real,
        "imaginary": response.imag,
        "magnitude": magnitude,
        "magnitude_dB": 20.0 * np.log10(np.maximum(magnitude, SMALLEST_SIZE)),
        "phase_deg": phase,
        "coherence": responses.coherence[row],
        "partial_coherence": responses.partial_coherence[row, column],
        "random_error": responses.random_error[row, column],
        "std": responses.std[row, column],
        "magnitude_low": np.maximum(magnitude - half_width, 0.0),
        "magnitude_high": magnitude + half_width,
        "phase_low_deg": phase - phase_half_width,
        "phase_high_deg": phase + phase_half_width,
        "degrees_of_freedom": responses.degrees[row],
        "usable": responses.usable[row, column].astype(int),
    }
    if estimates.direct is not None:
        direct = estimates.direct.response[row, column]
        columns |= {"direct_real": direct.real, "direct_imaginary": direct.imag}
    return columns


def responses_csv(estimates: ResponseEstimates) -> str:
    """Return the content of ``responses.csv``: a row for each output, input and frequency."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for number, (row, column, _) in enumerate(pairs(estimates)):
        columns = response_columns(estimates, row, column)
        if not number:
            writer.writerow(["output", "input", *columns])
        names = [estimates.names.outputs[row], estimates.names.inputs[column]]
        for cells in zip(*(values.tolist() for values in columns.values()), strict=True):
            writer.writerow([*names, *map(repr, cells)])
    return out.getvalue()


def responses_content(estimates: ResponseEstimates) -> dict[str, Any]:
    """Return the content of ``responses.json``."""
    estimate = estimates.responses
    bands = estimate.bands()
    responses = []
    for row, column, _ in pairs(estimates):
        band = bands[row][column]
        output, name = estimates.names.outputs[row], estimates.names.inputs[column]
        columns = response_columns(estimates, row, column)
        columns["usable"] = columns["usable"].astype(bool)
        responses.append(
            {
                "output": output,
                "input": name,
                "unit": estimates.unit(output, name) or "1",
                **({"usable_band_Hz": list(band)} if band else {}),
                **{key: values.tolist() for key, values in columns.items()},
            }
        )
    parts = zip(estimates.parts, estimates.durations, strict=True)
    return {
        "schema": SCHEMA,
        "method": "joint input-output" if estimate.joint else "direct",
        "references": list(estimates.names.references),
        "estimate": {
            "windows_s": list(estimate.spectra.windows),
            "tapers": estimate.spectra.tapers,
            "rate_Hz": estimates.rate,
            "detrended": "linear",
            "least_coherence": estimate.spectra.least_coherence,
        },
        **({"flying_qualities": _qualities_content(estimates)} if estimates.qualities else {}),
        "parts": [{"name": name, "duration_s": duration} for name, duration in parts],
        "responses": responses,
        **(
            {"fits": _fits_content(estimates, estimates.fits)} if estimates.fits is not None else {}
        ),
        **({"model_fit": model_content(estimates.model)} if estimates.model is not None else {}),
        **({"margins": margins_content(estimates.loop)} if estimates.loop is not None else {}),
        "notes": list(estimates.notes),
        "warnings": list(estimates.cautions),
        "inputs": {
            "records": [file.name for file in estimates.identities],
            "sha256": [file.sha256 for file in estimates.identities],
        },
        "versions": versions(),
    }


def _fits_content(estimates: ResponseEstimates, fits: Fits) -> dict[str, Any]:
    functions = []
    for (row, column), function, mismatch in zip(
        fits.places, fits.fit.functions, fits.mismatches, strict=True
    ):
        form, compared = function.form, bool(envelope_sentence(function, mismatch))
        functions.append(
            {
                "output": estimates.names.outputs[row],
                "input": estimates.names.inputs[column],
                "form": form.name,
                "cost": function.cost,
                "numerator": function.numerator.tolist(),
                "denominator": function.denominator.tolist(),
                "delay": function.values["delay"],
                "parameters": {
                    name: {
                        "value": function.values[name],
                        "std": function.std[name],
                        "insensitivity": function.insensitivity[name],
                        "unit": _unit_of(estimates, row, column, form, name),
                    }
                    for name in function.std
                },
                "fixed": {
                    name: value
                    for name, value in function.values.items()
                    if name not in function.std
                },
                **({"unnoticeable": not bool(mismatch.outside.any())} if compared else {}),
                "mismatch": {
                    "frequency_Hz": mismatch.frequency.tolist(),
                    "gain_dB": mismatch.gain.tolist(),
                    "phase_deg": mismatch.phase.tolist(),
                },
            }
        )
    return {
        "cost": fits.fit.cost,
        "converged": fits.fit.converged,
        "shared": list(fits.fit.shared),
        "functions": functions,
    }


def _qualities_content(estimates: ResponseEstimates) -> list[dict[str, Any]]:
    return [
        {
            "output": estimates.names.outputs[qualities.place[0]],
            "input": estimates.names.inputs[qualities.place[1]],
            **{
                name: {"value": number.value, "std": number.std, "unit": unit}
                for name, (number, unit) in qualities.numbers.items()
            },
            "notes": list(qualities.bandwidth.notes) if qualities.bandwidth is not None else [],
            **({"levels": levels} if (levels := levels_content(qualities)) else {}),
        }
        for qualities in estimates.qualities
    ]
