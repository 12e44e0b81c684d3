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
    listed,
    number_text,
    shown_in,
    spaced,
)

if TYPE_CHECKING:
    from rich.console import Console

# ---- Paragraphs that fit a terminal

WIDTH = 118  # characters of a line if the output is not a terminal, and at most in a terminal
TEXT_WIDTH = 100  # characters of a line of a paragraph; longer lines are hard to read
CLAUSE_SHARE = 0.75  # share of a line that whole clauses fill, else it is shortened at words
_FIXED = "\N{NO-BREAK SPACE}"
# Blanks at which lines do not break: before a sigma or unit, after a comparison sign.
_JOINED = re.compile(
    r" (?=(?:\+-|[<>=]) [\d.-])|(?<=\+-|[ (][<>=]) (?=[\d.-])|(?<=\d) "
    r"(?=(?:deg|rad|s|ms|Hz|m|g|kg|N|Pa|%)(?![A-Za-z]))"
)


def terminal_width() -> int:
    """Return the number of characters in a line of the terminal, at most ``WIDTH``."""
    if not sys.stdout.isatty():
        return WIDTH
    return min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns - 1)


def folded(text: str, width: int, first: str = "", further: str = "") -> list[str]:
    """Return a text in lines of ``width`` characters; a longer word has a line of its own.

    ``first`` and ``further`` are the indents of the first and of the other lines.
    """
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
    """Return ``label`` and text in one line of ``width`` characters.

    A longer text is cut after a clause or, if clauses would leave much of the line empty, after a
    word. Dots follow.
    """
    limit = max(width - len(label), 1)
    clause_end = text.rfind("; ", 0, limit - 3)
    if len(text) > limit and clause_end > CLAUSE_SHARE * limit:
        return f"{label}{text[:clause_end]}; ..."
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


NEXT = "; next: "  # stands before the command with which a caution ends


def print_caution(out: Console, text: str) -> None:
    """Print a caution folded at words; print the command after ``NEXT`` on one line, to copy."""
    sentence, separator, command = text.partition(NEXT)
    print_paragraph(out, f"{sentence}; next:" if separator else sentence, 0)
    if separator:
        print_lines(out, [f"  {command}"])


_CLAUSE_ENDS = re.compile(r"[;.](?= )")
LONGEST_BEFORE = 2 * TEXT_WIDTH - 20  # characters of a warning before the result: two lines


def first_clauses(sentence: str) -> tuple[str, str]:
    """Return the beginning of a warning, which stands before the result, and the rest of it.

    The beginning has whole clauses and at most ``LONGEST_BEFORE`` characters, and the command that
    is to be typed next. The rest is empty if the whole warning is that short.

    Examples
    --------
    >>> first_clauses("the record is short")
    ('the record is short', '')
    """
    told, _, command = sentence.partition(NEXT)
    following = f"{NEXT}{command}" if command else ""
    ends = [match.start() for match in _CLAUSE_ENDS.finditer(told)]
    fitting = [end for end in ends if end <= LONGEST_BEFORE]
    if len(told) <= LONGEST_BEFORE or not ends:
        return sentence, ""
    end = fitting[-1] if fitting else ends[0]
    return f"{told[:end]}{following}", told[end + 1 :].strip()


def print_paragraph(out: Console, text: str, indent: int = 2) -> None:
    """Print a text folded at words, in lines of at most ``TEXT_WIDTH``, with an indent."""
    margin = " " * indent
    print_lines(out, folded(text, min(out.width - 1, TEXT_WIDTH), margin, margin))


# ---- Tables

INDENT = "  "  # before each line
GAP = "  "  # between columns
LEAST_WIDTH = 24  # characters; narrower columns of words are not folded
# A long name may be split after a colon or hyphen between letters, so never within a number.
_PARTS = re.compile(r"(?<=[A-Za-z][:-])(?=[A-Za-z])")


@dataclass(frozen=True)
class TableColumn:
    """A column of a table.

    Attributes
    ----------
    heading : heading.
    cells : texts of the cells, one for each row.
    left : whether the cells are words: left-aligned, and folded if the table is too wide. Else
        they are numbers: right-aligned.
    beside : whether the column stays next to the one before it if a wide table is split.
    """

    heading: str
    cells: Sequence[str]
    left: bool = False
    beside: bool = False


