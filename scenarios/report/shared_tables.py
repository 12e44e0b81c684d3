"""Tables that pages of several kinds share."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from ident.flying_qualities.modes import MODAL_UNITS
from ident.statistics.residuals import ResidualTest
from ident.tracing.diagnosis import Quantity
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    SIGMAS,
    Cell,
    Column,
    Number,
    Table,
    estimate,
    formatted,
    known,
    table,
)
from scenarios.report.quantities import displayed, shown_in, spaced

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
    shown = [(row, shown_in(row.unit, row.name)) for row in rows]
    scaled = [(row, each.factor) for row, each in shown]
    begun = starts or {}
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
        (Column("start", BY_ROW), [_times(f, begun.get(row.name)) for row, f in scaled]),
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
    """Sigma in percent of the value; infinite, and so a dash, where either says nothing."""
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
    """A table that is given by rows of cells."""
    return Table(caption, tuple(columns), tuple(map(tuple, rows)))


def fit_cells(channel: str, error: Quantity, fit: float, r2: float, theil: float) -> list[Cell]:
    """Cells below ``FITS``: what a free simulation misses of a channel."""
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
