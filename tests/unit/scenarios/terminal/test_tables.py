"""Tables and paragraphs in terminals of any width: no number is cut, no line runs past the edge."""

from __future__ import annotations

import io
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from scenarios.studies.campaign import Campaign, Spread
from scenarios.studies.campaign_text import print_campaign
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


@pytest.mark.parametrize("width", [80, 120])
def test_a_campaign_is_whole_in_a_narrow_terminal(width: int) -> None:
    spreads = [Spread(name, "1/rad", -34.75, -0.0712345, 0.0031, 0.0029, 0.683, 0.954, (0.158, 1.0)) for name in ("Cm_alpha", "Cm_q")]
    named: Any = SimpleNamespace(name="rigid", label="output error")
    out = Console(file=io.StringIO(), width=width, markup=False, no_color=True)
    nothing = np.zeros((2, 2))
    print_campaign(Campaign(named, named, range(1, 3), ("Cm_alpha", "Cm_q"), nothing, nothing, 0, tuple(spreads), spreads[0]), out)
    assert isinstance(out.file, io.StringIO)
    text = out.file.getvalue()
    assert "…" not in text and all(len(line) <= width for line in text.splitlines())
    for cell in ("reference", "-34.75", "-0.0712", "0.0031", "0.0029", "95.4 %", "15.8 to 100.0 %", "68.3 %"):
        assert cell in text, cell


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
