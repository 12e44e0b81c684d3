"""`flightid check`: what it prints and writes, and what it refuses."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.files.writing import write_record
from sim.record import Channel
from tests.integration.command_line import VEHICLE, CommandLine, contents
from tests.oracles import six_degrees as axes
from tests.oracles.flight_path import Sensors
from tests.unit.ident.compatibility.flights import FOUR, SPEED, THREE, record

LOES = f"airspeed = {SPEED}\ngravity = 9.80665\nvane_arm = 4.0\n[derivatives]\n" + "".join(
    f"{name} = 1.0\n"
    for name in ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")
)


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder: two records with a late alpha and a vehicle file beside them."""
    for number in (1, 2):
        write_record(
            tmp_path, record(sensors=Sensors(delay={"alpha": 0.06}), seed=number), f"flight{number}"
        )
    (tmp_path / "vehicle.toml").write_text(VEHICLE.replace("200.64984", str(SPEED)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def numbers(content: Any) -> Iterator[float]:
    if isinstance(content, dict):
        content = list(content.values())
    if isinstance(content, list):
        for item in content:
            yield from numbers(item)
    elif isinstance(content, float):
        yield content


@pytest.mark.long
def test_one_record(flightid: CommandLine, place: Path) -> None:
    out = flightid.done("check", "flight1.csv", "--out", "out")
    assert "fault found: sensor-delay:alpha, alpha is late by 0.0" in out
    assert "a delay common to alpha, q and nz is not observable" in out and "written to out" in out
    content = json.loads((place / "out" / "compatibility.json").read_text())
    assert (
        content["schema"] == "flightid/compatibility/1"
        and content["constants"]["airspeed"] == SPEED
    )
    late = content["joint"]["estimates"]["sensor-delay:alpha"]
    assert late["smoother"]["value"] == pytest.approx(0.06, abs=0.005) and late["output_error"][
        "value"
    ] == pytest.approx(0.06, abs=0.005)
    assert (
        content["findings"][0]["name"] == "sensor-delay:alpha"
        and content["findings"][0]["stands"] is True
    )
    assert all(math.isfinite(value) for value in numbers(content))
    assert content["files"] == [
        "compatibility.json",
        "reconstruction.png",
        "report.html",
        "report.json",
    ]
    assert (
        content["inputs"]["records"] == ["flight1.csv"]
        and content["inputs"]["vehicle"]["name"] == "vehicle.toml"
    )


def timeless(folder: Path) -> dict[str, str]:
    """Every file of a study without the times that its page tells."""
    return {
        name: re.sub(r"\d{4}-\d\d-\d\d[T ][\d:]+Z?", "", raw.decode())
        for name, raw in contents(folder).items()
    }


@pytest.mark.long
def test_several_records_and_the_same_bytes_again(flightid: CommandLine, place: Path) -> None:
    out = flightid.done("check", "flight1.csv", "flight2.csv", "--out", "out", "--no-figures")
    assert "all records" in out and "each record by itself" in out
    first = timeless(place / "out")
    flightid.done("check", "flight1.csv", "flight2.csv", "--out", "out", "--no-figures")
    assert timeless(place / "out") == first
    content = json.loads(first["compatibility.json"])
    assert [single["records"] for single in content["single"]] == [["flight1.csv"], ["flight2.csv"]]


@pytest.mark.long
def test_degrees_odd_headers_az_and_a_window(flightid: CommandLine, place: Path) -> None:
    rows = (place / "flight1.csv").read_text().splitlines()[1:]
    lines = ["t,AoA1 [deg],q_deg_s,AZ [m/s2]"]
    for row in rows:
        t, alpha, q, nz = map(float, row.split(","))
        lines.append(f"{t},{math.degrees(alpha)!r},{math.degrees(q)!r},{-9.80665 * nz!r}")
    (place / "export.csv").write_text("\n".join(lines) + "\n")
    (place / "map.toml").write_text('time = "t"\nalpha = "AoA1"\naz = "AZ"\n')
    odd = flightid.done(
        "check", "export.csv", "--channels", "map.toml", "--from", "0.5", "--to", "18"
    )
    plain = flightid.done("check", "flight1.csv", "--from", "0.5", "--to", "18")
    assert [line for line in odd.splitlines() if "stands" in line] == [
        line for line in plain.splitlines() if "stands" in line
    ]
    assert "nz is" in odd or "az serves as nz" in odd


@pytest.mark.long
def test_a_known_vane_arm_is_no_finding(flightid: CommandLine, place: Path) -> None:
    write_record(place, record(sensors=Sensors(arm=4.0), seed=3), "vane")
    (place / "loes.toml").write_text(LOES)
    assert "no sensor fault found" in flightid.done("check", "vane.csv", "--vehicle", "loes.toml")
    assert "fault found: vane-offset" in flightid.done("check", "vane.csv")


@pytest.mark.long
def test_no_vehicle_file_is_needed_where_the_airspeed_is_recorded(
    flightid: CommandLine, place: Path
) -> None:
    (place / "vehicle.toml").unlink()
    write_record(place, record((*FOUR, "airspeed"), seed=3), "whole")
    assert "relation of alpha" in flightid.done("check", "whole.csv")
    told = flightid.done("check", "flight1.csv")
    told = " ".join(told.split())
    assert "no airspeed is recorded or given, without which the relation of alpha" in told
    assert "add --vehicle V.toml: the check takes the airspeed from it" in told
    assert "cannot show" in told


@pytest.mark.long
def test_a_dynamic_pressure_makes_the_airspeed(flightid: CommandLine, place: Path) -> None:
    """VEHICLE's air weighs 1.0555 kg/m3; its airspeed, here far too low, is not needed."""
    whole = record((*THREE, "airspeed"), Sensors(delay={"alpha": 0.06}), seed=3)
    pressure = Channel.of("dynamic_pressure", "Pa", 0.5 * 1.0555 * whole["airspeed"].values ** 2)
    write_record(place, replace(whole, outputs=(*whole.outputs[:3], pressure)), "pressure")
    (place / "vehicle.toml").write_text(VEHICLE.replace("200.64984", "65.0"))
    out = " ".join(flightid.done("check", "pressure.csv").split())
    assert (
        "fault found: sensor-delay:alpha, alpha is late by 0.0" in out
        and "airspeed from the dynamic pressure, in air of 1.05" in out
    )


@pytest.mark.long
def test_bank_heading_and_height_in_their_units(flightid: CommandLine, place: Path) -> None:
    """Degrees, g and feet, a heading through north, and a roll gyro with a bias, in the sentence
    and the file.
    """
    channels = ("p", "q", "r", "phi", "theta", "psi", "alpha", "airspeed", "height", "ay", "beta")
    record = axes.shown(axes.fly(), channels, axes.Faults(bias={"p": 0.02}, delay={"phi": 0.08}), 1)
    assert record["psi"].values.max() > 6.0 > 1.0 > record["psi"].values.min()
    units = {
        "rad": ("deg", 180.0 / math.pi),
        "rad/s": ("deg/s", 180.0 / math.pi),
        "m/s2": ("g", 1.0 / 9.80665),
        "m": ("ft", 1.0 / 0.3048),
    }
    columns, header = [record.time], ["time"]
    for channel in record.outputs:
        unit, factor = units.get(channel.unit, (channel.unit, 1.0))
        header.append(f"{channel.name} [{unit}]")
        columns.append(channel.values * factor)
    np.savetxt(
        place / "axes.csv", np.array(columns).T, delimiter=",", header=",".join(header), comments=""
    )
    out = " ".join(flightid.done("check", "axes.csv", "--out", "out", "--no-figures").split())
    assert (
        "relation of height: height, theta, alpha, airspeed, phi, beta" in out
        and "warning" not in out
    )
    assert (
        "fault found: bias:p, p reads 1." in out
        and "deg/s too much" in out
        and "phi is late by 0.0" in out
    )
    content = json.loads((place / "out" / "compatibility.json").read_text())
    found = {finding["name"]: finding for finding in content["findings"]}
    assert (
        found["bias:p"]["kind"] == "bias"
        and abs(found["bias:p"]["value"] - 0.02) < 3.0 * found["bias:p"]["std"]
    )
    assert all(math.isfinite(value) for value in numbers(content))


def test_alpha_and_q_alone_say_so(flightid: CommandLine, place: Path) -> None:
    write_record(place, record(THREE).only(["alpha", "q"]), "two")
    out = flightid.done("check", "two.csv", "--out", "out")
    assert (
        "nothing is checked: check needs channels that kinematics relate: alpha, q and nz" in out
        and "no sensor fault found" not in out
    )
    assert (
        "alpha: cannot be checked" in out
        and "without the load the lift between alpha and q is unknown" in " ".join(out.split())
    )
    assert json.loads((place / "out" / "compatibility.json").read_text())["findings"] == []


BAD: dict[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "no record": (("check",), ("missing argument 'RECORD...'",)),
    "not there": (("check", "absent.csv"), ("absent.csv", "no such file")),
    "twice": (("check", "flight1.csv", "./flight1.csv"), ("flight1.csv", "named twice", "once")),
    "none of the channels": (
        ("check", "other.csv"),
        ("other.csv, header", "no column 'alpha'", "--channels"),
    ),
    "elevator alone": (("check", "elevator.csv"), ("elevator.csv", "none of the channels")),
    "too short": (("check", "short.csv"), ("short.csv", "samples are too few", "at least 20")),
    "window": (
        ("check", "flight1.csv", "--from", "99"),
        ("flight1.csv", "no row between --from and --to"),
    ),
    "text": (("check", "text.csv"), ("text.csv, row 2", "'bad' is not a number")),
    "unit": (("check", "unit.csv"), ("column 'alpha [foo]'", "unknown unit 'foo'")),
    "standstill": (
        ("check", "still.csv"),
        ("still.csv, channel airspeed", "not above zero", "--from"),
    ),
    "beyond measure": (("check", "huge.csv"), ("huge.csv, channel alpha", "is no measurement")),
    "falling body": (
        ("check", "flight1.csv", "--vehicle", "body.toml"),
        ("body.toml", "falling body", "aircraft"),
    ),
    "vehicle not there": (
        ("check", "flight1.csv", "--vehicle", "absent.toml"),
        ("absent.toml", "no such file"),
    ),
    "vehicle wrong": (
        ("check", "flight1.csv", "--vehicle", "wrong.toml"),
        ("wrong.toml", "key chrod", "no such key"),
    ),
    "map": (
        ("check", "flight1.csv", "--channels", "map.toml"),
        ("map.toml, key alhpa", "did you mean 'alpha'?"),
    ),
}


@pytest.mark.sampled
@pytest.mark.parametrize("case", BAD)
def test_bad_input(flightid: CommandLine, place: Path, case: str) -> None:
    head, *rows = (place / "flight1.csv").read_text().splitlines()
    (place / "other.csv").write_text("time,a,b\n0,1,2\n1,2,3\n")
    (place / "elevator.csv").write_text("time,elevator\n0,1\n1,2\n")
    (place / "short.csv").write_text("\n".join([head, *rows[:10]]) + "\n")
    (place / "text.csv").write_text("\n".join([head, "0,bad,0,0", *rows[1:]]) + "\n")
    (place / "unit.csv").write_text("\n".join([head.replace("alpha", "alpha [foo]"), *rows]) + "\n")
    (place / "still.csv").write_text(
        "\n".join([f"{head},airspeed", *(f"{row},0" for row in rows)]) + "\n"
    )
    (place / "huge.csv").write_text("\n".join([head, "0,1e300,0,0", *rows[1:]]) + "\n")
    (place / "body.toml").write_text(
        "air_density_reference = 1.2\ndensity_scale_height = 7000.0\ngravity = "
        "9.8\n[derivatives]\nbeta = 100.0\n"
    )
    (place / "wrong.toml").write_text(VEHICLE.replace("chord =", "chrod ="))
    (place / "map.toml").write_text('alhpa = "AoA"\n')
    arguments, parts = BAD[case]
    before = contents(place)
    message = flightid.refused(*arguments, *([] if case == "no record" else ["--out", "out"]))
    for part in parts:
        assert part in message, message
    assert contents(place) == before and not (place / "out").exists()


def test_channels_that_need_a_map_lead_to_the_command_that_drafts_it(
    place: Path, flightid: CommandLine
) -> None:
    (place / "my log.csv").write_text("t,foo,bar\n0,1,2\n0.1,2,3\n0.2,1,4\n")
    assert "flightid map 'my log.csv' drafts one" in flightid.refused("check", "my log.csv")
