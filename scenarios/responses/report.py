"""Frequency responses in the terminal, on their page and in their folder."""

from __future__ import annotations

import csv
import io
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
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats, caption_of
from scenarios.report.folder import figures, write_page
from scenarios.report.quantities import console, number_text
from scenarios.report.summary import BELOW, Summary, print_paragraph, print_summary
from scenarios.report.terminal import show_blocks, show_table
from scenarios.responses.analysis import ResponseEstimates, pairs
from scenarios.responses.fitting import (
    Fits,
    cost_sentence,
    envelope_sentence,
    model_content,
    model_lines,
    model_table,
    transfer_text,
)
from scenarios.responses.loops import loop_tables, margin_lines, margins_content
from scenarios.responses.qualities import levels_content, quality_lines, quality_tables

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# ---- Frequency responses in the terminal: a summary, notes, and a table for each response

PRINTED_FREQUENCIES = 12  # frequencies of a printed table


def print_responses(
    estimates: ResponseEstimates, out: Console | None = None, details: str = BELOW
) -> None:
    """Print an estimate."""
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
    """Output and input of a response."""
    return estimates.names.outputs[row], estimates.names.inputs[column]


def responses_summary(estimates: ResponseEstimates, details: str = BELOW) -> Summary:
    """Summary: the records, the estimate, and the usable bands."""
    whole = sum(estimates.durations)
    some = ", ".join(estimates.parts[:3]) + (", ..." if len(estimates.parts) > 3 else "")
    number = len(pairs(estimates))
    method = "joint input-output" if estimates.responses.joint else "direct"
    bands = [
        f"{name} {band_sentence(estimates, row, column)}" for row, column, name in pairs(estimates)
    ]
    return Summary(
        f"{some}, {whole:.4g} s in {len(estimates.parts)} part{'s' * (len(estimates.parts) > 1)}",
        f"{number} frequency response{'s' * (number > 1)}, {method} estimate",
        "; ".join(bands),
        "",
        details,
    )


def fit_lines(estimates: ResponseEstimates, row: int, column: int) -> list[str]:
    """Return the transfer function of a response, its cost and how its mismatch is judged."""
    fitted = estimates.fits.of(row, column) if estimates.fits is not None else None
    if fitted is None:
        return []
    function, mismatch = fitted
    judged = envelope_sentence(function, mismatch)
    head = f"{function.name} = {transfer_text(function)} ({function.form.name})"
    return [head, cost_sentence(function), *([judged] if judged else [])]


def _unit_of(estimates: ResponseEstimates, row: int, column: int, form: Form, name: str) -> str:
    names = estimates.names
    unit = form.units.get(name, "")
    return estimates.parameter_unit(names.outputs[row], names.inputs[column], name, unit)


def fit_tables(
    estimates: ResponseEstimates, row: int, column: int, caption: str = ""
) -> list[Table]:
    """Return the parameters of a fitted transfer function; no table where none was fitted."""
    fitted = estimates.fits.of(row, column) if estimates.fits is not None else None
    if fitted is None or estimates.fits is None:
        return []
    function, _ = fitted
    names = list(function.form.parameters)

    def share(name: str, sizes: Mapping[str, float]) -> Cell:
        size = max(abs(function.values[name]), 1e-300)
        known = name in function.std and function.std[name] < size
        return formatted(100.0 * sizes[name] / size if known else None, ".3g")

    def spread(name: str) -> Cell:
        return formatted(function.std[name], ".2g") if name in function.std else "fixed"

    shared = ["shared" if name in estimates.fits.fit.shared else "" for name in names]
    return [
        table(
            caption,
            (Column("parameter"), names),
            (
                Column("value", BY_ROW),
                [
                    Number(value, shown=number_text(value, function.std.get(name)))
                    for name in names
                    for value in [function.values[name]]
                ],
            ),
            (Column("std", BY_ROW, beside=True), [spread(name) for name in names]),
            (Column("std", "%"), [share(name, function.std) for name in names]),
            (Column("insensitivity", "%"), [share(name, function.insensitivity) for name in names]),
            (Column("note"), shared) if any(shared) else None,
            units=[_unit_of(estimates, row, column, function.form, name) for name in names],
        )
    ]


