"""dynamax's filter of many records: vmap over records, a hundred at a time so that their histories
stay small, jitted.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.peers.dynamax_ekf import filter_of
from benchmarks.peers.short_period import Problem

AT_ONCE = 100


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    run = filter_of(problem)

    def one(z: Any) -> Any:
        post = run(z)
        return (
            post.filtered_means[-1, 2:],
            jnp.sqrt(jnp.diagonal(post.filtered_covariances[-1]))[2:],
            post.marginal_loglik,
        )

    all_runs = jax.jit(lambda z: jax.lax.map(one, z, batch_size=AT_ONCE))
    z = jnp.array(np.transpose(problem["z_runs"], (2, 1, 0)))

    def work() -> dict[str, np.ndarray]:
        estimate, std, total = (np.asarray(each) for each in all_runs(z))
        return {"estimate": estimate.T, "estimate_std": std.T, "log_likelihood": total}

    return work
