"""Frequency responses in the terminal: a summary, notes, and a table for each response."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console

from scenarios.responses.analysis import Responses, pairs
from scenarios.responses.fitting import cost_sentence, envelope_sentence, transfer_text
from scenarios.responses.loops import MINUS, LoopMargins, margin_columns, margin_lines, worst_columns
from scenarios.terminal.quantities import console, number_text
from scenarios.terminal.summary import BELOW, Summary, print_summary
from scenarios.terminal.tables import TableColumn, print_paragraph, print_table

ROWS = 12  # frequencies of a printed table


def print_responses(found: Responses, out: Console | None = None, details: str = BELOW) -> None:
    """Print an estimate."""
    out = out or console()
    print_summary(out, responses_summary(found, details))
    for line in found.cautions:
        print_paragraph(out, f"warning: {line}", indent=0)
    for line in found.notes:
        print_paragraph(out, line, indent=0)
    for row, column, name in pairs(found):
        unit = found.unit(*name_pair(found, row, column))
        title = f"{name}{f', {unit}' if unit else ''}: {band_sentence(found, row, column)}"
        print_table(out, title, table_columns(found, row, column))
    for line in quality_lines(found):
        print_paragraph(out, line, indent=0)
    if found.loop is not None:
        for title, columns in loop_tables(found.loop):
            print_table(out, title, columns)
        for line in margin_lines(found.loop):
            print_paragraph(out, line, indent=0)
    for row, column, _ in pairs(found):
        for line in fit_lines(found, row, column):
            print_paragraph(out, line, indent=0)
        columns = fit_columns(found, row, column)
        if columns:
            print_table(out, "", columns)


def loop_tables(loop: LoopMargins) -> list[tuple[str, list[TableColumn]]]:
    """Titles and columns of the margins, and of the worst maneuver where there are several."""
    sign = "-" if loop.sign == MINUS else "+"
    title = f"Stability margins of {loop.name}, a loop with command = excitation {sign} returned"
    tables = [(title, margin_columns(loop)), ("The worst maneuver, intervals for all together", worst_columns(loop))]
    return [(heading, columns) for heading, columns in tables if columns[0].cells]


def quality_lines(found: Responses) -> list[str]:
    """Flying qualities, one sentence each."""
    return [line for each in found.qualities for line in each.lines]


def name_pair(found: Responses, row: int, column: int) -> tuple[str, str]:
    """Output and input of a response."""
    return found.names.outputs[row], found.names.inputs[column]


def responses_summary(found: Responses, details: str = BELOW) -> Summary:
    """The records, what was estimated, and the usable bands."""
    whole = sum(found.durations)
    some = ", ".join(found.parts[:3]) + (", ..." if len(found.parts) > 3 else "")
    number = len(pairs(found))
    method = "joint input-output" if found.found.joint else "direct"
    bands = [f"{name} {band_sentence(found, row, column)}" for row, column, name in pairs(found)]
    return Summary(
        f"{some}, {whole:.4g} s in {len(found.parts)} part{'s' * (len(found.parts) > 1)}",
        f"{number} frequency response{'s' * (number > 1)}, {method} estimate",
        "; ".join(bands),
        "",
        details,
    )


def fit_lines(found: Responses, row: int, column: int) -> list[str]:
    """The transfer function of a response, its cost and how its mismatch is judged."""
    fitted = found.fits.of(row, column) if found.fits is not None else None
    if fitted is None:
        return []
    function, mismatch = fitted
    judged = envelope_sentence(function, mismatch)
    head = f"{function.name} = {transfer_text(function)} ({function.form.name})"
    return [head, cost_sentence(function), *([judged] if judged else [])]


def fit_columns(found: Responses, row: int, column: int) -> list[TableColumn]:
    """The table of the parameters of a fitted transfer function; none where none was fitted."""
    fitted = found.fits.of(row, column) if found.fits is not None else None
    if fitted is None or found.fits is None:
        return []
    function, _ = fitted
    rows = []
    for name in function.form.parameters:
        value = function.values[name]
        size = max(abs(value), 1e-300)
        if name in function.std:
            std, alone = function.std[name], function.insensitivity[name]
            shares = [f"{100.0 * each / size:.3g}" if std < size else "-" for each in (std, alone)]
            cells = [number_text(value, std), f"{std:.2g}", *shares]
        else:
            cells = [f"{value:.5g}", "fixed", "-", "-"]
        unit = function.form.units.get(name, "")
        said = "shared" if name in found.fits.fit.shared else ""
        rows.append([name, *cells, "" if unit == "1" else unit, said])
    headings = ["parameter", "value", "std", "std, %", "insensitivity, %", "unit", "note"]
    kept = len(headings) if any(row[-1] for row in rows) else len(headings) - 1
    return [TableColumn(head, [row[n] for row in rows], left=head in ("parameter", "unit", "note")) for n, head in enumerate(headings[:kept])]


def band_sentence(found: Responses, row: int, column: int) -> str:
    """``"usable from 0.1 to 4.2 Hz (coherence 0.6 or more)"``."""
    band = found.found.bands()[row][column]
    limit = f"coherence {found.found.spectra.least_coherence:g} or more"
    if band is None:
        return f"nowhere usable ({limit})"
    return f"usable from {band[0]:.3g} to {band[1]:.3g} Hz ({limit})"


def shown_rows(count: int, most: int = ROWS) -> np.ndarray:
    """Positions of at most ``most`` frequencies, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def table_columns(found: Responses, row: int, column: int) -> list[TableColumn]:
    """The columns of the table of a response."""
    one = found.found
    at = shown_rows(one.frequency.size)
    response, usable = one.response[row, column], one.usable[row, column]
    size, half = np.abs(response), one.half_width()[row, column]
    phase = np.degrees(one.phase()[row, column])
    turn = np.degrees(one.phase_half_width()[row, column])
    several = len(found.names.inputs) > 1

    def cells(values: np.ndarray, form: str) -> Sequence[str]:
        return [format(float(values[k]), form) for k in at]

    columns = [
        TableColumn("Hz", cells(one.frequency, ".3g")),
        TableColumn("rad/s", cells(2.0 * np.pi * one.frequency, ".3g")),
        TableColumn("magnitude", cells(size, ".4g")),
        TableColumn("+-", cells(half, ".2g")),
        TableColumn("dB", cells(20.0 * np.log10(np.maximum(size, 1e-300)), ".1f")),
        TableColumn("phase, deg", cells(phase, ".1f")),
        TableColumn("+-", cells(turn, ".1f")),
        TableColumn("coherence", cells(one.coherence[row], ".3f")),
    ]
    if several:
        columns.append(TableColumn("partial coherence", cells(one.partial_coherence[row, column], ".3f")))
    columns.append(TableColumn("random error", cells(one.random_error[row, column], ".3f")))
    columns.append(TableColumn("usable", ["yes" if usable[k] else "-" for k in at], left=True))
    return columns
