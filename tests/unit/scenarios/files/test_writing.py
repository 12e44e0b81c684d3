"""Written records read back bit for bit; JSON is strict and the same for the same content."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.files.records import read_record
from scenarios.files.writing import file_stems, json_text, unportable, write_json, write_record
from scenarios.studies.catalogue import (
    IDENTIFICATION,
    load_document,
    load_scenario,
    scenario_kind,
    scenario_names,
)
from scenarios.studies.reading import scenario_of
from sim.errors import DeclarationError, FlightidError
from sim.record import Channel, Hold, Record

FINITE = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def records(draw: st.DrawFn) -> Record:
    count = draw(st.integers(2, 12))
    time = np.sort(np.array(draw(st.lists(FINITE, min_size=count, max_size=count, unique=True))))
    stick = Channel.of(
        "stick",
        draw(st.sampled_from(["in", "1", "deg"])),
        np.array(draw(st.lists(FINITE, min_size=count, max_size=count))),
    )
    outputs = []
    for name, unit in (("alpha", "rad"), ("q", "rad/s"), ("nz", "g"), ("az", "m/s2")):
        values = np.array(
            draw(st.lists(st.one_of(FINITE, st.just(np.nan)), min_size=count, max_size=count))
        )
        values[draw(st.integers(0, count - 1))] = draw(FINITE)
        outputs.append(Channel.of(name, unit, values))
    return Record(
        time, (stick,), tuple(outputs), draw(st.sampled_from(Hold)), draw(st.text(min_size=1))
    )


@pytest.mark.long
@settings(deadline=None, max_examples=60)
@given(records())
def test_a_written_record_reads_back_bit_for_bit(record: Record) -> None:
    with tempfile.TemporaryDirectory() as folder:
        table, _ = write_record(folder, record, "flight")
        again = read_record(table, ["stick"], ["alpha", "q", "nz"], optional=["az"])
        assert sorted(path.name for path in Path(folder).iterdir()) == ["flight.csv", "flight.json"]
    assert again.time.tobytes() == record.time.tobytes()
    assert (again.hold, again.name) == (record.hold, record.name)
    assert [(channel.name, channel.unit) for channel in again.channels] == [
        (channel.name, channel.unit) for channel in record.channels
    ]
    for ours, theirs in zip(record.channels, again.channels, strict=True):
        assert (
            ours.values.tobytes() == theirs.values.tobytes()
            and ours.valid.tobytes() == theirs.valid.tobytes()
        )


def test_the_table_is_plain(tmp_path: Path) -> None:
    record = Record(
        np.array([0.0, 0.1]),
        (Channel.of("elevator", "rad", np.array([0.0, 1e-7])),),
        (Channel.of("q", "rad/s", np.array([np.nan, 0.1 + 0.2])),),
    )
    table, sidecar = write_record(tmp_path, record)
    assert table.read_bytes() == b"time,elevator,q\n0.0,0.0,\n0.1,1e-07,0.30000000000000004\n"
    expected = {
        "schema": "flightid/record/1",
        "name": "record",
        "hold": "previous",
        "units": {"time": "s", "elevator": "rad", "q": "rad/s"},
    }
    assert json.loads(sidecar.read_text()) == expected


def test_json_takes_numpy_and_is_laid_out_the_same_way(tmp_path: Path) -> None:
    content = {
        "b": np.float64(0.1),
        "a": {"z": np.arange(3), "y": (np.int64(1), np.bool_(True)), "é": Path("x")},
        "c": [{"k": 1}, {}],
        "d": [],
        "e": np.ones((2, 2)),
        "f": Hold.LINEAR,
    }
    write_json(tmp_path / "x.json", content)
    text = (tmp_path / "x.json").read_text(encoding="utf-8")
    assert json.loads(text) == {
        "a": {"y": [1, True], "z": [0, 1, 2], "é": "x"},
        "b": 0.1,
        "c": [{"k": 1}, {}],
        "d": [],
        "e": [[1.0, 1.0], [1.0, 1.0]],
        "f": "linear",
    }
    assert text == json_text(dict(reversed(content.items()))) + "\n"
    assert '    "z": [0, 1, 2],\n' in text and text.index('"a"') < text.index('"b"')


@pytest.mark.parametrize(
    ("content", "place"),
    [
        ({"a": {"b": [1.0, float("nan")]}}, "key a.b[1]"),
        ({"a": np.array([[1.0, np.inf]])}, "key a[0][1]"),
        ({"a": None}, "key a:"),
        ({"a": {3: 1}}, "key a:"),
        ({"a": {"b": object()}}, "key a.b:"),
        ({"a": 1j}, "key a:"),
    ],
)
def test_what_json_cannot_say_is_refused(
    tmp_path: Path, content: dict[str, Any], place: str
) -> None:
    path = tmp_path / "x.json"
    with pytest.raises(FlightidError) as caught:
        write_json(path, content)
    assert (
        "\n" not in str(caught.value)
        and f"{path}, {place}" in str(caught.value)
        and caught.value.remedy
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("input-delay:rudder.png", "':'"),
        ("a/b", "'/'"),
        ("a\\b", r"'\\'"),
        ("what?.csv", "'?'"),
        ("a\tb", r"'\t'"),
        ("CON", "device"),
        ("nul.tar.gz", "device"),
        ("Lpt1.csv", "device"),
        ("F1.", "point"),
        ("F1 ", "space"),
        ("", "empty"),
    ],
)
def test_names_that_windows_has_not_are_known(name: str, why: str) -> None:
    assert why in unportable(name)


@pytest.mark.parametrize(
    "name",
    [
        "record.csv",
        ".report.json.part",
        "rows-000000.parquet",
        "Übung 7.png",
        "console.csv",
        "com10",
        "a.b",
    ],
)
def test_names_that_every_system_has(name: str) -> None:
    assert unportable(name) == ""


def test_stems_of_files_differ_by_more_than_case() -> None:
    assert file_stems(["mach", "Mach", "MACH", "fuel left", "fuel:left", "mach", "mach_2"]) == {
        **{
            "mach": "mach",
            "Mach": "Mach_2",
            "MACH": "MACH_3",
            "fuel left": "fuel_left",
            "fuel:left": "fuel_left_2",
            "mach_2": "mach_2_2",
        }
    }


def test_every_scenario_names_its_methods_as_every_system_names_files() -> None:
    scenarios = [
        load_scenario(name) for name in scenario_names() if scenario_kind(name) == IDENTIFICATION
    ]
    named = [[method.name for method in scenario.estimations] for scenario in scenarios]
    assert len(named) > 5 and any(len(names) > 3 for names in named)
    for names in named:
        assert [name for name in names if unportable(f"record_{name}.csv")] == []
        assert len({name.lower() for name in names}) == len(names)


@pytest.mark.parametrize(
    ("taken", "said"), [("q:free", "':'"), ("a/b", "'/'"), ("MAIN", "is taken")]
)
def test_a_method_whose_name_no_file_can_have_is_refused(taken: str, said: str) -> None:
    document, name, where = load_document("rigid", [])
    changed = {key: value for key, value in document.items() if key != "kind"} | {
        "methods": [{"name": taken}]
    }
    with pytest.raises(DeclarationError, match=said):
        scenario_of(changed, name, where)
