"""The file of a survey: every key, and every fault in one line that names file, flight and
remedy.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scenarios.cli.model_commands import EXAMPLE
from scenarios.survey.flights import Flights, read_flights, toml_text
from sim.errors import DeclarationError
from sim.record import Hold
from tests.integration.command_line import VEHICLE

HEAD = 'model = "rigid"\nvehicle = "aircraft.toml"\n'


def flights_of(folder: Path, text: str) -> Flights:
    (folder / "aircraft.toml").write_text(VEHICLE)
    (folder / "flights.toml").write_text(text)
    return read_flights(folder / "flights.toml")


def test_every_key_is_read_and_a_flight_takes_its_own(tmp_path: Path) -> None:
    for name in ("map.toml", "other.toml", "own.toml"):
        (tmp_path / name).write_text("")
    text = """
title = "spring"
model = "rigid"
vehicle = "aircraft.toml"
channels = "map.toml"
effects = "own.toml"
effort = "thorough"
from = 1.0
to = 9.0
hold = "linear"
rate = 25.0
lowpass = 6.0
[[flights]]
record = "records/one.csv"
[[flights]]
records = ["two.csv", "three.csv"]
name = "F002"
date = 2026-03-02
tail = "FT-1"
channels = "other.toml"
from = 2.0
to = 8.0
hold = "previous"
rate = 20.0
lowpass = 5.0
vehicle = {mass = "10000 lb", derivatives = {Cm_q = -20.0}}
condition = {altitude = "5000 ft", mach = 0.36, fuel = "200 kg", flaps = "10 deg"}
"""
    found = flights_of(tmp_path, text)
    one, two = found.flights
    assert (found.title, found.model, [each.name for each in found.flights]) == (
        "spring",
        "rigid",
        ["one", "F002"],
    )
    assert one.records == (tmp_path / "records/one.csv",)
    assert two.records == (tmp_path / "two.csv", tmp_path / "three.csv")
    assert (one.channels, two.channels) == (tmp_path / "map.toml", tmp_path / "other.toml")
    assert one.effects == two.effects == tmp_path / "own.toml"
    assert one.effort == two.effort == "thorough"
    assert [(s.start, s.stop) for each in (one, two) for s in each.plan.segments] == [
        (1.0, 9.0),
        (2.0, 8.0),
    ]
    assert [(each.plan.hold, each.plan.rate, each.plan.lowpass) for each in (one, two)] == [
        (Hold.LINEAR, 25.0, 6.0),
        (Hold.PREVIOUS, 20.0, 5.0),
    ]
    assert (two.date, two.tail, one.date, one.tail) == ("2026-03-02", "FT-1", "", "")
    plain, changed = tomllib.loads(one.vehicle), tomllib.loads(two.vehicle)
    assert plain == tomllib.loads(VEHICLE)
    assert changed == {
        **plain,
        "mass": "10000 lb",
        "derivatives": {**plain["derivatives"], "Cm_q": -20.0},
    }
    assert [each.condition["mass"][0] for each in (one, two)] == pytest.approx(
        [288017 * 0.45359237, 4535.9237]
    )
    assert two.condition["altitude"][0] == pytest.approx(1524.0)
    assert {each.condition["mass"][1] for each in (one, two)} == {"kg"}
    assert (two.condition["mach"], two.condition["fuel"], two.condition["flaps"]) == (
        (0.36, "1"),
        (200.0, "kg"),
        (10.0, "deg"),
    )


def test_a_condition_has_one_unit_in_all_flights(tmp_path: Path) -> None:
    text = (
        HEAD
        + ONE
        + (
            'condition = {fuel = "200 kg"}\n[[flights]]\nrecord = "b.csv"\ncondition = {fuel = '
            '"300 lb"}\n'
        )
    )
    assert [each.condition["fuel"] for each in flights_of(tmp_path, text).flights] == [
        (200.0, "kg"),
        (pytest.approx(136.0777), "kg"),
    ]


def test_records_of_a_pattern_are_flights_but_those_that_have_a_table(tmp_path: Path) -> None:
    (tmp_path / "records").mkdir()
    for name in ("b", "a", "c"):
        (tmp_path / "records" / f"{name}.csv").write_text("")
    found = flights_of(
        tmp_path,
        HEAD + 'records = "records/*.csv"\n[[flights]]\nrecord = "records/b.csv"\ntail = "T"\n',
    )
    assert [(each.name, each.tail) for each in found.flights] == [("a", ""), ("c", ""), ("b", "T")]
    # what is not there fails as a flight
    listed = flights_of(tmp_path, HEAD + 'records = ["records/c.csv", "gone.csv"]\n')
    assert [each.name for each in listed.flights] == ["c", "gone"]
    assert listed.title == "flights"


ONE = '[[flights]]\nrecord = "a.csv"\n'
FAULTS = {
    "modle = 1\n" + ONE: "modle",
    HEAD + 'colour = "red"\n' + ONE: "colour",
    HEAD + ONE + "mass = 5.0\n": "mass",
    'vehicle = "aircraft.toml"\n' + ONE: "model",
    'model = "rigit"\n' + ONE: "rigit",
    HEAD: "there is no flight",
    HEAD + 'records = "none/*.csv"\n': "no file matches 'none/*.csv'",
    HEAD + '[[flights]]\nname = "F1"\n': "flight F1 names no record",
    HEAD + ONE + 'records = ["b.csv"]\n': "flight 1 has record and records",
    HEAD + "[[flights]]\nrecords = []\n": "records",
    HEAD + ONE + '[[flights]]\nrecord = "other/a.csv"\n': "two flights are called a",
    HEAD + ONE + 'name = "../a"\n': "name",
    HEAD + '[[flights]]\nrecord = "a b.csv"\n': "'a b' cannot be the name of a folder",
    HEAD + ONE + 'condition = {altitude = "1500 blorb"}\n': "blorb",
    HEAD + ONE + 'condition = {fuel = "much"}\n': "'much' is not a number with a unit",
    HEAD
    + ONE
    + 'condition = {fuel = "200 kg"}\n[[flights]]\nrecord = "b.csv"\ncondition = {fuel = "3 m"}\n': "flight b, fuel",  # noqa: E501
    HEAD + ONE + "condition = {mach = nan}\n": "mach",
    HEAD + ONE + 'vehicle = {mass = "5 blorb"}\n': "blorb",
    HEAD + ONE + "vehicle = {mass = -5.0}\n": "flight a, vehicle, key mass",
    HEAD + ONE + "vehicle = {maas = 5.0}\n": "flight a, vehicle, key maas",
    HEAD + ONE + "vehicle = {derivatives = {Cm_p = 1.0}}\n": "derivatives.Cm_p",
    'model = "rigid"\n'
    + ONE
    + "vehicle = {mass = 5.0}\n": "changes a vehicle file that is not named",
    'model = "rigid"\nvehicle = "gone.toml"\n' + ONE: "gone.toml",
    'model = "rigid"\nvehicle = "broken.toml"\n' + ONE: "broken.toml: key missing: chord",
    HEAD + 'channels = "gone.toml"\n' + ONE: "gone.toml",
    HEAD + 'effects = "gone.toml"\n' + ONE: "gone.toml",
    HEAD + 'hold = "next"\n' + ONE: "hold",
    HEAD + "rate = -1.0\n" + ONE: "rate",
    HEAD + "from = 5.0\nto = 2.0\n" + ONE: "flight a",
    HEAD + 'effort = "heroic"\n' + ONE: "effort",
    HEAD + ONE + "date = 3\n": "date",
    "model = ": "not valid TOML",
}


@pytest.mark.parametrize(
    ("text", "said"), FAULTS.items(), ids=[str(number) for number in range(len(FAULTS))]
)
def test_every_fault_is_one_line(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "broken.toml").write_text(VEHICLE.replace("chord = 4.66344\n", ""))
    with pytest.raises(DeclarationError) as told:
        flights_of(tmp_path, text)
    line = str(told.value)
    assert said in line
    assert told.value.where
    assert told.value.remedy
    assert "\n" not in line


def test_the_example_is_a_file_as_it_should_be(tmp_path: Path) -> None:
    (tmp_path / "flight_vehicle.toml").write_text(VEHICLE)
    (tmp_path / "flights.toml").write_text(EXAMPLE)
    first, second = read_flights(tmp_path / "flights.toml").flights
    assert [each.name for each in (first, second)] == ["F001", "F002"]
    assert second.condition["mass"] == (2.9e5, "kg")
    assert first.condition["mass"] != second.condition["mass"]


def test_the_digest_is_of_everything_that_results_depend_on(tmp_path: Path) -> None:
    def digests(text: str) -> list[str]:
        return [each.digest for each in flights_of(tmp_path, text).flights]

    (tmp_path / "a.csv").write_text("1")
    two = HEAD + ONE + '[[flights]]\nrecord = "b.csv"\n'
    before = digests(two)
    # a diagnosis does not know them
    assert digests(two + 'condition = {mach = 0.3}\ntail = "T"\n') == before
    assert digests("title = 'other'\n" + two) == before
    for changed in (
        two + "vehicle = {mass = 2.0e5}\n",
        two + "rate = 20.0\n",
        two + 'name = "c"\n',
    ):
        now = digests(changed)
        assert now[0] == before[0]
        assert now[1] != before[1]
    assert all(
        now != was for now, was in zip(digests('effort = "thorough"\n' + two), before, strict=True)
    )
    (tmp_path / "a.csv").write_text("2")
    assert [now == was for now, was in zip(digests(two), before, strict=True)] == [False, True]
    (tmp_path / "b.json").write_text("{}")  # its sidecar
    assert digests(two)[1] != before[1]


scalars = st.one_of(
    st.booleans(),
    st.integers(-(2**60), 2**60),
    st.floats(allow_nan=False),
    st.text(st.characters(exclude_categories=["Cs"])),
)
tables = st.dictionaries(
    st.text(st.characters(exclude_categories=["Cs"])),
    st.recursive(
        scalars,
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.text('ab é"\\', max_size=4), inner, max_size=3)
        ),
        max_leaves=8,
    ),
    max_size=4,
)


@pytest.mark.long
@given(tables)
def test_written_toml_is_what_was_read(content: dict[str, object]) -> None:
    assert tomllib.loads(toml_text(content)) == content
