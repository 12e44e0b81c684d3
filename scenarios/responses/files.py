"""The folder of an estimate: CSV, figures, page, and the JSON last."""

from __future__ import annotations

import csv
import io
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ident.flying_qualities.levels import Level
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Drawn, Formats
from scenarios.responses.analysis import Responses, pairs
from scenarios.responses.fitting import Fits, envelope_sentence
from scenarios.responses.loops import margins_content
from scenarios.responses.page import responses_page

MAIN = "responses.json"
TABLE = "responses.csv"
SCHEMA = "flightid/responses/1"


def write_responses(found: Responses, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write an estimate into ``folder``, whole or not at all; returns the folder."""
    with study_folder(folder, MAIN) as scratch:
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import drawn_for_page
            from scenarios.plots.low_order import figure_response

            several = len(pairs(found)) > 1
            named = [
                (
                    f"response_{n}" if several else "response",
                    partial(figure_response, found, row, column),
                )
                for n, (row, column, _) in enumerate(pairs(found), start=1)
            ]
            if found.fits is not None:
                from scenarios.plots.low_order import figure_mismatch

                named += [
                    (
                        f"mismatch_{n}" if several else "mismatch",
                        partial(figure_mismatch, found, *place),
                    )
                    for n, (row, column, _) in enumerate(pairs(found), start=1)
                    if (place := (row, column)) in found.fits.places
                ]
            if any(each.curve is not None for each in found.qualities):
                from scenarios.plots.low_order import figure_bandwidth

                named += [
                    (
                        f"bandwidth_{n}" if several else "bandwidth",
                        partial(figure_bandwidth, found, n - 1),
                    )
                    for n in range(1, len(found.qualities) + 1)
                ]
            if found.loop is not None:
                from scenarios.plots.low_order import figure_margins

                named.append(("loop", partial(figure_margins, found)))
            drawn = drawn_for_page(named, scratch, figures)
        write_text(scratch / TABLE, responses_csv(found))
        write_page(scratch, responses_page(found, drawn))
        write_json(scratch / MAIN, responses_content(found))
    return Path(folder)


def response_columns(found: Responses, row: int, column: int) -> dict[str, np.ndarray]:
    """The numbers of one response by the names of their columns, each ``(F,)``.

    ``magnitude`` in the unit of output over input, phases in degrees without jumps, bands of 95 %;
    the lower bound of a magnitude that is not determined is zero.
    """
    one = found.found
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
    if found.direct is not None:
        other = found.direct.response[row, column]
        columns |= {"direct_real": other.real, "direct_imaginary": other.imag}
    return columns


def responses_csv(found: Responses) -> str:
    """Content of ``responses.csv``: a row for each output, input and frequency."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for number, (row, column, _) in enumerate(pairs(found)):
        columns = response_columns(found, row, column)
        if not number:
            writer.writerow(["output", "input", *columns])
        names = [found.names.outputs[row], found.names.inputs[column]]
        for cells in zip(*(each.tolist() for each in columns.values()), strict=True):
            writer.writerow([*names, *map(repr, cells)])
    return out.getvalue()


def responses_content(found: Responses) -> dict[str, Any]:
    """Content of ``responses.json``: the same numbers by response, with the usable bands in Hz."""
    one = found.found
    bands = one.bands()
    responses = []
    for row, column, _ in pairs(found):
        band = bands[row][column]
        output, name = found.names.outputs[row], found.names.inputs[column]
        columns = response_columns(found, row, column)
        columns["usable"] = columns["usable"].astype(bool)
        responses.append(
            {
                "output": output,
                "input": name,
                "unit": found.unit(output, name) or "1",
                **({"usable_band_Hz": list(band)} if band else {}),
                **{key: values.tolist() for key, values in columns.items()},
            }
        )
    parts = zip(found.parts, found.durations, strict=True)
    return {
        "schema": SCHEMA,
        "method": "joint input-output" if one.joint else "direct",
        "references": list(found.names.references),
        "estimate": {
            "windows_s": list(one.spectra.windows),
            "tapers": one.spectra.tapers,
            "rate_Hz": found.rate,
            "detrended": "linear",
            "least_coherence": one.spectra.least_coherence,
        },
        **({"flying_qualities": _qualities_content(found)} if found.qualities else {}),
        "parts": [{"name": name, "duration_s": duration} for name, duration in parts],
        "responses": responses,
        **({"fits": _fits_content(found, found.fits)} if found.fits is not None else {}),
        **({"margins": margins_content(found.loop)} if found.loop is not None else {}),
        "notes": list(found.notes),
        "warnings": list(found.cautions),
        "inputs": {
            "records": [each.name for each in found.identities],
            "sha256": [each.sha256 for each in found.identities],
        },
        "versions": versions(),
    }


def _fits_content(found: Responses, fits: Fits) -> dict[str, Any]:
    functions = []
    for (row, column), function, mismatch in zip(fits.places, fits.fit.functions, fits.mismatches, strict=True):
        form, judged = function.form, envelope_sentence(function, mismatch)
        functions.append(
            {
                "output": found.names.outputs[row],
                "input": found.names.inputs[column],
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
                        "unit": form.units.get(name, ""),
                    }
                    for name in function.std
                },
                "fixed": {name: value for name, value in function.values.items() if name not in function.std},
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


def _level_content(level: Level) -> dict[str, Any]:
    return {
        "quantity": level.quality.name,
        "category": level.criterion.category,
        "level": level.level,
        "best": level.best,
        "worst": level.worst,
        "source": level.criterion.source,
    }


def _qualities_content(found: Responses) -> list[dict[str, Any]]:
    return [
        {
            "output": found.names.outputs[each.place[0]],
            "input": found.names.inputs[each.place[1]],
            **{name: {"value": number.value, "std": number.std, "unit": unit} for name, (number, unit) in each.numbers.items()},
            "notes": list(each.bandwidth.notes) if each.bandwidth is not None else [],
            **({"levels": [_level_content(level) for level in each.levels]} if each.levels else {}),
        }
        for each in found.qualities
    ]