def band_sentence(estimates: ResponseEstimates, row: int, column: int) -> str:
    """``"usable from 0.1 to 4.2 Hz (coherence 0.6 or more)"``."""
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
    """Some frequencies of a response, named by its output, input and unit."""
    one, output, name = estimates.responses, *name_pair(estimates, row, column)
    at = shown_rows(one.frequency.size)
    response, usable = one.response[row, column], one.usable[row, column]
    unit = estimates.unit(output, name)
    label = next(text for i, j, text in pairs(estimates) if (i, j) == (row, column))
    size = np.abs(response)

    def cells(values: np.ndarray, form: str) -> list[Cell]:
        return [formatted(float(values[k]), form) for k in at]

    magnitude = unit or PURE
    several = len(estimates.names.inputs) > 1
    return table(
        f"{label}{f', {unit}' if unit else ''}{sentence}",
        (Column("frequency", "Hz", printed="Hz"), cells(one.frequency, ".3g")),
        (Column("frequency", "rad/s", printed="rad/s"), cells(2.0 * np.pi * one.frequency, ".3g")),
        (Column("magnitude", magnitude, printed="magnitude"), cells(size, ".4g")),
        (Column("+-", magnitude, printed="+-"), cells(one.half_width()[row, column], ".2g")),
        (
            Column("magnitude", "dB", printed="dB"),
            cells(20.0 * np.log10(np.maximum(size, 1e-300)), ".1f"),
        ),
        (Column("phase", "deg"), cells(np.degrees(one.phase()[row, column]), ".1f")),
        (
            Column("+-", "deg", printed="+-"),
            cells(np.degrees(one.phase_half_width()[row, column]), ".1f"),
        ),
        (Column("coherence", PURE), cells(one.coherence[row], ".3f")),
        (Column("partial coherence", PURE), cells(one.partial_coherence[row, column], ".3f"))
        if several
        else None,
        (Column("random error", PURE), cells(one.random_error[row, column], ".3f")),
        (Column("usable"), ["yes" if usable[k] else MISSING for k in at]),
    )


# ---- The page of an estimate: figures, tables, how it was made and how its numbers are read

READING = (
    "The bands hold the response with a probability of 95 % at each frequency by itself. They "
    "cover "
    "random errors; an error of a sensor's scale or delay is not among them.",
    "The coherence is the share of the output's power that follows the inputs linearly. The "
    "partial "
    "coherence of an input leaves the other inputs out.",
    "The random error is the standard deviation of the magnitude over the magnitude.",
    "If the output acts back on the input through a controller or a pilot, name an excitation with "
    "--reference: without one the estimate is biased towards the negative inverse of the feedback.",
)


