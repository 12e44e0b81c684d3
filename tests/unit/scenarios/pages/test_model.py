"""The document: nothing stands in a table without a unit, nothing is lost on the way through
JSON.
"""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from scenarios.pages.folder import page_content, page_of
from scenarios.pages.model import (
    BY_ROW,
    Column,
    Number,
    Page,
    Section,
    Table,
    estimate,
    known,
    read_cell,
    section,
    signs,
)
from scenarios.pages.tables import printed_blocks, rows_table
from scenarios.terminal.tables import TableColumn as Printed
from scenarios.terminal.tables import print_paragraph, print_table
from sim.errors import ModelError
from tests.pages import PAGE


def test_page_goes_through_json_and_back() -> None:
    assert page_of(json.loads(json.dumps(page_content(PAGE)))) == PAGE
    for broken in (
        {},
        {**page_content(PAGE), "schema": "flightid/comparison/1"},
        {**page_content(PAGE), "sections": [{"title": 1}]},
    ):
        with pytest.raises((KeyError, TypeError, ValueError)):
            page_of(broken)


@pytest.mark.parametrize(
    ("columns", "row", "units", "told"),
    [
        ((Column("name"), Column("value")), ("a", Number(1.0)), (), "has no unit"),
        ((Column("name"), Column("value", BY_ROW)), ("a", Number(1.0)), (), "has no unit"),
        ((Column("name"), Column("value", "m")), ("a", "1.5"), (), "stands as a word"),
        ((Column("name"), Column("value", "m")), ("a", "−2 %"), (), "stands as a word"),
        ((Column("name"), Column("value", "m")), ("a",), (), "row 1 has 1 cells"),
        (
            (Column("name"), Column("value", BY_ROW)),
            ("a", Number(1.0)),
            ("m", "s"),
            "as many units as rows",
        ),
    ],
)
def test_number_without_a_unit_is_refused(
    columns: tuple[Column, ...], row: tuple, units: tuple[str, ...], told: str
) -> None:
    with pytest.raises(ModelError, match=told):
        Table("t", columns, (row,), units)


def test_number_with_a_unit_of_its_own_its_column_or_its_row_is_taken() -> None:
    Table("t", (Column("name"), Column("value")), (("a", Number(1.0, unit="m")),))
    Table("t", (Column("name"), Column("value", "1")), (("a", Number(1.0)),))
    Table("t", (Column("name"), Column("value", BY_ROW)), (("a", Number(1.0)),), ("m",))
    Table("t", (Column("hash", code=True),), (("12",),))


def test_nothing_that_is_not_finite_is_a_number() -> None:
    for value, sigma in ((float("nan"), None), (float("inf"), None), (1.0, float("nan"))):
        with pytest.raises(ModelError, match="not finite"):
            Number(value, sigma)
        assert estimate(value, sigma) == "not determined"
    assert known(None) == known(float("inf")) == "–" and estimate(1.0, 5e3) == "not determined"


@pytest.mark.parametrize(
    ("number", "text"),
    [
        (Number(-1.65702, 0.0018), "−1.6570 ± 0.0018"),
        (Number(1.9, None, "rad/s"), "1.9 rad/s"),
        (Number(2.5, digits=2, signed=True), "+2.50"),
        (Number(3.0, 0.5, digits=1), "3.0 ± 0.5"),
        (Number(7.0, unit="1"), "7"),
    ],
)
def test_numbers_have_the_digits_of_their_sigma(number: Number, text: str) -> None:
    assert number.text.replace("\N{NO-BREAK SPACE}", " ") == text


@pytest.mark.parametrize(
    ("text", "value", "sigma", "unit"),
    [
        ("-1.6570 +- 0.0018", -1.657, 0.0018, ""),
        ("+12.5 %", 12.5, None, "%"),
        ("-2.0 sigma *", -2.0, None, "σ"),
        ("<1e-300", 1e-300, None, ""),
        ("over +900 %", 900.0, None, "%"),
        ("0.3 (bound)", 0.3, None, ""),
        ("0.97*", 0.97, None, ""),
        ("0.126 deg/s", 0.126, None, "deg/s"),
    ],
)
def test_printed_numbers_are_numbers_again(
    text: str, value: float, sigma: float | None, unit: str
) -> None:
    cell = read_cell(text)
    assert isinstance(cell, Number) and (cell.value, cell.sigma, cell.unit) == (value, sigma, unit)


@pytest.mark.parametrize(
    "text",
    [
        "not determined",
        "1 to 5 %",
        "level 1 (97 %)",
        "3 of 10",
        "x29-flight",
        "2-sigma",
        "lag-1",
        "1_2",
        "nan",
        "inf",
        "1e400",
    ],
)
def test_words_stay_words(text: str) -> None:
    assert read_cell(text) == text
    assert rows_table("records", ("record", "fit %"), [(text, "97.1")]).rows[0] == (
        text,
        read_cell("97.1"),
    )


def test_signs_leave_names_alone() -> None:
    assert (
        signs("lag-1 of 1e-3 is -0.5 +- 0.1 -> ok")
        == "lag-1 of 1e-3 is −0.5\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.1 → ok"
    )


def test_what_is_printed_is_heard_with_units_and_sigmas() -> None:
    columns = [
        Printed("parameter", ["L", "M"], left=True),
        Printed("unit", ["1/s", ""], left=True),
        Printed("estimate", ["-1.50", "2"]),
        Printed("+- sigma", ["0.10", "-"]),
        Printed("delay, s", ["0.05", "-"]),
        Printed("error, sigmas", ["+1.5", ""]),
        Printed("", ["beyond", ""], left=True),
    ]

    def show(out) -> None:
        print_table(out, "estimate", columns)
        print_paragraph(out, "a sentence " * 40)
        out.print()
        print_table(out, "nothing", [Printed("parameter", [])])

    table, prose = printed_blocks(show)
    assert isinstance(table, Table) and table.units == ("1/s", "1")
    assert [(c.heading, c.unit) for c in table.columns] == [
        ("parameter", None),
        ("estimate", BY_ROW),
        ("delay", "s"),
        ("error", "σ"),
        ("remark", None),
    ]
    assert table.rows[0][1] == Number(
        -1.5, 0.1, shown="−1.50\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.10"
    )
    assert table.rows[1][1:] == (Number(2.0, shown="2"), "–", "", "")
    assert getattr(prose, "text", "").lower().count("a sentence") == 40


def test_known_units_are_taken_by_row_and_by_heading() -> None:
    table = rows_table(
        "t",
        ("state", "L", "final"),
        [("q", "1.0", "2.0"), ("other", "3", "4")],
        units={"q": "rad/s", "L": "1/s"},
    )
    assert table.units == ("rad/s", "1") and [c.unit for c in table.columns] == [
        None,
        "1/s",
        BY_ROW,
    ]


def test_sections_without_content_are_left_out() -> None:
    assert section("empty", None, Table("t", (Column("a"),), ())) == ()
    assert (
        Section("Simulation error on x.csv (held out)").name == "simulation-error-on-x-csv-held-out"
    )
    with pytest.raises(ModelError, match="no tone"):
        replace(PAGE, tone="loud")
    assert isinstance(PAGE, Page)


@pytest.mark.parametrize(("value", "text"), [(0.0, "+0.00"), (0.2, "+0.20"), (-0.2, "−0.20")])
def test_a_signed_number_has_a_sign_at_zero_as_well(value: float, text: str) -> None:
    assert Number(value, digits=2, signed=True).text == text
    assert Number(value, digits=2).text == text.lstrip("+")
