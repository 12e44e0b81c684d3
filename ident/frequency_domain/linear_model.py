"""The matrices of a linear System and their slopes by its parameters; what is not linear is found out by trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.model import System
from sim.maths import COMPLEX_STEP
from sim.record import Record

STRAIGHT = 1e-7  # of a rate's or reading's own change, by which rounding may bend it
_POINTS = 6  # points at which a System is compared with its matrices


@dataclass(frozen=True, eq=False)
class LinearModel:
    """x_dot = A x + B u, y = C x + D u less constants: ``A (n, n)``, ``B (n, r)``, ``C (m, n)``, ``D (m, r)``.

    ``dA (q, n, n)`` and so on are the slopes by each of the wanted parameters.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dA: np.ndarray
    dB: np.ndarray
    dC: np.ndarray
    dD: np.ndarray


def linear_model(system: System, p: np.ndarray, free: Sequence[int]) -> LinearModel:
    """The matrices of a System that is linear in states and inputs, at parameters ``p``, with slopes by those at the positions ``free``.

    One call each of ``f`` and ``h``: a row a unit step of a state or input, a column a complex step of a parameter. Effects on the input
    and sensor paths are left out.
    """
    n, r, q = len(system.states), len(system.inputs), max(len(free), 1)
    rows: list[Any] = [complex(value) for value in p]
    for column, position in enumerate(free):
        rows[position] = p[position] + 1j * COMPLEX_STEP * (np.arange(q) == column)
    unit = np.vstack([np.zeros(n + r), np.eye(n + r)])[:, :, None]
    x, u = list(unit[:, :n].swapaxes(0, 1)), list(unit[:, n:].swapaxes(0, 1))
    rates, readings = (
        np.array([np.broadcast_to(row, (1 + n + r, q)) for row in function(0.0, x, u, rows)]).reshape(-1, 1 + n + r, q)
        for function in (system.f, system.h)
    )
    F, H = (each[:, 1:] - each[:, :1] for each in (rates, readings))
    dF, dH = ((each.imag / COMPLEX_STEP).transpose(2, 0, 1)[: len(free)] for each in (F, H))
    F, H = F[:, :, 0].real, H[:, :, 0].real
    return LinearModel(F[:, :n], F[:, n:], H[:, :n], H[:, n:], dF[:, :, :n], dF[:, :, n:], dH[:, :, :n], dH[:, :, n:])


def bent(system: System, records: Sequence[Record]) -> str:
    """The first rate or output that is no linear function of states and inputs, the same at all times, over the records' extent; else empty."""
    p = system.parameters.values()
    with np.errstate(all="ignore"):  # what is not finite at rest is not linear
        model = linear_model(system, p, ())
    names = [f"the rate of {name}" for name in system.state_names] + list(system.output_names)
    matrix = np.block([[model.A, model.B], [model.C, model.D]])
    sizes = np.array([_size(name, records) for name in (*system.state_names, *system.input_names)])
    times = np.concatenate([np.zeros(1), *(record.time for record in records)])
    # At sines of no common period, which reach every corner of a few dimensions, and at rest.
    points = [*(sizes * np.sin(1.0 + np.arange(len(sizes)) * (k + 1.0) + 0.7 * k) for k in range(_POINTS)), 0.0 * sizes]
    with np.errstate(all="ignore"):
        start = _values(system, points[-1], p, np.zeros(1))
        room = STRAIGHT * np.maximum(np.max(np.abs(matrix * sizes), axis=1), 1e-300) + 1e-12 * np.abs(start[:, 0])
        for point in points:
            found, expected = _values(system, point, p, times) - start, matrix @ point
            off = ~np.all(np.abs(found - expected[:, None]) <= room[:, None], axis=1)
            if np.any(off):
                return names[int(np.argmax(off))]
    return ""


def _values(system: System, point: np.ndarray, p: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Rates and outputs ``(n + m, T)`` at a point at all times."""
    n = len(system.states)
    x, u = list(point[:n]), list(point[n:])  # numbers of NumPy, whose division by zero is no exception
    rows = (*system.f(times, x, u, p.tolist()), *system.h(times, x, u, p.tolist()))
    return np.array([np.broadcast_to(row, times.shape) for row in rows], dtype=float)


def _size(name: str, records: Sequence[Record]) -> float:
    """Largest recorded value of a signal, one where it is not recorded."""
    found = [np.max(np.abs(channel.values[channel.valid]), initial=0.0) for record in records for channel in record.channels if channel.name == name]
    return float(max(found, default=0.0)) or 1.0