def responses_page(estimates: ResponseEstimates, figure_files: Sequence[Drawn] = ()) -> Page:
    """Return the page of an estimate with the figures ``figure_files``."""
    names, summary = estimates.names, responses_summary(estimates)
    files = [each.name for each in estimates.identities]
    tables: list[Block] = []
    functions: list[Block] = []
    for row, column, name in pairs(estimates):
        tables.append(response_table(estimates, row, column))
        tables.append(Prose(f"{name}: {band_sentence(estimates, row, column)}.", "note"))
        functions += [Prose(as_sentence(line)) for line in fit_lines(estimates, row, column)]
        functions += fit_tables(estimates, row, column, f"Parameters of {name}")
    qualities: list[Block] = [*quality_tables(estimates.qualities)]
    if judged := quality_lines(estimates.qualities):
        qualities.append(Bullets(tuple(map(as_sentence, judged))))
    margins: list[Block] = []
    if estimates.loop is not None:
        margins += loop_tables(estimates.loop)
        margins.append(Bullets(tuple(map(as_sentence, margin_lines(estimates.loop)))))
    words = ["flightid", "response", *files]
    words += [word for name in names.inputs for word in ("--input", name)]
    words += [word for name in names.outputs for word in ("--output", name)]
    words += [word for name in names.references for word in ("--reference", name)]
    words += ["--margins", estimates.loop.sign] if estimates.loop is not None else []
    vehicle = estimates.model.file if estimates.model is not None else None
    words += ["--model", estimates.model.model] if estimates.model is not None else []
    words += ["--vehicle", vehicle.name] if vehicle is not None else []
    usable = sum(band is not None for row in estimates.responses.bands() for band in row)
    number = len(pairs(estimates))
    return Page(
        title=f"{', '.join(files[:3])}{', ...' if len(files) > 3 else ''}: frequency responses",
        kind="Frequency responses",
        verdict=f"{usable} of {number} usable"
        if number > 1
        else ("usable" if usable else "not usable"),
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
        reproduction=reproduction(
            words,
            "",
            [
                *(("used", each.name, each.sha256) for each in estimates.identities),
                *(("vehicle", each.name, each.sha256) for each in (vehicle,) if each is not None),
            ],
        ),
        created=now(),
    )


# ---- The folder of an estimate: CSV, figures, page, and the JSON last

MAIN = "responses.json"
TABLE = "responses.csv"
SCHEMA = "flightid/responses/1"


def write_responses(
    estimates: ResponseEstimates, folder: str | Path, *, figures: Formats = USUAL
) -> Path:
    """Write an estimate into ``folder``, completely or not at all; return the folder."""
    with study_folder(folder, MAIN) as scratch:
        figure_files: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import draw_for_page
            from scenarios.plots.flying_qualities import figure_response

            several = len(pairs(estimates)) > 1
            named = [
                (
                    f"response_{n}" if several else "response",
                    partial(figure_response, estimates, row, column),
                )
                for n, (row, column, _) in enumerate(pairs(estimates), start=1)
            ]
            if estimates.fits is not None:
                from scenarios.plots.flying_qualities import figure_mismatch

                named += [
                    (
                        f"mismatch_{n}" if several else "mismatch",
                        partial(figure_mismatch, estimates, *place),
                    )
                    for n, (row, column, _) in enumerate(pairs(estimates), start=1)
                    if (place := (row, column)) in estimates.fits.places
                ]
            about = {
                f"{kind}_{n}": name
                for n, (_, _, name) in enumerate(pairs(estimates), start=1)
                for kind in ("response", "mismatch")
            }
            named += quality_figures(estimates)
            if any(each.curve is not None for each in estimates.qualities):
                from scenarios.plots.flying_qualities import figure_bandwidth

                named += [
                    (
                        f"bandwidth_{n}" if several else "bandwidth",
                        partial(figure_bandwidth, estimates, n - 1),
                    )
                    for n in range(1, len(estimates.qualities) + 1)
                ]
            if estimates.loop is not None:
                from scenarios.plots.flying_qualities import figure_margins

                named.append(("loop", partial(figure_margins, estimates)))
            figure_files = tuple(
                replace(
                    each,
                    caption=f"{about[each.stem]}: {caption_of(each.stem.rstrip('_0123456789'))}",
                )
                if each.stem in about
                else each
                for each in draw_for_page(named, scratch, figures)
            )
        write_text(scratch / TABLE, responses_csv(estimates))
        write_page(scratch, responses_page(estimates, figure_files))
        write_json(scratch / MAIN, responses_content(estimates))
    return Path(folder)


def model_blocks(estimates: ResponseEstimates) -> list[Block]:
    """Return the fitted model on the page; none if none was fitted."""
    if estimates.model is None:
        return []
    title = f"Parameters of {estimates.model.model}"
    return [
        *(Prose(as_sentence(line)) for line in model_lines(estimates.model)),
        model_table(estimates.model, title),
    ]


