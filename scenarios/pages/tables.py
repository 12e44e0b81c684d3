"""Tables that pages of several kinds share."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

from ident.flying_qualities.modes import MODAL_UNITS
from ident.statistics.residuals import ResidualTest
from scenarios.pages.model import (
    BY_ROW,
    PURE,
    Block,
    Cell,
    Column,
    Number,
    Prose,
    Table,
    as_sentence,
    capital,
    estimate,
    known,
    read_cell,
    signs,
)
from scenarios.terminal.quantities import shown_in
from scenarios.terminal.tables import CapturedTable, captured
from scenarios.terminal.tables import TableColumn as Printed

if TYPE_CHECKING:
    from rich.console import Console


# ---- What a command prints

SIGMA = ("+- sigma", "± sigma")  # headings of a column that belongs to the number before it
UNIT = "unit"
SIGMAS = "σ"
# what stands behind the words of a heading
_BEHIND = re.compile(r", (?P<unit>sigmas|s|Hz|deg|rad|%|dB|m|m/s|rad/s)$")


def printed_blocks(
    show: Callable[[Console], object], units: Mapping[str, str] = MappingProxyType({})
) -> list[Block]:
    """The tables and sentences that ``show`` prints on a console; ``units`` as in ``table_of``."""
    return [
        Prose(as_sentence(each)) if isinstance(each, str) else table_of(each, units)
        for each in captured(show)
    ]


def table_of(told: CapturedTable, known: Mapping[str, str] = MappingProxyType({})) -> Table:
    """A printed table; a column of sigmas joins the numbers before it, a column of units becomes
    that of the rows.

    ``known`` are units by what stands at the head of a column, or at the begin of a row where the
    table has no units.
    """
    count = len(told.columns[0][1])
    known = {} if "correlation" in told.title else known  # which has no unit, whatever it is of
    units: tuple[str, ...] = next((cells for heading, cells in told.columns if heading == UNIT), ())
    if not units and any(name in known for name in told.columns[0][1]):
        units = tuple(known.get(name, PURE) for name in told.columns[0][1])
    headings: list[str] = []
    columns: list[list[Cell]] = []
    for heading, cells in told.columns:
        if heading == UNIT:
            continue
        read = [read_cell(cell) for cell in cells]
        if (
            heading in SIGMA
            and columns
            and not any(isinstance(cell, Number) and cell.sigma for cell in columns[-1])
        ):
            columns[-1] = [
                _with_sigma(cell, sigma) for cell, sigma in zip(columns[-1], read, strict=True)
            ]
            continue
        headings.append(heading or ("remark" if headings else "name"))
        columns.append(read)
    rows = tuple(tuple(column[at] for column in columns) for at in range(count))
    made = tuple(
        _column(heading, column, known.get(heading, BY_ROW if units else PURE))
        for heading, column in zip(headings, columns, strict=True)
    )
    return Table(capital(told.title), made, rows, tuple(unit or PURE for unit in units))


def rows_table(
    caption: str,
    headings: Sequence[str],
    rows: Sequence[Sequence[str]],
    printed: int | None = None,
    units: Mapping[str, str] = MappingProxyType({}),
) -> Table:
    """A table of which there are texts by row; ``printed`` as in ``Table``, ``units`` as in
    ``table_of``.
    """
    cells = tuple(tuple(row[at] for row in rows) for at in range(len(headings)))
    made = (
        table_of(CapturedTable(caption, tuple(zip(headings, cells, strict=True))), units)
        if rows
        else Table(caption, tuple(map(Column, headings)), ())
    )
    return Table(caption, made.columns, made.rows, made.units, printed)


def columns_table(
    caption: str, columns: Sequence[Printed], units: Mapping[str, str] = MappingProxyType({})
) -> Table:
    """A table of which there are the columns that a terminal prints."""
    return table_of(
        CapturedTable(caption, tuple((column.heading, tuple(column.cells)) for column in columns)),
        units,
    )


def _with_sigma(cell: Cell, sigma: Cell) -> Cell:
    if not isinstance(cell, Number) or not isinstance(sigma, Number):
        return cell
    return Number(cell.value, sigma.value, cell.unit, shown=signs(f"{cell.shown} ± {sigma.shown}"))


def _column(heading: str, cells: Sequence[Cell], usual: str) -> Column:
    numbers = [cell for cell in cells if isinstance(cell, Number)]
    if not numbers:
        return Column(heading)
    behind = _BEHIND.search(heading)
    if behind is not None:
        return Column(
            heading[: behind.start()], SIGMAS if behind["unit"] == "sigmas" else behind["unit"]
        )
    if heading.endswith(" %"):
        return Column(heading.removesuffix(" %"), "%")
    return Column(heading, PURE if all(cell.unit for cell in numbers) else usual)


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
    """Each parameter with its sigma, beside it what there is: true, condensed, published value,
    where the search began.
    """
    shown = {row.name: shown_in(row.unit, row.name) for row in rows}
    factors = [shown[row.name].factor for row in rows]
    columns: list[Column] = [Column("parameter")]
    cells: list[list[Cell]] = [[row.name for row in rows]]

    def add(heading: str, unit: str, values: Iterable[Cell]) -> None:
        found = list(values)
        if any(isinstance(cell, Number) for cell in found):
            columns.append(Column(heading, unit))
            cells.append(found)

    add(
        "true",
        BY_ROW,
        [_times(factor, row.true) for factor, row in zip(factors, rows, strict=True)],
    )
    add(
        "condensed",
        BY_ROW,
        [_times(factor, row.condensed) for factor, row in zip(factors, rows, strict=True)],
    )
    columns.append(Column("estimate ± σ", BY_ROW))
    cells.append(
        [
            estimate(factor * row.estimate, factor * row.std)
            for factor, row in zip(factors, rows, strict=True)
        ]
    )
    if all(row.true is None for row in rows):
        add(
            "σ of the value",
            "%",
            [
                known(
                    _share(row.estimate, row.std), 1 if _share(row.estimate, row.std) >= 10 else 2
                )
                for row in rows
            ],
        )
    add("error", "%", [known(row.percent, 2, signed=True) for row in rows])
    add(
        "error", SIGMAS, [known(row.sigmas, 2, signed=True) if row.std > 0 else "–" for row in rows]
    )
    add(
        "published",
        BY_ROW,
        [_published(factor, row) for factor, row in zip(factors, rows, strict=True)],
    )
    add("published, off", "its σ", [known(row.published_sigmas, 1, signed=True) for row in rows])
    add(
        "start",
        BY_ROW,
        [
            _times(factor, (starts or {}).get(row.name))
            for factor, row in zip(factors, rows, strict=True)
        ],
    )
    return Table(
        caption,
        tuple(columns),
        tuple(zip(*cells, strict=True)),
        tuple(shown[row.name].unit for row in rows),
    )


def _times(factor: float, value: float | None) -> Cell:
    return known(None if value is None else factor * value)


def _published(factor: float, row: EstimatedParameter) -> Cell:
    return (
        estimate(factor * row.published.value, factor * row.published.std) if row.published else "–"
    )


def _share(value: float, std: float) -> float:
    """Sigma in percent of the value; infinite, and so a dash, where either says nothing."""
    return (
        100.0 * std / abs(value) if value and std > 0.0 and std < 1e3 * abs(value) else float("inf")
    )


def derived_table(caption: str, derived: Mapping[str, tuple[float, float]]) -> Table:
    """Frequencies, dampings, time constants and delays with their sigmas."""
    names = {name: name.replace("_", " ").replace("dutch", "Dutch") for name in derived}
    rows = tuple((names[name], estimate(value, std)) for name, (value, std) in derived.items())
    units = tuple({**MODAL_UNITS, "delay": "s"}.get(name, PURE) for name in derived)
    return Table(caption, (Column("quantity"), Column("estimate ± σ", BY_ROW)), rows, units)


def tests_table(caption: str, tests: Sequence[ResidualTest]) -> Table:
    """What the residual tests say of each channel."""
    columns = (Column("test"), Column("channel"), Column("p", PURE), Column("result"))
    return Table(
        caption,
        columns,
        tuple(
            (_TESTS.get(t.name, t.name), t.channel, p_value(t.p_value), t.sentence) for t in tests
        ),
    )


def p_value(value: float) -> Number:
    """A probability with two digits."""
    return Number(value, shown=f"{value:.2g}" if value > 0.0 else "<1e-300")


def fixed_table(caption: str, fixed: Mapping[str, tuple[float, str]]) -> Table:
    """What was held, with units."""
    rows = tuple((name, _exact(value)) for name, (value, _) in fixed.items())
    return Table(
        caption,
        (Column("constant"), Column("value", BY_ROW)),
        rows,
        tuple(unit or PURE for _, unit in fixed.values()),
    )


def _exact(value: float) -> Cell:
    """A constant with the digits that it was given with, as a mass of six."""
    return Number(value, shown=f"{value:.7g}") if math.isfinite(value) else known(value)


def levels_of_noise(caption: str, noise: Mapping[str, tuple[float, str]]) -> Table:
    """Standard deviations by channel, with units."""
    shown = {name: shown_in(unit, name) for name, (_, unit) in noise.items()}
    values = {name: shown[name].factor * value for name, (value, _) in noise.items()}
    rows = tuple((name, Number(value, shown=f"{value:.3g}")) for name, value in values.items())
    return Table(
        caption,
        (Column("channel"), Column("standard deviation", BY_ROW)),
        rows,
        tuple(each.unit or PURE for each in shown.values()),
    )
