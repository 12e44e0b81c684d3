"""A light twin along its lateral and its whole longitudinal axis, flown through maneuvers on two
inputs each: records, files and wrong starts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.optimize import fsolve

from scenarios.files.vehicles import VehicleFile
from sim.declaration.model import Model, Noise
from sim.maneuvers import Maneuver, Sum, doublet, pulse, step, three_two_one_one
from sim.maths import G0
from sim.record import Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import model_from_constants

CONSTANTS: Mapping[str, Mapping[str, float]] = {
    "lateral": {
        **{
            "mass": 2100.0,
            "wing_area": 18.2,
            "span": 11.4,
            "roll_inertia": 4300.0,
            "yaw_inertia": 6900.0,
            "cross_inertia": 210.0,
        },
        **{"airspeed": 62.0, "air_density": 1.1, "trim_alpha": 0.05, "trim_theta": 0.03},
    },
    "longitudinal": {
        **{
            "mass": 2100.0,
            "wing_area": 18.2,
            "chord": 1.65,
            "pitch_inertia": 3900.0,
            "air_density": 1.1,
        },
        **{"reference_airspeed": 62.0, "thrust_arm": -0.1},
    },
}
TRUE: Mapping[str, Mapping[str, float]] = {
    "lateral": {
        **{
            "CY_beta": -0.65,
            "CY_dr": 0.19,
            "Cl_beta": -0.09,
            "Cl_p": -0.47,
            "Cl_r": 0.14,
            "Cl_da": 0.16,
        },
        **{"Cn_beta": 0.09, "Cn_p": -0.04, "Cn_r": -0.15, "Cn_dr": -0.085},
    },
    "longitudinal": {
        **{"CD_0": 0.03, "CD_alpha": 0.24, "CL_0": 0.3, "CL_alpha": 4.9, "CL_de": 0.4},
        **{"Cm_0": 0.05, "Cm_alpha": -0.9, "Cm_q": -14.0, "Cm_de": -1.2},
    },
}
NOISE: Mapping[str, Mapping[str, float]] = {
    "lateral": {"beta": 0.002, "p": 0.003, "r": 0.002, "phi": 0.003, "ny": 0.008},
    "longitudinal": {
        "airspeed": 0.25,
        "alpha": 0.002,
        "theta": 0.002,
        "q": 0.002,
        "nz": 0.012,
        "nx": 0.004,
    },
}
DURATION: Mapping[str, float] = {"lateral": 14.0, "longitudinal": 24.0}
RATE = 25.0


def vehicle_file(model: str, share: float | Mapping[str, float] = 1.0) -> VehicleFile:
    """What a vehicle file says that has the derivatives at a share of the true ones."""
    factor = dict.fromkeys(TRUE[model], share) if isinstance(share, float) else share
    return VehicleFile(
        "twin",
        model,
        CONSTANTS[model],
        {name: factor[name] * value for name, value in TRUE[model].items()},
    )


def vehicle_text(model: str, share: float = 0.8) -> str:
    """The same as a TOML text."""
    vehicle = vehicle_file(model, share)
    lines = ['name = "twin"', *(f"{name} = {value}" for name, value in vehicle.constants.items())]
    return (
        "\n".join(
            [
                *lines,
                "[derivatives]",
                *(f"{name} = {value}" for name, value in vehicle.derivatives.items()),
            ]
        )
        + "\n"
    )


def trim() -> tuple[float, float, float]:
    """Angle of attack, elevator (rad) and thrust (N) of level flight at the reference airspeed, by
    another solver and equations written again.
    """
    c, d = CONSTANTS["longitudinal"], TRUE["longitudinal"]
    pressure_area = 0.5 * c["air_density"] * c["reference_airspeed"] ** 2 * c["wing_area"]

    def off(unknown: np.ndarray) -> list[float]:
        alpha, elevator, kilonewtons = unknown
        thrust = 1000.0 * kilonewtons
        lift = pressure_area * (d["CL_0"] + d["CL_alpha"] * alpha + d["CL_de"] * elevator)
        drag = pressure_area * (d["CD_0"] + d["CD_alpha"] * alpha)
        moment = (
            pressure_area * c["chord"] * (d["Cm_0"] + d["Cm_alpha"] * alpha + d["Cm_de"] * elevator)
            + thrust * c["thrust_arm"]
        )
        return [
            (lift + thrust * np.sin(alpha)) / (c["mass"] * G0) - 1.0,
            (thrust * np.cos(alpha) - drag) / 1000.0,
            moment / 1000.0,
        ]

    alpha, elevator, kilonewtons = fsolve(off, [0.05, 0.0, 2.0], xtol=1e-13)
    return float(alpha), float(elevator), 1000.0 * float(kilonewtons)


def flown(
    model: str, seed: int = 0, offsets: Mapping[str, float] | None = None, noise: float = 1.0
) -> Record:
    """A record of the true aircraft at 25 Hz with white noise, and constant ``offsets`` by input or
    output.
    """
    true = model_from_constants(model, CONSTANTS[model], TRUE[model], initial=_start(model))
    std = {name: noise * value for name, value in NOISE[model].items()}
    record, _ = fly(
        true.with_noise(Noise(std)),
        maneuvers(model),
        sample_times(RATE, DURATION[model]),
        np.random.default_rng(seed),
        step=0.01,
        name=f"{model}.csv",
    )
    return moved(record, offsets or {})


def moved(record: Record, offsets: Mapping[str, float]) -> Record:
    """The record with constants added to some channels."""
    inputs, outputs = (
        tuple(
            type(c).of(
                c.name, c.unit, np.where(c.valid, c.values + offsets.get(c.name, 0.0), np.nan)
            )
            for c in group
        )
        for group in (record.inputs, record.outputs)
    )
    return Record(record.time, inputs, outputs, record.hold, record.name)


def maneuvers(model: str) -> dict[str, Maneuver]:
    """An input after the other, switched at samples; the longitudinal ones about trim."""
    if model == "lateral":
        return {
            "aileron": doublet(0.07, 0.8, 1.0),
            "rudder": Sum((three_two_one_one(0.06, 0.72, 4.0), doublet(-0.05, 0.72, 10.0))),
        }
    _, elevator, thrust = trim()
    return {
        "elevator": Sum(
            (step(elevator), three_two_one_one(0.035, 0.48, 1.0), doublet(-0.03, 0.6, 18.0))
        ),
        "thrust": Sum((step(thrust), pulse(1200.0, 6.0, 7.0))),
    }


def _start(model: str) -> dict[str, float]:
    if model == "lateral":
        return {}
    alpha, _, _ = trim()
    return {"airspeed": CONSTANTS[model]["reference_airspeed"], "alpha": alpha, "theta": alpha}


def true_model(model: str) -> Model:
    """The aircraft with all its true derivatives free."""
    return model_from_constants(model, CONSTANTS[model], TRUE[model], initial=_start(model))


def write_flown(
    folder: Path, model: str, record: Record, units: Mapping[str, tuple[str, float]] | None = None
) -> Path:
    """The record as ``MODEL.csv`` and the vehicle file, 20 % wrong, as ``vehicle.toml``; ``units``:
    channel -> header and factor.
    """
    columns = {"time": record.time}
    for channel in record.channels:
        header, factor = (units or {}).get(channel.name, (channel.name, 1.0))
        columns[header] = factor * channel.with_gaps()
    path = folder / f"{model}.csv"
    np.savetxt(
        path,
        np.array([*columns.values()]).T,
        delimiter=",",
        header=",".join(columns),
        comments="",
        fmt="%.12g",
    )
    (folder / "vehicle.toml").write_text(vehicle_text(model), encoding="utf-8")
    return path