def columns_of(
    headings: Sequence[str], rows: Sequence[Sequence[str]], left: int = 1
) -> list[TableColumn]:
    """Return the columns of a table given by rows; the first ``left`` are left-aligned."""
    return [
        TableColumn(heading, [row[i] for row in rows], left=i < left)
        for i, heading in enumerate(headings)
    ]


def table_lines(
    columns: Sequence[TableColumn], *, title: str = "", width: int = WIDTH, keys: int = 1
) -> list[str]:
    """Return a table as lines of at most ``width`` characters, if possible; empty without rows.

    A wide table is split into blocks of columns. Each block begins with the first ``keys`` columns.
    """
    if not columns or not columns[0].cells:
        return []
    lines = wrapped(title, width) if title else []
    for number, block in enumerate(_blocks(columns, width, keys)):
        if number:
            lines.append("")
        lines += _block_lines(block, width)
    return lines


def print_table(out: Console, title: str, columns: Sequence[TableColumn]) -> None:
    """Print a table with the width of a console and a bold title."""
    lines = table_lines(columns, width=out.width)
    for line in wrapped(title, out.width) if title and lines else ():
        out.print(line, style="bold", highlight=False, markup=False, soft_wrap=True)
    print_lines(out, lines)


def _blocks(columns: Sequence[TableColumn], width: int, keys: int) -> list[list[TableColumn]]:
    """Return the columns of each block: as many as fit with their least widths."""
    first, groups = list(columns[:keys]), list[list[TableColumn]]()
    for column in columns[keys:]:
        if column.beside and groups:
            groups[-1].append(column)
        else:
            groups.append([column])
    blocks = [list(first)]
    for group in groups:
        total = _total_width([_least_width(column) for column in (*blocks[-1], *group)])
        if len(blocks[-1]) > keys and total > width:
            blocks.append(list(first))
        blocks[-1] += group
    return blocks


def _block_lines(columns: Sequence[TableColumn], width: int) -> list[str]:
    """Return heading, rule and rows of a block."""
    widths = _widths(columns, width)
    headings = [folded(column.heading, size) for column, size in zip(columns, widths, strict=True)]
    height = max(map(len, headings))
    headings = [[""] * (height - len(heading)) + heading for heading in headings]
    lines = [_line(columns, widths, headings, k) for k in range(height)]
    lines.append(INDENT + GAP.join("-" * size for size in widths))
    for cells in zip(*(column.cells for column in columns), strict=True):
        texts = [
            _folded_cell(cell, size) if column.left else [cell]
            for column, cell, size in zip(columns, cells, widths, strict=True)
        ]
        lines += [_line(columns, widths, texts, k) for k in range(max(map(len, texts)))]
    return lines


def _line(
    columns: Sequence[TableColumn], widths: Sequence[int], texts: Sequence[Sequence[str]], k: int
) -> str:
    """Return line ``k`` of a row whose cells are folded into the lines ``texts``."""
    cells = []
    for column, lines, width in zip(columns, texts, widths, strict=True):
        text = lines[k] if k < len(lines) else ""
        cells.append(text.ljust(width) if column.left else text.rjust(width))
    return (INDENT + GAP.join(cells)).rstrip()


def _widths(columns: Sequence[TableColumn], width: int) -> list[int]:
    """Return widths of the columns with which the table fits, if possible.

    First cells are folded, then headings. The widest column is always folded first.
    """
    widths = [max(len(text) for text in (column.heading, *column.cells)) for column in columns]
    least = [_least_width(column) for column in columns]
    least_with_heading = [
        max(smallest, len(column.heading)) for smallest, column in zip(least, columns, strict=True)
    ]
    for limits in (least_with_heading, least):
        while (excess := _total_width(widths) - width) > 0:
            wide = [i for i, limit in enumerate(limits) if widths[i] > limit]
            if not wide:
                break
            widest = max(wide, key=lambda i: widths[i])
            second = max((widths[i] for i in wide if i != widest), default=0)
            widths[widest] = max(
                limits[widest], widths[widest] - excess, min(second, widths[widest] - 1)
            )
    return widths


