"""True derivatives: slopes of the forces and moments that JSBSim made in a motion, by least squares over its frames, free of noise.

In a small motion they are the derivatives about trim; over the maneuver itself, the straight lines that lie nearest to what the aircraft did.
Terms in alpha_dot and beta_dot fall to the others, as in any fit of models that have none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scenarios.trials.jsbsim.machine import Flown

Columns = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Slopes:
    """Derivatives of one model by name; ``weight``: what each moves its load by, over the load's spread; ``left``: the largest share of a
    load's variance that straight lines leave.
    """

    values: Mapping[str, float]
    weight: Mapping[str, float]
    left: float

    def without(self, *symbols: str) -> Slopes:
        """The same but for derivatives by these symbols."""
        return Slopes({name: value for name, value in self.values.items() if name.partition("_")[2] not in symbols}, self.weight, self.left)


def slopes_of(model: str, flown: Flown, motion: Flown | None = None) -> Slopes:
    """The derivatives of a model (rigid, longitudinal or lateral); of ``motion`` where it is another flight from the same trim."""
    return {"rigid": _rigid, "longitudinal": _longitudinal, "lateral": _lateral}[model](flown, motion or flown)


def constants_of(model: str, flown: Flown) -> dict[str, float]:
    """What the vehicle file of a model holds beside its derivatives, SI: body, air and trim as they are at the start of a flight."""
    body = flown.body
    found = {"mass": body.mass, "wing_area": body.wing_area, "air_density": float(flown["air_density"][0])}
    speed = float(flown["airspeed"][0])
    if model == "lateral":
        found |= {"span": body.span, "roll_inertia": body.roll_inertia, "yaw_inertia": body.yaw_inertia, "cross_inertia": body.cross_inertia}
        return {**found, "airspeed": speed, "trim_alpha": float(flown["alpha"][0]), "trim_theta": float(flown["theta"][0])}
    found |= {"chord": body.chord, "pitch_inertia": body.pitch_inertia}
    if model == "rigid":
        return {**found, "airspeed": speed}
    return {**found, "reference_airspeed": speed, "thrust_arm": thrust_arm(flown)}


def thrust_arm(flown: Flown) -> float:
    """Moment of the engines over their thrust in trim, m, nose up positive; 0 where there is no thrust."""
    thrust = float(flown["thrust"][0])
    return float(flown["thrust_moment"][0]) / thrust if thrust else 0.0


def _rigid(trim: Flown, flown: Flown) -> Slopes:
    """Lift across the path, engines included; what depends on the speed is told apart and left out."""
    speed, body = float(trim["airspeed"][0]), flown.body
    columns = {
        "alpha": flown["alpha"],
        "q": flown["q"] * body.chord / (2.0 * speed),
        **_moved(flown, {"de": "elevator"}),
        "V": flown["airspeed"] / speed,
    }
    lift = -flown["force_z"] * np.cos(flown["alpha"]) + flown["force_x"] * np.sin(flown["alpha"])
    area = 0.5 * float(trim["air_density"][0]) * speed**2 * body.wing_area
    return _straight({"CL": (lift / area, columns), "Cm": (flown["moment_m"] / (area * body.chord), columns)}).without("0", "V")


def _longitudinal(trim: Flown, flown: Flown) -> Slopes:
    """Coefficients of the whole axis at the speed and density of the moment, thrust and its moment taken off."""
    speed, body, alpha = float(trim["airspeed"][0]), flown.body, flown["alpha"]
    slow = {"V": flown["airspeed"] / speed, "alpha": alpha}
    columns = {**slow, "q": flown["q"] * body.chord / (2.0 * speed), **_moved(flown, {"de": "elevator"})}
    x, z, area = flown["force_x"] - flown["thrust"], flown["force_z"], _pressure_area(flown)
    moment = flown["moment_m"] - thrust_arm(trim) * flown["thrust"]
    return _straight(
        {
            "CD": ((-x * np.cos(alpha) - z * np.sin(alpha)) / area, slow),
            "CL": ((x * np.sin(alpha) - z * np.cos(alpha)) / area, columns),
            "Cm": (moment / (area * body.chord), columns),
        }
    )


def _lateral(trim: Flown, flown: Flown) -> Slopes:
    half, area = flown.body.span / (2.0 * flown["airspeed"]), _pressure_area(flown)
    columns = {"beta": flown["beta"], "p": flown["p"] * half, "r": flown["r"] * half, **_moved(flown, {"da": "aileron", "dr": "rudder"})}
    loads = {"CY": flown["force_y"], "Cl": flown["moment_l"] / flown.body.span, "Cn": flown["moment_n"] / flown.body.span}
    return _straight({letter: (load / area, columns) for letter, load in loads.items()}).without("0")


def _pressure_area(flown: Flown) -> np.ndarray:
    return np.asarray(0.5 * flown["air_density"] * flown["airspeed"] ** 2 * flown.body.wing_area)


def _moved(flown: Flown, names: Mapping[str, str]) -> dict[str, np.ndarray]:
    """The surfaces that the loads of this aircraft read, under the names of derivatives."""
    return {symbol: flown[surface] for symbol, surface in names.items() if surface in flown.signals}


def _straight(loads: Mapping[str, tuple[np.ndarray, Columns]]) -> Slopes:
    """Least squares of every load on a constant and its columns, each scaled to its own spread."""
    values: dict[str, float] = {}
    weight: dict[str, float] = {}
    left = 0.0
    for letter, (load, columns) in loads.items():
        spread = {name: float(np.std(column)) or 1.0 for name, column in columns.items()}
        matrix = np.stack([np.ones(len(load)), *((column - column[0]) / spread[name] for name, column in columns.items())], axis=1)
        solved = np.linalg.lstsq(matrix, load, rcond=None)[0]
        size = float(np.std(load)) or 1.0
        left = max(left, float(np.var(load - matrix @ solved)) / size**2)
        slopes = {name: float(value) / spread[name] for name, value in zip(columns, solved[1:], strict=True)}
        values[f"{letter}_0"] = float(solved[0]) - sum(slopes[name] * float(columns[name][0]) for name in columns)
        values |= {f"{letter}_{name}": slope for name, slope in slopes.items()}
        weight |= {f"{letter}_{name}": abs(slope) * spread[name] / size for name, slope in slopes.items()}
    return Slopes(values, weight, left)
