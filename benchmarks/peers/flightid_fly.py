"""flightid's flight of the rigid aircraft: its truth and the record of its sensors."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers.flightid_model import true_model
from benchmarks.peers.names import OUTPUTS
from benchmarks.peers.short_period import Problem
from sim.maneuvers import MultiStep
from sim.truth.flight import fly


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    model, time = true_model(problem), problem["time"]
    elevator = MultiStep(
        tuple(problem["levels"][1:-1].tolist()), tuple(problem["switches"].tolist())
    )

    def work() -> dict[str, np.ndarray]:
        record, truth = fly(model, elevator, time, np.random.default_rng(1), outputs=OUTPUTS)
        return {
            "clean": np.array([truth.outputs[name] for name in OUTPUTS]),
            "z": record.output_array(OUTPUTS)[0],
        }

    return work
