"""The document of a page: title, sections with prose, tables and figures, and the commands that
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
_PATH_BELOW = re.compile(r"(?:[A-Za-z0-9][A-Za-z0-9._+-]*/)*[A-Za-z0-9][A-Za-z0-9._+-]*")


@dataclass(frozen=True)
class Number:
    """A value with its standard deviation, if it has one.

    Attributes
    ----------
    value, sigma : finite numbers; ``sigma`` may be None.
    unit : unit; empty for that of the column or row.
    digits : number of decimals. None shows two digits of the sigma or, without sigma, five
        significant digits.
    signed : show a plus sign.
    shown, shown_sigma : texts to show. A page still sorts and copies the exact value.

    Raises
    ------
    ModelError : value or sigma is not finite.
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
        """The value without sigma, as a terminal shows it."""
        if self.shown:
            return self.shown
        sign = "+" if self.signed and self.value >= 0 else ""
        if self.digits is not None:
            return f"{sign}{self.value:z.{self.digits}f}"
        return f"{sign}{number_text(self.value, self.sigma)}"

    @property
    def sigma_text(self) -> str:
        """The sigma as a terminal shows it; empty without sigma."""
        if not self.sigma:
            return ""
        if self.shown_sigma or self.digits is None:
            return self.shown_sigma or number_text(self.sigma, self.sigma)
        return f"{self.sigma:.{self.digits}f}"

    @property
    def plain(self) -> str:
        """Value, sigma and the number's own unit as a terminal shows them: ``-1.66 +- 0.02 s``."""
        sigma = f" +- {self.sigma_text}" if self.sigma_text else ""
        unit = "" if self.shown or self.unit in ("", PURE) else f" {self.unit}"
        return f"{self.value_text}{sigma}{unit}"

    @property
    def text(self) -> str:
        """Value, sigma and unit as a page shows them: ``−1.66 ± 0.02 s``."""
        return signs(self.plain.replace(" sigma", " σ"))


@dataclass(frozen=True)
class Link:
    """A link to a file in the page's folder or below it.

    Attributes
    ----------
    text : text of the link.
    to : path from the page's folder.

    Raises
    ------
    ModelError : the path leads elsewhere. A page must not depend on files outside its folder.
    """

    text: str
    to: str

    def __post_init__(self) -> None:
        if not _PATH_BELOW.fullmatch(self.to):
            raise ModelError(
                f"{self.to!r} is no file below the page",
                where="link of a page",
                remedy="give its path from the page's folder",
            )


Cell = Number | Link | str
MISSING = "–"  # cell of a missing quantity


def estimate(value: float, sigma: float | None, unit: str = "") -> Cell:
    """Return the cell of an estimate; ``UNDETERMINED`` if the data do not determine it."""
    if not math.isfinite(value) or (sigma is not None and not math.isfinite(sigma)):
        return UNDETERMINED
    if sigma is not None and sigma > 0.0 and not determined(value, sigma):
        return UNDETERMINED
    return Number(value, sigma if sigma else None, unit)


def brief_estimate(value: float, sigma: float, mark: str = "") -> Cell:
    """Return the cell of an estimate with two digits of its sigma, followed by ``mark``.

    A parameter at its bound has sigma 0.
    """
    if sigma == 0.0 and value != 0.0:
        return Number(value, shown=f"{value:.5g} (bound)")
    if not determined(value, sigma):
        return UNDETERMINED
    value_text, sigma_text = value_parts(value, sigma)
    return Number(value, sigma, shown=value_text, shown_sigma=f"{sigma_text}{mark}")


def known(value: float | None, digits: int | None = None, *, signed: bool = False) -> Cell:
    """Return the cell of a number; a dash if it is None or not finite."""
    if value is None or not math.isfinite(value):
        return MISSING
    return Number(value, digits=digits, signed=signed)


def counted(value: int) -> Number:
    """Return the cell of a whole number."""
    return Number(value, digits=0)


def formatted(value: float | None, form: str, unit: str = "") -> Cell:
    """Return a number in a format such as ``+.2f``; a dash if it is None or not finite."""
    if value is None or not math.isfinite(value):
        return MISSING
    if form.endswith("e") and value == 0.0:
        return Number(value, None, unit, shown="0")
    if form.endswith("f"):  # no zero with a minus sign
        form = form.replace(".", "z.", 1)
    return Number(value, None, unit, shown=format(value, form))


