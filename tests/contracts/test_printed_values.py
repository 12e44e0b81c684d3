"""Every value that the paper on simulated flight data prints, and every start and prior of its
scenarios, against a second copy.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest

from sim.vehicles.library import Origin, SourcedNumber, read_parameter_set
from tests.oracles.printed_values import STARTS, TABLES, TRUE, declared, printed, true_values

ROOT = Path(__file__).parents[2]
PUBLISHED, CATALOG = (
    ROOT / "scenarios/studies/published/simulated_flight_data.toml",
    ROOT / "scenarios/catalog",
)
NUMBER = re.compile(r"(?:value|std) = \"?-?([\d.]+)(?:e-0?\d+)?")


def published(text: str) -> dict[str, Decimal]:
    """Values and standard deviations of a file of published numbers, by ``table.column.name.value``
    or ``.std``.
    """
    tables = {
        name: table
        for name, table in tomllib.loads(text, parse_float=Decimal).items()
        if isinstance(table, dict) and name != "remarks"
    }
    columns = {
        f"{name}.{key}": entry
        for name, table in tables.items()
        for key, entry in table.items()
        if isinstance(entry, dict)
    }
    return {
        f"{place}.{name}.{kind}": Decimal(value)
        for place, rows in columns.items()
        for name, row in rows.items()
        for kind, value in row.items()
    }


def started(text: str) -> dict[str, tuple[Decimal, str]]:
    """Starts and standard deviations of a scenario file as number and unit, by
    ``estimate.name.value`` or ``METHOD.name.std``.
    """
    document = tomllib.loads(text, parse_float=Decimal)
    places: list[tuple[str, Mapping[str, Any]]] = [("estimate", document["estimate"])]
    places += [(method["name"], method) for method in document.get("methods", [])]
    out = {}
    for place, table in places:
        for name, row in {**table.get("start", {}), **table.get("initial", {})}.items():
            for kind, quantity in row.items():
                number, _, unit = str(quantity).partition(" ")
                out[f"{place}.{name}.{kind}"] = (Decimal(number), unit)
    return out


def scenario(name: str) -> str:
    return (CATALOG / f"{name}.toml").read_text(encoding="utf-8")


def mutated(text: str) -> list[str]:
    """The text with one number changed, once for every value and standard deviation in it: by one
    in its last digit.
    """
    places = [found.end(1) - 1 for found in NUMBER.finditer(text)]
    return [f"{text[:at]}{(int(text[at]) + 1) % 10}{text[at + 1 :]}" for at in places]


def test_every_scenario_of_the_paper_has_a_second_copy_of_its_starts() -> None:
    named = {
        path.stem
        for path in CATALOG.glob("*.toml")
        if 'file = "simulated_flight_data"' in path.read_text(encoding="utf-8")
    }
    assert named == STARTS.keys()
    assert published(PUBLISHED.read_text(encoding="utf-8")).keys() == printed().keys()
    assert len(printed()) == 2 * (4 + 6 * 3 + 6 * 2 + 15 * 2) and len(TABLES) == 4


def test_published_values_are_the_printed_ones() -> None:
    assert published(PUBLISHED.read_text(encoding="utf-8")) == printed()


def as_printed(number: SourcedNumber) -> tuple[Decimal, str]:
    """What the paper prints of a number, with its unit."""
    digits, _, unit = (number.printed_by_paper or number.printed).partition(" ")
    return Decimal(digits), unit


@pytest.mark.parametrize("vehicle", TRUE)
def test_true_values_are_the_printed_ones(vehicle: str) -> None:
    data, expected = read_parameter_set(vehicle), true_values(vehicle)
    numbers = {number.name: number for number in (*data.numbers, *data.initial)}
    assert {name: as_printed(numbers[name]) for name in expected} == expected
    papers = {
        name
        for name, number in numbers.items()
        if number.origin is Origin.PAPER or number.printed_by_paper
    }
    others = {"air_density_reference", "density_scale_height"} | (
        set(true_values("bomber_rigid")) if vehicle == "bomber_ac1" else set()
    )
    assert papers - others == expected.keys(), (
        "those of eq. 19 and of the set that this one is based on apart"
    )


@pytest.mark.parametrize("name", STARTS)
def test_starts_and_priors_are_the_declared_ones(name: str) -> None:
    assert started(scenario(name)) == declared(name)


def test_any_changed_published_value_fails() -> None:
    changed = mutated(PUBLISHED.read_text(encoding="utf-8"))
    assert len(changed) == len(printed())
    assert [text for text in changed if published(text) == printed()] == []


@pytest.mark.parametrize("name", STARTS)
def test_any_changed_start_or_prior_fails(name: str) -> None:
    text = scenario(name)
    changed = mutated(text)
    assert len(changed) == len(declared(name)), "each start is a number that is changed"
    assert [other for other in changed if started(other) == declared(name)] == []


@pytest.mark.parametrize("name", STARTS)
def test_a_lost_sign_unit_or_entry_of_a_start_fails(name: str) -> None:
    text = scenario(name)
    lines = {line for line in text.splitlines() if "{value = " in line}
    assert lines
    for line in lines:
        for other in (
            line.replace("= -", "= "),
            line.replace('= "-', '= "'),
            line.replace(" deg", " rad"),
            line.replace(" ft", " m"),
            "",
        ):
            assert other == line or started(text.replace(line, other, 1)) != declared(name), (
                line,
                other,
            )
