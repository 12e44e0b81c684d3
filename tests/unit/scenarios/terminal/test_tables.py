"""Tables and paragraphs in terminals of any width: no number is cut, no line runs past the edge."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from scenarios.terminal.rich_tables import Column, print_paragraph, print_table

NAMES = [f"parameter_{i}" for i in range(3)]
NUMBERS = {
    heading: [f"{sign}{i}.2345e-0{k}" for i, sign in enumerate(("", "-", "+"))] for k, heading in enumerate(("true", "estimate", "error, sigmas"))
}
FURTHER = {"published": ["1.0", "2.0", ""], "off, own sigmas": ["+111.4", "-0.5", ""]}


def printed(width: int) -> list[str]:
    out = Console(file=io.StringIO(), width=width, markup=False, no_color=True)
    columns = [Column("parameter", NAMES, left=True), *(Column(heading, cells) for heading, cells in NUMBERS.items())]
    print_table(out, "a title [1]", columns, [Column(heading, cells) for heading, cells in FURTHER.items()])
    assert isinstance(out.file, io.StringIO)
    return out.file.getvalue().splitlines()


@pytest.mark.parametrize(("width", "framed", "tables"), [(120, True, 1), (70, False, 1), (50, False, 2)])
def test_every_number_is_whole_at_any_width(width: int, framed: bool, tables: int) -> None:
    lines = printed(width)
    text = "\n".join(lines)
    assert "a title [1]" in text
    assert all(len(line) <= width for line in lines)
    for cells in (*NUMBERS.values(), *FURTHER.values()):
        assert all(cell in text for cell in cells)
    assert ("│" in text) is framed
    assert sum(NAMES[0] in line for line in lines) == tables


def test_numbers_stand_at_the_right_and_names_at_the_left() -> None:
    for width in (120, 50):
        rows = [line for line in printed(width) if "parameter_" in line and "e-00" in line]
        ends = {line.index("e-00") for line in rows}
        assert len(rows) == 3 and len(ends) == 1
        assert len({line.index("parameter_") for line in rows}) == 1


@pytest.mark.parametrize("width", [40, 80, 200])
def test_paragraphs_are_folded_at_words_and_keep_brackets(width: int) -> None:
    out = Console(file=io.StringIO(), width=width, markup=False, no_color=True)
    text = "the unit is [own] and " + "seven sigmas off " * 20
    print_paragraph(out, text, indent=2)
    assert isinstance(out.file, io.StringIO)
    lines = out.file.getvalue().splitlines()
    assert all(line.startswith("  ") and len(line) <= min(width, 100) for line in lines)
    assert " ".join(" ".join(lines).split()) == " ".join(text.split())
