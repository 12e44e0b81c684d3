"""`flightid maneuvers`, and `--maneuver` of identify, diagnose and survey: the same as the times by
hand, one line for what is not there.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import flightid as fid
from scenarios.files.vehicles import read_vehicle
from scenarios.files.writing import write_record
from scenarios.preparation.declared_model import model_of_file
from sim.declaration.model import Noise
from sim.maneuvers import doublet, sequence, three_two_one_one
from sim.truth.flight import fly, sample_times
from tests.integration.command_line import VEHICLE, CommandLine

NOISE = {"alpha": 5e-4, "q": 5e-4, "nz": 2e-3}
LENGTH = 200.0
PARTS = """
record = "flight.csv"
[[maneuvers]]
name = "first"
from = 40
to = 55.5
[[maneuvers]]
number = 7
name = "second"
from = 100
to = 118.0
[[maneuvers]]
name = "over"
from = 110.0
to = 130.0
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rigid aircraft's record of 200 s with a 3-2-1-1 at 42 s and a doublet 60 s later, its
    vehicle file, and a file of parts.
    """
    folder = tmp_path_factory.mktemp("maneuvers")
    (folder / "vehicle.toml").write_text(VEHICLE)
    (folder / "parts.toml").write_text(PARTS)
    model = model_of_file(read_vehicle(folder / "vehicle.toml", "rigid")).with_noise(Noise(NOISE))
    maneuver = sequence([three_two_one_one(0.03, 1.0), doublet(0.03, 1.5)], 55.0, start=42.0)
    record, _ = fly(
        model,
        maneuver,
        sample_times(20.0, LENGTH),
        np.random.default_rng(1),
        step=0.01,
        outputs=list(NOISE),
        name="flight",
    )
    write_record(folder, record, "flight", simulated=True)
    return folder


@pytest.fixture(scope="module")
def searched(folder: Path) -> Path:
    """The folder with ``maneuvers.toml`` beside the record."""
    fid.find_maneuvers(folder / "flight.csv").save(folder, figures="png")
    return folder


def identified(flightid: CommandLine, folder: Path, out: Path, *options: object) -> dict[str, Any]:
    """Content of ``comparison.json`` of an identification of the record."""
    flightid.done(
        "identify",
        folder / "flight.csv",
        "--model",
        "rigid",
        "--no-figures",
        "--out",
        out,
        *options,
    )
    content: dict[str, Any] = json.loads((out / "comparison.json").read_text())
    return content


@pytest.mark.long
def test_the_table_and_the_folder(flightid: CommandLine, folder: Path, tmp_path: Path) -> None:
    told = flightid.done("maneuvers", folder / "flight.csv", "--out", tmp_path / "found")
    assert "2 maneuvers (1 3-2-1-1, 1 doublet)" in told
    content = json.loads(
        (tmp_path / "found" / "maneuvers.json").read_text(), parse_constant=pytest.fail
    )
    first, second = (each for each in content["maneuvers"] if each["kind"] != "trim")
    for each in content["maneuvers"]:
        assert f"--from {each['from']:.9g} --to {each['to']:.9g}" in told
    assert (first["kind"], first["axis"], first["channel"], first["unit"]) == (
        "3-2-1-1",
        "pitch",
        "elevator",
        "rad",
    )
    assert first["start"] == pytest.approx(42.0, abs=0.3) and first["end"] == pytest.approx(
        49.0, abs=0.3
    )
    assert first["amplitude"] == pytest.approx(0.03, rel=0.05)
    assert (
        set(first["excitation"]) == {"Cm_alpha", "Cm_q", "Cm_de"}
        and min(first["excitation"].values()) > 5.0
    )
    assert second["from"] < second["start"] < second["end"] < second["to"]
    parts = tomllib.loads((tmp_path / "found" / "maneuvers.toml").read_text(encoding="utf-8"))
    assert [each["name"] for each in parts["maneuvers"]] == [
        each["name"] for each in content["maneuvers"]
    ]
    assert parts["record"] == "flight.csv" and parts["sha256"] == content["inputs"]["sha256"][0]
    assert {"flight.png", "report.html"} <= set(content["files"])
    again = flightid.done("maneuvers", folder / "flight.csv", "--json")
    assert json.loads(again)["maneuvers"] == content["maneuvers"]


@pytest.mark.long
def test_a_maneuver_is_the_pair_of_its_times(
    flightid: CommandLine, searched: Path, tmp_path: Path
) -> None:
    by_name = identified(flightid, searched, tmp_path / "a", "--maneuver", "pitch-3-2-1-1-1")
    parts = tomllib.loads((searched / "maneuvers.toml").read_text(encoding="utf-8"))["maneuvers"]
    (one,) = [each for each in parts if each["name"] == "pitch-3-2-1-1-1"]
    by_hand = identified(
        flightid, searched, tmp_path / "b", "--from", one["from"], "--to", one["to"]
    )
    by_number = identified(flightid, searched, tmp_path / "c", "--maneuver", one["number"])
    assert by_name["parameters"] == by_hand["parameters"] == by_number["parameters"]
    sentence = (
        f"maneuver {one['number']} (pitch-3-2-1-1-1), {one['from']:g} to {one['to']:g} s, of "
        f"{searched / 'maneuvers.toml'}"
    )
    assert sentence in by_name["notes"]


@pytest.mark.long
def test_several_and_a_file_of_ones_own(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    asked = ("--maneuvers", folder / "parts.toml", "--maneuver", "second", "--maneuver", 1)
    both = identified(flightid, folder, tmp_path / "a", *asked)
    by_hand = identified(
        flightid, folder, tmp_path / "b", "--from", 40, "--to", 55.5, "--from", 100, "--to", 118
    )
    assert both["parameters"] == by_hand["parameters"]


@pytest.mark.long
def test_python(searched: Path) -> None:
    record = fid.read_record(searched / "flight.csv")
    found = fid.find_maneuvers(record)
    frame = found.to_dataframe()
    number = int(frame.index[frame["kind"] == "doublet"][0])
    by_result = fid.identify(
        record, "rigid", searched / "vehicle.toml", maneuver=number, maneuvers=found
    )
    row = frame.loc[number]
    by_times = fid.identify(
        record, "rigid", searched / "vehicle.toml", start=row["from"], stop=row["to"]
    )
    assert np.array_equal(by_result.values, by_times.values)
    beside = fid.identify(record, "rigid", searched / "vehicle.toml", maneuver=row["name"])
    assert np.array_equal(beside.values, by_times.values)
    assert found.plot.maneuvers().axes and "doublet" in found.summary() and len(found) == len(frame)
    with pytest.raises(fid.InputError, match="a float holds no maneuvers"):
        fid.identify(record, "rigid", searched / "vehicle.toml", maneuver=1, maneuvers=3.0)
    in_memory = fid.read_record(record.to_pandas())
    with pytest.raises(fid.InputError, match="the record is in memory"):
        fid.identify(in_memory, "rigid", searched / "vehicle.toml", maneuver=1)


REFUSED = [
    (["--maneuver", "9"], "parts.toml: there is no maneuver '9'; it has 1 first, 7 second, 8 over"),
    (
        ["--maneuver", "1", "--from", "3"],
        "--maneuver: goes without --from and --to; leave one or the other out",
    ),
    (
        ["--maneuver", "7", "--maneuver", "over"],
        "maneuvers 7 and 8 overlap (100 to 118 s, 110 to 130 s); take one of them",
    ),
    (
        ["--maneuver", "1", "--maneuver", "first"],
        "--maneuver: maneuver 1 is asked for twice; name each once",
    ),
    ([], "--maneuvers: no maneuver is named; add --maneuver NUMBER, or leave it out"),
]


@pytest.mark.sampled
@pytest.mark.parametrize(("options", "said"), REFUSED)
@pytest.mark.parametrize("command", ["identify", "diagnose"])
def test_one_line_for_what_is_not_there(
    flightid: CommandLine, folder: Path, command: str, options: list[str], said: str
) -> None:
    asked = [
        folder / "flight.csv",
        "--model",
        "rigid",
        "--maneuvers",
        folder / "parts.toml",
        *options,
    ]
    assert said in flightid.refused(command, *asked)


FILES = [
    ("[[maneuvers]]\nfrom = 3\nto = 2\n", "maneuver 1: from = 3 is not before to = 2"),
    ("[[maneuvers]]\nfrom = 3\n", "missing"),
    ("[[maneuvers]]\nfrom = 3\nto = 4\nfirst = 2\n", "there is no such key"),
    (
        "[[maneuvers]]\nfrom = 3\nto = 4\n[[maneuvers]]\nnumber = 1\nfrom = 5\nto = 6\n",
        "two maneuvers have the number 1",
    ),
    (
        '[[maneuvers]]\nname = "a"\nfrom = 3\nto = 4\n[[maneuvers]]\nname = "a"\nfrom = 5\nto = '
        "6\n",
        "two maneuvers have the name a",
    ),
    (
        'sha256 = "00"\nrecord = "other.csv"\n[[maneuvers]]\nfrom = 3\nto = 4\n',
        "is of other.csv, not of flight.csv",
    ),
    (
        'sha256 = "00"\nrecord = "flight.csv"\n[[maneuvers]]\nfrom = 3\nto = 4\n',
        "its content has changed",
    ),
    ("maneuvers = 3\n", "key maneuvers"),
    ("", "there is no maneuver '1'; it has none"),
]


@pytest.mark.sampled
@pytest.mark.parametrize(("text", "said"), FILES)
def test_one_line_for_a_file_that_is_wrong(
    flightid: CommandLine, folder: Path, tmp_path: Path, text: str, said: str
) -> None:
    (tmp_path / "m.toml").write_text(text)
    asked = [
        folder / "flight.csv",
        "--model",
        "rigid",
        "--maneuvers",
        tmp_path / "m.toml",
        "--maneuver",
        "1",
    ]
    assert said in flightid.refused("identify", *asked)


def test_no_file_and_several_records(flightid: CommandLine, folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / "flight.csv"
    copy.write_bytes((folder / "flight.csv").read_bytes())
    asked = ["--model", "rigid", "--vehicle", folder / "vehicle.toml", "--maneuver", "1"]
    assert "there is no maneuvers.toml beside flight.csv" in flightid.refused(
        "identify", copy, *asked
    )
    assert "maneuvers are of one record, and 2 are named" in flightid.refused(
        "identify", copy, folder / "flight.csv", *asked
    )
    (tmp_path / "empty.csv").write_text("time,temperature\n0,1\n1,2\n")
    assert "empty.csv" in flightid.refused("maneuvers", tmp_path / "empty.csv")


def test_a_survey_takes_them(searched: Path) -> None:
    from scenarios.survey.flights import read_flights
    from sim.errors import DeclarationError

    head = 'model = "rigid"\nvehicle = "vehicle.toml"\n[[flights]]\nrecord = "flight.csv"\n'
    (searched / "flights.toml").write_text(head + 'maneuver = ["pitch-doublet-1"]\n')
    (flight,) = read_flights(searched / "flights.toml").flights
    parts = tomllib.loads((searched / "maneuvers.toml").read_text(encoding="utf-8"))["maneuvers"]
    (one,) = [each for each in parts if each["name"] == "pitch-doublet-1"]
    assert [(each.start, each.stop) for each in flight.plan.segments] == [(one["from"], one["to"])]
    (searched / "flights.toml").write_text(head + 'maneuver = 7\nmaneuvers = "parts.toml"\n')
    assert [
        each.start for each in read_flights(searched / "flights.toml").flights[0].plan.segments
    ] == [100.0]
    (searched / "flights.toml").write_text(head + "maneuver = 77\n")
    with pytest.raises(DeclarationError, match="flight flight: there is no maneuver '77'"):
        read_flights(searched / "flights.toml")


@pytest.mark.long
def test_almost_all_cruise_is_said(flightid: CommandLine, searched: Path, tmp_path: Path) -> None:
    """One caution with the share and the command for the whole record; none for a maneuver of
    it.
    """
    whole = identified(flightid, searched, tmp_path / "a")
    (said,) = [each for each in whole["warnings"] if "cruise" in each]
    assert (
        "an input moves beyond its noise in " in said
        and "flightid maneuvers flight.csv --out DIR" in said
    )
    assert 0.03 < float(said.split("noise in ")[1].split(" %")[0]) / 100.0 < 0.1
    part = identified(flightid, searched, tmp_path / "b", "--maneuver", "pitch-doublet-1")
    assert not any("cruise" in each for each in part["warnings"])


def test_a_record_without_a_clock_and_without_a_header(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    """The same maneuvers at the same times as from the record with both; without the rate one
    line.
    """
    rows = np.loadtxt(folder / "flight.csv", delimiter=",", skiprows=1)
    header = (folder / "flight.csv").read_text().splitlines()[0].split(",")
    np.savetxt(tmp_path / "bare.csv", rows[:, 1:], delimiter=",", fmt="%.9g")
    options = ("--columns", ",".join(name.split(" ")[0] for name in header[1:]))
    assert "--rate" in flightid.refused("maneuvers", tmp_path / "bare.csv", *options)
    flightid.done(
        "maneuvers",
        tmp_path / "bare.csv",
        *options,
        "--rate",
        20,
        "--no-figures",
        "--out",
        tmp_path / "found",
    )
    found = json.loads((tmp_path / "found" / "maneuvers.json").read_text())["maneuvers"]
    wanted = fid.find_maneuvers(folder / "flight.csv").to_dict()["maneuvers"]
    assert [(each["kind"], each["start"]) for each in found] == [
        (each["kind"], pytest.approx(each["start"], abs=1e-6)) for each in wanted
    ]
    columns = {
        name.split(" ")[0]: column for name, column in zip(header[1:], rows[:, 1:].T, strict=True)
    }
    assert len(fid.find_maneuvers(columns, rate=20.0)) == len(wanted)


@pytest.mark.long
def test_columns_that_look_like_controls_are_said_and_a_drafted_map_reads_them(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    header, _, rows = (folder / "flight.csv").read_text().partition("\n")
    recorded = tmp_path / "recorded.csv"
    recorded.write_text(f"{header.replace('elevator', 'DELV')}\n{rows}")
    told = flightid.done("maneuvers", recorded)
    assert "0 maneuvers" in told or "no maneuver" in told or "no input is recorded" in told
    assert "DELV looks like elevator: not read" in told and "flightid map" in told
    flightid.done("map", recorded, "--out", tmp_path / "draft")
    told = flightid.done("maneuvers", recorded, "--channels", tmp_path / "draft" / "channels.toml")
    assert "2 maneuvers (1 3-2-1-1, 1 doublet)" in told and "looks like" not in told
