"""flightid's filters of many records as batches of 500, as its campaigns run them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers.flightid_model import declared, record_of
from benchmarks.peers.names import OUTPUTS
from benchmarks.peers.short_period import Problem
from ident.banks.bank import run_bank
from ident.filters.ekf import FilterSettings
from sim.declaration.compile import compile_model

BATCH = 500


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    record, system, z = (
        record_of(problem),
        compile_model(declared(problem), OUTPUTS, online=True),
        problem["z_runs"],
    )

    def work() -> dict[str, np.ndarray]:
        banks = [
            run_bank(record, system, FilterSettings(), z=z[:, :, b : b + BATCH])
            for b in range(0, z.shape[2], BATCH)
        ]
        return {
            "estimate": np.concatenate([bank.mean[2:] for bank in banks], axis=1),
            "estimate_std": np.concatenate([bank.std[2:] for bank in banks], axis=1),
            "log_likelihood": np.concatenate([bank.log_likelihood for bank in banks]),
        }

    return work
