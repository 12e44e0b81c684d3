"""A model about rest as a linear system: matrices, frequency response, response to a held input."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.maths.elementary import complex_step_jacobian


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x_dot = A x + B u, y = C x + D u, with the shapes ``(n, n)``, ``(n, r)``, ``(m, n)``, ``(m, r)``."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


def linearise(model: Model, outputs: Sequence[str] | None = None) -> StateSpace:
    """Matrices of a model about the origin, exact to rounding; effects on the input and sensor paths are left out."""
    system = compile_model(model, outputs)
    p = system.parameters.values().tolist()
    x0, u0 = [0.0] * len(system.states), [0.0] * len(system.inputs)
    return StateSpace(
        complex_step_jacobian(lambda x: system.f(0.0, x, u0, p), x0),
        complex_step_jacobian(lambda u: system.f(0.0, x0, u, p), u0),
        complex_step_jacobian(lambda x: system.h(0.0, x, u0, p), x0),
        complex_step_jacobian(lambda u: system.h(0.0, x0, u, p), u0),
    )


def frequency_response(system: StateSpace, omega: float) -> np.ndarray:
    """C (j omega - A)^-1 B + D at ``omega``, rad/s; shape ``(m, r)``, complex."""
    return system.C @ np.linalg.solve(1j * omega * np.eye(len(system.A)) - system.A, system.B) + system.D


def held_response(system: StateSpace, u: np.ndarray, step: float) -> np.ndarray:
    """Outputs ``(m, N)`` from rest for one input ``u (N,)`` held over ``step`` s: the exact discrete system."""
    from scipy.linalg import expm

    n = len(system.A)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = system.A, system.B[:, 0]
    jump = expm(block * step)
    states = np.zeros((len(u), n))
    for k in range(len(u) - 1):
        states[k + 1] = jump[:n, :n] @ states[k] + jump[:n, n] * u[k]
    return system.C @ states.T + system.D[:, :1] * u