def value_and_width(value: float, width: float) -> tuple[Cell, Cell]:
    """Return a value and its standard deviation or half width as two cells with equal decimals."""
    if not (math.isfinite(value) and math.isfinite(width) and width > 0.0):
        return formatted(value, ".3g"), formatted(width, ".2g")
    value_text, width_text = value_parts(value, width)
    return Number(value, shown=value_text), Number(width, shown=width_text)


def signs(text: str) -> str:
    """Return a text with typographic signs: ``±``, ``→`` and minus for ``+-``, ``->``, ``-``."""
    text = (
        text.replace("+-", "±")
        .replace("->", "→")
        .replace(" ± ", "\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}")
    )
    text = re.sub(r"(?<![\w.])-(?=[\d.])", "−", text)
    text = re.sub(
        r"(?<=±\N{NO-BREAK SPACE})([\d.e+−-]+) (?=[a-z1(])", "\\1\N{NO-BREAK SPACE}", text
    )
    return _POWER.sub(lambda found: found[0].replace("^", "").translate(_RAISED), text)


_RAISED = str.maketrans("234", "²³⁴")
# Powers of units, where a unit can stand: 1/s2, kg m2, 3 deg2, deg^2, (deg/s)^2; also R2.
_POWER = re.compile(
    r"(?:(?<=/)(?:kg|m|s|ft|g)|(?<=kg )m|(?<=kg )s|(?<=g )s|(?<=\d )(?:deg|rad|m|s|g|ft))"
    r"([234])(?!\w|\.\w)"
    r"|(?<![\w.])R(2)(?!\w|\.\w)"
    r"|(?:(?<=[a-z])|(?<=\)))\^([234])(?!\w|\.\w)"
)


def unit_signs(unit: str) -> str:
    """Return a unit with raised powers: ``m/s²`` for ``m/s2``."""
    return re.sub(r"(?<=[a-z)])\^?[234]\b", lambda found: found[0][-1].translate(_RAISED), unit)


# ---- Sentences of a page from lines of a terminal


def as_sentence(text: str) -> str:
    """Return the text with a capital letter and a full stop."""
    return capital(text) + ("" if text.endswith((".", ":", "?", "!")) else ".")


CAUTION = "Caution: "


def warning_lines(doubts: Iterable[str], cautions: Iterable[str]) -> tuple[str, ...]:
    """Return the warnings of a page: doubts on the files first, then cautions on the results."""
    warnings = [as_warning(doubt) for doubt in doubts]
    warnings += [CAUTION + as_warning(caution) for caution in cautions]
    return tuple(warnings)


def as_warning(text: str) -> str:
    """Return a warning as a sentence. If it ends in a command to copy, it has no full stop."""
    return capital(text) if NEXT in text else as_sentence(text)


def summary_sentences(summary: Summary) -> tuple[str, ...]:
    """Return the main results and the residual of a summary as sentences."""
    residual = f"residual: {summary.residual}" if summary.residual else ""
    return tuple(as_sentence(line) for line in (summary.result, residual) if line)


def capital(text: str) -> str:
    """Return a text with a capital letter, unless it begins with the name of a parameter, an effect
    or a file.
    """
    first_word = text.split(" ", 1)[0].rstrip(".:")
    if any(mark in first_word for mark in "_.:-/"):
        return text
    return text[:1].upper() + text[1:]


# ---- The document of a page

BY_ROW = "by row"  # unit of a column whose rows have different units
# A number in a cell; a name such as 1_2 or nan does not match.
_NUMBER = re.compile(r"[+−-]?(\d+\.?\d*|\.\d+)(e[+−-]?\d{1,2})?[ %]*", re.ASCII)
TONES = ("good", "fair", "open", "plain")  # colours of a verdict


