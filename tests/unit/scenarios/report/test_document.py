"""The document: nothing stands in a table without a unit, nothing is lost on the way through
JSON.
"""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from scenarios.report.document import (
    BY_ROW,
    MISSING,
    SIGMAS,
    Block,
    Column,
    Number,
    Page,
    Prose,
    Section,
    Table,
    estimate,
    formatted,
    known,
    section,
    signs,
    table,
    unit_signs,
    value_and_width,
)
from scenarios.report.html import page_content, page_html, page_of
from scenarios.report.quantities import as_text
from scenarios.report.terminal import show_blocks
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


def test_signs_leave_names_alone() -> None:
    assert (
        signs("lag-1 of 1e-3 is -0.5 +- 0.1 -> ok")
        == "lag-1 of 1e-3 is −0.5\N{NO-BREAK SPACE}±\N{NO-BREAK SPACE}0.1 → ok"
    )


def test_powers_of_units_are_raised_and_names_are_not() -> None:
    assert (
        signs("0.33 1/(g s2), 2 kg m2, 3 deg^2 and R2") == "0.33 1/(g s²), 2 kg m², 3 deg² and R²"
    )
    assert signs("m2.csv, data/m2.csv, eta2 and x_2") == "m2.csv, data/m2.csv, eta2 and x_2"
    assert [unit_signs(each) for each in ("m2", "kg/m3", "deg/s2", "1/rad", "1")] == [
        "m²",
        "kg/m³",
        "deg/s²",
        "1/rad",
        "1",
    ]


def test_zero_has_no_minus_sign_and_a_value_the_decimals_of_its_width() -> None:
    assert [formatted(each, "+.1f") for each in (-0.04, 0.26)] == [
        Number(-0.04, shown="+0.0"),
        Number(0.26, shown="+0.3"),
    ]
    assert formatted(0.0, ".3e") == Number(0.0, shown="0")
    assert value_and_width(3.298, 1.4) == (Number(3.298, shown="3.3"), Number(1.4, shown="1.4"))


DOCUMENT: list[Block] = [
    table(
        "estimate",
        (Column("parameter"), ["L", "M", "N"]),
        (
            Column("estimate", BY_ROW),
            [Number(-1.5, 0.1, shown="-1.50", shown_sigma="0.10"), Number(2.0), "not determined"],
        ),
        (Column("delay", "s"), [Number(0.05), MISSING, ""]),
        (Column("error", SIGMAS), [known(1.5, 1, signed=True), MISSING, ""]),
        (Column("both", BY_ROW, together=True), [Number(1.0, 0.25), "", ""]),
        (Column("remark", printed=" "), ["beyond", "", ""]),
        units=["1/s", "", "m"],
    ),
    Prose("a sentence " * 20),
    Prose("a note", "note"),
    table("nothing", (Column("parameter"), [])),
]


def test_a_terminal_shows_units_of_rows_and_sigmas_in_columns_of_their_own() -> None:
    text = as_text(lambda out: show_blocks(out, DOCUMENT))
    title, heads, _, first, second, third, *rest = text.splitlines()
    assert title == "estimate"
    assert heads.split("  ") and " ".join(heads.split()) == (
        "parameter unit estimate +- sigma delay, s error, sigmas both"
    )
    assert " ".join(first.split()) == "L 1/s -1.50 0.10 0.05 +1.5 1.00 +- 0.25 beyond"
    assert second.split() == ["M", "2", "-", "-"]
    assert third.split() == ["N", "m", "not", "determined", "-"]
    assert len(rest) == 4 and rest[-1] == "  a note" and not rest[0].startswith(" ")
    assert text.isascii()


def test_a_page_and_its_json_have_the_same_numbers_in_full() -> None:
    shown = DOCUMENT[0]
    assert isinstance(shown, Table) and shown.units == ("1/s", "1", "m")
    exact = Number(1.0 / 3.0, 0.01)
    page = replace(PAGE, sections=section("one", table("t", (Column("x", "s"), [exact]))))
    assert exact.plain == "0.333 +- 0.010"
    assert f'data-value="{1.0 / 3.0!r}"' in page_html(page)
    assert f'"value": {1.0 / 3.0!r}' in json.dumps(page_content(page))


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
