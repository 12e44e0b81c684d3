"""Terminal output: blocks of a document, progress of long work, and tables of several kinds of
study.

Tables have separate columns for units and sigmas. Progress goes to stderr: as a bar to a terminal,
else as a line every few seconds.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from rich.console import Console

from ident.flying_qualities.modes import MODAL_UNITS
from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Quantity
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    SIGMAS,
    Block,
    Bullets,
    Cell,
    Column,
    Number,
    Prose,
    Table,
    estimate,
    formatted,
    known,
    table,
)
from scenarios.report.quantities import displayed, shown_in, spaced, unit_cell
from scenarios.report.summary import WIDTH, TableColumn, print_paragraph, print_table, table_lines
from sim.record import Record

SIGMA, UNIT = "+- sigma", "unit"  # headings


def show_blocks(out: Console, blocks: Sequence[Block], *, apart: bool = False) -> None:
    """Print tables and sentences; notes are indented.

    ``apart`` : print an empty line before each table.
    """
    for block in blocks:
        match block:
            case Table():
                if apart and block.rows:
                    out.print()
                show_table(out, block)
            case Prose():
                print_paragraph(out, block.text, indent=2 if block.kind == "note" else 0)
            case Bullets():
                for item in block.items:
                    print_paragraph(out, item, indent=0)
            case _:
                pass


def show_table(out: Console, table: Table) -> None:
    """Print a table with the width of the console and a bold caption; nothing without rows."""
    print_table(out, table.caption, printed_columns(table))


def table_as_lines(
    table: Table, width: int = WIDTH, keys: int = 1, *, titled: bool = True
) -> list[str]:
    """Return a table as lines of text, below its caption unless ``titled`` is False."""
    title = table.caption if titled else ""
    return table_lines(printed_columns(table), title=title, width=width, keys=keys)


def printed_columns(table: Table) -> list[TableColumn]:
    """Return the columns of a table for a terminal.

    Units of rows follow the first column; sigmas follow their values.
    """
    columns: list[TableColumn] = []
    for i, column in enumerate(table.columns):
        cells = [row[i] for row in table.rows]
        sigmas = [cell.sigma_text if isinstance(cell, Number) else "" for cell in cells]
        with_sigma_column = any(sigmas) and not column.together
        texts = [cell_text(cell, with_sigma_column) for cell in cells]
        left = column.left or (column.unit is None and not column.right)
        columns.append(TableColumn(heading_text(column), texts, left, column.beside))
        if with_sigma_column:
            sigma_texts = [
                "-" if isinstance(cell, str) and cell else text
                for cell, text in zip(cells, sigmas, strict=True)
            ]
            columns.append(TableColumn(SIGMA, sigma_texts, beside=True))
        if i == 0 and table.units:
            columns.append(TableColumn(UNIT, [unit_cell(unit) for unit in table.units], left=True))
    return columns


def heading_text(column: Column) -> str:
    """Return a heading with the unit of its column."""
    if column.printed:
        return column.printed
    if column.unit in (None, PURE, BY_ROW):
        return column.heading
    return f"{column.heading}, {'sigmas' if column.unit == SIGMAS else column.unit}"


def cell_text(cell: Cell, apart: bool = False) -> str:
    """Return a cell as a terminal shows it; with ``apart``, a number without its sigma."""
    if isinstance(cell, Number):
        return cell.value_text if apart else cell.plain
    if cell == MISSING:
        return "-"
    return cell if isinstance(cell, str) else cell.text


Advance = Callable[[str, float], None]  # reports the stage of the work and the share done

QUIET_START_TIME = 2.0  # s before the bar is shown
PLAIN_LINE_INTERVAL = 10.0  # s between plain lines
POLL_INTERVAL = 0.2  # s between updates of the bar
LEAST_SHARE_FOR_ESTIMATE = 0.02  # share of the work from which the remaining time is estimated


@dataclass
class LastProgress:
    """Last reported progress.

    Attributes
    ----------
    stage : stage of the work.
    share : share that is done, 0 to 1.
    since : start of the work, s of the monotonic clock.
    """

    stage: str = ""
    share: float = 0.0
    since: float = field(default_factory=time.monotonic)

    def line(self, now: float) -> str:
        """Return ``"37 of 100 flights, 24 s, about 41 s left"``."""
        elapsed = now - self.since
        remaining = 0.0
        if LEAST_SHARE_FOR_ESTIMATE < self.share < 1.0:
            remaining = elapsed * (1.0 - self.share) / self.share
        texts = [self.stage] if self.stage else []
        texts.append(time_text(elapsed))
        if round(remaining):
            texts.append(f"about {time_text(remaining)} left")
        return ", ".join(texts)


@contextmanager
def progress_bar(
    shown: bool = True, *, counted: bool = True, before: tuple[int, int, float] | None = None
) -> Iterator[Advance]:
    """Show progress while the body runs; yield the function that reports it.

    Parameters
    ----------
    shown : False shows nothing.
    counted : whether the reported share is that of the time. Without this, as in a search, only
        stage and elapsed time are shown.
    before : number of finished tasks, number of all tasks, and start time, if the body is one of
        several tasks. The shown share is that of all tasks.
    """
    done, total, since = before or (0, 1, time.monotonic())
    prefix = f"{done + 1} of {total}: " if total > 1 else ""
    first_stage = f"{done} of {total} done" if total > 1 else ""
    progress = LastProgress(first_stage, done / total, since)

    def advance(stage: str, share: float) -> None:
        share_of_task = min(max(share, 0.0), 1.0) if counted else 0.0
        progress.stage, progress.share = f"{prefix}{stage}", (done + share_of_task) / total

    if not shown:
        yield advance
        return
    ended = threading.Event()
    show = _show_bar if sys.stderr.isatty() else _print_lines
    thread = threading.Thread(target=show, args=(progress, ended), daemon=True)
    thread.start()
    try:
        yield advance
    finally:
        ended.set()
        thread.join()


def time_text(seconds: float) -> str:
    """Return a duration as ``"24 s"``, ``"3 min 20 s"`` or ``"2 h 5 min"``."""
    minutes, whole_seconds = divmod(round(seconds), 60)
    if not minutes:
        return f"{whole_seconds} s"
    if minutes < 60:
        return f"{minutes} min {whole_seconds} s" if whole_seconds else f"{minutes} min"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if minutes else f"{hours} h"


def _print_lines(progress: LastProgress, ended: threading.Event) -> None:
    """Print a line every ``PLAIN_LINE_INTERVAL`` seconds until the work has ended."""
    while not ended.wait(PLAIN_LINE_INTERVAL):
        with contextlib.suppress(OSError, ValueError):  # stderr may be closed
            print(f"flightid: {progress.line(time.monotonic())}", file=sys.stderr, flush=True)


def _show_bar(progress: LastProgress, ended: threading.Event) -> None:
    """Show a bar that disappears at the end; while no share is known, the bar pulses."""
    if ended.wait(QUIET_START_TIME):
        return
    from rich.progress import BarColumn, Progress, TextColumn

    from scenarios.files.sources import styled_stream
    from scenarios.report.quantities import EscapingConsole

    columns = (BarColumn(bar_width=24), TextColumn("{task.description}", markup=False))
    console = EscapingConsole(file=styled_stream(sys.stderr))
    with Progress(
        *columns, console=console, transient=True, redirect_stdout=False, redirect_stderr=False
    ) as bar:
        task = bar.add_task("", total=None)
        while True:
            bar.update(
                task,
                description=progress.line(time.monotonic()),
                total=1.0 if progress.share else None,
                completed=progress.share,
            )
            if ended.wait(POLL_INTERVAL):
                return


# ---- Tables of several kinds of study

_TESTS = {"ljung-box": "whiteness", "nis": "size of the innovations"}  # test -> its name in words
LARGEST_SHOWN_SHARE = 1e3  # sigma over the value, above which the share is shown as a dash


class EstimatedParameter(Protocol):
    """An estimated parameter, as ``studies.declaration.Row``."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...
    @property
    def estimate(self) -> float: ...
    @property
    def std(self) -> float: ...
    @property
    def true(self) -> float | None: ...
    @property
    def condensed(self) -> float | None: ...
    @property
    def published(self) -> Any: ...
    @property
    def percent(self) -> float | None: ...
    @property
    def sigmas(self) -> float | None: ...
    @property
    def published_sigmas(self) -> float | None: ...


