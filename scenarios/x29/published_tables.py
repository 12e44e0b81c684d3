"""The published tables of a closed-loop study beside the same method on its record."""

from __future__ import annotations

import math

import numpy as np

from scenarios.report.document import (
    BY_ROW,
    PURE,
    Block,
    Cell,
    Column,
    Number,
    Prose,
    Table,
    formatted,
    table,
)
from scenarios.report.quantities import Shown, number_text, shown_in
from scenarios.x29.content import correlated_pairs, procedure_and_printed, units_of
from scenarios.x29.declaration import has_table, printed_column, printed_correlation
from scenarios.x29.estimating import LARGE_CORRELATION, LoopMethodResult
from scenarios.x29.findings import COMPARED, off, own_method
from scenarios.x29.study import LoopStudy

TITLES = {"simulation": "Table 1", "flight": "Table 2"}
PER_ROOT_SECOND = "unit/√s"  # square root of a spectral density; the row names the unit


def paper_blocks(study: LoopStudy) -> list[Block]:
    """Return the blocks of the published tables, all methods and restarts."""
    column = study.scenario.column
    out: list[Block] = []
    if study.scenario.methods and has_table(column):
        names, C = printed_correlation(column)
        title = (
            f"correlations as published in {TITLES[column]}, * above {LARGE_CORRELATION:g} in size"
        )
        out += [*_states(study, column), _pairs(study, column), triangle(title, names, C)]
    if study.scenario.methods:
        out += _methods(study, column)
    return [*out, *_restarts(study)]


def bare(heading: str, unit: str) -> Column:
    """Return a column whose unit is shown on pages only."""
    return Column(heading, unit, printed=heading)


def triangle(title: str, names: tuple[str, ...], C: np.ndarray) -> Table:
    def cell(i: int, j: int) -> Cell:
        if j > i:
            return ""
        mark = "*" if i != j and abs(C[i, j]) > LARGE_CORRELATION else ""
        return Number(float(C[i, j]), shown=f"{C[i, j]:+z.2f}{mark}")

    columns = [
        (
            Column(name, PURE, printed=name.replace("alpha", "al").replace("delta", "de")),
            [cell(i, j) for i in range(len(names))],
        )
        for j, name in enumerate(names)
    ]
    return table(title, (Column("name", printed=" "), names), *columns)


def _states(study: LoopStudy, column: str) -> list[Block]:
    rows = procedure_and_printed(study, column)
    shown = {name: shown_in(unit, name) for name, unit in units_of(study).items()}

    def both(key: str, heading: str) -> list[tuple[Column, list[Cell]]]:
        """Return values with their sigmas, here and as published."""
        here, published = (
            [
                _with_variance(row[key][side], row[f"{key}_variance"][side], shown[name])
                for name, row in rows.items()
            ]
            for side in ("here", "published")
        )
        return [
            (Column(f"{heading}, here", BY_ROW), here),
            (Column(f"{heading}, published", BY_ROW), published),
        ]

    values = table(
        f"{TITLES[column]} and the published method on this record (plain bank, "
        f"{study.single_pass.delay:.3f} s)",
        (Column("state"), list(rows)),
        *both("initial", "initial"),
        *both("final", "final"),
        units=[shown[name].unit for name in rows],
    )
    noisy = {
        name: row
        for name, row in rows.items()
        if any(row[key][side] for key in ("R", "Q") for side in ("here", "published"))
    }

    def sigma(key: str, side: str) -> list[Cell]:
        return [
            formatted(shown[name].factor * math.sqrt(variance), ".3g") if variance else ""
            for name, variance in ((name, row[key][side]) for name, row in noisy.items())
        ]

    noise = table(
        f"noise in {TITLES[column]} and here",
        (Column("state"), list(noisy)),
        (Column("sensor noise, here", BY_ROW), sigma("R", "here")),
        (Column("sensor noise, published", BY_ROW), sigma("R", "published")),
        (bare("process noise, here", PER_ROOT_SECOND), sigma("Q", "here")),
        (bare("process noise, published", PER_ROOT_SECOND), sigma("Q", "published")),
        units=[shown[name].unit for name in noisy],
    )
    note = (
        "the publication prints variances; standard deviations are shown here; process noise is "
        "the square root of the spectral density; the sensor noise of nz is in the row of nz_0"
    )
    return [values, noise, Prose(note, "note")]


def _with_variance(value: float | None, variance: float | None, shown: Shown) -> Cell:
    """Return a value with its standard deviation in display units; empty without a value."""
    if value is None:
        return ""
    std = math.sqrt(variance) if variance else None
    if std is None:
        return Number(shown.factor * value)
    return Number(shown.factor * value, shown.factor * std)


def _pairs(study: LoopStudy, column: str) -> Table:
    rows = correlated_pairs(study, column)
    return table(
        f"largest correlations of {TITLES[column]}",
        (Column("correlation of"), [f"{a}, {b}" for a, b, *_ in rows]),
        (Column("published", PURE), [formatted(value, "+.3f") for _, _, value, _, _ in rows]),
        (Column("its method, here", PURE), [formatted(value, "+.3f") for *_, value, _ in rows]),
        (Column("ours, refined", PURE), [formatted(value, "+.3f") for *_, value in rows]),
    )


def _methods(study: LoopStudy, column: str) -> list[Block]:
    methods: list[LoopMethodResult] = [*study.methods, own_method(study)]
    printed, units = printed_column(column), units_of(study)

    def published(name: str, form: str) -> Cell:
        """Return a printed number; Table 3 of the paper has no frequency and damping ratio."""
        return formatted(printed[name].value if name in printed else None, form)

    shown = table(
        "methods by name",
        (Column("method"), [*(m.label for m in methods), "published"]),
        (bare("delay", "s"), [*(formatted(m.delay, ".4f") for m in methods), ""]),
        *(
            (
                bare(n, units[n]),
                [by_sigma(m.values[n], m.std[n]) for m in methods] + [published(n, "g")],
            )
            for n in ("L_alpha", *COMPARED)
        ),
        (
            Column("frequency", "rad/s", printed="rad/s"),
            [
                *(formatted(m.frequency, ".2f") for m in methods),
                published("natural_frequency", ".2f"),
            ],
        ),
        (
            Column("damping", PURE),
            [*(formatted(m.damping, ".3f") for m in methods), published("damping_ratio", ".3f")],
        ),
        (Column("off", "%"), [*(formatted(100.0 * off(m, column), ".0f") for m in methods), ""]),
    )
    note = (
        f"off: root mean square of the relative differences of {', '.join(COMPARED)} from the "
        "published ones"
    )
    return [shown, Prose(note, "note")]


def by_sigma(value: float, std: float) -> Cell:
    """Return a number with digits by its sigma, which is not shown."""
    return Number(value, shown=number_text(value, std))


def _restarts(study: LoopStudy) -> list[Block]:
    units, out = units_of(study), list[Block]()
    for label, restarted in study.restarts.items():
        rows = [
            (k, i)
            for k in range(len(restarted.delays))
            for i in range(len(restarted.values["M_q"]))
        ]
        columns = [
            (
                Column(n, units[n], printed=n),
                [formatted(restarted.values[n][i, k], ".4g") for k, i in rows],
            )
            for n in ("L_alpha", *COMPARED)
        ]
        out.append(
            table(
                f"plain filters started again from their own result: {label}",
                (
                    Column("delay", "s", printed="delay"),
                    [formatted(restarted.delays[k], ".4f") for k, _ in rows],
                ),
                (Column("pass", PURE), [Number(i + 1, digits=0) for _, i in rows]),
                *columns,
            )
        )
    return out
