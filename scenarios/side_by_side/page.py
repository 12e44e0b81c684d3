"""The page of studies side by side: a column a study."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import combinations

from scenarios.pages.folder import figures
from scenarios.pages.model import BY_ROW, Block, Bullets, Column, Page, Table, section
from scenarios.pages.numbers import Cell, estimate, known
from scenarios.pages.printed import SIGMAS
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import capital, sentence
from scenarios.plots.page.named import Drawn
from scenarios.side_by_side.comparison import SideBySide
from scenarios.side_by_side.value import Column as Study
from scenarios.side_by_side.value import Value

ESTIMATES = "Estimates"
REFERENCE = "What each study should find: true, or condensed where its model lacks modes"
LIMIT = 3.0  # combined sigmas from which two studies are said to disagree


def compared_page(compared: SideBySide, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a comparison with the figures ``drawn``."""
    labels = [column.label for column in compared.columns]
    apart, told = _farthest(compared)
    shared = f"{len(compared.names)} parameters are estimated by at least two of {len(labels)} studies"
    return Page(
        title="Studies side by side",
        kind=", ".join(labels),
        verdict="" if apart is None else "apart" if apart > LIMIT else "alike",
        tone="plain" if apart is None else "fair" if apart > LIMIT else "good",
        sentence=sentence(told) if told else "",
        summary=(sentence(shared),),
        warnings=tuple([f"In different units, therefore not compared: {', '.join(compared.apart)}."] if compared.apart else []),
        sections=(
            *section("The studies", _studies(compared.columns)),
            *section("Estimates", *_tables(compared)),
            *section("What only one has", Bullets(tuple(f"Only {label} has {', '.join(names)}." for label, names in compared.single.items()))),
            *section("Figures", *figures(drawn)),
        ),
        reproduction=reproduction(["flightid", "compare", *(_named(column) for column in compared.columns)]),
        created=now(),
    )


def _studies(columns: Sequence[Study]) -> Table:
    headings = Column("study"), Column("title"), Column("estimator"), Column("outcome"), Column("seed", "1")
    rows = tuple((c.label, c.title or "–", c.estimator or "–", c.outcome, known(c.seed, 0)) for c in columns)
    return Table("Studies", headings, rows)


def _tables(compared: SideBySide) -> list[Block]:
    names = (*compared.names, *compared.derived)
    true = [_common(compared, name) for name in names]
    blocks: list[Block] = [_table(compared, names, ESTIMATES, BY_ROW, lambda v: estimate(v.estimate, v.std), true)]
    blocks.append(_table(compared, names, REFERENCE, BY_ROW, lambda v: known(v.reference)))
    blocks.append(_table(compared, names, "Error in the study's own sigmas", SIGMAS, lambda v: known(v.sigmas, 1, signed=True)))
    blocks.append(_table(compared, names, "Error", "%", lambda v: known(v.percent, 2, signed=True)))
    blocks.append(_table(compared, names, "Published values", BY_ROW, lambda v: estimate(*v.published) if v.published else "–"))
    errors = _table(compared, names, "Error of the published values in their own sigmas", SIGMAS, _published_error)
    return [block for block in (*blocks, errors) if isinstance(block, Table) and block.rows]


def _published_error(value: Value) -> Cell:
    printed = value.published_value
    return "–" if printed is None else known(printed.sigmas, 1, signed=True)


def _table(
    compared: SideBySide, names: Sequence[str], caption: str, unit: str, cell: Callable[[Value], Cell], true: Sequence[float | None] = ()
) -> Table:
    """A column a study; rows and studies that say nothing are left out."""
    cells = {name: [("–" if value is None else cell(value)) for value in (compared.value(name, c) for c in compared.columns)] for name in names}
    cells = {name: row for name, row in cells.items() if any(each != "–" for each in row)}
    shown = [at for at in range(len(compared.columns)) if any(row[at] != "–" for row in cells.values())]
    with_true = any(value is not None for value in true)
    columns = [Column("parameter"), *([Column("true", BY_ROW)] if with_true else [])]
    columns += [Column(compared.columns[at].label + (" ± σ" if caption == ESTIMATES else ""), unit) for at in shown]
    known_true = dict(zip(names, true, strict=True)) if with_true else {}
    rows = tuple((compared.words(name), *([known(known_true[name])] if with_true else []), *(row[at] for at in shown)) for name, row in cells.items())
    return Table(caption, tuple(columns), rows, tuple(compared.unit(name) for name in cells))


def _common(compared: SideBySide, name: str) -> float | None:
    """The true value where all studies that state one state the same."""
    told = {value.true for column in compared.columns if (value := compared.value(name, column)) is not None and value.true is not None}
    return told.pop() if len(told) == 1 else None


def _farthest(compared: SideBySide) -> tuple[float | None, str]:
    """The two studies that are farthest apart in one parameter, in their combined sigmas; None where no two have sigmas."""
    best: tuple[float, str, str, str] | None = None
    for name in compared.names:
        there = [(c.label, value) for c in compared.columns if (value := compared.value(name, c)) is not None and value.std > 0.0]
        for (one, a), (other, b) in combinations(there, 2):
            apart = abs(a.estimate - b.estimate) / math.hypot(a.std, b.std)
            if best is None or apart > best[0]:
                best = apart, name, one, other
    if best is None:
        return None, ""
    apart, name, one, other = best
    return apart, f"{capital('farthest apart')} is {name} of {one} and {other}: {apart:.1f} of their combined sigmas, were their records independent"


def _named(column: Study) -> str:
    return f"{column.folder}:{column.method}" if column.method else str(column.folder)
