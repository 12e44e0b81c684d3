"""The tables that pages of several kinds share: estimates, derived quantities, residual tests, what was held."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Protocol

from ident.flying_qualities.modes import MODAL_UNITS
from ident.statistics.residuals import ResidualTest
from scenarios.pages.model import BY_ROW, Column, Table
from scenarios.pages.numbers import PURE, Cell, Number, estimate, known
from scenarios.pages.printed import SIGMAS
from scenarios.terminal.display_units import shown_in

_TESTS = {"ljung-box": "whiteness", "nis": "size of the innovations"}


class Estimated(Protocol):
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


def estimates_table(caption: str, rows: Sequence[Estimated], starts: Mapping[str, float] | None = None) -> Table:
    """Each parameter with its sigma, beside it what there is: true, condensed, published value, where the search began."""
    shown = {row.name: shown_in(row.unit, row.name) for row in rows}
    factors = [shown[row.name].factor for row in rows]
    columns: list[Column] = [Column("parameter")]
    cells: list[list[Cell]] = [[row.name for row in rows]]

    def add(heading: str, unit: str, values: Iterable[Cell]) -> None:
        found = list(values)
        if any(isinstance(cell, Number) for cell in found):
            columns.append(Column(heading, unit))
            cells.append(found)

    add("true", BY_ROW, [_times(factor, row.true) for factor, row in zip(factors, rows, strict=True)])
    add("condensed", BY_ROW, [_times(factor, row.condensed) for factor, row in zip(factors, rows, strict=True)])
    columns.append(Column("estimate ± σ", BY_ROW))
    cells.append([estimate(factor * row.estimate, factor * row.std) for factor, row in zip(factors, rows, strict=True)])
    if all(row.true is None for row in rows):
        add("σ of the value", "%", [known(_share(row.estimate, row.std), 1 if _share(row.estimate, row.std) >= 10 else 2) for row in rows])
    add("error", "%", [known(row.percent, 2, signed=True) for row in rows])
    add("error", SIGMAS, [known(row.sigmas, 2, signed=True) if row.std > 0 else "–" for row in rows])
    add("published", BY_ROW, [_published(factor, row) for factor, row in zip(factors, rows, strict=True)])
    add("published, off", "its σ", [known(row.published_sigmas, 1, signed=True) for row in rows])
    add("start", BY_ROW, [_times(factor, (starts or {}).get(row.name)) for factor, row in zip(factors, rows, strict=True)])
    return Table(caption, tuple(columns), tuple(zip(*cells, strict=True)), tuple(shown[row.name].unit for row in rows))


def _times(factor: float, value: float | None) -> Cell:
    return known(None if value is None else factor * value)


def _published(factor: float, row: Estimated) -> Cell:
    return estimate(factor * row.published.value, factor * row.published.std) if row.published else "–"


def _share(value: float, std: float) -> float:
    """Sigma in percent of the value; infinite, and so a dash, where either says nothing."""
    return 100.0 * std / abs(value) if value and std > 0.0 and std < 1e3 * abs(value) else float("inf")


def derived_table(caption: str, derived: Mapping[str, tuple[float, float]]) -> Table:
    """Frequencies, dampings, time constants and delays with their sigmas."""
    names = {name: name.replace("_", " ").replace("dutch", "Dutch") for name in derived}
    rows = tuple((names[name], estimate(value, std)) for name, (value, std) in derived.items())
    units = tuple({**MODAL_UNITS, "delay": "s"}.get(name, PURE) for name in derived)
    return Table(caption, (Column("quantity"), Column("estimate ± σ", BY_ROW)), rows, units)


def tests_table(caption: str, tests: Sequence[ResidualTest]) -> Table:
    """What the residual tests say of each channel."""
    columns = (Column("test"), Column("channel"), Column("p", PURE), Column("result"))
    return Table(caption, columns, tuple((_TESTS.get(t.name, t.name), t.channel, p_value(t.p_value), t.sentence) for t in tests))


def p_value(value: float) -> Number:
    """A probability with two digits."""
    return Number(value, shown=f"{value:.2g}" if value > 0.0 else "<1e-300")


def fixed_table(caption: str, fixed: Mapping[str, tuple[float, str]]) -> Table:
    """What was held, with units."""
    rows = tuple((name, _exact(value)) for name, (value, _) in fixed.items())
    return Table(caption, (Column("constant"), Column("value", BY_ROW)), rows, tuple(unit or PURE for _, unit in fixed.values()))


def _exact(value: float) -> Cell:
    """A constant with the digits that it was given with, as a mass of six."""
    return Number(value, shown=f"{value:.7g}") if math.isfinite(value) else known(value)


def levels_of_noise(caption: str, noise: Mapping[str, tuple[float, str]]) -> Table:
    """Standard deviations by channel, with units."""
    shown = {name: shown_in(unit, name) for name, (_, unit) in noise.items()}
    values = {name: shown[name].factor * value for name, (value, _) in noise.items()}
    rows = tuple((name, Number(value, shown=f"{value:.3g}")) for name, value in values.items())
    return Table(caption, (Column("channel"), Column("standard deviation", BY_ROW)), rows, tuple(each.unit or PURE for each in shown.values()))
