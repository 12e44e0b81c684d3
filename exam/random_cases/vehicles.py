"""A vehicle for each model, its maneuvers, and the vehicle file for the loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from exam.aircraft import NOISE as OF_AIRCRAFT
from exam.aircraft import USUAL, drawn_aircraft
from exam.random_cases.case import Setting
from sim.declaration.model import Model
from sim.maneuvers import (
    Maneuver,
    MultiStep,
    Sum,
    alternating,
    doublet,
    schroeder_multisine,
    three_two_one_one,
)
from sim.maths import G0
from sim.vehicles.factory import BALLISTIC_CONSTANTS, RIGID_CONSTANTS, model_from_constants

NOISE = {**OF_AIRCRAFT, "altitude": 6.0}
CONTROL = {"rigid": "elevator", "loes": "stick"}
RATES: Mapping[str, tuple[float, ...]] = {
    "rigid": (20.0, 25.0, 50.0, 50.0, 100.0),
    "loes": (20.0, 25.0, 50.0, 50.0, 100.0),
    "ballistic": (10.0, 20.0, 25.0),
}
EQUIVALENTS: Mapping[str, Mapping[str, float]] = {
    "augmented fighter": {
        **{"airspeed": 208.0, "L_alpha": -1.5, "M_alpha": -6.5, "L_delta": -0.003, "M_delta": 0.3},
        **{"L_q": 0.97, "M_q": -2.3, "inv_tau": 10.4, "delay": 0.07},
    },
    "augmented transport": {
        **{"airspeed": 140.0, "L_alpha": -0.8, "M_alpha": -2.4, "L_delta": -0.003, "M_delta": 0.12},
        **{"L_q": 0.98, "M_q": -1.4, "inv_tau": 7.0, "delay": 0.1},
    },
}
LOES_ESTIMATED = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")
# L_q is one less what little the tail carries: neither the truth nor a start is far from that.
SPREAD, NEARLY_KNOWN = {"L_q": 0.02}, {"L_q": 0.03}


@dataclass(frozen=True)
class Flight:
    """One record to be flown: the setting of its sizes, and its maneuver (None for a fall)."""

    setting: Setting
    maneuver: Maneuver | None


def drawn_vehicle(model: str, rng: np.random.Generator) -> tuple[str, Model]:
    """Draw a vehicle; return its label and its true model."""
    if model == "rigid":
        return drawn_aircraft(rng)
    if model == "loes":
        name = sorted(EQUIVALENTS)[int(rng.integers(len(EQUIVALENTS)))]
        values = {
            key: value * rng.uniform(1.0 - SPREAD.get(key, 0.2), 1.0 + SPREAD.get(key, 0.2))
            for key, value in EQUIVALENTS[name].items()
        }
        constants = {"airspeed": values.pop("airspeed"), "gravity": G0}
        return name, model_from_constants("loes", constants, values)
    constants = {"air_density_reference": 1.75, "density_scale_height": 6705.6, "gravity": 9.81}
    return "falling body", model_from_constants(
        "ballistic", constants, {"beta": float(rng.uniform(1600.0, 4000.0))}
    )


def drawn_flights(model: Model, rate: float, rng: np.random.Generator) -> tuple[Flight, Flight]:
    """Draw two records: two maneuvers of different shape and equal size, or two falls of different
    height and speed.
    """
    if model.equations.name == "ballistic":
        return _fall(model, rate, rng), _fall(model, rate, rng)
    duration, interval = float(rng.uniform(12.0, 25.0)), 1.0 / rate
    if model.equations.name == "rigid":
        setting = Setting(model, float(rng.uniform(0.03, 0.08)), duration, interval)
    else:
        peak, p = float(rng.uniform(1.4, 3.2)), model.parameters
        moment, lift = (
            p["M_alpha"].value / USUAL["Cm_alpha"],
            p["L_alpha"].value / USUAL["CL_alpha"],
        )
        setting = Setting(model, peak, duration, interval, moment, lift, peak / 0.055)
    one, two = maneuvers(rng, setting.peak, duration)
    return Flight(setting, one), Flight(setting, two)


def _fall(model: Model, rate: float, rng: np.random.Generator) -> Flight:
    height, speed = float(rng.uniform(45e3, 62e3)), float(rng.uniform(1300.0, 2000.0))
    start = replace(
        model, initial=model.initial.with_values({"altitude": height, "velocity": -speed})
    )
    return Flight(
        Setting(start, 0.0, round(float(rng.uniform(0.75, 0.9)) * height / speed, 1), 1.0 / rate),
        None,
    )


def maneuvers(rng: np.random.Generator, peak: float, duration: float) -> tuple[Maneuver, Maneuver]:
    """Draw two maneuvers of different shape that leave some rest at the end."""
    unit = float(rng.uniform(0.3, 0.7))
    period = round(duration - 3.0)
    sine = schroeder_multisine(
        0.45 * peak, float(period), range(1, max(4, round(1.6 * period)), 2), 1.0
    )
    choices: list[Maneuver] = [
        Sum(
            (three_two_one_one(peak, unit, 1.0), doublet(-0.6 * peak, 1.6 * unit, 1.0 + 9.0 * unit))
        ),
        Sum((doublet(0.9 * peak, 0.8, 1.0), three_two_one_one(-0.7 * peak, 0.8 * unit, 4.0))),
        Sum(
            (
                alternating(peak, (0.7, 0.5, 0.3, 0.3), 1.0),
                alternating(0.55 * peak, (1.0, 0.6, 0.4), 4.5),
            )
        ),
        sine,
    ]
    one, two = rng.choice(len(choices), 2, replace=False)
    return choices[int(one)], choices[int(two)]


def as_sampled(maneuver: Maneuver, time: np.ndarray, interval: float) -> MultiStep:
    """Return a maneuver as a record shows it: samples are held, and switches between samples are
    not seen.
    """
    return MultiStep(tuple(maneuver(time).tolist()), (*time.tolist(), float(time[-1] + interval)))


def estimated(model: str) -> tuple[str, ...]:
    """Return the derivatives that the loop estimates."""
    return tuple(USUAL) if model == "rigid" else LOES_ESTIMATED if model == "loes" else ("beta",)


def vehicle_file(model: Model, rng: np.random.Generator) -> str:
    """Return the text of the vehicle file: true constants, and derivatives up to 30 % wrong."""
    name = model.equations.name
    constants = {
        "rigid": tuple(RIGID_CONSTANTS),
        "loes": ("airspeed", "gravity"),
        "ballistic": tuple(BALLISTIC_CONSTANTS),
    }[name]
    lines = [f"{key} = {model.parameters[key].value!r}" for key in constants]
    wrong = {key: NEARLY_KNOWN.get(key, 0.3) for key in estimated(name)}
    starts = (
        (key, model.parameters[key].value * float(rng.uniform(1.0 - part, 1.0 + part)))
        for key, part in wrong.items()
    )
    return (
        "\n".join([*lines, "[derivatives]", *(f"{key} = {value!r}" for key, value in starts)])
        + "\n"
    )
