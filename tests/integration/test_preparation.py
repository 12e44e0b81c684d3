"""Preparation on the command line: several maneuvers, a measured speed, a common filter, for every
command alike.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.files.records import read_record
from tests.integration.command_line import CommandLine
from tests.oracles.falling_speed import CONSTANTS, TRUE, fly_falling
from tests.preparing import OUTPUTS, write_flown

SEGMENTS = ("--from", 1, "--to", 9, "--from", 10, "--to", 19)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A flight that slows down, with airspeed, and its vehicle file."""
    place = tmp_path_factory.mktemp("flight")
    write_flown(
        place / "flight.csv",
        fly_falling(weight=True),
        (*OUTPUTS, "airspeed"),
        np.random.default_rng(0),
    )
    numbers = [f"{name} = {value}" for name, value in CONSTANTS.items()]
    starts = [f"{name} = {0.8 * value}" for name, value in TRUE.items()]
    (place / "vehicle.toml").write_text(
        "\n".join(['name = "oracle"', *numbers, "[derivatives]", *starts])
    )
    return place


def identify(flightid: CommandLine, folder: Path, record: Path, *options: object) -> dict[str, Any]:
    out = folder / "out"
    words = ("--model", "rigid", "--vehicle", folder / "vehicle.toml", "--out", out, "--no-figures")
    flightid.done("identify", record, *words, *options)
    content: dict[str, Any] = json.loads((out / "comparison.json").read_text())
    return content


def test_segments_of_a_slowing_flight_give_the_true_derivatives(
    flightid: CommandLine, folder: Path
) -> None:
    content = identify(flightid, folder, folder / "flight.csv", *SEGMENTS)
    for name, entry in content["parameters"].items():
        assert abs(entry["estimate"] - TRUE[name]) < max(
            4.0 * entry["std"], 0.004 * abs(TRUE[name])
        ), name
    assert content["segments"] == [[1.0, 9.0], [10.0, 19.0]]
    assert any("measured airspeed used" in note for note in content["notes"])
    first, second = (
        read_record(folder / "out" / f"{stem}.csv", ["elevator"], OUTPUTS, optional=["airspeed"])
        for stem in ("record", "record_2")
    )
    assert (first.time[0], second.time[-1], first.output_names) == (
        1.0,
        19.0,
        (*OUTPUTS, "airspeed"),
    )
    assert first.name == "flight.csv[1-9 s]"


@pytest.mark.long
def test_the_record_of_a_study_gives_the_same_numbers(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    content = identify(flightid, folder, folder / "flight.csv", "--from", 1, "--to", 9)
    for name in ("record.csv", "record.json"):
        (tmp_path / name).write_bytes((folder / "out" / name).read_bytes())
    again = identify(flightid, folder, tmp_path / "record.csv")
    assert again["parameters"] == content["parameters"]


@pytest.mark.long
def test_a_filter_runs_along_one_segment(flightid: CommandLine, folder: Path) -> None:
    words = ("--model", "rigid", "--vehicle", folder / "vehicle.toml", "--method", "ekf")
    assert "a filter runs along one segment, and there are 2" in flightid.refused(
        "identify", folder / "flight.csv", *words, *SEGMENTS
    )
    assert "note: " in flightid.done("identify", folder / "flight.csv", *words, "--to", 6)


@pytest.mark.long
@pytest.mark.parametrize(
    "command", [("identify", "--model", "rigid"), ("diagnose", "--model", "rigid"), ("check",)]
)
@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (("--from", 1, "--from", 3, "--to", 4), ("2 times --from and 1 times --to", "in pairs")),
        (("--hold", "cubic"), ("there is no hold 'cubic'",)),
        (("--rate", 80), ("--rate 80 Hz is above the record's 50 Hz",)),
        (("--lowpass", -1), ("-1 Hz is no frequency",)),
        (
            ("--from", 1, "--to", 3, "--from", 30, "--to", 40),
            ("there is no row between --from and --to", "0 to 20 s"),
        ),
    ],
)
def test_every_command_refuses_alike(
    flightid: CommandLine,
    folder: Path,
    command: tuple[str, ...],
    options: tuple[object, ...],
    parts: tuple[str, ...],
) -> None:
    line = flightid.refused(
        command[0],
        folder / "flight.csv",
        *command[1:],
        "--vehicle",
        folder / "vehicle.toml",
        *options,
    )
    assert all(part in line for part in parts), line


@pytest.mark.long
def test_check_takes_segments_and_filter(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    text = flightid.done(
        "check",
        folder / "flight.csv",
        *SEGMENTS,
        "--lowpass",
        5,
        "--out",
        tmp_path / "study",
        "--no-figures",
    )
    assert "flight.csv[10-19 s]: 451 samples" in text and "low-pass of 5 Hz" in " ".join(
        text.split()
    )
    notes = json.loads((tmp_path / "study" / "compatibility.json").read_text())["notes"]
    assert any(
        "flight.csv[1-9 s]: all channels after one zero-phase low-pass of 5 Hz" in note
        for note in notes
    )


@pytest.mark.long
def test_a_vehicle_file_of_another_speed_is_warned_of_first(
    flightid: CommandLine, folder: Path, tmp_path: Path
) -> None:
    text = (folder / "vehicle.toml").read_text()
    slower = tmp_path / "slower.toml"
    slower.write_text(
        "\n".join(
            "airspeed = 90.0" if line.startswith("airspeed") else line for line in text.splitlines()
        )
    )
    call = ("--model", "rigid", "--vehicle", slower, "--no-figures", "--out", tmp_path / "out")
    warning = "warning: flight.csv: the measured airspeed, "
    for command, file in (("identify", "comparison.json"), ("diagnose", "diagnosis.json")):
        said = flightid.done(command, folder / "flight.csv", "--to", 12, *call)
        details = said.partition("\n\n")[2]
        assert details.index(warning) < details.index("alpha"), (
            "it stands before everything but the summary"
        )
        content = json.loads((tmp_path / "out" / file).read_text())
        (told,) = [
            warning
            for warning in content["warnings"]
            if "is far from 90 m/s in the vehicle file" in warning
        ]
        assert (
            told == content["warnings"][0]
            and "natural frequency and damping are those at that speed; mend airspeed there" in told
        )
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("the measured airspeed") == 1 and page.index(
        "the measured airspeed"
    ) < page.index("<section")