@dataclass(frozen=True)
class Prose:
    """A paragraph.

    Attributes
    ----------
    text : the text.
    kind : ``""``, ``"note"``, ``"value"``, ``"warning"`` or ``"code"``.
    term : bold words before the text.
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
    """Paragraphs that a reader can open below a ``summary``; they are always printed."""

    summary: str
    items: tuple[str, ...]


@dataclass(frozen=True)
class Column:
    """Heading and unit of a column.

    Attributes
    ----------
    heading : heading.
    unit : unit of the numbers: None for words, ``PURE`` for counts and ratios, ``BY_ROW`` if the
        rows have units.
    code : whether the cells are hashes or file names.
    printed : replaces heading and unit in a terminal.
    left, right : alignment in a terminal; by default words are left-aligned, numbers right-aligned.
    beside : keep the column next to the one before it if a terminal splits a wide table.
    together : show values and sigmas in one column of a terminal.
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
    """A table.

    Attributes
    ----------
    caption, columns, rows : caption, columns, and cells of each row.
    units : unit of each row, shown after the first column; may be empty.
    printed : number of rows on paper; None for all.

    Raises
    ------
    ModelError : a row has another number of cells than columns, a number has no unit, or a number
        is given as a text.
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
        for number, row in enumerate(self.rows, start=1):
            if len(row) != len(self.columns):
                raise ModelError(
                    f"row {number} has {len(row)} cells",
                    where=f"table {self.caption!r}",
                    remedy=f"give it {len(self.columns)}",
                )
            for column, cell in zip(self.columns, row, strict=True):
                self._check(column, cell)

    def _check(self, column: Column, cell: Cell) -> None:
        """Raise ModelError for a number without unit or a number as a text."""
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
    """Return a table from columns with their cells; a column None is left out."""
    present = [item for item in columns if item is not None]
    rows = tuple(zip(*(cells for _, cells in present), strict=True))
    return Table(
        caption, tuple(column for column, _ in present), rows, tuple(unit or PURE for unit in units)
    )


@dataclass(frozen=True)
class Figure:
    """A figure.

    Attributes
    ----------
    name : identifier on the page.
    svg : SVG element; its ``aria-label`` describes the figure for screen readers.
    caption : caption.
    plot : data of an interactive figure; None for a figure that is not interactive.
    """

    name: str
    svg: str
    caption: str
    plot: PlotData | None = field(default=None, compare=False)


Block = Prose | Bullets | Fold | Table | Figure


@dataclass(frozen=True)
class Section:
    """A section of a page.

    Attributes
    ----------
    title : heading.
    blocks : content.
    parts : subsections.
    card : draws a frame: ``"claim"``, or ``"hint"`` for a broken frame; empty for none.
    """

    title: str
    blocks: tuple[Block, ...] = ()
    parts: tuple[Section, ...] = ()
    card: str = ""

    @property
    def name(self) -> str:
        """Identifier of the section in the address of the page."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-") or "section"


@dataclass(frozen=True)
class Reproduction:
    """Data to reproduce a study.

    Attributes
    ----------
    commands : command lines.
    versions : version of each program.
    seed : sentence on the seed.
    inputs : use, name and SHA-256 of each input file.
    """

    commands: tuple[str, ...]
    versions: dict[str, str] = field(default_factory=dict)
    seed: str = ""
    inputs: tuple[tuple[str, str, str], ...] = ()


@dataclass(frozen=True)
class Page:
    """A page.

    Attributes
    ----------
    title : title.
    kind : kind of study.
    verdict : one or two words.
    tone : colour of the verdict, of ``TONES``.
    sentence : sentence after the verdict.
    summary : main results, a sentence each.
    warnings : warnings; those that begin with ``CAUTION`` are shown as cautions.
    sections : content.
    reproduction : data to reproduce the study.
    created : time stamp.
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
    """Return a tuple with a section of the blocks that are not empty; an empty tuple if there are
    no such blocks and no ``parts``.
    """
    content = tuple(block for block in blocks if block is not None and not _is_empty(block))
    return (Section(title, content, parts),) if content or parts else ()


def _is_empty(block: Block) -> bool:
    if isinstance(block, Table):
        return not block.rows
    return isinstance(block, Bullets) and not block.items


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


# ---- Reproduction of a study

PROGRAM = "flightid"
_PACKAGES = ("scenarios", PROGRAM)  # packages that ``python -m`` runs as the program


def reproduction(
    usual: Sequence[str], seed: str = "", inputs: Sequence[tuple[str, str, str]] = ()
) -> Reproduction:
    """Return the data to reproduce a study.

    Parameters
    ----------
    usual : words of the command, if the process was not started by a command line.
    seed : sentence on the seed.
    inputs : use, name and SHA-256 of each input file.
    """
    return Reproduction((shlex.join(typed() or usual),), versions(), seed, tuple(inputs))


def typed() -> list[str]:
    """Return the words of the command line of this process, beginning with the program's name;
    empty if another program uses the library.
    """
    program, *words = sys.argv or [""]
    path = Path(program)
    is_module = path.name == "__main__.py" and path.parent.name in _PACKAGES
    is_program = path.stem == PROGRAM or is_module
    return [PROGRAM, *words] if is_program and words else []


def now() -> str:
    """Return the time stamp of a page, UTC."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
