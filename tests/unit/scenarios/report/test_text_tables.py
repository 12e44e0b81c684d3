"""Tables and paragraphs in terminals of any width: whatever is printed is read back whole, no line
runs past the edge without need.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from ident.tracing.diagnosis import Verdict
from scenarios.diagnosis.text import diagnosis_text
from scenarios.report.summary import (
    WIDTH,
    TableColumn,
    columns_of,
    folded,
    print_paragraph,
    print_table,
    shortened,
    table_lines,
    wrapped,
)
from scenarios.studies.campaign import CampaignRuns, Spread
from scenarios.studies.campaign_report import print_campaign
from tests.diagnoses import spread_tracing, tracing_of
from tests.printed_tables import closed, read_back

NUMBER = st.floats(-1e9, 1e9).map(lambda value: f"{value:.6g}") | st.floats(1e-4, 1.0).map(
    lambda s: f"{10 * s:.4f} +- {s:.4f}"
)
WORD = st.sampled_from(
    [
        "",
        "converged",
        "sensor-lag:alpha",
        "at its bound",
        "like vane-offset, unmeasured-input",
        "0.061 +- 0.002 s, start 17.976 s",
    ]
)
WIDTHS = st.sampled_from([40, 80, 120, WIDTH])


@st.composite
def tables(draw: st.DrawFn) -> list[TableColumn]:
    count, rows = draw(st.integers(1, 9)), draw(st.integers(1, 5))
    kinds = draw(st.lists(st.booleans(), min_size=count, max_size=count))
    cells = [
        draw(st.lists(WORD if left else NUMBER, min_size=rows, max_size=rows)) for left in kinds
    ]
    names = TableColumn("parameter", [f"Cm_alpha_{i}" for i in range(rows)], left=True)
    return [
        names,
        *(
            TableColumn(f"heading {i} of it", each, left=left)
            for i, (left, each) in enumerate(zip(kinds, cells, strict=True))
        ),
    ]


def on_console(width: int, title: str, columns: list[TableColumn]) -> list[str]:
    out = Console(file=io.StringIO(), width=width, markup=False, no_color=True)
    print_table(out, title, columns)
    assert isinstance(out.file, io.StringIO)
    return out.file.getvalue().splitlines()


@given(tables(), WIDTHS)
@settings(max_examples=80)
def test_what_is_printed_is_read_back_and_every_number_is_whole(
    columns: list[TableColumn], width: int
) -> None:
    lines = table_lines(columns, width=width)
    found = read_back(lines)
    assert found == {
        closed([column.heading]): [closed([cell]) for cell in column.cells] for column in columns
    }
    printed = re.split(r"\s\s+|\n", "\n".join(lines))
    for column in columns:
        for cell in column.cells:
            for number in (
                re.findall(r"\d[\d.e+-]*(?: \+- [\d.]+)?", cell)
                if not column.left or "+-" in cell
                else ()
            ):
                assert any(number in part for part in printed), number
    assert all(len(line) <= width for line in lines), (
        "two columns of this size fit any of these terminals"
    )
    assert on_console(width, "", columns) == lines


def rounds(rows: Sequence[tuple[str, str, str, str]]) -> list[TableColumn]:
    """Return columns of a table of rounds, whose last column holds words."""
    *first, remarks = columns_of(("round", "candidate", "gain", "remarks"), rows, 2)
    return [*first, replace(remarks, left=True)]


def test_a_table_that_fits_is_one_block_with_numbers_at_the_right() -> None:
    rows = [("1", "sensor-lag:alpha", "420.0", "like vane-offset"), ("2", "saturation", "9.3", "")]
    lines = table_lines(rounds(rows), title="a title [1]")
    assert lines[0] == "a title [1]" and len(lines) == 5
    assert lines[3].index("420.0") + 5 == lines[4].index("9.3") + 3, "numbers end in one column"
    assert lines[3].index("sensor") == lines[4].index("saturation")
    assert table_lines(columns_of(("a",), [])) == []
    assert on_console(120, "a title [1]", columns_of(("a", "b"), [("1", "2")]))[0] == "a title [1]"


def test_a_name_longer_than_its_column_is_parted_behind_a_colon_or_a_hyphen() -> None:
    rows = [
        ("1", "guard:drifting-derivatives:side_force", "7.0", "x" * 40),
        ("2", "a", "8.0", "b c d " * 9),
    ]
    lines = table_lines(rounds(rows), width=85)[2:]
    assert [line.split()[:2] for line in lines[:2]] == [
        ["1", "guard:drifting-derivatives:"],
        ["side_force"],
    ]


def test_blocks_begin_with_the_columns_that_name_the_row() -> None:
    columns = columns_of(
        ("round", "candidate", "gain", "p"), [("1", "lag", "123456789.0", "1e-300")] * 2, left=2
    )
    text = "\n".join(table_lines(columns, width=30, keys=2))
    assert text.count("candidate") == 2 and text.count("123456789.0") == 2


@pytest.mark.parametrize("width", [40, 80, 120])
def test_a_campaign_is_whole_in_a_narrow_terminal(width: int) -> None:
    spreads = [
        Spread(name, "1/rad", -34.75, -0.0712345, 0.0031, 0.0029, 0.683, 0.954, (0.158, 1.0))
        for name in ("Cm_alpha", "Cm_q")
    ]
    named: Any = SimpleNamespace(name="rigid", label="output error")
    out = Console(file=io.StringIO(), width=width, markup=False, no_color=True)
    nothing = np.zeros((2, 2))
    seeds, kept, row = np.array([1, 2]), np.ones(2, dtype=bool), np.zeros(2)
    names = ("Cm_alpha", "Cm_q")
    print_campaign(
        CampaignRuns(
            named,
            named,
            1,
            seeds,
            names,
            nothing,
            nothing,
            kept,
            tuple(spreads),
            spreads[0],
            2,
            row,
            row,
            row,
            named,
            {},
        ),
        out,
    )
    assert isinstance(out.file, io.StringIO)
    text = out.file.getvalue()
    assert all(len(line) <= width for line in text.splitlines())
    for cell in ("reference", "-34.75", "-0.0712", "0.0031", "0.0029", "95.4 %", "15.8", "100.0"):
        assert cell in text, cell


@pytest.mark.sampled
@pytest.mark.parametrize("width", [80, 100, WIDTH])
def test_a_diagnosis_fits_its_terminal(width: int) -> None:
    for tracing in (spread_tracing(), *(tracing_of(verdict) for verdict in Verdict)):
        assert max(len(line) for line in diagnosis_text(tracing, width).splitlines()) <= width


@pytest.mark.parametrize("width", [40, 80, 200])
def test_paragraphs_are_folded_at_words_and_keep_brackets(width: int) -> None:
    out = Console(file=io.StringIO(), width=width, markup=False, no_color=True)
    text = "the unit is [own] and " + "seven sigmas off " * 20
    print_paragraph(out, text, indent=2)
    assert isinstance(out.file, io.StringIO)
    lines = out.file.getvalue().splitlines()
    assert all(line.startswith("  ") and len(line) <= min(width, 100) for line in lines)
    assert " ".join(" ".join(lines).split()) == " ".join(text.split())


@given(st.integers(12, 60))
def test_a_quantity_is_never_torn(width: int) -> None:
    text = "alpha is late by 0.061 +- 0.002 s and the pitch rate is read 3.4 deg/s too small"
    for lines in (folded(text, width), wrapped(text, width), [shortened(text, width)]):
        told = "\n".join(lines)
        assert "0.061" not in told or "0.061 +- 0.002 s" in told
        assert "3.4" not in told or "3.4 deg/s" in told
    assert (
        len(shortened(text, width)) <= width
        and shortened(text, 200, "outcome  ") == f"outcome  {text}"
    )


def test_a_paragraph_moves_its_further_lines_in_and_a_path_stays_whole() -> None:
    assert wrapped("one two three", 10) == ["one two", "  three"] and wrapped("") == []
    assert shortened("/a/long/path/to/report.html and more", 12) == "/a/long/path/to/report.html"
