"""The series: samples, states, parameters, candidates of the tracing loop, runs of a campaign."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from benchmarks.jobs.rigid_flight import rigid_problem
from benchmarks.peers import flightid_ekf, flightid_fit, flightid_fly
from benchmarks.peers.names import CONSTANTS, DERIVATIVES
from benchmarks.scaling.flexible import filtered, fitted, flown, full_order, with_free, with_modes
from benchmarks.scaling.series import Series

RATE = 100  # samples a second


@cache
def _rigid(samples: int) -> Any:
    found = rigid_problem((samples - 1) / RATE)
    changes = np.flatnonzero(np.diff(found["elevator"])) + 1
    return {
        **found,
        "switches": found["time"][changes],
        "levels": np.append(0.0, found["elevator"][changes]),
    }


def _traced(candidates: int) -> Callable[[], Any]:
    """A diagnosis of a record with a late elevator, with so many effects offered, the right one
    first.
    """
    from ident.tracing.loop import diagnose
    from scenarios.diagnosis.opening import candidates_for
    from scenarios.studies.catalogue import load_document
    from scenarios.trials.planted_flights import fly_trace, trace_scenario_of
    from sim.vehicles.factory import model_from_constants

    scenario, known = trace_scenario_of(*load_document("trace-delay")), rigid_problem()
    flight = fly_trace(scenario, scenario.seed)
    starts = dict(zip(DERIVATIVES, known["start"][2:].tolist(), strict=True))
    model = model_from_constants(
        "rigid", dict(zip(CONSTANTS, known["constants"].tolist(), strict=True)), starts
    )
    model = model.with_biases([channel.name for channel in flight.train.outputs])
    every = sorted(candidates_for(model), key=lambda each: each.name != "input-delay")
    named = [each for each in every if not each.traits.general][:candidates]
    return lambda: diagnose([flight.train], model, named, (), [flight.validate])


def _campaign(runs: int) -> Callable[[], Any]:
    from scenarios.studies.campaign import fly_campaign
    from scenarios.studies.catalogue import load_scenario

    scenario = load_scenario("rigid")
    return lambda: fly_campaign(scenario, runs)


SERIES: tuple[Series, ...] = (
    Series(
        "samples",
        "Growth with samples",
        "The rigid aircraft at 100 Hz, six derivatives: one filter, one output-error fit, one "
        "simulation, each a warm call.",
        "samples",
        (401, 801, 1601, 3201, 6401),
        {
            "filter": lambda n: flightid_ekf.prepare(_rigid(n)),
            "output error": lambda n: flightid_fit.prepare(_rigid(n)),
            "simulation": lambda n: flightid_fly.prepare(_rigid(n)),
        },
    ),
    Series(
        "states",
        "Growth with states",
        "801 samples, six derivatives; each elastic mode brings two states.",
        "states",
        (2, 4, 6, 8, 10),
        {
            "filter": lambda n: filtered(full_order()[0], with_modes((n - 2) // 2)),
            "output error": lambda n: fitted(full_order()[0], with_modes((n - 2) // 2)),
            "simulation": lambda n: flown(full_order()[0], with_modes((n - 2) // 2)),
        },
    ),
    Series(
        "parameters",
        "Growth with free parameters",
        "801 samples, ten states, priors. A fit may need more steps with more parameters, which "
        "the exponent counts too.",
        "parameters",
        (6, 12, 24, 48, 66),
        {
            "filter": lambda n: filtered(full_order()[0], with_free(n)),
            "output error": lambda n: fitted(full_order()[0], with_free(n)),
        },
        rounds=5,
    ),
    Series(
        "candidates",
        "Growth with candidates of the tracing loop",
        """A diagnosis of the scenario `trace-delay`, which hides a late elevator; so many effects of the library are offered, the right one first, no
guards.""",  # noqa: E501
        "candidates",
        (3, 6, 12, 24, 48),
        {"diagnosis": _traced},
        rounds=3,
    ),
    Series(
        "runs",
        "Growth with runs",
        "`flightid campaign rigid` in one process: flights, filters and the table, without its "
        "start.",
        "runs",
        (100, 1000, 10000),
        {"campaign": _campaign},
        rounds=3,
    ),
)
