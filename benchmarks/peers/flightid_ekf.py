"""flightid's own kernel for one record (``--engine batched``): states and parameters with their
histories, innovations and likelihoods.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers.flightid_model import declared, record_of
from benchmarks.peers.names import OUTPUTS
from benchmarks.peers.short_period import Problem
from ident.banks.bank import filter_batched
from ident.filters.ekf import run_ekf
from sim.declaration.compile import compile_model


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    record, system = record_of(problem), compile_model(declared(problem), OUTPUTS, online=True)

    def work() -> dict[str, np.ndarray]:
        found = run_ekf(record, system, by=filter_batched)
        history = found.history
        assert history is not None
        return {
            "mean": history.mean.T,
            "std": history.std.T,
            "estimate": found.values,
            "estimate_std": found.std,
            "log_likelihood": np.array(found.log_likelihood),
        }

    return work
