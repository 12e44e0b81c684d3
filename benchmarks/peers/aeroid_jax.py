"""Output error by aeroid's identify with its gradient by JAX."""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np

from benchmarks.peers.aeroid_fit import identified, model_of
from benchmarks.peers.short_period import Problem


def prepare(problem: Problem) -> Callable[[], dict[str, np.ndarray]]:
    model = model_of(problem, jnp.array)
    return lambda: identified(problem, model, "jax")
