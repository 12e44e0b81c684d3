"""Bad input of model aircraft: one line that says what, where and how to mend, exit code 2, nothing
written.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from scenarios.files.aircraft_files import vehicle_file_text
from scenarios.files.writing import write_record
from sim.record import Channel, Hold, Record
from sim.vehicles.aircraft import aircraft_model
from tests.airliner import AIRLINER
from tests.bases import AIRLINER_NOISE, airliner_flight, fly_model
from tests.integration.command_line import CommandLine

Rows = dict[str, np.ndarray]
DEGREE = np.pi / 180.0


@pytest.fixture(scope="module")
def flown() -> Rows:
    """A flight of 4 s in SI, without its time."""
    flight, model = airliner_flight(4.0), aircraft_model(AIRLINER).with_noise(AIRLINER_NOISE)
    names = [signal.name for signal in (*model.equations.inputs, *model.equations.outputs)]
    rows = dict(zip(names, (*flight.u, *fly_model(model, flight)), strict=True))
    rng = np.random.default_rng(2)
    noise = {name: 1e-4 * rng.standard_normal(len(row)) for name, row in rows.items()}
    return {name: row + noise[name] for name, row in rows.items()} | {"time": flight.time}


def files(folder: Path, rows: Mapping[str, np.ndarray], edit: tuple[str, str] = ("", "")) -> None:
    """``flight.csv`` of plain numbers, and ``plane.toml`` with one text in the place of another."""
    units = {signal.name: signal.unit for signal in _signals()}
    order = [signal.name for signal in aircraft_model(AIRLINER).equations.inputs]
    channels = {
        name: Channel.of(name, units[name], row) for name, row in rows.items() if name != "time"
    }
    record = Record(
        rows["time"],
        tuple(channels[name] for name in order if name in channels),
        tuple(each for name, each in channels.items() if name not in order),
        Hold.PREVIOUS,
        "flight",
    )
    write_record(folder, record, "flight")
    text = vehicle_file_text(AIRLINER)
    assert edit[0] in text
    (folder / "plane.toml").write_text(text.replace(*edit, 1) if edit[0] else text)


def _signals() -> tuple:
    equations = aircraft_model(AIRLINER).equations
    return (*equations.inputs, *equations.outputs)


def scaled(factor: float, *names: str) -> Callable[[Rows], Rows]:
    return lambda rows: {**rows, **{name: factor * rows[name] for name in names}}


RECORDS: dict[str, tuple[Callable[[Rows], Rows], tuple[str, ...]]] = {
    "collinear surfaces": (
        lambda rows: {**rows, "rudder": 0.5 * rows["aileron"]},
        ("aileron and rudder move together", "flight.csv", "move one after the other"),
    ),
    "no thrust": (
        lambda rows: {name: row for name, row in rows.items() if name != "thrust"},
        ("there is no column 'thrust'", "--channels"),
    ),
    "surfaces in degrees": (
        scaled(1.0 / DEGREE, "elevator", "aileron", "rudder"),
        ("flight.csv, channel", "in degrees", "header"),
    ),
    "all angles in degrees": (
        scaled(1.0 / DEGREE, "elevator", "alpha", "beta", "p", "q", "r", "phi", "theta"),
        ("flight.csv, channel", "in degrees", "_deg"),
    ),
    "accelerations in g": (
        scaled(1.0 / 9.80665, "ax", "ay", "az"),
        ("flight.csv, channel az", "in g", "channel map"),
    ),
    "accelerations in ft/s2": (
        scaled(1.0 / 0.3048, "ax", "ay", "az"),
        ("flight.csv, channel az", "in ft/s2", "channel map"),
    ),
}
VEHICLES: dict[str, tuple[tuple[str, str], tuple[str, ...]]] = {
    "triangle inequality": (
        ("yaw_inertia = 450000.0", "yaw_inertia = 900000.0"),
        ("sum of the other two", "yaw_inertia"),
    ),
    "unknown signal": (
        ('"alpha^2" =', '"alpha*flap" ='),
        ("unknown signal flap", "aerodynamics.CD", "[surfaces]"),
    ),
    "span in feet": (("span = 21.5", "span = 70.54"), ("wing_area = 64 m2", "span 70.54 m", "ft")),
    "mass in slugs": (("mass = 17600.0", "mass = 1205.0"), ("radius of gyration", "slug")),
    "density in slug/ft3": (("air_density = 0.73", "air_density = 0.0014"), ("43 km", "slug/ft3")),
    "speed of sound in ft/s": (
        ("speed_of_sound = 320.0", "speed_of_sound = 1050.0"),
        ("no air", "ft/s"),
    ),
}


def refused(flightid: CommandLine, folder: Path, command: str, *more: object) -> str:
    """The line of a command that is refused, which wrote nothing."""
    told = flightid.refused(
        command, folder / "flight.csv", *more, "--vehicle", folder / "plane.toml",
        "--no-figures", "--out", folder / "out",
    )  # fmt: skip
    assert not (folder / "out").exists()
    return told


@pytest.mark.parametrize("case", RECORDS)
def test_records(flightid: CommandLine, tmp_path: Path, flown: Rows, case: str) -> None:
    change, words = RECORDS[case]
    files(tmp_path, change(flown))
    told = refused(flightid, tmp_path, "structure")
    assert all(word in told for word in words), told
    if case == "collinear surfaces":
        assert refused(flightid, tmp_path, "identify", "--model", "aircraft") == told


@pytest.mark.parametrize("case", VEHICLES)
def test_vehicles(flightid: CommandLine, tmp_path: Path, flown: Rows, case: str) -> None:
    edit, words = VEHICLES[case]
    files(tmp_path, flown, edit)
    told = refused(flightid, tmp_path, "structure")
    assert all(word in told for word in words), told


def test_a_diagnosis_refuses_them_too(flightid: CommandLine, tmp_path: Path, flown: Rows) -> None:
    files(tmp_path, RECORDS["surfaces in degrees"][0](flown))
    assert "in degrees" in refused(flightid, tmp_path, "diagnose", "--model", "aircraft")


def test_terms_of_one_surface_are_found_where_two_move_together(
    flightid: CommandLine, tmp_path: Path, flown: Rows
) -> None:
    """A list that offers one of them asks nothing of the other."""
    files(tmp_path, RECORDS["collinear surfaces"][0](flown))
    offered = 'CD = ["alpha"]\nCL = ["alpha"]\nCm = ["alpha", "q", "elevator"]\nCn = ["beta"]\n'
    (tmp_path / "offered.toml").write_text(offered + 'Cl = ["p", "aileron"]\nCY = ["beta"]\n')
    flightid.done(
        "structure", tmp_path / "flight.csv", "--vehicle", tmp_path / "plane.toml", "--terms",
        tmp_path / "offered.toml", "--no-figures", "--out", tmp_path / "out",
    )  # fmt: skip
    assert (tmp_path / "out").is_dir()


def test_a_vehicle_file_of_aircraft_names_its_model(
    flightid: CommandLine, tmp_path: Path, flown: Rows
) -> None:
    files(tmp_path, flown)
    told = refused(flightid, tmp_path, "identify", "--model", "lateral")
    assert "is for the aircraft model (key model), not for lateral" in told


def test_check_and_maneuvers_take_the_files_of_aircraft(
    flightid: CommandLine, tmp_path: Path, flown: Rows
) -> None:
    """A vehicle file without terms, and a channel map with surfaces of its own names."""
    files(tmp_path, flown)
    text = (tmp_path / "plane.toml").read_text()
    (tmp_path / "plane.toml").write_text(text[: text.index("[aerodynamics.")])
    surfaces = list(AIRLINER.surfaces)
    lines = [f'{name} = "{name}"' for name in (*surfaces, "alpha", "q", "az", "airspeed")]
    channels = tmp_path / "channels.toml"
    channels.write_text("\n".join(['time = "time"', 'left_elevon = "elevator"', *lines]))
    read = (tmp_path / "flight.csv", "--channels", channels)
    flightid.done("check", *read, "--vehicle", tmp_path / "plane.toml", "--no-figures")
    told = " ".join(flightid.done("maneuvers", *read, "--no-figures").split())
    assert "left_elevon" in told and "not searched; add the control that they make" in told
    channels.write_text('time = "time"\nalphha = "alpha"')
    assert "did you mean 'alpha'?" in flightid.refused("check", *read)
