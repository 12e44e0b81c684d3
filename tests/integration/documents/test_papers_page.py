"""docs/papers.md is what its declarations and its numbers make of it; what it says is printed is
printed; what it names exists.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator
from decimal import Decimal
from functools import cache
from itertools import groupby
from pathlib import Path

import pytest

from exam.reproduction.command import PAGE, make, scenarios_of, written
from exam.reproduction.declaration import PAPERS, Paper, paper_of
from exam.reproduction.lookups import Found, from_file, kept_text, split
from exam.reproduction.page import WIDTH
from scenarios.studies.catalogue import load_document, scenario_names
from sim.errors import DeclarationError
from tests.oracles import papers_print as print_
from tests.oracles.printed_tables import numbers_of, one_line, section

ROOT = Path(__file__).parents[3]
SHARED = ROOT.parent / "shared" / "seeds"
TEXTS = {
    "simulated_flight_data": "001_b775f3398d78c939.txt",
    "short_period_dynamics": "000_56b834f8104b08bf.txt",
}
STATEMENT = {"place", "says", "ours", "agrees", "why"}


@cache
def page() -> str:
    return (ROOT / PAGE).read_text(encoding="utf-8")


@cache
def paper(name: str) -> Paper:
    return paper_of(name)


@cache
def kept() -> dict[str, tuple[float, float | None, str]]:
    return dict(
        json.loads((ROOT / PAGE).with_suffix(".json").read_text(encoding="utf-8"))["numbers"]
    )


Row = dict[str, str]


def tables(name: str) -> Iterator[tuple[str, str, list[Row]]]:
    """Every table of a paper on the page: the heading of its part, the bold words above it (empty
    where there are none), its rows.
    """
    titles = [paper(each).title for each in PAPERS]
    text = (
        page()
        .split(f"\n## {paper(name).title}\n")[1]
        .split("\n## " + titles[(titles.index(paper(name).title) + 1) % 2] + "\n")[0]
    )
    part = label = ""
    for is_table, group in groupby(text.splitlines(), key=lambda line: line.startswith("|")):
        lines = list(group)
        if is_table:
            heads, _, *rows = (
                [cell.strip() for cell in line.strip("|").split(" | ")] for line in lines
            )
            yield part, label, [dict(zip(heads, row, strict=True)) for row in rows]
            label = ""
            continue
        for line in lines:
            part = line.removeprefix("### ") if line.startswith("### ") else part
            label = found[1] if (found := re.match(r"\*\*(.+?)\*\*", line)) else label


def values(name: str) -> Iterator[tuple[str, str, str, str]]:
    """Every printed number: part, label of its group in small letters, quantity, cell. A row for
    several quantities is several.
    """
    for part, label, rows in tables(name):
        for row in rows:
            if "printed" in row:
                whose = row["ours is"].partition(": `")[0] if "ours is" in row else label
                yield from (
                    (part, whose.lower(), quantity, row["printed"])
                    for quantity in re.findall(r"`([^`]+)`", row["quantity"])
                )


def test_the_page_is_what_its_numbers_make_of_it() -> None:
    """A word, a row or a reason that changes in a declaration, and a page that was not made again,
    are found here.
    """
    text, asked = written(from_file((ROOT / PAGE).with_suffix(".json")))
    assert text == page(), "python -m exam papers-page --kept"
    assert asked.keys() == kept().keys(), "make the page again: python -m exam papers-page"


@pytest.mark.parametrize("name", PAPERS)
def test_no_cell_is_empty_and_rows_fit(name: str) -> None:
    count = 0
    for part, label, rows in tables(name):
        for row in rows:
            count += 1
            assert all(cell for head, cell in row.items()), (part, label, row)
            numbers = " | ".join(
                cell for head, cell in row.items() if head not in ("why", "ours is", "quantity")
            )
            assert "printed" not in row or (len(numbers) <= 100 and len(row["why"]) <= 75), (
                part,
                row,
            )
    assert count > 100
    assert max(len(line) for line in page().splitlines() if not line.startswith("|")) <= WIDTH


def test_every_study_that_is_named_exists() -> None:
    known, methods = scenario_names(), {}
    for name in scenarios_of(paper(each) for each in PAPERS):
        assert name in known
        document, _, _ = load_document(name)
        loop = document.get("kind") == "x29"
        further = [
            each if isinstance(each, str) else each["name"] for each in document.get("methods", [])
        ]
        methods[name] = {"", *(["plain"] if loop else []), *further}
        if not loop:
            starts = [
                document["estimate"].get("start", {}),
                *(method.get("start", {}) for method in document.get("methods", [])),
            ]
            assert {
                split(key)[2]
                for key, (_, std, _) in kept().items()
                if split(key)[0] == name and std
            } <= {
                *(parameter for start in starts for parameter in start),
                "natural_frequency",
                "damping_ratio",
            }
    assert {key for key in kept() if split(key)[1] not in methods[split(key)[0]]} == set()


def leaves(table: object, name: str = "") -> Iterator[tuple[str, Decimal]]:
    """Every printed value of a file of published numbers, its quantity before it."""
    if isinstance(table, dict):
        if isinstance(table.get("value"), Decimal):
            yield name, abs(table["value"])
        for key, entry in table.items():
            yield from leaves(entry, key)


@pytest.mark.parametrize("name", PAPERS)
def test_every_published_number_is_on_the_page(name: str) -> None:
    shown = {(quantity, abs(print_.numbers_in(cell)[0])) for _, _, quantity, cell in values(name)}
    published = {
        *leaves(
            tomllib.loads(
                (ROOT / f"scenarios/studies/published/{name}.toml").read_text(encoding="utf-8"),
                parse_float=Decimal,
            )
        )
    }
    assert len(published) > 30
    assert published - shown == set()


def test_the_first_papers_numbers_are_those_of_the_second_copy() -> None:
    copy, seen, true = print_.first_paper(), set(), print_.true_values()
    for part, label, quantity, cell in values("simulated_flight_data"):
        column = next(
            key
            for key in copy
            if part.startswith(f"{key.split(': ')[0]}:")
            and label.startswith(key.split(": ")[1].lower())
        )
        assert tuple(print_.numbers_in(cell)) == copy[column][quantity], (column, quantity)
        seen.add((column, quantity))
    assert seen == {(column, quantity) for column, cells in copy.items() for quantity in cells}
    for _, _, rows in tables("simulated_flight_data"):
        for row in rows:
            if "true" in row:
                assert print_.numbers_in(row["true"])[0] == true[row["quantity"].strip("`")]
    assert (
        sum(
            cell == "0.0025, flown -0.032"
            for _, _, rows in tables("simulated_flight_data")
            for row in rows
            for cell in row.values()
        )
        == 4
    )


TEXT = {
    ("flight, by the filter", "delay"): "0.140 0.146",
    ("flight, range of the damping ratio by the filter", "damping_ratio"): "0.84 0.92",
    ("flight, by frequency response", "damping_ratio"): "1.05",
    ("flight, by frequency response", "delay"): "0.120",
    ("how it is sampled and searched", "record.rate"): "40",
    ("how it is sampled and searched", "bank.delays.0"): "0",
    ("how it is sampled and searched", "bank.delays.1"): "0.025",
    ("how it is sampled and searched", "bank.delays.8"): "0.200",
}


def expected(part: str, label: str, quantity: str) -> tuple[str, list[Decimal]]:
    """Where the copy of the second paper has a row of the page, and what it should show; a sigma
    with two digits of a variance's root.
    """
    copy, table = print_.second_paper(), part[:7]
    if (label, quantity) in TEXT:
        return "text", [Decimal(word) for word in TEXT[label, quantity].split()]
    if quantity in ("natural_frequency", "damping_ratio"):
        column = "simulation" if table == "Table 1" or label == "simulation" else "flight"
        return "headings", [Decimal(print_.HEADINGS[column][quantity == "damping_ratio"])]
    if "correlations" in part:
        return "correlations", [
            next(r for a, b, r in print_.correlations(table) if {a, b} == {*quantity.split(".")})
        ]
    if label.startswith("measurement noise"):
        return "noise", [Decimal(print_.NOISE[table].split()[["alpha", "q", "nz"].index(quantity)])]
    title = next(
        (
            key
            for key in copy
            if key.startswith(table) and label.startswith(key.split(": ")[1].lower())
        ),
        f"{table}: final estimate",
    )
    out: list[Decimal] = [copy[title][quantity]]
    if title.endswith("final estimate"):
        out.append(Decimal(f"{float(copy[f'{table}: final variance'][quantity]) ** 0.5:.2g}"))
    return title, out


def test_the_second_papers_numbers_are_those_of_the_second_copy() -> None:
    seen = set()
    for part, label, quantity, cell in values("short_period_dynamics"):
        title, wanted = expected(part, label, quantity)
        assert print_.numbers_in(cell) == wanted, (part, label, quantity)
        seen.add((title, quantity))
    copy = print_.second_paper()
    assert {
        (title, name)
        for title, cells in copy.items()
        for name in cells
        if "final variance" not in title
    } <= seen


@pytest.mark.parametrize("table", print_.LOWER)
def test_correlations_are_those_of_the_second_copy(table: str) -> None:
    (matrix,) = (
        m
        for part in paper("short_period_dynamics").parts
        if part.heading.startswith(f"{table}: ")
        for m in part.matrices
    )
    declared = {
        (a, b): Decimal(entry)
        for i, (a, line) in enumerate(zip(matrix.names, matrix.upper, strict=False))
        for b, entry in zip(matrix.names[i + 1 :], line.split(), strict=True)
    }
    assert declared == {(a, b): r for a, b, r in print_.correlations(table)}
    (rows,) = (
        rows
        for part, label, rows in tables("short_period_dynamics")
        if part.startswith(f"{table}: ") and "1" in rows[0]
    )
    for (a, b), r in declared.items():
        i, j = matrix.names.index(a), matrix.names.index(b)
        assert abs(Decimal(rows[i][str(j + 1)]) - r) <= Decimal("0.005"), (a, b)


# Figures and tables that each paper has, by its captions.
CAPTIONS = {
    "simulated_flight_data": (tuple(range(1, 6)), (*range(1, 16), 18)),
    "short_period_dynamics": (tuple(range(1, 4)), tuple(range(1, 11))),
}


@pytest.mark.parametrize("name", PAPERS)
def test_every_table_and_figure_of_the_paper_has_its_rows(name: str) -> None:
    tables_, figures = CAPTIONS[name]
    headings = [part.heading for part in paper(name).parts]
    assert all(any(heading.startswith(f"Table {n}:") for heading in headings) for n in tables_)
    places = [
        s.place for part in paper(name).parts for s in part.statements if s.place.startswith("Fig")
    ]
    assert sorted(int(n) for place in places for n in re.findall(r"\d+", place)) == sorted(figures)
    assert any(heading == "Conclusions" for heading in headings)


# What the reading has not: some powers of ten, written apart; L_delta of Table 1, which stands in
# Table 3.
NOT_READ = {
    ("Table 1: final estimate", "delta"),
    ("Table 1: final estimate", "L_delta"),
    ("Table 1: process noise", "q"),
    ("Table 2: final variance", "q"),
}


@pytest.mark.skipif(not SHARED.is_dir(), reason="the papers' text is not here")
def test_the_second_copy_is_in_the_papers_text() -> None:
    first, second = ((SHARED / TEXTS[name]).read_text(encoding="utf-8") for name in PAPERS)
    numbers = {abs(number) for number in numbers_of(first)}
    assert all(
        abs(value) in numbers and std in numbers
        for cells in print_.first_paper().values()
        for value, std in cells.values()
    )
    assert all(abs(value) in numbers for value in print_.true_values().values())
    ends = {"Table 1": "Table 2. Output", "Table 2": "Table 3. Robust", "Table 3": "Fig. 1 The"}
    sections = {table: section(second, f"{table}. ", end) for table, end in ends.items()}
    for title, cells in print_.second_paper().items():
        there = {abs(number) for number in numbers_of(sections[title[:7]])}
        assert {
            (title, name) for name, value in cells.items() if value and abs(value) not in there
        } <= NOT_READ
    for table, words in print_.NOISE.items():
        assert {Decimal(word) for word in words.split()} <= {*numbers_of(sections[table])}
        assert {abs(r) for _, _, r in print_.correlations(table)} <= {
            abs(number) for number in numbers_of(sections[table])
        }
    for name, text in (("simulated_flight_data", first), ("short_period_dynamics", second)):
        captions = {int(n) for n in re.findall(r"^Fig\s?\.\s*(\d+)\s*\.? ", text, re.MULTILINE)}
        assert captions <= {*CAPTIONS[name][1]}, captions
    whole = one_line(second)
    for words in (
        "between 140 msec and 146 msec",
        "delay of 120 msec",
        "estimated 0.84 to 0.92",
        "estimated 1.05",
        "0 to 200 msec, in increments of 25 msec",
    ):
        assert words in whole
    assert all(number in second for pair in print_.HEADINGS.values() for number in pair)


def test_a_number_that_moves_makes_the_page_stale() -> None:
    """Each of the kept numbers stands on the page, or a condition hangs on it."""
    numbers = from_file((ROOT / PAGE).with_suffix(".json"))
    for target in (
        "rigid: CL_q",
        "x29-flight: delay",
        "x29-innovations: misfit.q_innovations.lag_one",
    ):

        def moved(lookup: str, target: str = target) -> Found:
            found = numbers(lookup)
            return Found(found.value * 1.05, found.std, found.unit) if lookup == target else found

        assert written(moved)[0] != page()

    def fallen(lookup: str) -> Found:
        return (
            Found(0.0)
            if lookup == "x29-innovations: misfit.q_innovations.lag_one"
            else numbers(lookup)
        )

    with pytest.raises(DeclarationError, match=r"lag > 0\.08 does not hold"):
        written(fallen)


@pytest.mark.slow
def test_the_studies_still_have_these_numbers(tmp_path: Path) -> None:
    """All scenarios run again: every number to rounding, and the same page but for it."""
    make(tmp_path / "papers.md", tmp_path / "studies", jobs=2)
    found = json.loads((tmp_path / "papers.json").read_text(encoding="utf-8"))["numbers"]
    assert found.keys() == kept().keys()
    for key, (value, std, unit) in kept().items():
        new, new_std, new_unit = found[key]
        close = 1e-5 * abs(value) + 1e-3 * (std or 0.0) + 1e-9
        assert unit == new_unit and abs(new - value) <= close, (key, value, new)
        assert (std is None) == (new_std is None) and (
            std is None or abs(new_std - std) <= 1e-3 * std
        ), (key, std, new_std)


def test_the_file_of_numbers_reads_back() -> None:
    assert kept_text({key: Found(*entry) for key, entry in kept().items()}) == (
        ROOT / PAGE
    ).with_suffix(".json").read_text(encoding="utf-8")
