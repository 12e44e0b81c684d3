"""Vehicle files of the model aircraft: read, written, refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scenarios.files.aircraft_files import read_aircraft, read_model_file, vehicle_file_text
from scenarios.files.declarations import read_toml_source
from scenarios.files.vehicles import read_any_vehicle, read_vehicle
from sim.declaration.compile import compile_model
from sim.errors import DeclarationError
from sim.vehicles.aircraft import STATES, Aircraft, Thrust, aircraft_model
from tests.airliner import AIRLINER, ELEVATOR, THRUST

TRIMMED = replace(AIRLINER, start={**AIRLINER.start, "elevator": ELEVATOR, "thrust": THRUST})
MIXED = replace(
    TRIMMED,
    surfaces={"left": "rad", "right": "rad", "rudder": "rad"},
    mixes={"elevator": {"left": 0.5, "right": 0.5}, "aileron": {"left": 0.5, "right": -0.5}},
    thrust=Thrust("throttle", ((0.0, 0.4, 1.0), (0.0, 9e3, 20e3))),
    varying=("mass",),
    further=("psi",),
    wind="earth",
    start=AIRLINER.start,
)


def file_of(folder: Path, aircraft: Aircraft = TRIMMED) -> Path:
    path = folder / "plane.toml"
    path.write_text(vehicle_file_text(aircraft), encoding="utf-8")
    return path


QUOTED = replace(TRIMMED, name='the "new" wing\\ \x7f\n\u00fc')


@pytest.mark.long
@pytest.mark.parametrize(
    "aircraft",
    [
        QUOTED,
        TRIMMED,
        MIXED,
        replace(TRIMMED, recorded=("alpha", "q"), attitude="quaternion"),
        replace(TRIMMED, sensors={"beta": (8.0, 0.0, 0.0)}, estimated=("beta_x", "beta_z")),
    ],
    ids=["quotes in its name", "plain", "mixed", "recorded", "estimated places"],
)
def test_what_is_written_is_read_back(tmp_path: Path, aircraft: Aircraft) -> None:
    read, constraints = read_aircraft(read_toml_source(file_of(tmp_path, aircraft)))
    assert read == replace(aircraft, start=read.start) and not constraints
    one, other = compile_model(aircraft_model(aircraft)), compile_model(aircraft_model(read))
    assert one.input_names == other.input_names and one.parameters == other.parameters


@pytest.mark.long
def test_a_vehicle_file_serves_as_vehicle_and_as_model(tmp_path: Path) -> None:
    path = file_of(tmp_path)
    vehicle = read_vehicle(path, "aircraft")
    assert vehicle.model == "aircraft" and vehicle.own is not None
    assert vehicle.derivatives["Cm_alpha"] == -1.0 and vehicle.constants["mass"] == 17600.0
    assert read_any_vehicle(path).derivatives == vehicle.derivatives
    assert read_model_file(path).model.parameters == vehicle.own.parameters


@pytest.mark.long
def test_units_and_constraints(tmp_path: Path) -> None:
    path = file_of(tmp_path)
    text = path.read_text().replace("mass = 17600.0", 'mass = "17.6 t"')
    text = text.replace("wing_area = 64.0", 'wing_area = "688.890 ft2"')
    path.write_text(text + "\n[fixed]\nCn_aileron = 0.0\n[bounds]\nCm_q = [-40, -5]\n")
    aircraft, constraints = read_aircraft(read_toml_source(path))
    assert aircraft.constants["mass"] == pytest.approx(17600.0)
    assert aircraft.constants["wing_area"] == pytest.approx(64.0, rel=1e-4)
    assert aircraft.parameters["Cn_aileron"][0] == 0.0
    assert constraints.fixed == ("Cn_aileron",) and "Cm_q" in constraints.bounds
    model = read_model_file(path).model
    assert not model.parameters["Cn_aileron"].free


def test_sigmas_stand_beside_the_values(tmp_path: Path) -> None:
    text = vehicle_file_text(TRIMMED, {"Cm_alpha": 0.0123})
    assert '"alpha" = -1.0 # +- 0.012' in text


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"beta" = -0.9', '"betta" = -0.9', "unknown signal betta"),
        ("[aerodynamics.Cm]", "[aerodynamics.CM]", "there is no coefficient CM"),
        ("mass = 17600.0", 'mass = "17 m"', "mass"),
        ("mass = 17600.0", "", "missing: mass"),
        ("mass = 17600.0", "mas = 17600.0", "there is no such key"),
        ("yaw_inertia = 450000.0", "yaw_inertia = 900000.0", "which no body has"),
        ('elevator = "rad"', 'elevator = "deg"', "no unit of a surface"),
        ('input = "thrust"', 'input = "throttle"', "a throttle needs the thrust"),
        ('input = "thrust"', 'input = "rocket"', "'rocket' is no input"),
        ("columns = []", 'columns = ["fuel"]', "fuel cannot stand there"),
        ("columns = []", 'attitude = "matrix"', "no way to integrate"),
        ("columns = []", 'recorded = ["alfa"]', "alfa cannot stand there"),
        ("columns = []", f"recorded = {list(STATES)}", "nothing is left to simulate"),
        ("wind = false", "wind = true", "the heading is no state"),
        ("wind = false", 'wind = "bodies"', "no axes of a wind"),
        ("[sensors.alpha]", '[sensors.alpha]\nestimated = ["u"]', "'u' is no axis"),
        ("thrust = 11140.63", "flap = 0.1", "flap is no input"),
    ],
)
def test_bad_files_are_refused_in_one_line(tmp_path: Path, old: str, new: str, told: str) -> None:
    path = file_of(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(DeclarationError, match=told) as caught:
        read_vehicle(path, "aircraft")
    assert "\n" not in str(caught.value)


def test_the_place_of_a_recorded_vane_is_not_estimated(tmp_path: Path) -> None:
    path = file_of(tmp_path)
    text = path.read_text().replace("columns = []", 'recorded = ["alpha"]')
    path.write_text(text.replace("[sensors.alpha]", '[sensors.alpha]\nestimated = ["x"]'))
    with pytest.raises(DeclarationError, match="alpha is recorded"):
        read_vehicle(path, "aircraft")


@pytest.mark.parametrize(("text", "axes"), [("true", "earth"), ('"body"', "body")])
def test_axes_of_the_wind(tmp_path: Path, text: str, axes: str) -> None:
    path = file_of(tmp_path, replace(TRIMMED, further=("psi",)))
    path.write_text(path.read_text().replace("wind = false", f"wind = {text}"))
    aircraft, _ = read_aircraft(read_toml_source(path))
    assert aircraft.wind == axes
    path.write_text(vehicle_file_text(aircraft))
    assert read_aircraft(read_toml_source(path))[0].wind == axes


@pytest.mark.long
def test_values_of_the_file_reach_the_equations(tmp_path: Path) -> None:
    model = read_model_file(file_of(tmp_path)).model
    system = compile_model(model)
    x = [130.0, AIRLINER.start["alpha"], 0.0, 0.0, 0.0, 0.0, 0.0, AIRLINER.start["theta"]]
    rates = system.f(0.0, x, [ELEVATOR, 0.0, 0.0, THRUST], system.parameters.values().tolist())
    assert np.abs(rates) == pytest.approx(np.zeros(8), abs=1e-5)


def test_a_vehicle_file_of_another_model_is_told_as_such(tmp_path: Path) -> None:
    path = tmp_path / "trainer.toml"
    path.write_text('name = "trainer"\naircraft_class = "I"\n[derivatives]\nCm_alpha = -0.7\n')
    with pytest.raises(DeclarationError, match="vehicle file of another model; write one of"):
        read_aircraft(read_toml_source(path))