def _total_width(widths: Sequence[int]) -> int:
    return len(INDENT) + sum(widths) + len(GAP) * (len(widths) - 1)


def _least_width(column: TableColumn) -> int:
    """Return the least width of a column.

    Numbers and the words of a heading are not split; other words only beyond ``LEAST_WIDTH``.
    """
    heading = max(map(len, folded(column.heading, 1)))
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


def _folded_cell(text: str, width: int) -> list[str]:
    """Return the lines of a cell of words; a name that is too long is split after a colon or a
    hyphen.
    """
    if len(text) <= width:
        return [text]
    words = [_split_name(word, width) if len(word) > width else word for word in text.split(" ")]
    return folded(" ".join(words), width)


def _split_name(name: str, width: int) -> str:
    """Return a name with blanks between parts of at most ``width`` characters, if possible."""
    lines = [""]
    for part in _PARTS.split(name):
        if lines[-1] and len(lines[-1]) + len(part) > width:
            lines.append("")
        lines[-1] += part
    return " ".join(lines)


# ---- Levels of flying qualities in words and for JSON

LEAST_NAMED_PROBABILITY = 0.01  # least probability of a level that is named
QUANTITIES: Mapping[str, tuple[str, str]] = MappingProxyType(
    {  # quantity of a requirement -> its name in words, unit
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
    """Return ``"level 1 (97 %)"``, or the possible levels if the data do not determine it."""
    if level.determined:
        return f"{_level_name(level.level)} ({_percent(level.probability)})"
    possible = sorted(
        (
            (probability, number)
            for number, probability in enumerate(level.probabilities, start=1)
            if probability >= LEAST_NAMED_PROBABILITY
        ),
        reverse=True,
    )
    texts = [f"{_level_name(number)} {_percent(probability)}" for probability, number in possible]
    return f"not determined ({', '.join(texts)})"


def level_sentence(level: ModeLevel) -> str:
    """Return the mode, its level, and the limit of the next better level that it misses."""
    limit = limit_text(level)
    sentence = f"{level.mode} {level_text(level)}"
    return f"{sentence}: {limit}" if limit else sentence


def limit_text(level: ModeLevel) -> str:
    """Return the reason why the estimate does not reach the next better level; empty at level 1."""
    if not level.decided_by:
        return ""
    words, unit = QUANTITIES[level.decided_by]
    comparison = "at least" if level.value < level.limit else "at most"
    unit_text = f" {unit}" if unit else ""
    value = f"{level.value:.3g}{unit_text}" if math.isfinite(level.value) else "none"
    return f"{words} {value}, asked {comparison} {level.limit:.3g}{unit_text}"


def levels_heading(flown: FlightPhase) -> str:
    """Return the standard, class and category, and which of these are assumed."""
    heading = f"levels by {STANDARD}, class {flown.aircraft_class}, category {flown.category}"
    if not flown.assumed:
        return heading
    assumption = (
        f"{' and '.join(flown.assumed)} assumed, as neither an option (--class, --category) nor "
        "the vehicle file gives it"
    )
    if "class" in flown.assumed:
        assumption += (
            f"; class {flown.aircraft_class} is for medium weight: I is light, III large, IV a "
            "fighter"
        )
    return f"{heading} ({assumption})"


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
    heading = levels_heading(flown)
    if not all(test.passed for test in tests):
        heading += ", not valid here, because the residual shows that the model is incomplete"
    return f"{heading}: {'; '.join(map(level_sentence, levels))}"


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
    new_levels = {level.mode: level for level in after}
    pairs = [(old, new_levels[old.mode]) for old in before if old.mode in new_levels]
    return [
        f"the {old.mode} was {level_text(old)}, is {level_text(new)}"
        for old, new in pairs
        if old.determined and new.determined and old.level != new.level
    ]


def _level_name(number: int) -> str:
    return "below level 3" if number == WORST_LEVEL else f"level {number}"


def _percent(probability: float) -> str:
    """Return a probability in per cent, with a decimal from 99 % on."""
    if probability >= 0.9995:  # rounded to 100.0 %
        return "> 99.9 %"
    decimals = 1 if probability >= 0.99 else 0
    return f"{100.0 * probability:.{decimals}f} %"


def _content(level: ModeLevel) -> dict[str, Any]:
    content: dict[str, Any] = {
        "level": level.level,
        "probability": level.probability,
        "determined": level.determined,
        "probabilities": list(level.probabilities),
        "sources": list(level.sources),
    }
    if level.decided_by and math.isfinite(level.value):
        content["decided_by"] = {
            "quantity": level.decided_by,
            "estimate": level.value,
            "limit": level.limit,
        }
    return content


# ---- Summary at the top of every study

MOST_NAMED_NUMBERS = 3  # numbers in a summary
NAMED_FIRST = ("CL_alpha", "Cm_alpha", "Cm_q")  # the main derivatives come first in a summary
BELOW = "below; --out FOLDER keeps them"  # place of the details without a study folder
HERE = "below, and the files of this folder"  # place of the details in a study folder
PAGE = "report.html"  # page in the folder of every study
TEXT = "study.txt"  # terminal output in this folder


@dataclass(frozen=True)
class Summary:
    """Summary of a study.

    Attributes
    ----------
    study : what was studied.
    outcome : outcome.
    result : main numbers.
    residual : result of the residual tests.
    details : place of the details.
    """

    study: str
    outcome: str
    result: str = ""
    residual: str = ""
    details: str = BELOW


def summary_lines(summary: Summary, width: int = WIDTH) -> list[str]:
    """Return a line for each part that is not empty, shortened to ``width`` characters."""
    return [shortened(text, width, f"{label:10}") for label, text in vars(summary).items() if text]


def print_summary(out: Console, summary: Summary) -> None:
    """Print the summary, and an empty line."""
    print_lines(out, [*summary_lines(summary, out.width), ""])


def details_in(folder: Path | None) -> str:
    """Return the place of the details: below, and in a study folder."""
    return BELOW if folder is None else f"below; in {folder / PAGE}"


def written_to(folder: Path) -> str:
    """Return the last line of a command that wrote a study."""
    return f"written to {folder}; begin with {folder / PAGE}"


def value_phrase(name: str, value: float, std: float, unit: str) -> str:
    """Return an estimate in display units: ``"Cm_alpha -1.657 +- 0.002 1/rad"``."""
    if std > 0.0 and not determined(value, std):
        return f"{name} not determined"
    factor, shown_unit = shown_in(unit, name)
    phrase = f"{name} {number_text(factor * value, factor * std)}"
    if std > 0.0:
        phrase += f" +- {number_text(factor * std, factor * std)}"
    return f"{phrase}{spaced(shown_unit)}{in_hertz(value, name, unit)}"


def result_phrase(
    values: Sequence[tuple[str, float, float, str]], derived: Mapping[str, tuple[float, float]]
) -> str:
    """Return the main numbers of a study, ``MOST_NAMED_NUMBERS`` in all.

    Derived quantities are first, then the parameters ``NAMED_FIRST``, then others.

    Parameters
    ----------
    values : name, value, sigma and unit of each parameter.
    derived : value and sigma of each derived quantity.
    """
    values = sorted(values, key=lambda entry: entry[0] not in NAMED_FIRST)
    derived_phrase = derived_line(dict(list(derived.items())[:MOST_NAMED_NUMBERS]))
    count = MOST_NAMED_NUMBERS - min(len(derived), MOST_NAMED_NUMBERS)
    phrases = [value_phrase(*entry) for entry in values[:count]]
    not_named = len(values) - count
    more = f"; {not_named} more in the table" if phrases and not_named > 0 else ""
    if derived_phrase:
        phrases.insert(0, derived_phrase)
    return "; ".join(phrases) + more


def residual_phrase(tests: Sequence[ResidualTest]) -> str:
    """Return in words which channels have residuals that are noise; empty without tests."""
    channels = list(dict.fromkeys(test.channel.partition(",")[0] for test in tests))
    failed = {test.channel.partition(",")[0] for test in tests if not test.passed}
    white = [name for name in channels if name not in failed and name != "all"]
    if not failed:
        return f"consistent with noise in {listed(white)}" if white else ""
    coloured = [name for name in channels if name in failed and name != "all"]
    if not coloured:
        return "not consistent with noise"
    phrase = f"more than noise in {listed(coloured)}"
    return f"{phrase}; consistent with noise in {listed(white)}" if white else phrase
