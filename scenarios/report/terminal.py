"""Terminal output: blocks of a document, and the progress of long work.

Tables have separate columns for units and sigmas. Progress goes to stderr: a bar on a terminal,
else a line now and then. Also tables common to several kinds of study.
"""

from __future__ import annotations

import contextlib
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
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
from scenarios.report.summary import (
    WIDTH,
    TableColumn,
    print_paragraph,
    print_table,
    table_lines,
)

SIGMA = "+- sigma"
UNIT = "unit"


def show_blocks(out: Console, blocks: Sequence[Block], *, apart: bool = False) -> None:
    """Print tables and sentences, notes moved in; ``apart``: an empty line before each table."""
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
    """Print a table as wide as the console, with a bold caption; print nothing if it has no row."""
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
    out: list[TableColumn] = []
    for at, column in enumerate(table.columns):
        cells = [row[at] for row in table.rows]
        sigmas = [cell.sigma_text if isinstance(cell, Number) else "" for cell in cells]
        apart = any(sigmas) and not column.together
        texts = [cell_text(cell, apart) for cell in cells]
        left = column.left or (column.unit is None and not column.right)
        out.append(TableColumn(heading_text(column), texts, left, column.beside))
        if apart:
            shown = [
                "-" if isinstance(cell, str) and cell else text
                for cell, text in zip(cells, sigmas, strict=True)
            ]
            out.append(TableColumn(SIGMA, shown, beside=True))
        if at == 0 and table.units:
            out.append(TableColumn(UNIT, [unit_cell(unit) for unit in table.units], left=True))
    return out


def heading_text(column: Column) -> str:
    """Return a heading with the unit of its column."""
    if column.printed:
        return column.printed
    if column.unit in (None, PURE, BY_ROW):
        return column.heading
    return f"{column.heading}, {'sigmas' if column.unit == SIGMAS else column.unit}"


def cell_text(cell: Cell, apart: bool = False) -> str:
    """Return a cell as a terminal shows it; ``apart``: without its sigma."""
    if isinstance(cell, Number):
        return cell.value_text if apart else cell.plain
    return "-" if cell == MISSING else cell if isinstance(cell, str) else cell.text


Advance = Callable[[str, float], None]

QUIET_START_TIME = 2.0  # s, without any output
PLAIN_LINE_INTERVAL = 10.0  # s, between plain lines
POLL_INTERVAL = 0.2  # s, between updates of the bar
# share of the work after which the remaining time is estimated
LEAST_SHARE_FOR_ESTIMATE = 0.02


@dataclass
class LastProgress:
    """Last reported progress: stage, share of the work (0 to 1), start time."""

    stage: str = ""
    share: float = 0.0
    since: float = field(default_factory=time.monotonic)

    def line(self, now: float) -> str:
        """``"37 of 100 flights, 24 s, about 41 s left"``."""
        passed = now - self.since
        left = (
            passed * (1.0 - self.share) / self.share
            if LEAST_SHARE_FOR_ESTIMATE < self.share < 1.0
            else 0.0
        )
        return ", ".join(
            [
                *([self.stage] if self.stage else []),
                time_text(passed),
                *([f"about {time_text(left)} left"] if round(left) else []),
            ]
        )


@contextmanager
def progress_bar(
    shown: bool = True, *, counted: bool = True, before: tuple[int, int, float] | None = None
) -> Iterator[Advance]:
    """Context manager that gives a function for reporting the stage and the share done (0 to 1).

    ``counted``: the share measures time; False, as in a search, shows the stage and elapsed time
    only. ``before``: number of tasks done, of all tasks, and start time; shares then refer to all
    tasks.
    """
    done, of, since = before or (0, 1, time.monotonic())
    number = f"{done + 1} of {of}: " if of > 1 else ""
    progress = LastProgress(f"{done} of {of} done" if of > 1 else "", done / of, since)

    def advance(stage: str, share: float) -> None:
        within = min(max(share, 0.0), 1.0) if counted else 0.0
        progress.stage, progress.share = f"{number}{stage}", (done + within) / of

    if not shown:
        yield advance
        return
    ended = threading.Event()
    show = _bar if sys.stderr.isatty() else _lines
    thread = threading.Thread(target=show, args=(progress, ended), daemon=True)
    thread.start()
    try:
        yield advance
    finally:
        ended.set()
        thread.join()


