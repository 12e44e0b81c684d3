"""Tables, paragraphs and summary lines that fit a terminal; levels of flying qualities in words."""

from __future__ import annotations

import math
import re
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from ident.flying_qualities.levels import STANDARD, WORST_LEVEL, FlightPhase, ModeLevel
from ident.statistics.residuals import ResidualTest
from scenarios.report.quantities import (
    derived_line,
    determined,
    in_hertz,
    number_text,
    shown_in,
    spaced,
)

if TYPE_CHECKING:
    from rich.console import Console

# ---- Paragraphs that fit a terminal

WIDTH = 118  # columns where the output is no terminal, and the most that a wide one is used
TEXT_WIDTH = 100  # width of a paragraph; longer lines are hard to read
_FIXED = "\N{NO-BREAK SPACE}"
# Blanks that must not break: before a sigma or unit, after a comparison sign.
_JOINED = re.compile(
    r" (?=(?:\+-|[<>=]) [\d.-])|(?<=\+-|[ (][<>=]) (?=[\d.-])|(?<=\d) "
    r"(?=(?:deg|rad|s|ms|Hz|m|g|kg|N|Pa|%)(?![A-Za-z]))"
)


def terminal_width() -> int:
    """Return the columns that a print may use."""
    return (
        min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns - 1)
        if sys.stdout.isatty()
        else WIDTH
    )


def folded(text: str, width: int, first: str = "", further: str = "") -> list[str]:
    """Return a text in lines of ``width`` characters; a longer word gets its own line."""
    lines = textwrap.wrap(
        _JOINED.sub(_FIXED, text),
        max(width, 1),
        initial_indent=first,
        subsequent_indent=further,
        break_on_hyphens=False,
        break_long_words=False,
    )
    return [line.replace(_FIXED, " ") for line in lines] or [first]


def wrapped(text: str, width: int = WIDTH, indent: str = "") -> list[str]:
    """Return a paragraph folded at words, with further lines indented; empty without text."""
    return folded(text, width, indent, indent + "  ") if text else []


def shortened(text: str, width: int, label: str = "") -> str:
    """Return one line of ``width`` characters after ``label``, with dots for what has no room:
    whole clauses if they fill most of it, else whole words.
    """
    limit = max(width - len(label), 1)
    clause = text.rfind("; ", 0, limit - 3)
    if len(text) > limit and clause > 0.75 * limit:
        return f"{label}{text[:clause]}; ..."
    words = _JOINED.sub(_FIXED, text)
    first = words.split(" ")[0]
    if len(first) > limit:  # paths are not shortened
        return label + first.replace(_FIXED, " ")
    lines = textwrap.wrap(
        words,
        limit,
        break_on_hyphens=False,
        break_long_words=False,
        max_lines=1,
        placeholder=" ...",
    )
    return label + (lines[0] if lines else "").replace(_FIXED, " ")


def print_lines(out: Console, lines: Sequence[str]) -> None:
    """Print lines without folding."""
    for line in lines:
        out.print(line, highlight=False, markup=False, soft_wrap=True)


NEXT = "; next: "  # before the command that a caution leads to


def print_caution(out: Console, text: str) -> None:
    """Print a sentence folded at words, and the command after ``NEXT`` on one line, to copy."""
    told, found, command = text.partition(NEXT)
    print_paragraph(out, f"{told}; next:" if found else told, 0)
    if found:
        print_lines(out, [f"  {command}"])


def print_paragraph(out: Console, text: str, indent: int = 2) -> None:
    """Print a text folded at words, within the console and ``TEXT_WIDTH``, moved in by ``indent``
    columns.
    """
    margin = " " * indent
    print_lines(out, folded(text, min(out.width - 1, TEXT_WIDTH), margin, margin))


# ---- Tables

INDENT = "  "
GAP = "  "  # between columns
LEAST_WIDTH = 24  # characters below which a column of words is not folded
# where a long name may be parted: never within a number
_PARTS = re.compile(r"(?<=[A-Za-z][:-])(?=[A-Za-z])")


@dataclass(frozen=True)
class TableColumn:
    """A heading and its cells, all of the same length within a table.

    Numbers are right-aligned. ``left``: words, left-aligned, may be folded. ``beside``: never
    separated from the column before it.
    """

    heading: str
    cells: Sequence[str]
    left: bool = False
    beside: bool = False


def columns_of(
    headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1, words: Sequence[str] = ()
) -> list[TableColumn]:
    """Return the columns of a table given by rows.

    Left-aligned are the first ``left`` columns and those with a heading in ``words``.
    """
    return [
        TableColumn(head, [row[i] for row in rows], left=i < left or head in words)
        for i, head in enumerate(headings)
    ]


