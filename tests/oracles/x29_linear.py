"""Roots, poles and the step response of the linear closed loop, as tests ask for them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sim.closed_loop.airframe import X29
from sim.closed_loop.equations import (
    airframe_matrices,
)

if TYPE_CHECKING:
    pass
from sim.closed_loop.linear import closed_loop, respond


def airframe_roots(x29: X29) -> np.ndarray:
    """Roots of the bare airframe, rad/s, shape ``(2,)``, the unstable one first."""
    return np.sort(np.linalg.eigvals(airframe_matrices(x29.airframe).A))[::-1]


def closed_loop_poles(x29: X29) -> np.ndarray:
    """Poles z of the sampled closed loop; all inside the unit circle when it is stable."""
    return np.asarray(closed_loop(x29).poles())


def step_response(x29: X29, duration: float, size: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Linear response to a stick step of ``size`` in at time 0, as ``respond`` gives it, over
    ``duration`` s.
    """
    return respond(x29, np.full(round(duration / x29.frame) + 1, size))
