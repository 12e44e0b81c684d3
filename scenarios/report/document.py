"""The document of a page: title, sections of prose, tables, figures and numbers, and how to
reproduce it.
"""

from __future__ import annotations

import math
import re
import shlex
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from scenarios.files.sources import versions
from scenarios.report.plot_data import PlotData
from scenarios.report.quantities import determined, number_text, value_parts
from scenarios.report.summary import NEXT, Summary
from sim.errors import ModelError

# ---- Cells of a page

PURE = "1"  # the unit of counts, shares and ratios
SIGMAS = "σ"  # the unit of an error in its own standard deviations
UNDETERMINED = "not determined"
_BELOW = re.compile(r"(?:[A-Za-z0-9][A-Za-z0-9._+-]*/)*[A-Za-z0-9][A-Za-z0-9._+-]*")


@dataclass(frozen=True)
class Number:
    """A value with its standard deviation, if any, in ``unit`` (empty: that of its column or row).

    ``digits``: decimals; None: two digits of the sigma, or five significant digits without one.
    ``signed``: shows a plus. ``shown``, ``shown_sigma``: replacement texts; a page still sorts and
    copies the exact value.

    Raises ModelError for a value or a sigma that is not finite.
    """

    value: float
    sigma: float | None = None
    unit: str = ""
    digits: int | None = None
    signed: bool = False
    shown: str = ""
    shown_sigma: str = ""

    def __post_init__(self) -> None:
        if not math.isfinite(self.value) or not (self.sigma is None or math.isfinite(self.sigma)):
            raise ModelError(
                f"{self.value} +- {self.sigma} is not finite",
                where="number of a page",
                remedy="say in words why there is none",
            )

    @property
    def value_text(self) -> str:
        """The value alone, in the characters of a terminal."""
        if self.shown:
            return self.shown
        sign = "+" if self.signed and self.value >= 0 else ""
        if self.digits is not None:
            return f"{sign}{self.value:.{self.digits}f}"
        return f"{sign}{number_text(self.value, self.sigma)}"

    @property
    def sigma_text(self) -> str:
        """The sigma alone; empty if there is none."""
        if not self.sigma:
            return ""
        if self.shown_sigma or self.digits is None:
            return self.shown_sigma or number_text(self.sigma, self.sigma)
        return f"{self.sigma:.{self.digits}f}"

    @property
    def plain(self) -> str:
        """Value, sigma and its own unit as a terminal shows them: ``-1.66 +- 0.02 s``."""
        sigma = f" +- {self.sigma_text}" if self.sigma_text else ""
        unit = "" if self.shown or self.unit in ("", PURE) else f" {self.unit}"
        return f"{self.value_text}{sigma}{unit}"

    @property
    def text(self) -> str:
        """The same in the signs of print."""
        return signs(self.plain.replace(" sigma", " σ"))


@dataclass(frozen=True)
class Link:
    """Words that lead to a file below the page's own folder. Raises ModelError for anything else: a
    page leads nowhere outside.
    """

    text: str
    to: str

    def __post_init__(self) -> None:
        if not _BELOW.fullmatch(self.to):
            raise ModelError(
                f"{self.to!r} is no file below the page",
                where="link of a page",
                remedy="give its path from the page's folder",
            )


Cell = Number | Link | str
MISSING = "–"  # for a missing quantity


def estimate(value: float, sigma: float | None, unit: str = "") -> Cell:
    """Return an estimate, or in words that these data do not determine it."""
    if not math.isfinite(value) or (sigma is not None and not math.isfinite(sigma)):
        return UNDETERMINED
    if sigma is not None and sigma > 0.0 and not determined(value, sigma):
        return UNDETERMINED
    return Number(value, sigma if sigma else None, unit)


def brief_estimate(value: float, sigma: float, mark: str = "") -> Cell:
    """An estimate with two digits of its sigma, as ``value_text`` shows it; ``mark`` follows it."""
    if sigma == 0.0 and value != 0.0:
        return Number(value, shown=f"{value:.5g} (bound)")
    if not determined(value, sigma):
        return UNDETERMINED
    shown, spread = value_parts(value, sigma)
    return Number(value, sigma, shown=shown, shown_sigma=f"{spread}{mark}")


def known(value: float | None, digits: int | None = None, *, signed: bool = False) -> Cell:
    """Return a number if there is one, else a dash."""
    if value is None or not math.isfinite(value):
        return MISSING
    return Number(value, digits=digits, signed=signed)


