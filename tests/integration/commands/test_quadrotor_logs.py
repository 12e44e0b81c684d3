"""Logs of a quadrotor under its rate controller: to identified parameters and a diagnosis with the
numbers of a table made by hand.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.integration.command_line import CommandLine
from tests.recorders.quadrotor import TRUTH, VEHICLE, ardupilot, by_hand, flight, px4

pytest.importorskip("pyulog")
pytest.importorskip("pymavlink")
WRITERS = {".ulg": px4, ".bin": ardupilot}


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with one flight as ``quad.ulg``, ``quad.bin`` and ``quad.csv``, and one whose roll
    gyro is 30 ms late as ``late.*``.
    """
    folder = tmp_path_factory.mktemp("quadrotor")
    (folder / "quad.toml").write_text(VEHICLE)
    for name, columns in (("quad", flight()), ("late", flight(gyro_delay=0.03, seed=12))):
        by_hand(folder / f"{name}.csv", columns)
        for suffix, write in WRITERS.items():
            write(folder / f"{name}{suffix}", columns)
    return folder


def done(
    flightid: CommandLine, command: str, log: Path, out: Path, *options: str
) -> dict[str, Any]:
    """The JSON of a study of a log, its channel map drafted by ``flightid map``; of a table none is
    needed.
    """
    chosen: list[str] = []
    if log.suffix != ".csv":
        draft = out / "draft"
        flightid.done("map", str(log), "--out", str(draft))
        chosen = ["--channels", str(draft / "channels.toml")]
    vehicle = str(log.parent / "quad.toml")
    flightid.done(
        command,
        str(log),
        "--model",
        "multirotor",
        "--vehicle",
        vehicle,
        *chosen,
        *options,
        "--no-figures",
        "--out",
        str(out / "study"),
    )
    name = "comparison.json" if command == "identify" else "diagnosis.json"
    return dict(json.loads((out / "study" / name).read_text()))


@pytest.mark.long
@pytest.mark.parametrize(
    "method", ["output-error", pytest.param("equation-error", marks=pytest.mark.slow)]
)
def test_logs_give_the_truth_and_the_numbers_of_a_table_made_by_hand(
    flightid: CommandLine, logs: Path, tmp_path: Path, method: str
) -> None:
    found = {
        suffix: done(
            flightid, "identify", logs / f"quad{suffix}", tmp_path / suffix[1:], "--method", method
        )
        for suffix in (".csv", *WRITERS)
    }
    expected = found[".csv"]["parameters"]
    assert set(expected) == set(TRUTH)
    for name, truth in TRUTH.items():
        assert abs(expected[name]["estimate"] - truth) < 3.0 * expected[name]["std"], (
            name,
            expected[name],
        )
        assert expected[name]["std"] < 0.01 * abs(truth) + 0.03, name
        for suffix in WRITERS:
            parameter = found[suffix]["parameters"][name]
            assert parameter["estimate"] == pytest.approx(
                expected[name]["estimate"], abs=1e-3 * expected[name]["std"]
            ), (suffix, name)
            assert parameter["std"] == pytest.approx(expected[name]["std"], rel=1e-3), (
                suffix,
                name,
            )


@pytest.mark.long
@pytest.mark.parametrize(
    "suffixes", [(".ulg",), pytest.param((".csv", ".ulg", ".bin"), marks=pytest.mark.slow)]
)
def test_a_late_gyro_is_traced_from_logs_with_the_numbers_of_a_table(
    flightid: CommandLine, logs: Path, tmp_path: Path, suffixes: tuple[str, ...]
) -> None:
    found = {
        suffix: done(flightid, "diagnose", logs / f"late{suffix}", tmp_path / suffix[1:])
        for suffix in suffixes
    }
    expected = found[suffixes[0]]
    assert expected["verdict"] == "traced" and [
        effect["name"] for effect in expected["effects"]
    ] == ["sensor-delay:p"]
    delay = expected["effects"][0]["parameters"]["delay"]
    assert abs(delay["value"] - 0.03) < 3.0 * delay["std"] and delay["std"] < 1e-3
    after = expected["parameters"]["after"]
    for name, truth in TRUTH.items():
        assert abs(after[name]["value"] - truth) < 3.0 * after[name]["std"], (name, after[name])
    for suffix in suffixes[1:]:
        assert found[suffix]["verdict"] == "traced" and [
            effect["name"] for effect in found[suffix]["effects"]
        ] == ["sensor-delay:p"]
        for name in TRUTH:
            same = found[suffix]["parameters"]["after"][name]
            assert same["value"] == pytest.approx(
                after[name]["value"], abs=1e-2 * after[name]["std"]
            ), (suffix, name)


@pytest.mark.long
def test_a_sound_quadrotor_is_not_accused(
    flightid: CommandLine, logs: Path, tmp_path: Path
) -> None:
    found = done(flightid, "diagnose", logs / "quad.bin", tmp_path)
    assert found["verdict"] == "consistent" and not found["effects"]


@pytest.mark.long
def test_the_drafts_of_a_log_alone_lead_to_the_truth(
    flightid: CommandLine, logs: Path, tmp_path: Path
) -> None:
    printed = flightid.done("map", str(logs / "quad.ulg"), "--out", str(tmp_path / "draft"))
    assert "--model multirotor" in printed
    text = (tmp_path / "draft" / "channels.toml").read_text()
    assert 'thrust_command = "-vehicle_thrust_setpoint.xyz[2]"' in text and "elevator" not in text
    drafts = [
        "--channels",
        str(tmp_path / "draft" / "channels.toml"),
        "--vehicle",
        str(tmp_path / "draft" / "vehicle.toml"),
    ]
    out = tmp_path / "study"
    flightid.done(
        "identify",
        str(logs / "quad.ulg"),
        "--model",
        "multirotor",
        *drafts,
        "--no-figures",
        "--out",
        str(out),
    )
    for name, parameter in json.loads((out / "comparison.json").read_text())["parameters"].items():
        assert abs(parameter["estimate"] - TRUTH[name]) < 3.0 * parameter["std"], name


@pytest.mark.long
def test_idle_motors_are_said(flightid: CommandLine, tmp_path: Path) -> None:
    columns = flight(duration=9.0)
    columns["thrust_command"] = 0.0 * columns["time"]
    by_hand(tmp_path / "bench.csv", columns)
    (tmp_path / "quad.toml").write_text(VEHICLE)
    printed = flightid.done(
        "identify",
        str(tmp_path / "bench.csv"),
        "--model",
        "multirotor",
        "--vehicle",
        str(tmp_path / "quad.toml"),
        "--no-figures",
    )
    assert "thrust_command is zero throughout" in " ".join(printed.split())


def test_maneuvers_of_a_quadrotor_are_found_in_its_commands(
    flightid: CommandLine, logs: Path, tmp_path: Path
) -> None:
    flightid.done("map", str(logs / "quad.ulg"), "--out", str(tmp_path / "draft"))
    channels = str(tmp_path / "draft" / "channels.toml")
    printed = flightid.done(
        "maneuvers", str(logs / "quad.ulg"), "--channels", channels, "--no-figures"
    )
    lines = [line.split() for line in printed.splitlines()]
    rows = [(words[3], words[5]) for words in lines if len(words) > 6 and words[0].isdigit()]
    assert {("roll", "roll_command"), ("pitch", "pitch_command"), ("yaw", "yaw_command")} <= set(
        rows
    )
