"""State-space matrices of a model, linearised about a point.

With dx = x - x0, and likewise for u and y, the linear model is dx_dot = A dx + B du, dy = C dx +
D du. The matrices follow from complex steps through the functions f and h that the fits use, and
are exact to rounding. Pure delays of inputs are not in the matrices; `to_control` adds a Pade
approximation of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sim.declaration.effect import Signal
from sim.declaration.model import System
from sim.errors import ModelError
from sim.maths import complex_step_jacobian

if TYPE_CHECKING:
    import control


# order of the approximation of a delay: within two degrees of phase up to omega delay = 5
PADE_ORDER = 4
DELAY = "delay"  # parameter of a low-order equivalent system
DELAY_STAGE = "input-delay"  # effect that the delay belongs to


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A linear model about a point.

    Attributes
    ----------
    A, B, C, D : matrices ``(n, n)``, ``(n, m)``, ``(k, n)``, ``(k, m)``.
    states, inputs, outputs : names and units of the n, m and k signals.
    x0, u0, y0 : states, inputs and outputs at the point.
    rates : ``(n,)`` rates of the states at the point, zero in equilibrium.
    delays : name of an input -> its pure delay, s.
    left_out : names of effects with states of their own on the input or sensor path, which the
        matrices do not include.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    states: tuple[Signal, ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    x0: np.ndarray
    u0: np.ndarray
    y0: np.ndarray
    rates: np.ndarray
    delays: Mapping[str, float]
    left_out: tuple[str, ...] = ()

    @property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues of A (1/s), sorted by magnitude."""
        return np.array(sorted(np.linalg.eigvals(self.A), key=lambda root: (abs(root), root.imag)))


def state_space(
    system: System,
    values: Mapping[str, float],
    x0: Sequence[float] | None = None,
    u0: Sequence[float] | None = None,
) -> StateSpace:
    """Return a System linearised about states ``x0`` and inputs ``u0``; None takes zeros.

    ``values`` maps parameters to values; other parameters have their declared values. Raises
    ModelError if the rates or their derivatives are not finite at the point.
    """
    p = (
        system.parameters.with_values(
            {name: value for name, value in values.items() if name in system.parameters}
        )
        .values()
        .tolist()
    )
    x = [0.0] * len(system.states) if x0 is None else [float(value) for value in x0]
    u = [0.0] * len(system.inputs) if u0 is None else [float(value) for value in u0]
    try:
        with np.errstate(all="ignore"):
            (A, B, rates), (C, D, y0) = (_linear(g, x, u, p) for g in (system.f, system.h))
            finite = all(np.all(np.isfinite(some)) for some in (A, B, C, D, rates, y0))
    except ArithmeticError:
        finite = False
    if not finite:
        point = ", ".join(
            f"{name} {value:g}" for name, value in zip(system.state_names, x, strict=True)
        )
        raise ModelError(
            f"no finite derivatives at {point}", where="state_space", remedy="choose another point"
        )
    delays = (
        {"stick": p[system.parameters.index(DELAY)]}
        if DELAY in system.parameters and "stick" in system.input_names
        else {}
    )
    stages = tuple(
        name
        for name in (*system.input_stages, *system.sensor_stages)
        if not (delays and name == DELAY_STAGE)
    )
    return StateSpace(
        A,
        B,
        C,
        D,
        system.states,
        system.inputs,
        system.outputs,
        np.array(x),
        np.array(u),
        y0,
        rates,
        delays,
        stages,
    )


def _linear(
    g: Callable[..., Any], x: list[float], u: list[float], p: list[float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the derivatives of ``g``, f or h of a System, with respect to states and to inputs,
    and its value.
    """
    value = np.array(g(0.0, x, u, p), dtype=float)
    by_inputs = (
        complex_step_jacobian(lambda a: g(0.0, x, a, p), u) if u else np.zeros((len(value), 0))
    )
    return complex_step_jacobian(lambda a: g(0.0, a, u, p), x), by_inputs, value


def to_control(space: StateSpace, pade: int = PADE_ORDER) -> control.StateSpace:
    """Return the model as a StateSpace of python-control, with the names of its signals.

    Each delay is replaced by a Pade approximation of order ``pade``; order 0 leaves delays out. The
    states of an approximation follow those of the model and are named after the input. Raises
    ModelError for a model without inputs.
    """
    import control

    if not space.inputs:
        raise ModelError(
            "a model without an input cannot be converted for python-control",
            where="to_control",
            remedy="use its matrices A and C",
        )
    A, B, C, D = space.A, space.B, space.C, space.D
    names = [signal.name for signal in space.states]
    for i, signal in enumerate(space.inputs):
        delay = space.delays.get(signal.name, 0.0)
        if pade < 1 or not delay > 0.0:
            continue
        delay_system = control.tf2ss(*control.pade(delay, pade))
        order, old = delay_system.nstates, len(A)
        column, through = B[:, i : i + 1].copy(), D[:, i : i + 1].copy()
        A = np.block([[A, column @ delay_system.C], [np.zeros((order, old)), delay_system.A]])
        B = np.vstack([B, np.zeros((order, B.shape[1]))])
        B[:, i : i + 1] = np.vstack([column @ delay_system.D, delay_system.B])
        C, D = np.hstack([C, through @ delay_system.C]), D.copy()
        D[:, i : i + 1] = through @ delay_system.D
        names += [f"{signal.name}_delay_{k + 1}" for k in range(order)]
    named: dict[str, Any] = {
        "states": names,
        "inputs": _names(space.inputs),
        "outputs": _names(space.outputs),
    }
    return control.ss(A, B, C, D, **named)


def _names(signals: Sequence[Signal]) -> list[str]:
    return [signal.name for signal in signals]