def table_lines(
    columns: Sequence[TableColumn], *, title: str = "", width: int = WIDTH, keys: int = 1
) -> list[str]:
    """Return a table as lines no longer than ``width`` characters if that can be; nothing if there
    is no row.

    ``keys``: how many of the first columns begin every block.
    """
    if not columns or not columns[0].cells:
        return []
    lines = wrapped(title, width) if title else []
    for number, block in enumerate(_blocks(columns, width, keys)):
        lines += ([""] if number else []) + _block(block, width)
    return lines


def print_table(out: Console, title: str, columns: Sequence[TableColumn]) -> None:
    """Print a table on a console, as wide as that is, its title bold."""
    lines = table_lines(columns, width=out.width)
    for line in wrapped(title, out.width) if title and lines else ():
        out.print(line, style="bold", highlight=False, markup=False, soft_wrap=True)
    print_lines(out, lines)


def _blocks(columns: Sequence[TableColumn], width: int, keys: int) -> list[list[TableColumn]]:
    """Columns of each block: as many as fit when they are folded as far as they may be."""
    first, groups = list(columns[:keys]), list[list[TableColumn]]()
    for column in columns[keys:]:
        if column.beside and groups:
            groups[-1].append(column)
        else:
            groups.append([column])
    blocks = [list(first)]
    for group in groups:
        if (
            len(blocks[-1]) > keys
            and _total([_least(each) for each in (*blocks[-1], *group)]) > width
        ):
            blocks.append(list(first))
        blocks[-1] += group
    return blocks


def _block(columns: Sequence[TableColumn], width: int) -> list[str]:
    sizes = _sizes(columns, width)
    heads = [folded(column.heading, size) for column, size in zip(columns, sizes, strict=True)]
    deepest = max(map(len, heads))
    lines = [
        _line(columns, sizes, [("",) * (deepest - len(head)) + tuple(head) for head in heads], k)
        for k in range(deepest)
    ]
    lines.append(INDENT + GAP.join("-" * size for size in sizes))
    for cells in zip(*(column.cells for column in columns), strict=True):
        parts = [
            _cell(cell, size) if column.left else [cell]
            for column, cell, size in zip(columns, cells, sizes, strict=True)
        ]
        lines += [_line(columns, sizes, parts, k) for k in range(max(map(len, parts)))]
    return lines


def _line(
    columns: Sequence[TableColumn], sizes: Sequence[int], parts: Sequence[Sequence[str]], k: int
) -> str:
    shown = [part[k] if k < len(part) else "" for part in parts]
    placed = zip(columns, shown, sizes, strict=True)
    return (
        INDENT
        + GAP.join(
            text.ljust(size) if column.left else text.rjust(size) for column, text, size in placed
        )
    ).rstrip()


def _sizes(columns: Sequence[TableColumn], width: int) -> list[int]:
    """Widths with which the columns fit: words folded first, then headings, the widest first, none
    below its least.
    """
    sizes = [max(len(text) for text in (column.heading, *column.cells)) for column in columns]
    least = [_least(column) for column in columns]
    headed = [max(small, len(column.heading)) for small, column in zip(least, columns, strict=True)]
    for floors in (headed, least):
        while (over := _total(sizes) - width) > 0:
            wide = [i for i, floor in enumerate(floors) if sizes[i] > floor]
            if not wide:
                break
            widest = max(wide, key=lambda i: sizes[i])
            second = max((sizes[i] for i in wide if i != widest), default=0)
            sizes[widest] = max(
                floors[widest], sizes[widest] - over, min(second, sizes[widest] - 1)
            )
    return sizes


def _total(sizes: Sequence[int]) -> int:
    return len(INDENT) + sum(sizes) + len(GAP) * (len(sizes) - 1)


def _least(column: TableColumn) -> int:
    """Return the least width of a column.

    Words of its heading and numbers are not broken; other words only beyond ``LEAST_WIDTH``.
    """
    heading = _widest_word(column.heading)
    if not column.left:
        return max(heading, *map(len, column.cells))
    natural = max(map(len, column.cells))
    unbroken = max(
        len(part)
        for cell in column.cells
        for word in folded(cell, 1)
        for part in _PARTS.split(word)
    )
    return max(heading, unbroken, min(LEAST_WIDTH, natural))


def _widest_word(heading: str) -> int:
    return max(map(len, folded(heading, 1)), default=0)


def _cell(text: str, size: int) -> list[str]:
    """Return a cell of words on as many lines as it takes; a name too long for its column is parted
    after a colon or a hyphen.
    """
    if len(text) <= size:
        return [text]
    words = [_parted(word, size) if len(word) > size else word for word in text.split(" ")]
    return folded(" ".join(words), size)


