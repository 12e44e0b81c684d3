"""Printed numbers, lookups, rows and statements on a study that is written by hand."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from exam.reproduction.command import main, run_all, study_in
from exam.reproduction.declaration import (
    Matrix,
    Paper,
    Part,
    Statement,
    Values,
    paper_of,
    printed_of,
    published_of,
)
from exam.reproduction.lookups import Found, Numbers, from_studies, number_in, settling_time
from exam.reproduction.page import page_of, table
from exam.reproduction.rows import Row, cells_of, combined, holds, rows_of, told
from sim.errors import DeclarationError

STUDY = {
    "scenario": "one",
    "files": ["fit.png"],
    "parameters": {
        "a": {"estimate": 2.0, "std": 0.3, "unit": "rad", "true": 1.5},
        "b": {"estimate": -4.0, "std": 0.0, "unit": "1"},
    },
    "derived": {"omega": {"estimate": 3.0, "std": 0.1, "unit": "rad/s"}},
    "correlation": {"names": ["a", "b"], "matrix": [[1.0, -0.9], [-0.9, 1.0]]},
    "variants": [{"name": "x", "misfit": {"q": 7.0}}, {"name": "y", "misfit": {"q": 8.0}}],
    "frequency_response": {"loop_with_flown_L_q": {"M_q": -3.0, "L_q": 1.8}},
    "plain": {"parameters": {"a": {"estimate": 2.5, "std": 0.4}}},
    "methods": {
        "other": {
            "parameters": {"a": {"estimate": 1.6, "std": 0.2, "unit": "rad"}},
            "correlation": {"a": {"b": 0.25}},
        }
    },
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    place = tmp_path / "one"
    place.mkdir()
    (place / "comparison.json").write_text(json.dumps(STUDY))
    (place / "truth.json").write_text('{"airframe": {"a": 0.5}}')
    (place / "fit.png").write_bytes(b"")
    (place / "record.csv").write_text("time,q\n0.0,0.1\n0.5,-0.4\n1.0,0.2\n")
    (place / "history.csv").write_text("time,a,std_a\n0,5,1\n1,2.7,0.5\n2,2.5,0.4\n3,2,0.3\n")
    return place


@pytest.fixture
def numbers(folder: Path) -> Numbers:
    return from_studies(lambda scenario: folder.parent / scenario)


@pytest.mark.parametrize(
    ("lookup", "expected"),
    [
        ("one: a", Found(2.0, 0.3, "rad")),
        ("one: a.true", Found(1.5, None, "rad")),
        ("one: omega", Found(3.0, 0.1, "rad/s")),
        ("one/plain: a", Found(2.5, 0.4)),
        ("one/other: a", Found(1.6, 0.2, "rad")),
        ("one: correlation.b.a", Found(-0.9)),
        ("one/other: correlation.a.b", Found(0.25)),
        ("one: variants.name=y.misfit.q", Found(8.0)),
        ("one: variants.0.misfit.q", Found(7.0)),
        ("one: variants.0.misfit.q^2", Found(49.0)),
        ("one: files.fit.png", Found(1.0)),
        ("one: truth.airframe.a", Found(0.5)),
        ("one: record.q.peak", Found(0.4)),
        ("one: record.rate", Found(2.0, None, "Hz")),
        # Away by more than 0.6 until 1 s, by 0.5 at 2 s.
        ("one: history.settled", Found(1.0, None, "s")),
    ],
)
def test_a_number_is_found_where_it_stands(lookup: str, expected: Found, numbers: Numbers) -> None:
    assert numbers(lookup) == expected


@pytest.mark.parametrize(
    "lookup",
    [
        "one: c",
        "one: a.condensed",
        "one/none: a",
        "one: files.gone.png",
        "one: variants.name=z.misfit.q",
        "one: record.q.low",
    ],
)
def test_a_number_that_is_not_there_is_refused(lookup: str, numbers: Numbers) -> None:
    with pytest.raises(DeclarationError, match="the study has no"):
        numbers(lookup)


def test_a_lookup_of_another_form_is_refused(numbers: Numbers) -> None:
    with pytest.raises(DeclarationError, match="is not STUDY: PATH"):
        numbers("one a")


def test_settling_is_the_last_time_away(folder: Path) -> None:
    assert settling_time(folder / "history.csv", ["a", "absent"]) == 1.0
    assert settling_time(folder / "history.csv", []) == 0.0


def test_printed_numbers() -> None:
    assert printed_of("-0.486e-3 var 0.09", "x").std == 0.3
    assert printed_of("0.140 to 0.146", "x").upper == Decimal("0.146")
    assert [
        printed_of(text, "x").text() for text in ("0.6756 +- 0.01976", "-2.49e-5", "1.2 var 0.04")
    ] == [
        "0.6756 +- 0.01976",
        "-2.49e-5",
        "1.2 +- 0.2",
    ]
    with pytest.raises(DeclarationError, match="is no printed number"):
        printed_of("about 3", "x")


def test_published_signs_are_the_papers() -> None:
    short = paper_of("short_period_dynamics")
    column = published_of(short, "loes.flight")
    assert (column["M_delta"].value, column["L_alpha"].value, column["delta_0"].value) == (
        Decimal("-0.367"),
        Decimal("-2.10"),
        Decimal("0.402"),
    )
    with pytest.raises(DeclarationError, match="there is no column"):
        published_of(short, "loes.nothing")


def paper(**keys: Any) -> Paper:
    parts = [Part(heading="Table 1: x", **keys)]
    return Paper(
        schema="flightid/reproduction/1",
        title="t",
        source="s",
        about="a",
        published="short_period_dynamics",
        turned=["b"],
        parts=parts,
    )


def row(
    numbers: Numbers,
    true: dict[str, str] | None = None,
    misprints: dict[str, str] | None = None,
    **keys: Any,
) -> Row:
    """The row of one printed number."""
    group = Values(label="l", study=keys.pop("study", "one"), **keys)
    (found,) = rows_of(
        paper(), Part(heading="h", true=true or {}, misprints=misprints or {}), group, numbers
    )
    return found


def test_a_difference_is_over_the_root_of_both_variances(numbers: Numbers) -> None:
    # 1 over hypot(0.3, 0.4)
    assert row(numbers, printed={"a": "3.0 +- 0.4"}).sigmas == pytest.approx(-2.0)
    assert row(numbers, printed={"a": "1.7"}).sigmas == pytest.approx(1.0)
    assert row(numbers, printed={"a": "1.7 to 1.9"}).difference == "+0.3"
    assert row(numbers, printed={"a": "1.9 to 2.1"}).difference == "inside"
    # its sign is turned, and neither has a sigma
    assert row(numbers, printed={"b": "2.0"}, why="w").difference == "+100.0 %"
    assert row(numbers, printed={"a": "1"}, compare="ratio", why="w").difference == "x 2"
    assert (
        row(
            numbers,
            printed={"a.b": "0.95"},
            path="correlation.{name}",
            compare="difference",
            why="w",
        ).difference
        == "-0.05"
    )
    degrees = row(numbers, printed={"a": "114"}, unit="deg")
    assert degrees.ours == "115 +- 17"
    assert degrees.sigmas == pytest.approx(
        (math.degrees(2.0) - 114.0) / math.degrees(0.3), abs=1e-4
    )


def test_distance_from_the_reference_is_in_the_sigmas_of_each(numbers: Numbers) -> None:
    found = row(numbers, printed={"a": "2.0 +- 0.1"}, true={"a": "1.5"}, reference="true")
    assert (found.true, found.off) == ("1.5", "+5.0; +1.7")
    assert (
        row(numbers, printed={"M_q": "1.9"}, path="a", reference="loop_equivalent", why="w").off
        == "no sigma; +16.7"
    )
    # as it is flown
    assert (
        row(
            numbers, printed={"L_q": "1.9"}, path="a", reference="loop_equivalent", why="w"
        ).reference
        == "1.8"
    )
    assert (
        row(
            numbers, printed={"L_0": "1.9"}, path="a", reference="loop_equivalent", why="w"
        ).reference
        == "none"
    )


def test_that_the_reference_is_found_is_a_reason_only_where_the_row_shows_it(
    numbers: Numbers,
) -> None:
    keys: dict[str, Any] = {
        "printed": {"a": "5.0 +- 0.1"},
        "true": {"a": "1.5"},
        "reference": "true",
        "found": "found",
        "why": "not explained",
    }
    assert row(numbers, **keys).why == "found"  # 1.7 sigmas from its own truth
    assert row(numbers, **{**keys, "reasons": {"a": "another"}}).why == "found"
    far: dict[str, Any] = {
        "printed": {"M_q": "9.0"},
        "path": "a",
        "reference": "loop_equivalent",
        "found": "found",
        "why": "not explained",
    }
    assert row(numbers, **far).why == "not explained"  # 16.7 sigmas from it


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"printed": {"a": "3.5"}}, "sigmas and no reason"),
        ({"printed": {"a": "2.0"}, "compare": "ratio"}, "no reason"),
        ({"printed": {"a": "2.0"}, "reasons": {"c": "w"}}, "no row c"),
        ({"published": "loes.flight", "names": ["x"]}, "no x is published"),
        ({"printed": {"a": "2.0"}, "true": {"b": "1"}}, "no true value is declared"),
        ({"printed": {"a": "2.0"}, "true": {"a": "1.4"}}, "flown 1.5"),
        ({"printed": {"a": "2.0"}, "true": {"a": "1.5"}, "misprints": {"a": "w"}}, "flown 1.5"),
        ({"printed": {"a": "2.0"}, "zero": ["b"]}, "b of ours is not zero"),
    ],
)
def test_a_row_that_says_too_little_is_refused(
    keys: dict[str, Any], message: str, numbers: Numbers
) -> None:
    with pytest.raises(DeclarationError, match=message):
        row(numbers, **keys)


def statement(**keys: Any) -> Statement:
    return Statement(
        **({"place": "p", "says": "s", "ours": "o", "agrees": "yes", "why": "w"} | keys)
    )


def test_a_statement_tells_its_numbers(numbers: Numbers) -> None:
    found = told(
        statement(
            ours="{a:.1f} {r:.0%} {b:size}",
            numbers={"a": "one: a", "r": "one: a.std over one: a", "b": "one: b"},
        ),
        numbers,
    )
    assert found.ours == "2.0 15% 4"
    assert combined("one: a minus one/other: a", numbers).value == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"ours": "{c}"}, "in braces"),
        ({"figure": "one/gone.png"}, "the study has no files"),
        ({"numbers": {"a": "one: a"}, "holds": ["a < 1"]}, "a < 1 does not hold"),
        ({"holds": ["a < 1"]}, "there is no number 'a'"),
        ({"holds": ["a is 1"]}, "is no condition"),
    ],
)
def test_a_statement_that_does_not_follow_is_refused(
    keys: dict[str, Any], message: str, numbers: Numbers
) -> None:
    with pytest.raises(DeclarationError, match=message):
        told(statement(**keys), numbers)


def test_conditions() -> None:
    assert (
        holds("|a| > 2", {"a": -3.0})
        and not holds("a > 2", {"a": -3.0})
        and holds("a < b", {"a": -3.0, "b": 1.0})
        and holds("a < -2.5", {"a": -3.0})
    )


def test_a_matrix_has_the_cases_signs(numbers: Numbers) -> None:
    matrix = Matrix(label="m", study="one", names=["a", "b"], upper=["0.8"], why="w")
    cells = cells_of(matrix, ["b"], numbers)
    assert cells.ours["a", "b"] == 0.9
    assert cells.rms == pytest.approx(0.1)
    with pytest.raises(DeclarationError, match="2 entries, 1 are due"):
        cells_of(
            Matrix(label="m", study="one", names=["a", "b"], upper=["0.8 0.9"], why="w"),
            [],
            numbers,
        )


def test_a_page_of_one_row(numbers: Numbers) -> None:
    group = Values(label="by hand", study="one", printed={"a": "2.1 +- 0.4"}, note="A note.")
    text = page_of(
        [paper(values=[group], statements=[statement(figure="one/fit.png")], units="rad")], numbers
    )
    assert "**By hand**: ours is `one`. A note.\n\n| quantity | printed | ours | Δ | why |" in text
    assert "| `a` | 2.1 +- 0.4 | 2.00 +- 0.30 | -0.2 | within two sigmas |" in text
    assert (
        "1 rows of numbers: 1 within two sigmas, 0 beyond, 0 not compared" in text
        and "| p | s | `one/fit.png` | o | yes | w |" in text
    )
    with pytest.raises(DeclarationError, match="an empty cell beside x"):
        table(["one", "two"], [["x", " "]])


@pytest.mark.long
def test_what_lies_in_the_folder_is_not_run_again_and_must_be_the_study(folder: Path) -> None:
    assert study_in(folder.parent, "one") == folder
    (folder.parent / "two").mkdir()
    (folder.parent / "two" / "comparison.json").write_text(json.dumps(STUDY))
    with pytest.raises(DeclarationError, match="the study of one lies there"):
        study_in(folder.parent, "two")
    with pytest.raises(DeclarationError, match="there is no scenario 'three'"):
        study_in(folder.parent, "three")
    assert [*run_all(folder.parent, ["one"], 2)] == ["one"]


@pytest.mark.parametrize(
    "make",
    [
        lambda page: ["--kept", "--page", str(page)],
        lambda page: ["--page", str(page), "--studies", str(page.parent / "s")],
    ],
)
def test_what_is_at_fault_is_one_line_and_exit_code_2(
    make: Callable[[Path], list[str]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*arguments: Any) -> Any:
        raise DeclarationError("it cannot be", where="here", remedy="change it")

    monkeypatch.setattr("exam.reproduction.command.run_all", refuse)
    assert main(make(tmp_path / "papers.md")) == 2
    captured = capsys.readouterr()
    assert captured.out == "" and len(captured.err.splitlines()) == 1
    with pytest.raises(SystemExit):
        main(["--jobs", "0"])


def test_a_number_of_a_folder_has_no_other_form(folder: Path) -> None:
    with pytest.raises(LookupError):
        number_in(folder, "", "files.record.png")
