"""Aircraft whose surfaces are arranged in other ways: canard, flaps, flaperons and strake as those
of an X-29, a V-tail with a throttle; mass and centre of gravity that change along the record.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import flightid as fid
from scenarios.files.aircraft_files import read_aircraft
from scenarios.files.declarations import read_toml_source
from sim.declaration.compile import compile_model
from sim.record import Hold
from sim.vehicles.aircraft import Aircraft, aircraft_model
from tests.bases import Flight, fly

HEAD = """model = "aircraft"
name = "NAME"
mass = 7000.0
wing_area = 17.2
chord = 2.2
span = 8.29
roll_inertia = 6.0e3
pitch_inertia = 70e3
yaw_inertia = 74e3
cross_inertia = 2e3
air_density = 0.9
airspeed = 180.0
trim_alpha = 0.05
trim_theta = 0.05
"""
SWEPT_FORWARD = """
[surfaces]
canard = "rad"
left_flap = "rad"
right_flap = "rad"
strake = "rad"
rudder = "rad"
[mixes.flap]
left_flap = 0.5
right_flap = 0.5
[mixes.flaperon]
left_flap = 0.5
right_flap = -0.5
[thrust]
input = "thrust"
[aerodynamics.CD]
"1" = 0.03
"alpha^2" = 1.2
"flap" = 0.05
[aerodynamics.CY]
"beta" = -0.8
"rudder" = 0.2
[aerodynamics.CL]
"1" = 0.06
"alpha" = 4.6
"canard" = 0.5
"flap" = 1.5
"strake" = 0.2
[aerodynamics.Cl]
"beta" = -0.1
"p" = -0.35
"r" = 0.1
"flaperon" = -0.12
"rudder" = 0.02
[aerodynamics.Cm]
"1" = 0.01
"alpha" = -0.3
"q" = -6.0
"canard" = 0.6
"flap" = -0.2
"strake" = -0.15
[aerodynamics.Cn]
"beta" = 0.15
"r" = -0.3
"flaperon" = -0.01
"rudder" = -0.1
"""
V_TAIL = """
columns = ["mass", "cg_x"]
[surfaces]
left_tail = "rad"
right_tail = "rad"
aileron = "rad"
[mixes.elevator]
left_tail = 0.5
right_tail = 0.5
[mixes.rudder]
left_tail = 0.5
right_tail = -0.5
[thrust]
input = "throttle"
maximum = 40e3
[aerodynamics.CD]
"1" = 0.03
"alpha^2" = 1.2
[aerodynamics.CY]
"beta" = -0.8
"rudder" = 0.2
[aerodynamics.CL]
"1" = 0.06
"alpha" = 4.6
"elevator" = 0.5
[aerodynamics.Cl]
"beta" = -0.1
"p" = -0.35
"r" = 0.1
"aileron" = -0.12
"rudder" = 0.02
[aerodynamics.Cm]
"1" = 0.01
"alpha" = -0.3
"q" = -6.0
"elevator" = -0.6
[aerodynamics.Cn]
"beta" = 0.15
"r" = -0.3
"aileron" = -0.01
"rudder" = -0.1
"""
NOISE = {
    "airspeed": 0.1,
    **dict.fromkeys(("alpha", "beta", "p", "q", "r", "phi", "theta"), 1e-3),
    **dict.fromkeys(("ax", "ay"), 0.02),
    "az": 0.05,
}


def flown(aircraft: Aircraft, seed: int) -> pd.DataFrame:
    """Twenty seconds in which every surface moves by a sum of sines of its own, with noise."""
    rng = np.random.default_rng(seed)
    time = 0.04 * np.arange(501)
    system = compile_model(aircraft_model(aircraft))
    given = {
        "thrust": np.full(len(time), 8e3),
        "throttle": np.full(len(time), 0.2),
        "mass": 7000.0 - 3.0 * time,
        "cg_x": 0.05 - 0.002 * time,
    }
    for name in aircraft.surfaces:
        frequency = np.array([0.15, 0.3, 0.5, 0.8, 1.2]) * rng.uniform(0.85, 1.15, 5)
        phase = rng.uniform(0.0, 2.0 * np.pi, 5)
        sines = np.sin(2.0 * np.pi * np.outer(time, frequency) + phase)
        given[name] = 0.019 * np.minimum(time, 1.0) * sines.sum(axis=1)
    inputs = {signal.name: given[signal.name] for signal in system.inputs}
    flight = Flight(time, np.array(list(inputs.values())), hold=Hold.LINEAR, max_step=0.02)
    rows = dict(zip(system.output_names, fly(system, flight), strict=True))
    measured = {
        name: rows[name] + std * rng.standard_normal(len(time)) for name, std in NOISE.items()
    }
    return pd.DataFrame({"time": time, **inputs, **measured})


@pytest.mark.parametrize(("text", "seed"), [(SWEPT_FORWARD, 1), (V_TAIL, 2)])
def test_values_and_terms_of_any_arrangement_of_surfaces(
    text: str, seed: int, tmp_path: Path
) -> None:
    path = tmp_path / "vehicle.toml"
    path.write_text(HEAD + text)
    aircraft, *_ = read_aircraft(read_toml_source(path))
    record = flown(aircraft, seed)
    found = fid.identify(record, "aircraft", str(path), hold="linear").to_dataframe()
    true = pd.Series({name: value for name, (value, _) in aircraft.parameters.items()})
    z = (found["value"] - true) / found["sigma"]
    assert set(z.index) == set(true.index) and np.max(np.abs(z)) < 4.0
    assert np.mean(np.abs(z) < 2.0) > 0.85
    # Terms by regression: the signals that act, mixes among them, with what is left of noise.
    chosen = fid.structure(record, str(path), hold="linear", degree=1).terms
    for axis in ("CY", "CL", "Cl", "Cm", "Cn"):
        offered = {term.text for term in aircraft.coefficients[axis]}
        assert {*chosen[axis]} - {"1"} == offered - {"1"}, axis
        for term, value in aircraft.coefficients[axis].items():
            if abs(value) > 0.05:
                assert chosen[axis][term.text] == pytest.approx(value, rel=0.15), (axis, term.text)