def counted(value: int) -> Number:
    """Return a whole number."""
    return Number(value, digits=0)


def formatted(value: float | None, form: str, unit: str = "") -> Cell:
    """Return a number shown by a format such as ``+.2f``; a dash if there is none."""
    if value is None or not math.isfinite(value):
        return MISSING
    return Number(value, None, unit, shown=format(value, form))


def signs(text: str) -> str:
    """Signs as they are printed in books."""
    text = (
        text.replace("+-", "±")
        .replace("->", "→")
        .replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")
    )
    return re.sub(r"(?<![\w.])-(?=[\d.])", "−", text)


# ---- Lines of a terminal as sentences of a page


def as_sentence(text: str) -> str:
    """Return the text with a capital letter and a full stop."""
    return capital(text) + ("" if text.endswith((".", ":", "?", "!")) else ".")


CAUTION = "Caution: "


def warning_lines(doubts: Iterable[str], cautions: Iterable[str]) -> tuple[str, ...]:
    """Return the warnings of a page, and behind them those that only limit what was found."""
    return (*map(as_warning, doubts), *(CAUTION + as_warning(each) for each in cautions))


def as_warning(text: str) -> str:
    """Return the same, without an end where a command to copy stands last, after ``NEXT``."""
    return capital(text) if NEXT in text else as_sentence(text)


def summary_sentences(summary: Summary) -> tuple[str, ...]:
    """Return the main results and the residual from the five lines that a terminal shows; study and
    outcome precede them.
    """
    residual = f"residual: {summary.residual}" if summary.residual else ""
    return tuple(as_sentence(line) for line in (summary.result, residual) if line)


def capital(text: str) -> str:
    """Return the first letter large, but for names of parameters, effects and files."""
    first = text.split(" ", 1)[0]
    return (
        text if any(mark in first.rstrip(".:") for mark in "_.:-/") else text[:1].upper() + text[1:]
    )


# ---- The document that every page shows

BY_ROW = "by row"  # unit of a column whose rows have different units
# names such as 1_2 or nan are none
_NUMBER = re.compile(r"[+−-]?(\d+\.?\d*|\.\d+)(e[+−-]?\d{1,2})?[ %]*", re.ASCII)
TONES = ("good", "fair", "open", "plain")


@dataclass(frozen=True)
class Prose:
    """A paragraph, after a bold ``term`` if given.

    ``kind``: ``""``, ``"note"``, ``"value"``, ``"warning"`` or ``"code"``.
    """

    text: str
    kind: str = ""
    term: str = ""


@dataclass(frozen=True)
class Bullets:
    """A list of sentences; ``numbered`` if their order matters."""

    items: tuple[str, ...]
    numbered: bool = False


@dataclass(frozen=True)
class Fold:
    """Paragraphs that are opened when wanted, and printed."""

    summary: str
    items: tuple[str, ...]


@dataclass(frozen=True)
class Column:
    """Heading and unit of a column.

    ``unit``: None for words, ``BY_ROW``, ``"1"`` for counts and ratios. ``code``: the cells are
    hashes or file names.

    For a terminal only: ``printed`` replaces heading and unit; ``left``, ``right``: alignment
    (default: words left, numbers right); ``beside``: not separated from the column before it when
    a wide table is split; ``together``: values and sigmas in one column.
    """

    heading: str
    unit: str | None = None
    code: bool = False
    printed: str = field(default="", compare=False)
    left: bool = field(default=False, compare=False)
    right: bool = field(default=False, compare=False)
    beside: bool = field(default=False, compare=False)
    together: bool = field(default=False, compare=False)


