"""Many records through the filterpy subclass, one after the other: the first ``share`` of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.peers.filterpy_ekf import filtered
from benchmarks.peers.short_period import Problem


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    z = problem["z_runs"][:, :, : int(problem["share"])]

    def work() -> dict[str, np.ndarray]:
        found = [filtered(problem, z[:, :, b], likelihood=True) for b in range(z.shape[2])]
        return {
            name: np.stack([each[name] for each in found], axis=-1)
            for name in ("estimate", "estimate_std", "log_likelihood")
        }

    return work
