"""The aircraft file flown by JSBSim against the equations it was written from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as XML

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from scenarios.export.jsbsim import jsbsim_file
from scenarios.export.model import ExportedModel, exported
from sim.aerodynamics import FLOW, parse_term
from sim.declaration.compile import compile_model
from sim.errors import DeclarationError
from sim.vehicles.aircraft import Aircraft, aircraft_model
from tests.airliner import AIRLINER, CONSTANTS, ELEVATOR, SURFACES
from tests.bases import rigid_model

FOOT, DENSITY = 0.3048, 515.3788184  # m; kg/m3 in a slug per cubic foot
SIGNALS = (*FLOW, *SURFACES)
START = [130.0, 0.05, -0.03, 0.1, -0.05, 0.08, 0.2, 0.06]
INPUTS = {"elevator": 0.03, "aileron": 0.02, "rudder": -0.02, "thrust-n": 15e3}
END = 3.0  # s
# A sphere so large that it is flat, at rest, with standard gravity.
PLANET = """<?xml version="1.0"?>
<planet name="flat">
  <semimajor_axis unit="M">6.4e8</semimajor_axis><semiminor_axis unit="M">6.4e8</semiminor_axis>
  <rotation_rate unit="RAD/SEC">0.0</rotation_rate>
  <GM unit="M3/SEC2">{gm!r}</GM><J2>0.0</J2>
