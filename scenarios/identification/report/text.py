"""An identification in the terminal: records, warnings, parameters with their sigmas, what the residual says."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from ident.flying_qualities.mode_levels import Flown, mode_levels
from ident.tracing.diagnosis import Quantity
from scenarios.identification.assessment.text import bound_lines, fit_lines, interval_lines
from scenarios.identification.input_reading import reading_rows
from scenarios.identification.result import Identification
from scenarios.preparation.record_words import record_lines
from scenarios.terminal.flying_qualities import levels_line
from scenarios.terminal.numbers import console, derived_line, number, test_line
from scenarios.terminal.quantities import determined, displayed


def print_identification(found: Identification, flown: Flown, out: Console | None = None) -> None:
    """Records, warnings, the table of parameters, and what stands beside it."""
    estimate, terminal = found.estimate, out or console()
    for record in (found.record, *found.others):
        told = f"; {found.vehicle.model} model, {found.method}: {estimate.outcome.value}" if record is (found.record, *found.others)[-1] else ""
        terminal.print(f"{record.name}: {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} s{told}")
    for doubt in found.doubts:
        terminal.print(f"warning: {doubt}", highlight=False)
    for caution in found.cautions:
        terminal.print(f"caution: {caution}", highlight=False)
    for line in record_lines(found.look):
        terminal.print(line, highlight=False)
    for line in bound_lines(found.at_bounds, found.tied):
        terminal.print(line, highlight=False)
    table = Table()
    for heading in ("parameter", "unit", "estimate", "+- sigma", "sigma %", "start"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right", no_wrap=True)
    starts = {**found.vehicle.derivatives, **{name: value for _, mode in found.vehicle.modes for name, value in mode.items()}}
    for row in (*found.rows, *found.biases):
        begun = f"{starts[row.name]:.5g}" if row.name in starts else "-"
        if not determined(row.estimate, row.std):
            table.add_row(row.name, row.unit, "not determined", "-", "-", begun)
            continue
        share = f"{100.0 * row.std / abs(row.estimate):.2g}" if row.estimate else "-"
        table.add_row(row.name, row.unit, number(row.estimate, row.std), number(row.std, row.std), share, begun)
    terminal.print(table)
    for line in interval_lines(found.intervals, {row.name: row.unit for row in found.rows}):
        terminal.print(line, highlight=False)
    if found.reading:
        terminal.print(f"caution: {found.reading.sentence}", highlight=False)
        for line in reading_rows(found.reading):
            terminal.print(line, highlight=False)
    units = {channel.name: channel.unit for record in (found.record, *found.others) for channel in record.outputs}
    levels = zip(estimate.output_names, estimate.noise_std, strict=True)
    shown = [(name, displayed(Quantity(float(std), 0.0, units.get(name, "")))) for name, std in levels]
    noise = ", ".join(f"{name} {value:.3g}{f' {unit}' if unit != '1' else ''}" for name, (value, _, unit) in shown)
    terminal.print(f"residual (1 sigma): {noise}", highlight=False)
    for line in fit_lines(found.fits) if len(found.fits) > 1 else ():
        terminal.print(line, highlight=False)
    reached = levels_line(mode_levels(found.modes, flown), flown, found.tests) if found.modes is not None else ""
    for line in (derived_line(found.derived), reached, test_line(found.tests), *(f"note: {note}" for note in found.notes)):
        if line:
            terminal.print(line, highlight=False)
