"""The document that every page shows: a title, what was found, sections of prose, tables and figures, and how to do it again."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

from scenarios.pages.numbers import PURE, Cell, Number
from sim.errors import ModelError

BY_ROW = "by row"  # the unit of a column whose rows have units of their own
_NUMBER = re.compile(r"[+−-]?(\d+\.?\d*|\.\d+)(e[+−-]?\d{1,2})?[ %]*", re.ASCII)  # names such as 1_2 or nan are none
TONES = ("good", "fair", "open", "plain")


@dataclass(frozen=True)
class Prose:
    """A paragraph; ``kind`` is ``""``, ``"note"``, ``"warning"`` or ``"code"``; ``term`` stands before it, bold."""

    text: str
    kind: str = ""
    term: str = ""


@dataclass(frozen=True)
class Bullets:
    """A list of sentences; ``numbered`` where their order says something."""

    items: tuple[str, ...]
    numbered: bool = False


@dataclass(frozen=True)
class Fold:
    """Paragraphs that are opened when wanted, and printed."""

    summary: str
    items: tuple[str, ...]


@dataclass(frozen=True)
class Column:
    """A heading, and the unit of its numbers: None of words, ``BY_ROW``, ``"1"`` of counts and ratios. ``code``: hashes and names of files."""

    heading: str
    unit: str | None = None
    code: bool = False


@dataclass(frozen=True)
class Table:
    """Rows of cells below columns; ``units`` of the rows where they have units of their own, which the page shows behind the first column.

    ``printed``: how many rows stand on paper, the first of them; None is all.

    Raises ModelError where a row has another length than the columns, a number has no unit, or a number stands as a word.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    units: tuple[str, ...] = ()
    printed: int | None = None

    def __post_init__(self) -> None:
        if self.units and len(self.units) != len(self.rows):
            raise ModelError("as many units as rows", where=f"table {self.caption!r}", remedy="give each row its unit")
        for at, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ModelError(f"row {at + 1} has {len(row)} cells", where=f"table {self.caption!r}", remedy=f"give it {len(self.columns)}")
            for column, cell in zip(self.columns, row, strict=True):
                self._check(column, cell)

    def _check(self, column: Column, cell: Cell) -> None:
        where = f"table {self.caption!r}, column {column.heading!r}"
        if isinstance(cell, Number):
            if not cell.unit and (column.unit is None or (column.unit == BY_ROW and not self.units)):
                raise ModelError(f"{cell.text} has no unit", where=where, remedy="give the column, the row or the number one")
        elif not column.code and _is_number(cell if isinstance(cell, str) else cell.text):
            raise ModelError(f"the number {cell} stands as a word", where=where, remedy="make it a Number")


@dataclass(frozen=True)
class Figure:
    """An SVG element with its caption; what a reader who cannot see it is told is its ``aria-label``."""

    name: str
    svg: str
    caption: str


Block = Prose | Bullets | Fold | Table | Figure


@dataclass(frozen=True)
class Section:
    """A heading with its blocks; ``parts`` are sections below it, ``card`` draws a frame around it, ``"hint"`` a broken one."""

    title: str
    blocks: tuple[Block, ...] = ()
    parts: tuple[Section, ...] = ()
    card: str = ""

    @property
    def name(self) -> str:
        """Its place in the page's address."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-") or "section"


@dataclass(frozen=True)
class Reproduction:
    """How to do it again: commands, seed, versions of programs, and of each input its use, name and SHA-256."""

    commands: tuple[str, ...]
    versions: dict[str, str] = field(default_factory=dict)
    seed: str = ""
    inputs: tuple[tuple[str, str, str], ...] = ()


@dataclass(frozen=True)
class Page:
    """A page. ``kind`` says of what; ``verdict`` is a word or two, its ``tone`` one of ``TONES``, ``sentence`` goes on from it;
    ``summary`` are the lines that are read first."""

    title: str
    kind: str
    verdict: str
    tone: str
    sentence: str
    summary: tuple[str, ...]
    warnings: tuple[str, ...]
    sections: tuple[Section, ...]
    reproduction: Reproduction
    created: str = ""

    def __post_init__(self) -> None:
        if self.tone not in TONES:
            raise ModelError(f"there is no tone {self.tone!r}", where=f"page {self.title!r}", remedy=f"use one of {', '.join(TONES)}")


def section(title: str, *blocks: Block | None, parts: tuple[Section, ...] = (), card: str = "") -> tuple[Section, ...]:
    """A section with what there is of its blocks; none where there is nothing in it, so that calls can be strung together."""
    there = tuple(block for block in blocks if block is not None and not (isinstance(block, Table) and not block.rows))
    there = tuple(block for block in there if not (isinstance(block, Bullets) and not block.items))
    return (Section(title, there, parts, card),) if there or parts else ()


def _is_number(text: str) -> bool:
    return _NUMBER.fullmatch(text) is not None


__all__ = ["BY_ROW", "PURE", "Block", "Bullets", "Column", "Figure", "Fold", "Number", "Page", "Prose", "Reproduction", "Section", "Table", "section"]
