"""From the files of recorders to identified parameters and a diagnosis: the numbers are those of a
table made by hand.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.integration.command_line import CommandLine
from tests.recorders.flights import TRUTH, VEHICLE, ardupilot, flight, px4, sweep

pytest.importorskip("pyulog")
pytest.importorskip("pymavlink")
PX4 = """elevator = {column = "30 * 0.5*(actuator_servos.control[0] + actuator_servos.control[1])", unit = "deg"}
alpha = "vane.angle_of_attack"
q = "vehicle_angular_velocity.xyz[1]"
"""  # noqa: E501
ARDUPILOT = """elevator = "0.5*(pwm(RCOU.C2, 1510, 572.9577951308232) - pwm(RCOU.C1, 1500, 572.9577951308232))"
alpha = {column = "AOA.AOA", unit = "deg"}
q = "IMU[0].GyrY"
"""  # noqa: E501
PX4_AIRSPEED = 'airspeed = "airspeed_validated.true_airspeed_m_s"\n'
ARDUPILOT_AIRSPEED = 'airspeed = "ARSP.Airspeed"\n'


def estimates(
    flightid: CommandLine, folder: Path, record: Path, channels: str = ""
) -> dict[str, dict[str, float]]:
    """Parameters of the rigid model from a record."""
    (folder / "uav.toml").write_text(VEHICLE)
    (folder / "map.toml").write_text(channels)
    options = ["--channels", str(folder / "map.toml")] if channels else []
    out = folder / f"study-{record.suffix[1:]}"
    flightid.done(
        "identify",
        str(record),
        "--model",
        "rigid",
        "--vehicle",
        str(folder / "uav.toml"),
        *options,
        "--no-figures",
        "--out",
        str(out),
    )
    content = json.loads((out / "comparison.json").read_text())
    return dict(content["parameters"])


def by_hand(folder: Path, columns: dict[str, np.ndarray]) -> Path:
    path = folder / "hand.csv"
    rows = [
        ",".join(columns),
        *(
            ",".join(repr(float(value)) for value in row)
            for row in zip(*columns.values(), strict=True)
        ),
    ]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.long
def test_logs_give_the_numbers_of_a_table_made_by_hand(
    flightid: CommandLine, tmp_path: Path
) -> None:
    _same_numbers(flightid, tmp_path, flight())


@pytest.mark.long
def test_a_recorded_airspeed_that_swings_gives_the_numbers_of_a_table_made_by_hand(
    flightid: CommandLine, tmp_path: Path
) -> None:
    _same_numbers(flightid, tmp_path, flight(elevator=sweep, swing=0.8))


@pytest.mark.long
def test_sweeps_of_elevons_give_the_numbers_of_a_table_made_by_hand(
    flightid: CommandLine, tmp_path: Path
) -> None:
    _same_numbers(flightid, tmp_path, flight(elevator=sweep))


def _same_numbers(flightid: CommandLine, tmp_path: Path, columns: dict[str, np.ndarray]) -> None:
    expected = estimates(flightid, tmp_path, by_hand(tmp_path, columns))
    for name, truth in TRUTH.items():
        assert abs(expected[name]["estimate"] - truth) < 3.5 * expected[name]["std"], name
    flown = "airspeed" in columns
    logs = [(px4(tmp_path / "uav.ulg", columns), PX4 + flown * PX4_AIRSPEED)]
    mapped = ARDUPILOT + flown * ARDUPILOT_AIRSPEED
    logs += [(ardupilot(tmp_path / name, columns), mapped) for name in ("uav.bin", "uav.log")]
    for log, channels in logs:
        found = estimates(flightid, tmp_path, log, channels)
        for name in TRUTH:
            assert found[name]["estimate"] == pytest.approx(
                expected[name]["estimate"], abs=1e-3 * expected[name]["std"]
            ), (log.name, name)


@pytest.mark.long
def test_topics_at_a_fifth_of_the_rate_give_the_truth(
    flightid: CommandLine, tmp_path: Path
) -> None:
    found = estimates(flightid, tmp_path, px4(tmp_path / "uav.ulg", flight(), every=5), PX4)
    for name, truth in TRUTH.items():
        assert abs(found[name]["estimate"] - truth) < max(
            4.0 * found[name]["std"], 0.05 * abs(truth)
        ), (name, found[name])


@pytest.mark.long
@pytest.mark.parametrize(
    ("suffix", "write", "channels"), [(".ulg", px4, PX4), (".bin", ardupilot, ARDUPILOT)]
)
def test_a_log_is_diagnosed(
    flightid: CommandLine,
    tmp_path: Path,
    suffix: str,
    write: Callable[[Path, dict[str, np.ndarray]], Path],
    channels: str,
) -> None:
    content = diagnosed(
        flightid, tmp_path, write(tmp_path / f"uav{suffix}", flight(delay=0.06)), channels
    )
    named = {
        name for effect in content["effects"] for name in (effect["name"], *effect["alternatives"])
    }
    assert content["verdict"] in ("traced", "ambiguous", "partial") and "input-delay" in named


def diagnosed(
    flightid: CommandLine, folder: Path, record: Path, channels: str = ""
) -> dict[str, Any]:
    """The diagnosis of a record with the rigid model."""
    (folder / "uav.toml").write_text(VEHICLE)
    (folder / "map.toml").write_text(channels)
    options = ["--channels", str(folder / "map.toml")] if channels else []
    out = folder / f"diagnosis-{record.suffix[1:]}"
    flightid.done(
        "diagnose",
        str(record),
        "--model",
        "rigid",
        "--vehicle",
        str(folder / "uav.toml"),
        *options,
        "--no-figures",
        "--out",
        str(out),
    )
    return dict(json.loads((out / "diagnosis.json").read_text()))


@pytest.mark.long
@pytest.mark.parametrize("delay", [0.0, pytest.param(0.06, marks=pytest.mark.slow)])
def test_logs_of_sweeps_are_diagnosed_as_the_table_made_by_hand(
    flightid: CommandLine, tmp_path: Path, delay: float
) -> None:
    columns = flight(delay=delay, elevator=sweep)
    expected = diagnosed(flightid, tmp_path, by_hand(tmp_path, columns))
    named = [effect["name"] for effect in expected["effects"]]
    if delay:
        assert named == ["input-delay"] and expected["verdict"] in ("traced", "ambiguous")
        found = expected["effects"][0]["parameters"]["delay"]
        # half a sample, by which a held input reads late
        assert abs(found["value"] - delay) < 4.0 * found["std"] + 0.005
    else:
        assert expected["verdict"] == "consistent" and not named
    for log, channels in (
        (px4(tmp_path / "uav.ulg", columns), PX4),
        (ardupilot(tmp_path / "uav.bin", columns), ARDUPILOT),
    ):
        same = diagnosed(flightid, tmp_path, log, channels)
        assert (
            same["verdict"] == expected["verdict"]
            and [effect["name"] for effect in same["effects"]] == named
        ), log.name
        for name in TRUTH:
            one, other = same["parameters"]["after"][name], expected["parameters"]["after"][name]
            assert one["value"] == pytest.approx(other["value"], abs=1e-2 * other["std"]), (
                log.name,
                name,
            )


def test_a_draft_of_a_log_is_a_map_that_reads_it(flightid: CommandLine, tmp_path: Path) -> None:
    ardupilot(tmp_path / "uav.bin", flight())
    printed = flightid.done("map", str(tmp_path / "uav.bin"), "--out", str(tmp_path / "draft"))
    text = (tmp_path / "draft" / "channels.toml").read_text()
    assert 'q = "IMU[0].GyrY"' in text and 'alpha = {column = "AOA.AOA", unit = "deg"}' in text
    assert "a log of 4 topics" in printed and "drafts to check" in printed
    assert "already" in flightid.refused(
        "map", str(tmp_path / "uav.bin"), "--out", str(tmp_path / "draft")
    )


@pytest.mark.long
def test_a_draft_finds_the_clock_with_a_gap_and_the_columns_whose_units_are_stated(
    flightid: CommandLine, tmp_path: Path
) -> None:
    columns = flight()
    time = np.where(columns["time"] < 9.0, columns["time"], columns["time"] + 30.0)
    np.savetxt(
        tmp_path / "bare.txt",
        np.column_stack([time, columns["elevator"], columns["alpha"], columns["q"]]),
        fmt="%.9g",
    )
    assert "time = 1  # increases in even steps" in flightid.done("map", tmp_path / "bare.txt")
    rows = [
        f"{a:.9g},{b:.9g},{c:.9g},{d:.9g}"
        for a, b, c, d in zip(
            *(columns[each] for each in ("time", "elevator", "q", "q")), strict=True
        )
    ]
    (tmp_path / "two.csv").write_text("\n".join(["time,elevator,q,* q (rad/s)", *rows]) + "\n")
    assert 'q = {column = "* q (rad/s)", unit = "rad/s"}' in flightid.done(
        "map", tmp_path / "two.csv"
    )
    named = "\n".join(
        [
            "time,elevator rad,q rps,Vt fps",
            *(f"{row.rsplit(',', 1)[0]},{333.0 + n}" for n, row in enumerate(rows)),
        ]
    )
    (tmp_path / "spelt.csv").write_text(named + "\n")
    drafted = flightid.done("map", tmp_path / "spelt.csv")
    assert (
        'q = {column = "q rps", unit = "rad/s"}' in drafted
        and 'airspeed = {column = "Vt fps", unit = "ft/s"}' in drafted
    )


@pytest.mark.long
def test_a_file_that_ends_within_a_row_is_read_without_it(
    flightid: CommandLine, tmp_path: Path
) -> None:
    path = by_hand(tmp_path, flight())
    whole = path.read_text()
    cut = whole[: whole.rstrip().rindex(",")]  # the recorder lost its power
    path.write_text(cut)
    assert "note: the file ends within row 2001, which is left out" in flightid.done("map", path)
    path.write_text(cut + "\n")
    drafted = flightid.done("map", path)  # needs the headers alone
    assert "channels by their names alone, as no value can be read" in drafted
    assert "row 2001: 3 cells under a header of 4" in drafted


@pytest.mark.long
def test_a_column_that_cannot_be_read_is_left_out_and_others_without_a_channel_are_named(
    flightid: CommandLine, tmp_path: Path
) -> None:
    path = by_hand(tmp_path, flight())
    first, second, *rows = path.read_text().splitlines()
    channel = first.split(",")[-1]
    spoilt = ",".join([*second.split(",")[:-1], "bad"])
    lines = [f"{first},spare", f"{spoilt},1", *(f"{row},1" for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    told = flightid.done("map", path)
    assert "# Columns without a channel: spare." in told and "NOT USABLE" not in told
    assert told.count("'bad' is not a number") == 1 and "left out: " in told
    assert f"column {channel!r}" in told


@pytest.mark.long
def test_the_next_command_has_the_options_that_opened_the_file(
    flightid: CommandLine, tmp_path: Path
) -> None:
    columns = flight()
    np.savetxt(
        tmp_path / "bare.txt",
        np.column_stack([columns[each] for each in ("elevator", "alpha", "q")]),
        fmt="%.9g",
    )
    named = ["--columns", "elevator,alpha,q"]
    assert "--rate 100 --columns elevator,alpha,q" in flightid.done(
        "map", tmp_path / "bare.txt", *named, "--rate", "100", "--out", tmp_path / "a"
    )
    assert "--rate HZ --columns elevator,alpha,q" in flightid.done(
        "map", tmp_path / "bare.txt", *named, "--out", tmp_path / "b"
    )
    assert "name the columns with --columns" in flightid.refused(
        "identify", tmp_path / "bare.txt", "--model", "rigid", "--vehicle", _uav(tmp_path)
    )


def _uav(folder: Path) -> Path:
    (folder / "uav.toml").write_text(VEHICLE)
    return folder / "uav.toml"


@pytest.mark.long
def test_a_damaged_text_log_is_refused_in_one_line(flightid: CommandLine, tmp_path: Path) -> None:
    log = ardupilot(tmp_path / "uav.log", flight())
    log.write_text(log.read_text().replace("FMT, 1, 20, IMU, QBd", "FMT, 1, 20, IMU, Q?d"))
    assert "not a readable ArduPilot DataFlash file" in flightid.refused("map", str(log))


def test_a_draft_without_a_model_says_what_to_add(flightid: CommandLine, tmp_path: Path) -> None:
    rows = "\n".join(f"{0.02 * n:.2f},{0.01 * (n % 7):.3f},{n % 5}" for n in range(50))
    (tmp_path / "half.csv").write_text(f"time,alpha,Ruder A\n{rows}\n")
    draft = tmp_path / "draft"
    printed = flightid.done("map", str(tmp_path / "half.csv"), "--out", str(draft))
    words = " ".join(printed.split())
    assert "Columns without a channel: Ruder A" in words
    assert "next: not found: elevator," in words and "flightid models" in words