def _parted(word: str, size: int) -> str:
    lines = [""]
    for part in _PARTS.split(word):
        if lines[-1] and len(lines[-1]) + len(part) > size:
            lines.append("")
        lines[-1] += part
    return " ".join(lines)


# ---- Levels of flying qualities in words and for JSON

LEAST_NAMED_PROBABILITY = 0.01  # least probability of a level that is named
QUANTITIES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {
        "damping_ratio": ("damping ratio", ""),
        "natural_frequency": ("frequency", "rad/s"),
        "control_anticipation": ("control anticipation", "1/(g s2)"),
        "load_factor_slope": ("n/alpha", "g/rad"),
        "phugoid_damping": ("damping ratio", ""),
        "phugoid_time_to_double": ("time to double", "s"),
        "dutch_roll_damping": ("damping ratio", ""),
        "dutch_roll_damping_rate": ("damping ratio times frequency", "rad/s"),
        "dutch_roll_frequency": ("frequency", "rad/s"),
        "roll_time_constant": ("time constant", "s"),
        "spiral_time_to_double": ("time to double", "s"),
        "roll_spiral_damping_rate": ("damping ratio times frequency", "rad/s"),
        "delay": ("delay", "s"),
    }
)


def level_text(level: ModeLevel) -> str:
    """Return ``"level 1 (97 %)"``, or the possible levels if these data do not decide."""
    if level.determined:
        return f"{_named(level.level)} ({_percent(level.probability)})"
    shares = sorted(
        (
            (share, number)
            for number, share in enumerate(level.probabilities, start=1)
            if share >= LEAST_NAMED_PROBABILITY
        ),
        reverse=True,
    )
    return (
        "not determined "
        f"({', '.join(f'{_named(number)} {_percent(share)}' for share, number in shares)})"
    )


def level_sentence(level: ModeLevel) -> str:
    """Return the mode, its level, and the limit that it fails for the next better level."""
    why = limit_text(level)
    return f"{level.mode} {level_text(level)}{f': {why}' if why else ''}"


def limit_text(level: ModeLevel) -> str:
    """Return the reason why the estimate does not reach the next better level; empty at level 1."""
    if not level.decided_by:
        return ""
    words, unit = QUANTITIES[level.decided_by]
    least, spaced = (
        "at least" if level.value < level.limit else "at most",
        f" {unit}" if unit else "",
    )
    value = f"{level.value:.3g}{spaced}" if math.isfinite(level.value) else "none"
    return f"{words} {value}, asked {least} {level.limit:.3g}{spaced}"


def levels_heading(flown: FlightPhase) -> str:
    """Return the standard, class and category, and what of them nobody declared."""
    classes = (
        f"; class {flown.aircraft_class} is for medium weight: I is light, III large, IV a fighter"
        if "class" in flown.assumed
        else ""
    )
    assumed = (
        f" ({' and '.join(flown.assumed)} assumed, as neither an option (--class, --category) nor "
        f"the vehicle file gives it{classes})"
        if flown.assumed
        else ""
    )
    return f"levels by {STANDARD}, class {flown.aircraft_class}, category {flown.category}{assumed}"


def levels_line(
    levels: Sequence[ModeLevel], flown: FlightPhase, tests: Sequence[ResidualTest]
) -> str:
    """Return all levels in one line; empty if the model has no mode with a standard.

    Probabilities follow from the sigmas. If a residual test fails, the line says that they do not
    include model error.
    """
    if flown.uncrewed_mass is not None:
        return (
            f"no levels of flying qualities: {STANDARD} is for crewed aircraft, and the mass is "
            f"{flown.uncrewed_mass:.3g} kg; --class gives them all the same"
        )
    if not levels:
        return ""
    doubted = (
        ""
        if all(test.passed for test in tests)
        else ", not valid here: the residual shows that the model is incomplete"
    )
    return f"{levels_heading(flown)}{doubted}: {'; '.join(map(level_sentence, levels))}"


def levels_content(levels: Sequence[ModeLevel], flown: FlightPhase) -> dict[str, Any]:
    """Return level and probability of each mode for a JSON file, finite numbers only."""
    return {
        "standard": STANDARD,
        "class": flown.aircraft_class,
        "category": flown.category,
        "assumed": list(flown.assumed),
        "modes": {level.mode: _content(level) for level in levels},
    }


def changes(before: Sequence[ModeLevel], after: Sequence[ModeLevel]) -> list[str]:
    """Return ``"the Dutch roll was level 2 (99 %), is level 1 (97 %)"`` for each changed level."""
    new = {level.mode: level for level in after}
    pairs = [(old, new[old.mode]) for old in before if old.mode in new]
    return [
        f"the {old.mode} was {level_text(old)}, is {level_text(now)}"
        for old, now in pairs
        if old.determined and now.determined and old.level != now.level
    ]


