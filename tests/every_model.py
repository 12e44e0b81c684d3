"""A short record with noise of each model, by its true numbers, and a vehicle file that is wrong
about them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scenarios.files.vehicles import VehicleFile
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.record import Channel, Record
from sim.vehicles.factory import model_from_constants
from sim.vehicles.other_vehicles import Multirotor
from tests import whole_axes
from tests.bases import (
    BALLISTIC_VALUES,
    LOES_CONSTANTS,
    LOES_VALUES,
    RIGID_VALUES,
    Flight,
    fly,
    three_two_one_one,
)
from tests.own_models import roll
from tests.recorders import quadrotor
from tests.rigid_problem import FREE

MODELS = ("rigid", "flexible", "loes", "ballistic", "lateral", "longitudinal", "multirotor", "own")
WRONG = (1.2, 0.85, 1.15, 0.9)  # times the true values, in turn
_NOISE = {"alpha": 0.001, "q": 0.002, "nz": 0.01, "altitude": 6.0, "p": 0.004, "phi": 0.003}
_UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g", "altitude": "m", "p": "rad/s", "phi": "rad"}
_MODE = {"omega1": 14.0, "zeta1": 0.04, "generalized_mass1": 900.0}
_MODAL = {
    **{"CL_eta1": 0.06, "CL_etadot1": 0.02, "Cm_eta1": -0.09, "Cm_etadot1": -0.05},
    **{
        "Ceta1_alpha": -0.05,
        "Ceta1_q": -0.3,
        "Ceta1_de": 0.03,
        "Ceta1_eta1": -0.004,
        "Ceta1_etadot1": -0.02,
    },
}


@dataclass(frozen=True, eq=False)
class Case:
    """A record, the vehicle file that is handed over with it, and the true values of what is
    estimated.
    """

    record: Record
    vehicle: VehicleFile
    true: Mapping[str, float]


def case_of(model: str, seed: int = 0, noise: float = 1.0) -> Case:
    """The case of one of ``MODELS``; ``own`` is the roll of an aircraft as a user declares it."""
    if model in whole_axes.TRUE:
        wrong = _wrong(whole_axes.TRUE[model])
        share = {name: wrong[name] / value for name, value in whole_axes.TRUE[model].items()}
        return Case(
            whole_axes.flown(model, seed, noise=noise),
            whole_axes.vehicle_file(model, share),
            whole_axes.TRUE[model],
        )
    if model == "multirotor":
        return _quadrotor(seed, noise)
    rng = np.random.default_rng(seed)
    if model == "ballistic":
        constants = {name: value for name, value in BALLISTIC_VALUES.items() if name != "beta"}
        true = {"beta": BALLISTIC_VALUES["beta"]}
        start = {"altitude": 60960.0, "velocity": -1828.8}
        flown = model_from_constants("ballistic", constants, true, initial=start)
        return Case(
            _record(flown, np.arange(201) / 10.0, {}, rng, noise),
            VehicleFile("body", "ballistic", constants, _wrong(true)),
            true,
        )
    if model == "own":
        declared = roll()
        true = {"L_p": -2.4, "L_da": 7.0}
        time = np.arange(251) / 25.0
        record = _record(
            declared.with_values(true),
            time,
            {"aileron": three_two_one_one(time, size=0.08)},
            rng,
            noise,
        )
        starts = {"L_p": -2.0, "L_da": 8.0}
        return Case(
            record, VehicleFile("roll", "roll", {"airspeed": 60.0}, starts, own=declared), true
        )
    if model == "loes":
        true = LOES_VALUES | {"delay": 0.118}
        time = np.arange(201) / 25.0
        flown = model_from_constants("loes", LOES_CONSTANTS, true)
        record = _record(flown, time, {"stick": three_two_one_one(time, size=1.0)}, rng, noise)
        return Case(
            record,
            VehicleFile("fighter", "loes", LOES_CONSTANTS, {**_wrong(true), "L_q": 1.0}),
            true,
        )
    constants = {name: value for name, value in RIGID_VALUES.items() if name not in FREE}
    true = {name: RIGID_VALUES[name] for name in FREE}
    time = np.arange(401) / 50.0
    if model == "rigid":
        flown = model_from_constants("rigid", constants, true)
        record = _record(flown, time, {"elevator": three_two_one_one(time, size=0.05)}, rng, noise)
        return Case(record, VehicleFile("aircraft", "rigid", constants, _wrong(true)), true)
    flown = model_from_constants("rigid", {**constants, **_MODE}, {**true, **_MODAL}, modes=1)
    record = _record(flown, time, {"elevator": three_two_one_one(time, size=0.05)}, rng, noise)
    mode = {
        "frequency": _MODE["omega1"],
        "damping": _MODE["zeta1"],
        "generalized_mass": _MODE["generalized_mass1"],
        **_MODAL,
    }
    return Case(
        record, VehicleFile("aircraft", "flexible", constants, _wrong(true), ((1, mode),)), true
    )


def _quadrotor(seed: int, noise: float) -> Case:
    """A quadrotor under its rate controller, simulated apart from the project."""
    columns = quadrotor.flight(seed=seed, noise=noise, duration=18.0)
    equations = Multirotor()
    channels = {
        signal.name: Channel.of(signal.name, signal.unit, columns[signal.name])
        for signal in (*equations.inputs, *equations.outputs)
    }
    inputs, outputs = (
        [channels[signal.name] for signal in some] for some in (equations.inputs, equations.outputs)
    )
    record = Record(columns["time"], tuple(inputs), tuple(outputs), name="record.csv")
    return Case(
        record, VehicleFile("quadrotor", "multirotor", {}, quadrotor.STARTS), quadrotor.TRUTH
    )


def _wrong(true: Mapping[str, float]) -> dict[str, float]:
    return {name: value * WRONG[i % len(WRONG)] for i, (name, value) in enumerate(true.items())}


def _record(
    model: Model,
    time: np.ndarray,
    inputs: Mapping[str, np.ndarray],
    rng: np.random.Generator,
    noise: float,
) -> Record:
    system = compile_model(model)
    rows = fly(
        system,
        Flight(
            time,
            np.array([inputs[name] for name in system.input_names]).reshape(-1, len(time)),
            max_step=0.005,
        ),
    )
    channels = []
    for name, row in zip(system.output_names, rows, strict=True):
        channels.append(
            Channel.of(
                name, _UNITS[name], row + noise * _NOISE[name] * rng.standard_normal(len(time))
            )
        )
    units = {signal.name: signal.unit for signal in system.inputs}
    return Record(
        time,
        tuple(Channel.of(name, units[name], row) for name, row in inputs.items()),
        tuple(channels),
        name="record.csv",
    )
