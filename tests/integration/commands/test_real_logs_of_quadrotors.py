"""Measured logs of quadrotors, where they are at hand: what they do not tell is not claimed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scenarios.files.formats.cells import numbers
from scenarios.files.measured.columns import read_record_file
from tests.integration.command_line import CommandLine

LOGS = Path(__file__).resolve().parents[4] / "shared" / "flightdata" / "logs"
pytest.importorskip("pymavlink")
pytestmark = pytest.mark.skipif(
    not LOGS.is_dir(), reason="the measured logs are not part of the project"
)


def estimated(
    flightid: CommandLine, log: Path, folder: Path, *options: str
) -> dict[str, dict[str, float]]:
    out = folder / "study"
    flightid.done(
        "identify",
        str(log),
        "--model",
        "multirotor",
        "--method",
        "equation-error",
        *options,
        "--no-figures",
        "--out",
        str(out),
    )
    return dict(json.loads((out / "comparison.json").read_text())["parameters"])


@pytest.mark.long
def test_a_hover_logged_at_10_hz_gives_the_numbers_of_a_table_and_of_plain_least_squares(
    flightid: CommandLine, tmp_path: Path
) -> None:
    log = LOGS / "ardu_sample.bin"
    flightid.done("map", str(log), "--out", str(tmp_path / "draft"))
    lines = (tmp_path / "draft" / "vehicle.toml").read_text().splitlines()
    slow = [line for line in lines if not line.startswith(("motor_time_constant", "delay"))]
    (tmp_path / "quad.toml").write_text("\n".join(slow) + "\n")
    options = ("--vehicle", str(tmp_path / "quad.toml"), "--from", "217", "--to", "250")
    (tmp_path / "log").mkdir()
    found = estimated(
        flightid,
        log,
        tmp_path / "log",
        *options,
        "--channels",
        str(tmp_path / "draft" / "channels.toml"),
    )

    time, table = _by_hand(log)
    rows = np.column_stack([time, *table.values()])
    path = tmp_path / "hand.csv"
    np.savetxt(
        path, rows, delimiter=",", header=",".join(("time", *table)), comments="", fmt="%.17g"
    )
    (tmp_path / "table").mkdir()
    same = estimated(flightid, path, tmp_path / "table", *options)
    for name, parameter in found.items():
        assert same[name]["estimate"] == pytest.approx(
            parameter["estimate"], abs=1e-3 * parameter["std"]
        ), name

    inside = (time >= 217.0) & (time <= 250.0)
    fit = np.linalg.lstsq(
        np.column_stack([np.ones(inside.sum()), table["thrust_command"][inside]]),
        table["az"][inside],
        rcond=None,
    )[0]
    for name, value in zip(("Z_0", "Z_col"), fit, strict=True):
        assert abs(found[name]["estimate"] - value) < 0.1 * found[name]["std"], name
    span = 10
    for rate, command, gain in (
        ("p", "roll_command", "L_lat"),
        ("q", "pitch_command", "M_lon"),
        ("r", "yaw_command", "N_ped"),
    ):
        rates, commands = table[rate][inside], table[command][inside]
        clock = time[inside]
        sums = [
            np.concatenate([[0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(clock))])
            for v in (rates, commands)
        ]
        columns = [each[span:] - each[:-span] for each in (*sums, clock)]
        value = np.linalg.lstsq(np.column_stack(columns), rates[span:] - rates[:-span], rcond=None)[
            0
        ][1]
        assert abs(found[gain]["estimate"] - value) < 2.0 * found[gain]["std"], (
            gain,
            found[gain],
            value,
        )


def _by_hand(log: Path) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Times of the gyro, s, and the channels on them, commands on straight lines between their own
    samples.
    """
    topics = {topic.name: topic.table for topic in read_record_file(log).topics}

    def column(topic: str, name: str) -> np.ndarray:
        return numbers(topics[topic], topics[topic].header.index(name)).values

    time, slow = 1e-6 * column("IMU", "TimeUS"), 1e-6 * column("RATE", "TimeUS")
    commands = {
        "roll_command": "ROut",
        "pitch_command": "POut",
        "yaw_command": "YOut",
        "thrust_command": "AOut",
    }
    table = {name: np.interp(time, slow, column("RATE", field)) for name, field in commands.items()}
    return time, {
        **table,
        **{
            name: column("IMU", field)
            for name, field in (("p", "GyrX"), ("q", "GyrY"), ("r", "GyrZ"), ("az", "AccZ"))
        },
    }


@pytest.mark.long
def test_a_log_with_idle_motors_says_so(flightid: CommandLine, tmp_path: Path) -> None:
    log = LOGS / "px4_sample.ulg"
    pytest.importorskip("pyulog")
    flightid.done("map", str(log), "--out", str(tmp_path / "draft"))
    drafts = (
        "--vehicle",
        str(tmp_path / "draft" / "vehicle.toml"),
        "--channels",
        str(tmp_path / "draft" / "channels.toml"),
    )
    out = tmp_path / "study"
    flightid.done(
        "identify",
        str(log),
        "--model",
        "multirotor",
        *drafts,
        "--from",
        "113",
        "--to",
        "118",
        "--rate",
        "50",
        "--no-figures",
        "--out",
        str(out),
    )
    warnings = json.loads((out / "comparison.json").read_text())["warnings"]
    assert any("thrust_command is zero throughout" in warning for warning in warnings)
