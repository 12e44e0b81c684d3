"""Trimmed elevator maneuvers flown by JSBSim, six degrees of freedom, and the vehicle that they
belong to.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.independent.flight import G0, Flight, Vehicle
from tests.independent.jsbsim_aircraft import Aircraft, Condition
from tests.independent.maneuvers import Maneuver

FINE = 400.0  # Hz: a multiple of every sample rate that is used
FOOT, SLUG = 0.3048, 14.59390293720636
POUND = SLUG * FOOT  # N in a pound force
# of the pilot who holds the wings level: per rad, per rad/s, of full travel
BANK_GAIN, ROLL_GAIN, MOST_AILERON = 0.5, 0.3, 0.4
# JSBSim's number of the integrator of second order; its own choice for rotation, Euler's, has q
# half a step late
ADAMS_BASHFORTH = 3
MILSPEC = 3  # JSBSim's Dryden turbulence after MIL-F-8785C

AVAILABLE = importlib.util.find_spec("jsbsim") is not None


@dataclass(frozen=True)
class RoughAir:
    """JSBSim's Dryden turbulence: probability class of exceedance (3 light to 7 severe) and the
    seed of its own generator.
    """

    severity: int
    seed: int


@dataclass(frozen=True, eq=False)
class Motion:
    """A flight with what acted on it: lift (N, across the flight path, engines included) and
    pitching moment (N m).
    """

    flight: Flight
    lift: np.ndarray
    moment: np.ndarray
    air_density: float
    mass: float
    pitch_inertia: float
    wing_area: float
    chord: float


def trimmed(aircraft: Aircraft, condition: Condition) -> Any:
    """The simulator with the aircraft in level unaccelerated flight, gear up, engines running, fuel
    frozen. RuntimeError where it is not.
    """
    os.environ.setdefault("JSBSIM_DEBUG", "0")
    package = importlib.import_module("jsbsim")
    machine = package.FGFDMExec(str(Path(str(package.__file__)).parent))
    machine.set_debug_level(0)
    for name in aircraft.needs:
        machine[name] = 0.0
    machine.load_model(aircraft.name)
    machine.set_dt(1.0 / FINE)
    machine["ic/h-sl-ft"], machine["ic/vc-kts"], machine["ic/gamma-deg"] = (
        condition.altitude,
        condition.speed,
        0.0,
    )
    machine["gear/gear-cmd-norm"] = machine["gear/gear-pos-norm"] = 0.0
    machine.run_ic()
    machine["simulation/integrator/rate/rotational"] = machine[
        "simulation/integrator/position/rotational"
    ] = ADAMS_BASHFORTH
    machine["propulsion/fuel_freeze"] = 1
    machine["propulsion/set-running"] = -1
    for engine in range(4):
        machine[f"fcs/throttle-cmd-norm[{engine}]"], machine[f"fcs/mixture-cmd-norm[{engine}]"] = (
            0.6,
            0.87,
        )
    machine.do_trim(1)
    rest = [
        machine[f"accelerations/{name}"]
        for name in ("udot-ft_sec2", "wdot-ft_sec2", "qdot-rad_sec2")
    ]
    if max(map(abs, rest)) > 0.01 or machine["gear/gear-pos-norm"] > 0.0:
        raise RuntimeError(f"{aircraft.name} at {condition}: no trim, accelerations {rest}")
    return machine


def fly(
    aircraft: Aircraft,
    condition: Condition,
    maneuver: Maneuver,
    size: float,
    air: RoughAir | None = None,
) -> Motion:
    """A maneuver on the elevator command, ``size`` in parts of full command; every autopilot and
    damper off.
    """
    machine = trimmed(aircraft, condition)
    if air is not None:
        machine["simulation/randomseed"] = machine["atmosphere/randomseed"] = air.seed
        machine["atmosphere/turb-type"] = MILSPEC
        machine["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = 25.0
        machine["atmosphere/turbulence/milspec/severity"] = air.severity
    neutral, aileron = machine["fcs/elevator-cmd-norm"], machine["fcs/aileron-cmd-norm"]
    command = neutral + size * maneuver.at(np.arange(round(maneuver.duration * FINE) + 1) / FINE)
    level = aircraft.propeller or air is not None
    names = (aircraft.surface, *_READ)
    seen = np.empty((len(names), len(command)))
    for k, asked in enumerate(command):
        # The state of this frame and the surface of this frame: JSBSim moves the state first and
        # then runs the controls.
        machine["fcs/elevator-cmd-norm"] = asked
        if level:
            roll = (
                BANK_GAIN * machine["attitude/phi-rad"]
                + ROLL_GAIN * machine["velocities/p-rad_sec"]
            )
            machine["fcs/aileron-cmd-norm"] = aileron - float(
                np.clip(roll, -MOST_AILERON, MOST_AILERON)
            )
        machine.run()
        seen[:, k] = [machine[name] for name in names]
    return _motion(aircraft, machine, dict(zip(("surface", *_READ.values()), seen, strict=True)))


_READ = {
    "aero/alpha-rad": "alpha",
    "velocities/q-rad_sec": "q",
    "attitude/theta-rad": "theta",
    "velocities/vt-fps": "airspeed",
    "attitude/phi-rad": "phi",
    "forces/fbx-total-lbs": "x",
    "forces/fbz-total-lbs": "z",
    "moments/m-total-lbsft": "moment",
    "inertia/mass-slugs": "mass",
}
"""What is read after each step. The total body forces hold neither weight nor anything of the sensors: nz at the c.g. is -Z/(m g0)."""  # noqa: E501


def _motion(aircraft: Aircraft, machine: Any, seen: dict[str, np.ndarray]) -> Motion:
    if not np.all(np.isfinite(np.stack(list(seen.values())))) or np.max(np.abs(seen["phi"])) > 0.6:
        raise RuntimeError(f"{aircraft.name}: the flight went astray")
    mass = seen["mass"] * SLUG
    x, z = seen["x"] * POUND, seen["z"] * POUND
    alpha, speed = seen["alpha"], seen["airspeed"] * FOOT
    flight = Flight(
        step=1.0 / FINE,
        elevator=aircraft.surface_scale * seen["surface"],
        alpha=alpha,
        q=seen["q"],
        nz=-z / (mass * G0),
        theta=seen["theta"],
        airspeed=speed,
        trim_airspeed=float(speed[0]),
    )
    return Motion(
        flight=flight,
        lift=-z * np.cos(alpha) + x * np.sin(alpha),
        moment=seen["moment"] * POUND * FOOT,
        air_density=machine["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3,
        mass=float(mass[0]),
        pitch_inertia=machine["inertia/iyy-slugs_ft2"] * SLUG * FOOT**2,
        wing_area=machine["metrics/Sw-sqft"] * FOOT**2,
        chord=machine["metrics/cbarw-ft"] * FOOT,
    )


def vehicle_of(motion: Motion, name: str) -> tuple[Vehicle, float]:
    """The rigid vehicle whose derivatives are the slopes of lift and moment in a small motion about
    trim, and the worst 1 - R2 of the two.

    Slopes to alpha, q, elevator and airspeed are found together by least squares on the noise-free
    fine record (five columns, thousands of rows, exact but for the curvature of the tables within
    the motion). The rigid model has no alpha_dot, and alpha_dot is itself a linear function of
    these columns (alpha_dot = q - (rho V S/2m) CL): left out here, its share falls to the others
    exactly as a fit of that model must see it. So CL_q and Cm_q hold the alpha_dot terms. The slope
    to airspeed belongs to the phugoid and is left out.
    """
    flight = motion.flight
    speed, area = flight.trim_airspeed, motion.wing_area
    pressure_area = 0.5 * motion.air_density * speed**2 * area
    rate_time = motion.chord / (2.0 * speed)
    matrix = np.stack(
        [
            flight.alpha,
            flight.q * rate_time,
            flight.elevator,
            flight.airspeed / speed,
            np.ones(len(flight.q)),
        ],
        axis=1,
    )
    derivatives: dict[str, float] = {}
    lost = 0.0
    for letter, load in (
        ("CL", motion.lift / pressure_area),
        ("Cm", motion.moment / (pressure_area * motion.chord)),
    ):
        found = np.linalg.lstsq(matrix, load, rcond=None)[0]
        lost = max(lost, float(np.var(load - matrix @ found) / np.var(load)))
        derivatives |= {
            f"{letter}_{symbol}": float(value)
            for symbol, value in zip(("alpha", "q", "de"), found, strict=False)
        }
    return Vehicle(
        name,
        motion.mass,
        area,
        motion.chord,
        motion.pitch_inertia,
        speed,
        motion.air_density,
        derivatives,
    ), lost


def bend_of(motion: Motion, vehicle: Vehicle) -> tuple[float, float]:
    """What straight lift and moment lines leave of a motion: rms of nz (g), and of pitch rate
    (rad/s, moment over the short period).

    The lines go over alpha, q and elevator at the dynamic pressure of the moment, and airspeed.
    What is left is the bend of the tables and whatever else the rigid model with a phugoid cannot
    be.
    """
    flight = motion.flight
    speed = flight.airspeed
    pressure = (speed / speed[0]) ** 2
    columns = [
        flight.alpha * pressure,
        flight.q * speed / speed[0],
        flight.elevator * pressure,
        pressure,
        speed,
        np.ones(len(speed)),
    ]
    matrix = np.stack(columns, axis=1)
    loads = (motion.lift / (motion.mass * G0), motion.moment / motion.pitch_inertia)
    load, acceleration = (
        float(np.std(values - matrix @ np.linalg.lstsq(matrix, values, rcond=None)[0]))
        for values in loads
    )
    return load, acceleration / max(vehicle.short_period()[0], 1.0)
