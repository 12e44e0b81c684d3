"""The record and the declared model of a problem as flightid takes them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.peers.names import CONSTANTS, DERIVATIVES, OUTPUTS
from benchmarks.peers.short_period import Problem
from sim.declaration.model import Model, Noise
from sim.record import Channel, Record
from sim.vehicles.factory import model_from_constants


def record_of(problem: Problem) -> Record:
    """The record, its elevator held between samples."""
    outputs = tuple(
        Channel.of(name, unit, row)
        for name, unit, row in zip(OUTPUTS, ("rad", "rad/s"), problem["z"], strict=True)
    )
    return Record(problem["time"], (Channel.of("elevator", "rad", problem["elevator"]),), outputs)


def declared(problem: Problem, *, start_known: bool = False) -> Model:
    """The rigid model at the declared start with its priors; with ``start_known`` the motion begins
    at rest.
    """
    start, std = problem["start"], problem["start_std"]
    constants = dict(zip(CONSTANTS, problem["constants"].tolist(), strict=True))
    model = model_from_constants(
        "rigid", constants, dict(zip(DERIVATIVES, start[2:].tolist(), strict=True))
    )
    priors = dict(zip(DERIVATIVES, std[2:].tolist(), strict=True))
    parameters = model.parameters.only_free(DERIVATIVES).with_prior(priors)
    items = [
        replace(item, value=float(x), prior_std=float(s), free=not start_known)
        for item, x, s in zip(model.initial, start, std, strict=False)
    ]
    noise = Noise(dict(zip(OUTPUTS, problem["noise_std"].tolist(), strict=True)))
    return replace(
        model,
        parameters=parameters,
        initial=replace(model.initial, items=tuple(items)),
        noise=noise,
    )


def true_model(problem: Problem) -> Model:
    """The model that flies: true derivatives, at rest, with the noise of the sensors."""
    return declared(problem, start_known=True).with_values(
        dict(zip(DERIVATIVES, np.asarray(problem["true"]).tolist(), strict=True))
    )
