"""An identification in the terminal: a summary, then everything that stands beside the estimate."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from ident.flying_qualities.levels import Flown, mode_levels
from ident.tracing.diagnosis import Quantity
from scenarios.identification.assessment.text import bound_lines, fit_lines, interval_lines
from scenarios.identification.input_reading import reading_rows
from scenarios.identification.report.noise import noise_phrase
from scenarios.identification.result import Identification
from scenarios.preparation.record_words import record_lines
from scenarios.studies.rows import Row
from scenarios.terminal.display_units import shown_in, spaced, unit_cell
from scenarios.terminal.flying_qualities import levels_line
from scenarios.terminal.numbers import console, derived_line, number, test_line
from scenarios.terminal.paragraphs import print_lines, print_paragraph
from scenarios.terminal.quantities import determined, displayed
from scenarios.terminal.summary import BELOW, Summary, print_summary, residual_phrase, result_phrase
from scenarios.terminal.tables import Column, columns_of, print_table

HEADINGS = ("parameter", "unit", "estimate", "+- sigma", "sigma %", "start")


def print_identification(found: Identification, flown: Flown, out: Console | None = None, details: str = BELOW) -> None:
    """Print an identification; ``details`` says where else it is to be read."""
    out = out or console()
    records = (found.record, *found.others)
    print_summary(out, identification_summary(found, details))
    for record in records:
        told = f"; {found.vehicle.model} model, {found.method}: {found.estimate.outcome.value}" if record is records[-1] else ""
        print_paragraph(out, f"{record.name}: {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} s{told}", 0)
    if found.engine:
        print_paragraph(out, f"engine: {found.engine['sentence']}", 0)
    said = [*(f"warning: {doubt}" for doubt in found.doubts), *(f"caution: {caution}" for caution in found.cautions)]
    for line in (*said, *record_lines(found.look), *bound_lines(found.at_bounds, found.tied)):
        print_paragraph(out, line, 0)
    print_table(out, "", _estimates(found))
    print_lines(out, interval_lines(found.intervals, {row.name: row.unit for row in found.rows}, out.width))
    if found.reading:
        print_paragraph(out, f"caution: {found.reading.sentence}", 0)
        print_table(out, "", reading_rows(found.reading))
    print_paragraph(out, f"residual (1 sigma): {_residual(found)}", 0)
    print_lines(out, fit_lines(found.fits, out.width))
    reached = levels_line(mode_levels(found.modes, flown), flown, found.tests) if found.modes is not None else ""
    for line in (derived_line(found.derived), reached, test_line(found.tests), noise_phrase(found), *(f"note: {note}" for note in found.notes)):
        if line:
            print_paragraph(out, line, 0)


def identification_summary(found: Identification, details: str = BELOW) -> Summary:
    """Records, model and method; the outcome; what matters most; what the fit leaves."""
    records = (found.record, *found.others)
    named = found.record.name if len(records) == 1 else f"{found.record.name} and {len(records) - 1} more"
    samples = sum(len(record) for record in records)
    rows = [(row.name, row.estimate, row.std, row.unit) for row in found.rows]
    vague = [row.name for row in found.rows if not determined(row.estimate, row.std)]
    outcome = found.estimate.outcome.value + (f"; not determined: {', '.join(vague)}" if vague else "")
    cautions = len(found.cautions) + len(found.doubts)
    outcome += f"; {cautions} caution{'s' if cautions > 1 else ''} below" if cautions else ""
    return Summary(
        f"{named}, {samples} samples; {found.vehicle.name}, {found.vehicle.model} model, {found.method}",
        outcome,
        result_phrase(rows, found.derived),
        residual_phrase(found.tests),
        details,
    )


def _estimates(found: Identification) -> Sequence[Column]:
    starts = {**found.vehicle.derivatives, **{name: value for _, mode in found.vehicle.modes for name, value in mode.items()}}
    return columns_of(HEADINGS, [_cells(row, starts.get(row.name)) for row in (*found.rows, *found.biases)], left=2)


def _cells(row: Row, start: float | None) -> tuple[str, ...]:
    factor, unit = shown_in(row.unit, row.name)
    begun = f"{factor * start:.5g}" if start is not None else "-"
    if not determined(row.estimate, row.std):
        return row.name, unit_cell(unit), "not determined", "-", "-", begun
    share = f"{100.0 * row.std / abs(row.estimate):.2g}" if row.estimate else "-"
    return row.name, unit_cell(unit), number(factor * row.estimate, factor * row.std), number(factor * row.std, factor * row.std), share, begun


def _residual(found: Identification) -> str:
    units = {channel.name: channel.unit for record in (found.record, *found.others) for channel in record.outputs}
    levels = zip(found.estimate.output_names, found.estimate.noise_std, strict=True)
    shown = [(name, displayed(Quantity(float(std), 0.0, units.get(name, "")))) for name, std in levels]
    return ", ".join(f"{name} {value:.3g}{spaced(unit)}" for name, (value, _, unit) in shown)