def time_text(seconds: float) -> str:
    """``"24 s"``, ``"3 min 20 s"``, ``"2 h 5 min"``."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes, rest = divmod(whole, 60)
    if minutes < 60:
        return f"{minutes} min {rest} s" if rest else f"{minutes} min"
    hours, rest = divmod(minutes, 60)
    return f"{hours} h {rest} min" if rest else f"{hours} h"


def _lines(progress: LastProgress, ended: threading.Event) -> None:
    """A plain line every ``PLAIN_LINE_INTERVAL`` seconds until the work has ended."""
    while not ended.wait(PLAIN_LINE_INTERVAL):
        with contextlib.suppress(OSError, ValueError):  # stderr may be closed
            print(f"flightid: {progress.line(time.monotonic())}", file=sys.stderr, flush=True)


def _bar(progress: LastProgress, ended: threading.Event) -> None:
    """Show a bar that disappears at the end; it only pulses while no share is known."""
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


# ---- The tables that pages of several kinds share

_TESTS = {"ljung-box": "whiteness", "nis": "size of the innovations"}


class EstimatedParameter(Protocol):
    """One parameter: ``studies.rows.Row``, or what has the same names."""

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
    """Return a table of estimates with sigmas, and true, condensed, published and start values."""
    shown = [(row, shown_in(row.unit, row.name)) for row in rows]
    scaled = [(row, each.factor) for row, each in shown]
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
    further = [
        (Column("true", BY_ROW), [_times(factor, row.true) for row, factor in scaled]),
        (Column("condensed", BY_ROW), [_times(f, row.condensed) for row, f in scaled]),
        (
            Column("estimate ± σ", BY_ROW, printed="estimate"),
            [estimate(factor * row.estimate, factor * row.std) for row, factor in scaled],
        ),
        (
            Column("σ of the value", "%", printed="sigma %"),
            [_share_cell(_share(row.estimate, row.std)) for row in rows]
            if all(row.true is None for row in rows)
            else [],
        ),
        (Column("error", "%", printed="error %"), [known(row.percent, 2) for row in rows]),
        (
            Column("error", SIGMAS),
            [formatted(row.sigmas if row.std > 0 else None, "+.2f") for row in rows],
        ),
        (Column("published", BY_ROW), published),
        (
            Column("its error", "its σ", printed="its error, sigmas", beside=True),
            [formatted(row.published_sigmas, "+.1f") if row.published else "" for row in rows],
        ),
        (Column("start", BY_ROW), [_times(f, start_values.get(row.name)) for row, f in scaled]),
    ]
    return table(
        caption,
        (Column("parameter"), [row.name for row in rows]),
        *(
            (column, cells)
            for column, cells in further
            if column.printed == "estimate" or any(isinstance(cell, Number) for cell in cells)
        ),
        units=[each.unit for _, each in shown],
    )


def _share_cell(share: float) -> Cell:
    return formatted(share, ".2g" if share < 100.0 else ".0f")


def _times(factor: float, value: float | None) -> Cell:
    return known(None if value is None else factor * value)


def _share(value: float, std: float) -> float:
    """Return sigma in percent of the value; infinite (shown as a dash) if not meaningful."""
    return (
        100.0 * std / abs(value) if value and std > 0.0 and std < 1e3 * abs(value) else float("inf")
    )


FITS = (
    Column("channel"),
    Column("rms error", PURE),
    Column("fit", "%", printed="fit %"),
    Column("R2", PURE),
    Column("Theil", PURE),
)


def rows_table(caption: str, columns: Sequence[Column], rows: Sequence[Sequence[Cell]]) -> Table:
    """Return a table that is given by rows of cells."""
    return Table(caption, tuple(columns), tuple(map(tuple, rows)))


def fit_cells(channel: str, error: Quantity, fit: float, r2: float, theil: float) -> list[Cell]:
    """Return cells below ``FITS``: the error of a free simulation in one channel."""
    value, _, unit = displayed(error)
    return [
        channel,
        Number(value, unit=unit, shown=f"{value:.3g}{spaced(unit)}"),
        Number(fit, digits=1),
        Number(r2, digits=4),
        Number(theil, digits=3),
    ]


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
    return Table(
        caption,
        columns,
        tuple(
            (_TESTS.get(t.name, t.name), t.channel, p_value(t.p_value), t.sentence) for t in tests
        ),
    )


def p_value(value: float) -> Number:
    """Return a probability with two digits."""
    return Number(value, shown=f"{value:.2g}" if value > 0.0 else "<1e-300")


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
    """Return a constant with the digits that it was given with, as a mass of six."""
    return Number(value, shown=f"{value:.7g}") if math.isfinite(value) else known(value)


def levels_of_noise(caption: str, noise: Mapping[str, tuple[float, str]]) -> Table:
    """Return the standard deviations by channel, with units."""
    shown = {name: shown_in(unit, name) for name, (_, unit) in noise.items()}
    values = {name: shown[name].factor * value for name, (value, _) in noise.items()}
    rows = tuple((name, Number(value, shown=f"{value:.3g}")) for name, value in values.items())
    return Table(
        caption,
        (Column("channel"), Column("standard deviation", BY_ROW)),
        rows,
        tuple(each.unit or PURE for each in shown.values()),
    )
