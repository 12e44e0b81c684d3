"""The flexible aircraft with any number of elastic modes and free parameters, its record, and what
is done with them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from benchmarks.peers.names import DERIVATIVES, OUTPUTS
from ident.banks.bank import filter_batched
from ident.filters.ekf import run_ekf
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_output_error
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.estimating import (
    assumed_noise,
    declared_model,
    flight_constants,
    fly_scenario,
)
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.record import Record

MODES = 4
STATE_STD = 0.01  # rad, rad/s and as large for modes


@cache
def full_order() -> tuple[Record, Model]:
    """The record of `flexible-ac1-full-order` and its declared model: ten states, 66 free
    parameters with priors.
    """
    scenario = load_scenario("flexible-ac1-full-order")
    estimation = scenario.estimations[0]
    model = declared_model(
        estimation,
        flight_constants(scenario.flight, estimation),
        assumed_noise(scenario, estimation),
    )
    return fly_scenario(scenario, scenario.seed)[0], model


def with_free(count: int) -> Model:
    """The full-order model with its first ``count`` parameters free."""
    model = full_order()[1]
    free = model.parameters.free_names[:count]
    priors = {name: model.parameters[name].prior_std for name in free}
    return model.with_parameters(model.parameters.only_free(free).with_prior(priors))


def with_modes(count: int) -> Model:
    """The aircraft with so many of its modes, six derivatives free."""
    from sim.vehicles.factory import flexible_model
    from sim.vehicles.library import read_parameter_set

    model = flexible_model(read_parameter_set("bomber_ac1"), count, full_order()[1].noise)
    priors = {name: 0.3 * abs(model.parameters[name].value) for name in DERIVATIVES}
    parameters = model.parameters.only_free(DERIVATIVES).with_prior(priors)
    initial = replace(
        model.initial, items=tuple(replace(item, prior_std=STATE_STD) for item in model.initial)
    )
    return replace(model, parameters=parameters, initial=initial)


def filtered(record: Record, model: Model) -> Callable[[], Any]:
    """One filter over a record."""
    system = compile_model(model, OUTPUTS, online=True)
    return lambda: run_ekf(record, system, by=filter_batched)


def fitted(record: Record, model: Model) -> Callable[[], Any]:
    """An output-error fit with priors."""
    system = compile_model(model, OUTPUTS)
    return lambda: fit_output_error([record], system, FitSettings(use_priors=True))


def flown(record: Record, model: Model) -> Callable[[], Any]:
    """A simulation with the noise of the sensors, an elevator that moves as the record's."""
    from scenarios.studies.declaration import maneuvers_by_input
    from sim.truth.flight import fly

    plans = load_scenario("flexible-ac1-full-order").flight.maneuvers
    by_input = maneuvers_by_input(plans, {"elevator"}, "benchmark")
    return lambda: fly(model, by_input, record.time, np.random.default_rng(1), outputs=OUTPUTS)