def estimates_table(
    caption: str, rows: Sequence[EstimatedParameter], starts: Mapping[str, float] | None = None
) -> Table:
    """Return a table of estimates with sigmas, and true, condensed, published and start values.

    A column without numbers is left out, except that of the estimates.
    """
    units = [shown_in(row.unit, row.name) for row in rows]
    scaled = [(row, unit.factor) for row, unit in zip(rows, units, strict=True)]
    start_values = starts or {}
    published: list[Cell] = [
        Number(
            factor * row.published.value,
            factor * row.published.std,
            shown=f"{factor * row.published.value:.5g}",
            shown_sigma=f"{factor * row.published.std:.4g}",
        )
        if row.published
        else ""
        for row, factor in scaled
    ]
    columns: list[tuple[Column, list[Cell]]] = [
        (Column("true", BY_ROW), [_scaled_cell(f, row.true) for row, f in scaled]),
        (Column("condensed", BY_ROW), [_scaled_cell(f, row.condensed) for row, f in scaled]),
        (
            Column("estimate ± σ", BY_ROW, printed="estimate"),
            [estimate(factor * row.estimate, factor * row.std) for row, factor in scaled],
        ),
        (
            Column("σ of the value", "%", printed="sigma %"),
            [_percent_cell(row.estimate, row.std) for row in rows]
            if all(row.true is None for row in rows)
            else [],
        ),
        (
            Column("error", "%", printed="error %"),
            [known(row.percent, 2, signed=True) for row in rows],
        ),
        (
            Column("error", SIGMAS),
            [formatted(row.sigmas if row.std > 0 else None, "+.2f") for row in rows],
        ),
        (Column("published", BY_ROW), published),
        (
            Column("its error", "its σ", printed="its error, sigmas", beside=True),
            [formatted(row.published_sigmas, "+.1f") if row.published else "" for row in rows],
        ),
        (
            Column("start", BY_ROW),
            [_scaled_cell(f, start_values.get(row.name)) for row, f in scaled],
        ),
    ]
    return table(
        caption,
        (Column("parameter"), [row.name for row in rows]),
        *(
            (column, cells)
            for column, cells in columns
            if column.printed == "estimate" or any(isinstance(cell, Number) for cell in cells)
        ),
        units=[unit.unit for unit in units],
    )