def quality_figures(estimates: ResponseEstimates) -> list[tuple[str, partial[Figure]]]:
    """Names and makers of the charts of flying qualities and of the steps of fitted responses."""
    from scenarios.plots.flying_qualities import charts_of, figure_qualities, figure_steps

    charts = [each for each in estimates.qualities if charts_of(each)]
    out: list[tuple[str, partial[Figure]]] = [
        (
            f"qualities_{n}" if len(charts) > 1 else "qualities",
            partial(figure_qualities, estimates, n - 1),
        )
        for n in range(1, len(charts) + 1)
    ]
    places = [] if estimates.fits is None else list(estimates.fits.places)
    steady = [
        place
        for place in places
        if estimates.fits is not None
        and (fitted := estimates.fits.of(*place)) is not None
        and step_response(fitted[0]) is not None
    ]
    out += [
        (f"step_{n}" if len(steady) > 1 else "step", partial(figure_steps, estimates, *place))
        for n, place in enumerate(steady, start=1)
    ]
    return out


def response_columns(estimates: ResponseEstimates, row: int, column: int) -> dict[str, np.ndarray]:
    """Return the numbers of one response by the names of their columns, each ``(F,)``.

    ``magnitude`` in the unit of output over input, phases in degrees without jumps, bands of 95 %;
    the lower bound of a magnitude that is not determined is zero.
    """
    one = estimates.responses
    response, half = one.response[row, column], one.half_width()[row, column]
    size = np.abs(response)
    phase = np.degrees(one.phase()[row, column])
    turn = np.degrees(one.phase_half_width()[row, column])
    columns = {
        "frequency_Hz": one.frequency,
        "real": response.real,
        "imaginary": response.imag,
        "magnitude": size,
        "magnitude_dB": 20.0 * np.log10(np.maximum(size, 1e-300)),
        "phase_deg": phase,
        "coherence": one.coherence[row],
        "partial_coherence": one.partial_coherence[row, column],
        "random_error": one.random_error[row, column],
        "std": one.std[row, column],
        "magnitude_low": np.maximum(size - half, 0.0),
        "magnitude_high": size + half,
        "phase_low_deg": phase - turn,
        "phase_high_deg": phase + turn,
        "degrees_of_freedom": one.degrees[row],
        "usable": one.usable[row, column].astype(int),
    }
    if estimates.direct is not None:
        other = estimates.direct.response[row, column]
        columns |= {"direct_real": other.real, "direct_imaginary": other.imag}
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
        for cells in zip(*(each.tolist() for each in columns.values()), strict=True):
            writer.writerow([*names, *map(repr, cells)])
    return out.getvalue()


def responses_content(estimates: ResponseEstimates) -> dict[str, Any]:
    """Content of ``responses.json``: the same numbers by response, with the usable bands in Hz."""
    one = estimates.responses
    bands = one.bands()
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
        "method": "joint input-output" if one.joint else "direct",
        "references": list(estimates.names.references),
        "estimate": {
            "windows_s": list(one.spectra.windows),
            "tapers": one.spectra.tapers,
            "rate_Hz": estimates.rate,
            "detrended": "linear",
            "least_coherence": one.spectra.least_coherence,
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
            "records": [each.name for each in estimates.identities],
            "sha256": [each.sha256 for each in estimates.identities],
        },
        "versions": versions(),
    }


def _fits_content(estimates: ResponseEstimates, fits: Fits) -> dict[str, Any]:
    functions = []
    for (row, column), function, mismatch in zip(
        fits.places, fits.fit.functions, fits.mismatches, strict=True
    ):
        form, judged = function.form, envelope_sentence(function, mismatch)
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
                **({"unnoticeable": not bool(mismatch.outside.any())} if judged else {}),
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
            "output": estimates.names.outputs[each.place[0]],
            "input": estimates.names.inputs[each.place[1]],
            **{
                name: {"value": number.value, "std": number.std, "unit": unit}
                for name, (number, unit) in each.numbers.items()
            },
            "notes": list(each.bandwidth.notes) if each.bandwidth is not None else [],
            **({"levels": told} if (told := levels_content(each)) else {}),
        }
        for each in estimates.qualities
    ]
