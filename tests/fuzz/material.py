"""Sound inputs from which malformed ones are made: records, vehicle files, user models, study
folders.
"""

from __future__ import annotations

import contextlib
import io
from dataclasses import dataclass
from pathlib import Path

from scenarios.cli import main

VEHICLE = """\
name = "bomber"
mass = "288017 lb"
wing_area = "1946 ft2"
chord = 4.66344
pitch_inertia = "6.4e6 slug ft2"
airspeed = 200.64984
air_density = 1.055547358

[derivatives]
CL_alpha = 3.4
CL_q = -11.0
CL_de = 0.35
Cm_alpha = -1.3
Cm_q = -28.0
Cm_de = -2.1
"""
ROLL = """\
from sim.declaration import own_model

MODEL = own_model(
    name="roll",
    states={"p": "rad/s"},
    inputs={"aileron": "rad"},
    outputs={"p": "rad/s"},
    constants={"airspeed": (60.0, "m/s")},
    parameters={"L_p": (-2.0, "1/s"), "L_da": (8.0, "1/s2")},
    rates=lambda s, p: {"p": p.L_p * s.p + p.L_da * s.aileron},
    readings=lambda s, p: {"p": s.p},
)
"""
FLIGHTS = """\
title = "two flights"
model = "rigid"
vehicle = "vehicle.toml"

[[flights]]
record = "rigid.csv"
name = "F001"
date = 2026-03-02
condition = {altitude = "1500 m"}

[[flights]]
record = "second.csv"
name = "F002"
vehicle = {mass = "2.9e5 kg"}
"""
LIMITS = """\
nz_max = 2.5
alpha_max = "8 deg"
elevator_amplitude = "5 deg"
elevator_rate = "40 deg/s"
"""
CHANNELS = """\
alpha = {column = "alpha", unit = "rad"}
q = "q"
elevator = {column = "elevator"}
"""


@dataclass(frozen=True)
class Material:
    """A folder of sound inputs: files by name, and the study folders ``fit``, ``cause``, ``study``
    and ``watched``.
    """

    folder: Path

    def text(self, name: str) -> str:
        """The content of one of its files."""
        return (self.folder / name).read_text(encoding="utf-8")


def make_material(folder: Path) -> Material:
    """Write the sound inputs into an empty folder, by the commands themselves."""
    texts = {
        "vehicle.toml": VEHICLE,
        "roll.py": ROLL,
        "flights.toml": FLIGHTS,
        "limits.toml": LIMITS,
        "channels.toml": CHANNELS,
    }
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    short = ["--set", "flight.duration=6", "--set", "flight.rate=25", "--quiet"]
    rigid, vehicle, plain = (
        str(folder / "rigid.csv"),
        str(folder / "vehicle.toml"),
        ["--figures", "none", "--quiet"],
    )
    _run("simulate", "rigid", "--out", rigid, *short)
    _run("simulate", "rigid", "--seed", "2", "--out", str(folder / "second.csv"), *short)
    _run(
        "simulate",
        "--model",
        str(folder / "roll.py"),
        "--duration",
        "8",
        "--rate",
        "25",
        "--out",
        str(folder / "roll.csv"),
        "--quiet",
    )
    _run("simulate", "x29-simulation", "--out", str(folder / "long.csv"), "--quiet")
    stream = (folder / "long.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (folder / "stream.csv").write_text("".join(stream[:201]), encoding="utf-8")
    _run(
        "identify",
        rigid,
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--out",
        str(folder / "fit"),
        *plain,
    )
    _run(
        "diagnose",
        rigid,
        "--model",
        "rigid",
        "--vehicle",
        vehicle,
        "--out",
        str(folder / "cause"),
        *plain,
    )
    _run("run", "rigid", "--out", str(folder / "study"), "--figures", "none", *short)
    _run(
        "watch",
        str(folder / "stream.csv"),
        "--model",
        "loes",
        "--until-end",
        "--no-refine",
        "--out",
        str(folder / "watched"),
        "--quiet",
    )
    return Material(folder)


def _run(*arguments: str) -> None:
    said = io.StringIO()
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            main(list(arguments))
    except SystemExit as ended:
        if ended.code not in (0, None):
            raise RuntimeError(f"flightid {' '.join(arguments)}: {said.getvalue()}") from None