def _scaled_cell(factor: float, value: float | None) -> Cell:
    return known(None if value is None else factor * value)


def _percent_cell(value: float, std: float) -> Cell:
    """Return sigma in per cent of the value; a dash if this is not meaningful."""
    if not value or not 0.0 < std < LARGEST_SHOWN_SHARE * abs(value):
        return MISSING
    percent = 100.0 * std / abs(value)
    return formatted(percent, ".2g" if percent < 100.0 else ".0f")


FITS = (  # columns of the fit of each channel
    Column("channel"),
    Column("rms error", PURE),
    Column("fit", "%", printed="fit %"),
    Column("R2", PURE),
    Column("Theil", PURE),
)


def rows_table(caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Cell]]) -> Table:
    """Return a table from rows of cells."""
    return Table(caption, tuple(columns), tuple(map(tuple, rows)))


def fit_cells(channel: str, error: Quantity, fit: float, r2: float, theil: float) -> list[Cell]:
    """Return the cells of a channel below ``FITS``, for a free simulation."""
    value, _, unit = displayed(error)
    return [
        channel,
        Number(value, unit=unit, shown=f"{value:.3g}{spaced(unit)}"),
        Number(fit, digits=1),
        Number(r2, digits=4),
        Number(theil, digits=3),
    ]


def with_noise(fits: Table, noise: Mapping[str, float], record: Record) -> Table:
    """Return a table with the columns ``FITS`` and, after the rms error, the sensor noise of each
    channel: the rms error of a perfect model. ``noise`` is in the units of ``record``.
    """
    headings = [column.heading for column in fits.columns]
    channel, after = headings.index("channel"), headings.index("rms error") + 1

    def cell(name: Cell) -> Cell:
        if not isinstance(name, str) or name not in noise:
            return ""
        value, _, unit = displayed(Quantity(noise[name], 0.0, record[name].unit))
        return Number(value, unit=unit, shown=f"{value:.3g}{spaced(unit)}")

    columns = (*fits.columns[:after], Column("sensor noise", PURE), *fits.columns[after:])
    rows = [(*row[:after], cell(row[channel]), *row[after:]) for row in fits.rows]
    return replace(fits, columns=columns, rows=tuple(rows))


NO_FIT: list[Cell] = [MISSING, "no finite simulation", "", "", ""]


def derived_table(caption: str, derived: Mapping[str, tuple[float, float]]) -> Table:
    """Return the frequencies, dampings, time constants and delays with their sigmas."""
    names = {name: name.replace("_", " ").replace("dutch", "Dutch") for name in derived}
    rows = tuple((names[name], estimate(value, std)) for name, (value, std) in derived.items())
    units = tuple({**MODAL_UNITS, "delay": "s"}.get(name, PURE) for name in derived)
    return Table(caption, (Column("quantity"), Column("estimate ± σ", BY_ROW)), rows, units)


def tests_table(caption: str, tests: Sequence[ResidualTest]) -> Table:
    """Return a table with the residual tests of each channel."""
    columns = (Column("test"), Column("channel"), Column("p", PURE), Column("result"))
    rows = tuple(
        (_TESTS.get(test.name, test.name), test.channel, p_value(test.p_value), test.sentence)
        for test in tests
    )
    return Table(caption, columns, rows)


def p_value(value: float) -> Number:
    """Return a probability with two digits; as a bound where it is too small to be exact."""
    return Number(value, shown=f"{value:#.2g}" if value >= 1e-9 else "<1e-9")


def fixed_table(caption: str, fixed: Mapping[str, tuple[float, str]]) -> Table:
    """Return a table of the fixed parameters, with units."""
    rows = tuple((name, _exact(value)) for name, (value, _) in fixed.items())
    return Table(
        caption,
        (Column("constant"), Column("value", BY_ROW)),
        rows,
        tuple(unit or PURE for _, unit in fixed.values()),
    )


def _exact(value: float) -> Cell:
    """Return a constant with up to seven digits, without rounding to those of an estimate."""
    return Number(value, shown=f"{value:.7g}") if math.isfinite(value) else known(value)


def levels_of_noise(caption: str, noise: Mapping[str, tuple[float, str]]) -> Table:
    """Return a table of the standard deviation of each channel, with units."""
    units = {name: shown_in(unit, name) for name, (_, unit) in noise.items()}
    values = {name: units[name].factor * value for name, (value, _) in noise.items()}
    rows = tuple((name, Number(value, shown=f"{value:.3g}")) for name, value in values.items())
    return Table(
        caption,
        (Column("channel"), Column("standard deviation", BY_ROW)),
        rows,
        tuple(unit.unit or PURE for unit in units.values()),
    )
