"""Identification problems for estimators: the rigid aircraft and the falling body with noise,
starts and priors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.declaration.model import Model
from sim.record import Channel, Record
from tests.bases import (
    RIGID_VALUES,
    Flight,
    ballistic_flight,
    ballistic_model,
    fly,
    rigid_flight,
    rigid_model,
)

FREE = ("CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de")
TRUE = np.array([RIGID_VALUES[name] for name in FREE])
UNSTABLE = {**RIGID_VALUES, "Cm_alpha": 0.6}


def noisy(
    model: Model,
    flight: Flight,
    rng: np.random.Generator,
    *,
    offsets: Mapping[str, float] | None = None,
    scale: float = 1.0,
) -> Record:
    """A record of a model's flight with the model's own noise, times ``scale``, and constant
    offsets by channel.
    """
    system = compile_model(model)
    outputs = []
    for name, row in zip(system.output_names, fly(system, flight), strict=True):
        noise = scale * model.noise.measurement_std[name] * rng.standard_normal(len(flight.time))
        outputs.append(Channel.of(name, "1", row + noise + (offsets or {}).get(name, 0.0)))
    inputs = tuple(
        Channel.of(name, "rad", row) for name, row in zip(system.input_names, flight.u, strict=True)
    )
    return Record(flight.time, inputs, tuple(outputs), flight.hold)


def rigid_record(
    rng: np.random.Generator,
    duration: float = 6.0,
    rate: float = 50.0,
    values: Mapping[str, float] = RIGID_VALUES,
) -> Record:
    return noisy(rigid_model(values), rigid_flight(duration, rate), rng)


def rigid_start(
    factors: Sequence[float] | float = 1.3,
    prior: float = 0.5,
    values: Mapping[str, float] = RIGID_VALUES,
) -> Model:
    """The rigid aircraft at wrong derivatives, with relative priors and an uncertain initial state;
    for filters.
    """
    wrong = dict(zip(FREE, np.array([values[name] for name in FREE]) * factors, strict=True))
    model = rigid_model(values).with_values({name: float(value) for name, value in wrong.items()})
    priors = {name: prior * abs(values[name]) for name in FREE}
    initial = ParameterSet(
        (
            Parameter("alpha", 0.0, "rad", prior_std=0.01),
            Parameter("q", 0.0, "rad/s", prior_std=0.01),
        )
    )
    return model.with_parameters(model.parameters.with_prior(priors)).with_initial(initial)


def ballistic_record(rng: np.random.Generator) -> Record:
    return noisy(ballistic_model(), ballistic_flight(), rng)


def ballistic_start(beta: float = 1600.0) -> Model:
    """The falling body at a wrong beta, for filters."""
    model = ballistic_model().with_values({"beta": beta})
    initial = ParameterSet(
        (
            Parameter("altitude", 60960.0, "m", prior_std=50.0),
            Parameter("velocity", -1828.8, "m/s", prior_std=10.0),
        )
    )
    return model.with_parameters(model.parameters.with_prior({"beta": 800.0})).with_initial(initial)


def with_losses(record: Record) -> Record:
    """A third of the samples of each channel missing, and ten samples of all."""
    rng, outputs = np.random.default_rng(7), []
    for channel in record.outputs:
        values = np.where(rng.random(len(record)) < 0.3, np.nan, channel.values)
        values[40:50] = np.nan
        outputs.append(Channel.of(channel.name, channel.unit, values))
    return replace(record, outputs=tuple(outputs))