@dataclass(frozen=True)
class Table:
    """Rows of cells below columns.

    ``units``: by row, shown after the first column. ``printed``: number of rows on paper; None is
    all.

    Raises ModelError if a row and the columns differ in length, a number has no unit, or a number
    is given as a word.
    """

    caption: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    units: tuple[str, ...] = ()
    printed: int | None = None

    def __post_init__(self) -> None:
        if self.units and len(self.units) != len(self.rows):
            raise ModelError(
                "as many units as rows",
                where=f"table {self.caption!r}",
                remedy="give each row its unit",
            )
        for at, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ModelError(
                    f"row {at + 1} has {len(row)} cells",
                    where=f"table {self.caption!r}",
                    remedy=f"give it {len(self.columns)}",
                )
            for column, cell in zip(self.columns, row, strict=True):
                self._check(column, cell)

    def _check(self, column: Column, cell: Cell) -> None:
        where = f"table {self.caption!r}, column {column.heading!r}"
        if isinstance(cell, Number):
            if not cell.unit and (
                column.unit is None or (column.unit == BY_ROW and not self.units)
            ):
                raise ModelError(
                    f"{cell.text} has no unit",
                    where=where,
                    remedy="give the column, the row or the number one",
                )
        elif not column.code and _is_number(cell if isinstance(cell, str) else cell.text):
            raise ModelError(
                f"the number {cell} stands as a word", where=where, remedy="make it a Number"
            )


def table(
    caption: str, *columns: tuple[Column, Sequence[Cell]] | None, units: Sequence[str] = ()
) -> Table:
    """Return a table from columns with their cells; None is skipped."""
    there = [each for each in columns if each is not None]
    rows = tuple(zip(*(cells for _, cells in there), strict=True))
    return Table(
        caption,
        tuple(column for column, _ in there),
        rows,
        tuple(unit or PURE for unit in units),
    )


@dataclass(frozen=True)
class Figure:
    """An SVG element with its caption; what a reader who cannot see it is told is its
    ``aria-label``. ``plot``: its data, from which the page draws it so that it zooms; None if it
    stays as it is.
    """

    name: str
    svg: str
    caption: str
    plot: PlotData | None = field(default=None, compare=False)


Block = Prose | Bullets | Fold | Table | Figure


@dataclass(frozen=True)
class Section:
    """A heading with its blocks; ``parts`` are sections below it, ``card`` draws a frame around it,
    ``"hint"`` a broken one.
    """

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
    """How to do it again: commands, seed, versions of programs, and of each input its use, name and
    SHA-256.
    """

    commands: tuple[str, ...]
    versions: dict[str, str] = field(default_factory=dict)
    seed: str = ""
    inputs: tuple[tuple[str, str, str], ...] = ()


@dataclass(frozen=True)
class Page:
    """A page.

    ``kind``: kind of study. ``verdict``: a word or two, with ``tone`` of ``TONES`` and a
    continuing ``sentence``. ``summary``: the first lines. ``warnings``: those that begin with
    ``CAUTION`` are shown as cautions.
    """

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
            raise ModelError(
                f"there is no tone {self.tone!r}",
                where=f"page {self.title!r}",
                remedy=f"use one of {', '.join(TONES)}",
            )


def section(
    title: str, *blocks: Block | None, parts: tuple[Section, ...] = ()
) -> tuple[Section, ...]:
    """Return a section with its non-empty blocks as a tuple; an empty tuple if there are none."""
    there = tuple(
        block
        for block in blocks
        if block is not None and not (isinstance(block, Table) and not block.rows)
    )
    there = tuple(block for block in there if not (isinstance(block, Bullets) and not block.items))
    return (Section(title, there, parts),) if there or parts else ()


def _is_number(text: str) -> bool:
    return _NUMBER.fullmatch(text) is not None


__all__ = [
    "BY_ROW",
    "PURE",
    "Block",
    "Bullets",
    "Column",
    "Figure",
    "Fold",
    "Number",
    "Page",
    "Prose",
    "Reproduction",
    "Section",
    "Table",
    "section",
]


# ---- How to repeat a study

PROGRAM = "flightid"
_PACKAGES = ("scenarios", PROGRAM)  # python -m


def reproduction(
    usual: Sequence[str], seed: str = "", inputs: Sequence[tuple[str, str, str]] = ()
) -> Reproduction:
    """Return the command that was typed, or ``usual`` (its words) where none was; ``seed`` in a
    sentence; use, name and SHA-256 of each input.
    """
    return Reproduction((shlex.join(typed() or usual),), versions(), seed, tuple(inputs))


def typed() -> list[str]:
    """Return the words of this process's command line, beginning with the program's name; none if
    another program uses the library.
    """
    program, *words = sys.argv or [""]
    path = Path(program)
    ours = path.stem == PROGRAM or (path.name == "__main__.py" and path.parent.name in _PACKAGES)
    return [PROGRAM, *words] if ours and words else []


def now() -> str:
    """Return the time stamp of a page, UTC."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