</planet>"""


def unlike_others() -> Aircraft:
    """Everything that the file can say: centre of gravity, arm and angle of the thrust, a product,
    a spline, an absolute value, mixed ailerons."""
    c = {**AIRLINER.coefficients}
    c["Cm"] = {
        **c["Cm"],
        parse_term("alpha*elevator", SIGNALS): 3.0,
        parse_term("spline(alpha, 0.03, 1)", SIGNALS): -0.5,
    }
    c["Cn"] = {**c["Cn"], parse_term("beta*abs(beta)", SIGNALS): 0.05}
    off = {"cg_x": 0.4, "cg_y": -0.1, "cg_z": 0.2, "thrust_arm": 0.5, "thrust_angle": 0.05}
    return replace(AIRLINER, constants={**CONSTANTS, **off}, coefficients=c, sensors={})


def written(aircraft: Aircraft) -> ExportedModel:
    return exported(aircraft.name, aircraft_model(aircraft), aircraft=aircraft)


def flown(
    folder: Path,
    model: ExportedModel,
    step: float,
    start: Sequence[float] = START,
    inputs: Mapping[str, float] = INPUTS,
    end: float = END,
) -> tuple[np.ndarray, np.ndarray]:
    """States ``(8, N)`` by JSBSim, and the density of its air ``(N,)``."""
    jsbsim = pytest.importorskip("jsbsim")
    place = folder / "aircraft" / model.identifier
    place.mkdir(parents=True, exist_ok=True)
    (place / f"{model.identifier}.xml").write_text(jsbsim_file(model))
    (folder / "planet.xml").write_text(PLANET.format(gm=9.80665 * 6.4e8**2))
    machine = jsbsim.FGFDMExec(str(folder))
    machine.set_debug_level(0)
    machine.set_aircraft_path(str(folder / "aircraft"))
    assert machine.load_planet(str(folder / "planet.xml"), False)
    assert machine.load_model(model.identifier)
    machine["simulation/gravity-model"] = 0
    machine.set_dt(step)
    V, alpha, beta, *rates, phi, theta = start
    across = V * np.cos(beta)
    begin = {
        "h-sl-ft": 300.0,
        "u-fps": across * np.cos(alpha) / FOOT,
        "v-fps": V * np.sin(beta) / FOOT,
        "w-fps": across * np.sin(alpha) / FOOT,
        "phi-rad": phi,
        "theta-rad": theta,
        "psi-true-rad": 0.0,
        **dict(zip(("p-rad_sec", "q-rad_sec", "r-rad_sec"), rates, strict=True)),
    }
    for name, value in begin.items():
        machine[f"ic/{name}"] = value
    assert machine.run_ic()
    states = [
        "velocities/vt-fps",
        "aero/alpha-rad",
        "aero/beta-rad",
        *(f"velocities/{axis}-rad_sec" for axis in "pqr"),
        "attitude/phi-rad",
        "attitude/theta-rad",
        "atmosphere/rho-slugs_ft3",
    ]
    rows = [[machine[name] for name in states]]
    for _ in range(round(end / step)):
        for name, value in inputs.items():
            machine[f"flightid/{name}"] = value
        machine.run()
        rows.append([machine[name] for name in states])
    found = np.array(rows).T
    found[0] *= FOOT
    return found[:-1], found[-1] * DENSITY


@pytest.mark.long
def test_jsbsim_flies_the_same_to_its_integration_error(tmp_path: Path) -> None:
    aircraft, worst = unlike_others(), []
    for step in (0.004, 0.001):
        found, density = flown(tmp_path, written(aircraft), step)
        constants = {**aircraft.constants, "air_density": float(density[-1])}
        system = compile_model(aircraft_model(replace(aircraft, constants=constants)))
        p = system.parameters.values().tolist()
        u = list(INPUTS.values())
        times = np.linspace(0.0, END, found.shape[1])
        true = solve_ivp(
            lambda t, x, f=system.f, p=p, u=u: f(t, x.tolist(), u, p),
            (0.0, END),
            START,
            t_eval=times,
            rtol=1e-9,
            atol=1e-11,
        ).y
        worst.append(np.max(np.abs(found - true), axis=1) / np.ptp(true, axis=1))
    assert np.max(worst[1]) < 0.01
    # JSBSim's integrators are of first order here: a quarter of the step, a quarter of the error.
    assert np.all(worst[1] < 0.4 * worst[0])


@pytest.mark.long
def test_a_loop_flown_by_jsbsim_is_ours_by_quaternion(tmp_path: Path) -> None:
    start = [260.0, 0.02, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1]
    inputs = {"elevator": ELEVATOR - 0.13, "aileron": 0.001, "rudder": 0.0, "thrust-n": 80e3}
    end, aircraft = 12.0, replace(unlike_others(), coefficients=AIRLINER.coefficients)
    begun = dict(zip(("airspeed", "alpha", "beta", *"pqr", "phi", "theta"), start, strict=True))
    # The density falls with height: ours is told what JSBSim's air had.
    ours = replace(aircraft, attitude="quaternion", varying=("air_density",), start=begun)
    system, worst = compile_model(aircraft_model(ours)), []
    p = system.parameters.values().tolist()
    for step in (0.004, 0.001):
        found, density = flown(tmp_path, written(aircraft), step, start, inputs, end)
        times = np.linspace(0.0, end, found.shape[1])

        def given(t: float, times=times, density=density) -> list[float]:
            return [*inputs.values(), float(np.interp(t, times, density))]

        states = solve_ivp(
            lambda t, x, given=given: system.f(t, x.tolist(), given(t), p),
            (0.0, end),
            system.initial.values(),
            t_eval=times[:: round(0.04 / step)],
            rtol=1e-8,
            atol=1e-10,
        )
        read = [
            dict(zip(system.output_names, system.h(t, x.tolist(), given(t), p), strict=True))
            for t, x in zip(states.t, states.y.T, strict=True)
        ]
        names = list(begun)
        true = np.array([[each[name] for each in read] for name in names])
        assert np.max(true[-1]) > 1.2 and np.max(np.abs(true[-2])) > 2.5
        found = np.vstack([found[:6], down(*found[6:])])[:, :: round(0.04 / step)]
        true = np.vstack([true[:6], down(*true[6:])])
        worst.append(np.max(np.abs(found - true), axis=1) / np.ptp(true, axis=1))
    assert np.max(worst[1]) < 0.01
    assert np.all(worst[1] < 0.5 * worst[0])


def down(phi: np.ndarray, theta: np.ndarray) -> np.ndarray:
    """Where down is, in body axes: no angle jumps in it."""
    return np.array([-np.sin(theta), np.cos(theta) * np.sin(phi), np.cos(theta) * np.cos(phi)])


def test_the_file_names_its_inputs_and_is_xml() -> None:
    root = XML.fromstring(jsbsim_file(written(unlike_others())).encode())
    assert root.attrib["name"] == "airliner"
    inputs = [each.text for each in root.findall("flight_control/property")]
    assert inputs == [f"flightid/{name}" for name in INPUTS]


@pytest.mark.parametrize(
    ("model", "told"),
    [
        (lambda: exported("plain", rigid_model()), "six degrees of freedom"),
        (lambda: written(replace(AIRLINER, varying=("mass",))), "columns"),
    ],
)
def test_what_jsbsim_cannot_fly_is_refused(model, told: str) -> None:
    with pytest.raises(DeclarationError, match=told):
        jsbsim_file(model())
