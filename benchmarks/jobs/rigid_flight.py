"""The flight that jobs work on: the scenario `rigid`, its record as bare arrays, so that a peer
needs nothing of flightid.
"""

from __future__ import annotations

import numpy as np

from benchmarks.peers.names import CONSTANTS, DERIVATIVES, OUTPUTS
from scenarios.studies.catalogue import load_scenario
from scenarios.studies.estimating import fly_scenario, true_model
from sim.truth.flight import remeasure


def rigid_problem(duration: float = 8.0, runs: int = 0) -> dict[str, np.ndarray]:
    """The record of the scenario `rigid` (100 Hz, so many seconds) and what an estimator is told.

    ``time (N,)`` s, ``elevator (N,)`` rad, held between samples, ``z (2, N)`` alpha and q, ``clean
    (2, N)`` the same without noise, ``noise_std (2,)``; ``constants (6,)``; ``start``, ``start_std
    (8,)`` of states and derivatives, ``true (6,)``; ``z_runs (2, N, runs)`` the same flight
    measured again.
    """
    scenario = load_scenario("rigid", [f"flight.duration={duration}"])
    record, truth = fly_scenario(scenario, scenario.seed)
    estimation, model = scenario.estimations[0], true_model(scenario.flight)
    starts = [
        *(estimation.initial[name] for name in OUTPUTS),
        *(estimation.start[name] for name in DERIVATIVES),
    ]
    again = [
        remeasure(record, truth, np.random.default_rng((scenario.seed, run))).output_array(OUTPUTS)[
            0
        ]
        for run in range(runs)
    ]
    problem = {
        "time": np.array(record.time),
        "elevator": record.input_array(("elevator",))[0],
        "z": record.output_array(OUTPUTS)[0],
        "clean": np.array([truth.outputs[name] for name in OUTPUTS]),
        "noise_std": np.array([scenario.flight.noise_std[name] for name in OUTPUTS]),
        "constants": np.array([model.parameters[name].value for name in CONSTANTS]),
        "start": np.array([each.value for each in starts]),
        "start_std": np.array([each.std for each in starts]),
        "true": np.array([model.parameters[name].value for name in DERIVATIVES]),
    }
    return {**problem, "z_runs": np.stack(again, axis=2)} if runs else problem
