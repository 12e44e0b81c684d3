"""Terminal tables of what the paper prints beside what its procedure, and each step of ours, finds on our record."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from rich.console import Console

from scenarios.terminal.numbers import number
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.tables import Column, print_table
from scenarios.x29.measures import LARGE
from scenarios.x29.methods import MethodResult
from scenarios.x29.paper.content import beside, noted_pairs
from scenarios.x29.paper.sentences import COMPARED, off, own_method
from scenarios.x29.published import Printed, has_table, printed_column, printed_correlation
from scenarios.x29.study import LoopStudy

TITLES = {"simulation": "Table 1", "flight": "Table 2"}


def print_paper(study: LoopStudy, out: Console) -> None:
    """Tables 1 or 2 and their correlations beside the paper's procedure here, the methods, and restarts of plain filters."""
    column = study.scenario.published[0] if study.scenario.published else ""
    if study.scenario.methods and has_table(column):
        _states(study, column, out)
        _pairs(study, column, out)
        names, C = printed_correlation(column)
        print_triangle(out, f"correlations as published in {TITLES[column]}, * above {LARGE:g} in size", names, C)
    if study.scenario.methods:
        _methods(study, column, out)
    _restarts(study, out)


def print_triangle(out: Console, title: str, names: tuple[str, ...], C: np.ndarray) -> None:
    """The lower triangle of a correlation matrix."""

    def cell(i: int, j: int) -> str:
        return f"{C[i, j]:+.2f}{'*' if i != j and abs(C[i, j]) > LARGE else ''}" if j <= i else ""

    columns = [Column("", names, left=True)]
    columns += [Column(name.replace("alpha", "al").replace("delta", "de"), [cell(i, j) for i in range(len(names))]) for j, name in enumerate(names)]
    out.print()
    print_table(out, title, columns)


def _states(study: LoopStudy, column: str, out: Console) -> None:
    rows = beside(study, column)

    def cells(key: str) -> list[list[str]]:
        pairs = [row[key] for row in rows.values()]
        return [[f"{pair[side]:.2e}" if pair[side] is not None else "" for pair in pairs] for side in ("here", "published")]

    def block(key: str, heading: str) -> list[Column]:
        here, published = cells(key)
        return [Column(f"{heading}, here", here), Column("published", published, beside=True)]

    columns = [Column("state", list(rows), left=True), *block("initial", "initial"), *block("initial_variance", "P0")]
    further = [*block("final", "final"), *block("final_variance", "variance"), *block("R", "R"), *block("Q", "Q")]
    out.print()
    print_table(out, f"{TITLES[column]} and the paper's procedure on this record (plain bank, {study.plain.delay:.3f} s)", [*columns, *further])
    print_paragraph(out, "SI, in the paper's units R of alpha and q are deg2 and (deg/s)2; Q here is a spectral density; R of nz stands with nz_0")


def _pairs(study: LoopStudy, column: str, out: Console) -> None:
    rows = noted_pairs(study, column)
    columns = [
        Column("correlation of", [f"{a}, {b}" for a, b, *_ in rows], left=True),
        Column("published", [f"{row[2]:+.3f}" for row in rows]),
        Column("paper's procedure", [f"{row[3]:+.3f}" for row in rows]),
        Column("ours, refined", [f"{row[4]:+.3f}" for row in rows]),
    ]
    out.print()
    print_table(out, f"largest correlations of {TITLES[column]}", columns)


def _methods(study: LoopStudy, column: str, out: Console) -> None:
    found: list[MethodResult] = [*study.methods, own_method(study)]
    names = ("L_alpha", *COMPARED)
    printed = printed_column(column)
    columns = [
        Column("method", [*(m.label for m in found), "published"], left=True),
        Column("delay", [*(f"{m.delay:.4f}" for m in found), ""]),
        *(Column(n, [*(number(m.values[n], m.std[n]) for m in found), f"{printed[n].value:g}"]) for n in names),
        Column("rad/s", [*(f"{m.frequency:.2f}" for m in found), _printed_cell(printed, "natural_frequency", ".2f")]),
        Column("damping", [*(f"{m.damping:.3f}" for m in found), _printed_cell(printed, "damping_ratio", ".3f")]),
        Column("off, %", [*(f"{100.0 * off(m, column):.0f}" for m in found), ""]),
    ]
    out.print()
    print_table(out, "methods by name", columns)
    print_paragraph(out, f"off: root mean square of the relative differences of {', '.join(COMPARED)} from the published ones")


def _printed_cell(printed: Mapping[str, Printed], name: str, form: str) -> str:
    """A printed number, or a dash: the paper prints no frequency and no damping ratio of its Table 3."""
    return format(printed[name].value, form) if name in printed else "-"


def _restarts(study: LoopStudy, out: Console) -> None:
    for label, found in study.restarts.items():
        rows = [(k, i) for k in range(len(found.delays)) for i in range(len(found.values["M_q"]))]
        columns = [
            Column("delay", [f"{found.delays[k]:.4f}" for k, _ in rows]),
            Column("pass", [str(i + 1) for _, i in rows]),
            *(Column(n, [f"{found.values[n][i, k]:.4g}" for k, i in rows]) for n in ("L_alpha", *COMPARED)),
        ]
        out.print()
        print_table(out, f"plain filters started again from their own result: {label}", columns)
