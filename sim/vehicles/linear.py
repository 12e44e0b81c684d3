"""A model about rest or a trimmed flight as a linear system: matrices, frequency response, response to a held input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.errors import DeclarationError
from sim.maths.elementary import complex_step_jacobian


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x_dot = A x + B u, y = C x + D u, with the shapes ``(n, n)``, ``(n, r)``, ``(m, n)``, ``(m, r)``."""

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray


def linearise(model: Model, outputs: Sequence[str] | None = None, about: Mapping[str, float] | None = None) -> StateSpace:
    """Matrices of a model, exact to rounding; effects on the input and sensor paths are left out.

    Parameters
    ----------
    model : the declaration.
    outputs : the outputs wanted, in order; all when None.
    about : the point, states and inputs by name in SI, zero where one is not named; the origin when None. The matrices are the
        derivatives there, whether or not the point is a trim: rates that are not zero in it are not kept.

    Raises
    ------
    DeclarationError : ``about`` names what is neither state nor input.
    """
    system = compile_model(model, outputs)
    p = system.parameters.values().tolist()
    point = dict(about or {})
    x0 = [float(point.pop(signal.name, 0.0)) for signal in system.states]
    u0 = [float(point.pop(signal.name, 0.0)) for signal in system.inputs]
    for name in point:
        known = ", ".join(signal.name for signal in (*system.states, *system.inputs))
        raise DeclarationError(f"there is no state or input {name}", where=f"linearising {model.equations.name}", remedy=f"use {known}")
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