def _named(number: int) -> str:
    return "below level 3" if number == WORST_LEVEL else f"level {number}"


def _percent(share: float) -> str:
    if share >= 0.9995:
        return "> 99.9 %"
    return f"{100.0 * share:.1f} %" if share >= 0.99 else f"{100.0 * share:.0f} %"


def _content(level: ModeLevel) -> dict[str, Any]:
    out: dict[str, Any] = {
        "level": level.level,
        "probability": level.probability,
        "determined": level.determined,
        "probabilities": list(level.probabilities),
        "sources": list(level.sources),
    }
    if level.decided_by and math.isfinite(level.value):
        out |= {
            "decided_by": {
                "quantity": level.decided_by,
                "estimate": level.value,
                "limit": level.limit,
            }
        }
    return out


# ---- The summary that every study begins with

MOST_NAMED_NUMBERS = 3  # numbers that a summary names
# of many coefficients those that a reader asks for, not the constant of drag
NAMED_FIRST = ("CL_alpha", "Cm_alpha", "Cm_q")
BELOW = "below; --out FOLDER keeps them"
PAGE = "report.html"  # in the folder of every study
TEXT = "study.txt"  # terminal output and details
HERE = "below, and the files of this folder"


@dataclass(frozen=True)
class Summary:
    """Summary of a study: input, outcome, main numbers, residual, place of details."""

    study: str
    outcome: str
    result: str = ""
    residual: str = ""
    details: str = BELOW


def summary_lines(summary: Summary, width: int = WIDTH) -> list[str]:
    """Return a line for each non-empty part; shortened ones are repeated in full below."""
    return [shortened(text, width, f"{label:10}") for label, text in vars(summary).items() if text]


def print_summary(out: Console, summary: Summary) -> None:
    """Print the summary, and an empty line."""
    print_lines(out, [*summary_lines(summary, out.width), ""])


def details_in(folder: Path | None) -> str:
    """Return where more details are: below, and in the study's folder, beginning with its page."""
    return BELOW if folder is None else f"below; in {folder / PAGE}"


def written_to(folder: Path) -> str:
    """Return the last line of a command that wrote a study."""
    return f"written to {folder}; begin with {folder / PAGE}"


def value_phrase(name: str, value: float, std: float, unit: str) -> str:
    """``"Cm_alpha -1.657 +- 0.002 1/rad"``, in the unit for display."""
    if std > 0.0 and not determined(value, std):
        return f"{name} not determined"
    factor, text = shown_in(unit, name)
    sigma = f" +- {number_text(factor * std, factor * std)}" if std > 0.0 else ""
    return (
        f"{name} "
        f"{number_text(factor * value, factor * std)}{sigma}{spaced(text)}{in_hertz(value, name, unit)}"  # noqa: E501
    )


def result_phrase(
    values: Sequence[tuple[str, float, float, str]], derived: Mapping[str, tuple[float, float]]
) -> str:
    """Return the quantities that follow from the parameters, if any, and parameters (name, value,
    sigma, unit), ``MOST_NAMED_NUMBERS`` in all: ``NAMED_FIRST`` and then in their order.
    """
    values = sorted(values, key=lambda each: each[0] not in NAMED_FIRST)
    follows = derived_line(dict(list(derived.items())[:MOST_NAMED_NUMBERS]))
    room = MOST_NAMED_NUMBERS - min(len(derived), MOST_NAMED_NUMBERS)
    named = [value_phrase(*each) for each in values[:room]]
    rest = len(values) - room
    more = f"; {rest} more in the table" if named and rest > 0 else ""
    return "; ".join([*([follows] if follows else []), *named]) + more


def residual_phrase(tests: Sequence[ResidualTest]) -> str:
    """``"consistent with noise in alpha and nz; not in q"``; empty if nothing was tested."""
    channels = list(dict.fromkeys(test.channel.partition(",")[0] for test in tests))
    failed = [
        name
        for name in channels
        if any(not test.passed and test.channel.partition(",")[0] == name for test in tests)
    ]
    sound = [name for name in channels if name not in failed and name != "all"]
    if not failed:
        return f"consistent with noise in {_listed(sound)}" if sound else ""
    named = [name for name in failed if name != "all"]
    phrase = f"more than noise in {_listed(named)}" if named else "not consistent with noise"
    return f"{phrase}; consistent with noise in {_listed(sound)}" if sound and named else phrase


def _listed(words: Sequence[str]) -> str:
    return " and ".join([", ".join(words[:-1]), words[-1]]) if len(words) > 1 else "".join(words)
