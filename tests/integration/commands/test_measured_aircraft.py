"""Measured aircraft by the commands that their owners would give; where the records are."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from ident.compatibility.check import compatibility
from ident.compatibility.trials import CompatibilitySettings
from scenarios.files.writing import write_record
from sim.record import Channel, Record
from tests.integration.command_line import CommandLine

ROOT = Path(__file__).parents[3]
AIRCRAFT = ROOT.parent / "shared" / "flightdata" / "aircraft"
PAGE = ROOT / "docs" / "how-to" / "lateral-and-longitudinal.md"
ATTAS = """
time = 1
phi = {column = 10, unit = "deg"}
airspeed = 15
elevator = {column = 22, unit = "deg"}
aileron = {column = "0.5*(NAME28 - NAME29)", unit = "deg"}
rudder = {column = 30, unit = "deg"}
"""
HFB = (
    "hfb320.asc",
    "--model",
    "longitudinal",
    "--vehicle",
    "hfb320.toml",
    "--channels",
    "map.toml",
    "--no-figures",
)
# Axis, kind, first and last second of each maneuver, as they are seen in the figures.
FLOWN = {
    "fAttasAil1": [("roll", "multistep", 55.8, 60.5)],
    "fAttasRud1": [("yaw", "doublet", 116.4, 118.7)],
    "fAttasAilRud1": [("roll", "multistep", 55.8, 60.5), ("yaw", "doublet", 116.4, 118.7)],
    "fAttasAilRud2": [("roll", "multistep", 83.3, 89.1), ("yaw", "doublet", 144.9, 147.3)],
    "hfb320": [("pitch", "3-2-1-1", 4.5, 11.8), ("pitch", "step", 25.4, 41.3)],
}


def present(name: str) -> Path:
    path = AIRCRAFT / name
    if not path.is_file():
        pytest.skip(f"the measured record {name} is not here")
    return path


def hfb(folder: Path) -> None:
    """The record, the channel map and the vehicle file of the page."""
    section = PAGE.read_text(encoding="utf-8").split("## A measured record in turbulence")[1]
    channels, vehicle = re.findall(r"```toml\n(.*?)```", section, re.DOTALL)[:2]
    (folder / "hfb320.asc").write_bytes(present("hfb320_1_10_withHeader.asc").read_bytes())
    (folder / "map.toml").write_text(channels)
    (folder / "hfb320.toml").write_text(vehicle)


def in_sigmas(content: dict[str, Any], name: str, value: float) -> float:
    row = content["parameters"][name]
    return abs(row["estimate"] - value) / float(row["std"])


@pytest.mark.slow
def test_hfb_320_by_the_commands_of_the_page(
    flightid: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    hfb(tmp_path)
    told = " ".join(flightid.done("identify", *HFB).split())
    command = " ".join(["flightid identify", *HFB[:-1], "--method filter-error"])
    assert (
        "one cause moves the residuals of airspeed, alpha, theta, q, nz and nx" in told
        and command in told
    )
    flightid.done(*command.split()[1:], "--no-figures", "--out", "fe")
    content = json.loads((tmp_path / "fe" / "comparison.json").read_text())
    assert content["outcome"] == "converged"
    # The published model: nothing of it is in the commands but its structure.
    assert in_sigmas(content, "CL_alpha", 4.328) < 2.0 and in_sigmas(content, "Cm_q", -34.7) < 1.0
    for name, value in {
        "CD_V": -0.0645,
        "CD_alpha": 0.320,
        "CL_V": 0.1487,
        "Cm_de": -1.529,
    }.items():
        assert in_sigmas(content, name, value) < 2.5, name
    assert {"held", "linear"} & set(" ".join(content["notes"] + content["warnings"]).split()), (
        "the reading of the inputs is said"
    )


@pytest.mark.sampled
@pytest.mark.parametrize("name", list(FLOWN))
def test_maneuvers_of_measured_flights(flightid: CommandLine, tmp_path: Path, name: str) -> None:
    if name == "hfb320":
        hfb(tmp_path)
        record = tmp_path / "hfb320.asc"
    else:
        record = present(f"{name}.mat")
        (tmp_path / "map.toml").write_text(ATTAS.replace("NAME", name))
    flightid.done(
        "maneuvers",
        record,
        "--channels",
        tmp_path / "map.toml",
        "--no-figures",
        "--out",
        tmp_path / "found",
    )
    found = json.loads((tmp_path / "found" / "maneuvers.json").read_text())["maneuvers"]
    moves = [each for each in found if each["kind"] != "trim"]
    assert [(each["axis"], each["kind"]) for each in moves] == [
        (axis, kind) for axis, kind, _, _ in FLOWN[name]
    ]
    for each, (_, _, start, end) in zip(moves, FLOWN[name], strict=True):
        assert [each["start"], each["end"]] == pytest.approx([start, end], abs=0.3)


def attas(name: str, columns: dict[str, tuple[int, str, float]]) -> list[Record]:
    """The two parts of a record, before and after its gap: outputs by column number, unit and
    factor.
    """
    (rows,) = [
        value for key, value in loadmat(present(f"{name}.mat")).items() if not key.startswith("_")
    ]
    cuts = np.flatnonzero(np.diff(rows[:, 0]) > 1.0) + 1
    control = (
        ("aileron", "rad", np.radians(rows[:, 27] - rows[:, 28]) / 2.0),
        ("rudder", "rad", np.radians(rows[:, 29])),
    )
    out = []
    for k, part in enumerate(np.split(np.arange(len(rows)), cuts)):
        inputs = tuple(Channel.of(each, unit, values[part]) for each, unit, values in control)
        outputs = tuple(
            Channel.of(each, unit, factor * rows[part, at])
            for each, (at, unit, factor) in columns.items()
        )
        out.append(Record(rows[part, 0] - rows[part[0], 0], inputs, outputs, name=f"{name}-{k}"))
    return out


RADIAN = float(np.pi / 180.0)
LATERAL = {
    "beta": (13, "rad", RADIAN),
    "p": (6, "rad/s", RADIAN),
    "r": (8, "rad/s", RADIAN),
    "phi": (9, "rad", RADIAN),
    "ay": (2, "m/s2", 1.0),
    "airspeed": (14, "m/s", 1.0),
}
WHOLE = LATERAL | {
    "alpha": (12, "rad", RADIAN),
    "q": (7, "rad/s", RADIAN),
    "theta": (10, "rad", RADIAN),
    "psi": (11, "rad", RADIAN),
    "ax": (1, "m/s2", 1.0),
    "az": (3, "m/s2", 1.0),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ["fAttasAilRud1", "fAttasAilRud2"])
@pytest.mark.parametrize(
    ("columns", "boom", "twin"),
    [
        (LATERAL, "vane-offset:beta", "accelerometer-offset:ay"),
        (WHOLE, "vane-offset:boom", "accelerometer-offset"),
    ],
)
def test_the_nose_boom_is_told_from_accelerometers_behind(
    name: str, columns: dict[str, Any], boom: str, twin: str
) -> None:
    """Vanes on the nose boom some 12 to 13 m ahead; accelerometers as far behind are as likely by
    kinematics, and were named.
    """
    found = compatibility(attas(name, columns), CompatibilitySettings(chord=3.159))
    told = next(finding for finding in found.findings if finding.name == boom)
    assert told.supported and abs(told.value - 12.5) < 3.0 * told.std < 3.0
    assert twin in told.group and told.probabilities[boom] > 0.8 and told.probabilities[twin] < 0.1
    assert not any(
        finding.name == twin and not finding.group
        for finding in found.findings
        if finding.supported
    )
    for channel, std in found.joint.noise_std.items():
        assert std > (1e-6 if channel in ("nz", "az", "ay", "ax", "airspeed") else 1e-8)


# Rough starting values: derivatives of a twin-jet of this size, none of them identified.
ATTAS_VEHICLE = """
name = "attas"
mass = 17631
wing_area = 64.0
span = 21.5
roll_inertia = 133367
yaw_inertia = 359593
cross_inertia = 11442
airspeed = 131.0
air_density = 0.732
trim_alpha = "2.1 deg"
trim_theta = "2.1 deg"
[derivatives]
CY_beta = -0.9
CY_p = 0.1
CY_r = 0.4
CY_dr = 0.2
Cl_beta = -0.10
Cl_p = -0.5
Cl_r = 0.2
Cl_da = -0.12
Cl_dr = 0.02
Cn_beta = 0.15
Cn_p = -0.05
Cn_r = -0.2
Cn_da = -0.005
Cn_dr = -0.12
"""
INTERVAL = 0.04  # s between samples of ATTAS


def late(record: Record, channel: str, samples: int) -> Record:
    """The record with a channel read some samples late; early where negative."""

    def moved(values: np.ndarray) -> np.ndarray:
        at = np.clip(np.arange(len(values)) - samples, 0, len(values) - 1)
        return values[at]

    return with_values(record, channel, moved)


def with_values(record: Record, channel: str, change: Callable[[np.ndarray], np.ndarray]) -> Record:
    """The record with the values of a channel changed."""

    def changed(channels: tuple[Channel, ...]) -> tuple[Channel, ...]:
        return tuple(
            replace(each, values=change(each.values)) if each.name == channel else each
            for each in channels
        )

    return replace(record, inputs=changed(record.inputs), outputs=changed(record.outputs))


# What is done to each measured record, the effect that has to be named, its size and three of its
# sigmas at most. The vane on the boom (12 to 13 m) is there whatever is done.
FAULTS = {
    "nothing": (lambda each: each, None, 0.0, 0.0),
    "aircraft responds late to the aileron": (
        lambda each: late(each, "aileron", -3),
        "input-delay:aileron",
        3 * INTERVAL,
        0.5 * INTERVAL + 0.01,  # held or linear inputs between samples differ by half an interval
    ),
    "roll rate read late": (
        lambda each: late(each, "p", 4),
        "sensor-delay:p",
        4 * INTERVAL + 0.0155,  # the record's own delay, by kinematics
        0.01,
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("what", list(FAULTS))
def test_faults_put_into_measured_records_are_named(
    flightid: CommandLine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """Two measured records with a fault put into them, their repeats predicted."""
    monkeypatch.chdir(tmp_path)
    change, effect, size, tolerance = FAULTS[what]
    names = []
    for flight in ("fAttasAilRud1", "fAttasAilRud2"):
        for record in attas(flight, LATERAL):
            names.append(f"{record.name}.csv")
            write_record(tmp_path, change(record), record.name)
    (tmp_path / "attas.toml").write_text(ATTAS_VEHICLE)
    command = ["--model", "lateral", "--vehicle", "attas.toml", "--no-figures", "--out", "found"]
    call = flightid("diagnose", *names[:2], "--validate", *names[2:], *command)
    assert call.code == 0, call.err
    content = json.loads((tmp_path / "found" / "diagnosis.json").read_text())
    claimed = {each["name"]: each for each in content["effects"] if each.get("claimed", True)}
    assert content["verdict"] == "partial"
    (arm,) = claimed["vane-offset"]["parameters"].values()
    assert abs(arm["value"] - 12.5) < 3.0 * arm["std"] < 3.0
    if effect is not None:
        (found,) = claimed[effect]["parameters"].values()
        assert found["value"] == pytest.approx(size, abs=tolerance)
    others = {"sensor-scale:p", "sensor-lag:p", "sensor-delay:p", "sensor-scale:phi"}
    assert set(claimed) <= {"vane-offset", effect} | others
