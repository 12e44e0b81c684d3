"""Instruments: filtered controls, which distinguish a gust from a sensor fault.

A gust w immediately changes the reading of the vane by w/V, and the load. The residual of the
kinematics is then correlated with nz and the rate of alpha, so that a regression on these is
biased. The controls are independent of the gust, so that filtered controls serve as instrumental
variables, here called instruments. A regression after projection onto them is unbiased for any
response of the aircraft (two-stage least squares; Sargan, Econometrica 26(3), 1958).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np

from ident.compatibility.signals import KinematicSignals, RelationNoise, differences, whitener
from sim.record import Record

# bounds (s before the sample) of the intervals over which controls are averaged: the means
# represent an impulse response in steps
_INTERVAL_BOUNDS = (0.0, 0.08, 0.16, 0.28, 0.4, 0.55, 0.75, 1.0, 1.3, 1.7, 2.2, 2.8, 3.5, 4.5)
_SAMPLES_PER_INSTRUMENT = 6  # fewest samples for each instrument
_ROUNDING_EIGENVALUE_SHARE = 1e-9  # smallest eigenvalue above rounding, relative to the largest

ColumnMap = Callable[[np.ndarray], np.ndarray]


def instruments_of(record: Record, every: int = 1) -> np.ndarray:
    """Return the instruments ``(N, L)``: the mean of each control over past intervals, its first
    two integrals, and the terms of a parabola in time. L is 0 without a moving control.

    ``every`` : use only each ``every``-th bound of the intervals.
    """
    t = record.time - record.time[0]
    moved = [
        channel.values - channel.values[0]
        for channel in record.inputs
        if np.ptp(channel.values) > 0
    ]
    if not moved:
        return np.empty((len(t), 0))
    bounds: tuple[float, ...] = _INTERVAL_BOUNDS[::every]
    while len(moved) * len(bounds) * _SAMPLES_PER_INSTRUMENT > len(t) and len(bounds) > 3:
        bounds = bounds[::2]
    columns = [np.ones(len(t)), t, t**2]
    for u in moved:
        integral = _integral(u, t)
        past = [np.interp(t - bound, t, integral) for bound in bounds]
        columns += [newer - older for newer, older in pairwise(past)]
        columns += [integral, _integral(integral, t)]
    return np.array([column / max(float(np.abs(column).max()), 1e-300) for column in columns]).T


def instrumented(signals: Sequence[KinematicSignals]) -> bool:
    """Return whether every record has controls, which distinguish a gust from a fault."""
    return all(s.instruments.shape[1] for s in signals)


# Many faults are tried under one noise: the cache holds whiteners of the records of a check for a
# few noises.
@lru_cache(maxsize=24)
def projected_whitener(s: KinematicSignals, noise: RelationNoise) -> ColumnMap:
    """Return the function that whitens columns ``(m, N, c)`` to unit variance, and with instruments
    also projects them onto these. Columns are zero where a sample is missing.
    """
    white = whitener(s, noise)
    if not s.instruments.shape[1]:
        return white
    m, n = s.valid.shape
    flat = white.of_differences(s.instrument_differences).reshape(n, m, -1)
    project = _projection(_orthonormal(flat.transpose(1, 0, 2).reshape(m * n, -1)))
    return lambda columns: project(white(columns))


@lru_cache(maxsize=24)
def reduced_whitener(
    s: KinematicSignals, noise: RelationNoise
) -> Callable[[np.ndarray], np.ndarray]:
    """Return the function that maps columns ``(m, N, c)`` to fewer rows ``(K, c)`` with the same
    scalar products as the columns after `projected_whitener`.
    """
    white = whitener(s, noise)
    if not s.instruments.shape[1]:
        return lambda columns: white.of_differences(differences(columns))
    basis = _orthonormal(white.of_differences(s.instrument_differences))
    return lambda columns: basis.T @ white.of_differences(differences(columns))


def instrument_projection(s: KinematicSignals) -> ColumnMap:
    """Return the function that projects columns ``(m, N, c)`` onto the instruments; without
    instruments it leaves them as they are.
    """
    if not s.instruments.shape[1]:
        return lambda columns: columns
    wide = s.instruments_by_output
    return _projection(_orthonormal(wide.reshape(-1, wide.shape[2])))


def _projection(basis: np.ndarray) -> ColumnMap:
    """Return the projection of columns ``(m, N, c)`` onto an orthonormal ``basis (m N, r)``."""

    def project(columns: np.ndarray) -> np.ndarray:
        flat = columns.reshape(-1, columns.shape[2])
        return np.asarray((basis @ (basis.T @ flat)).reshape(columns.shape))

    return project


def _orthonormal(flat: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis ``(m N, r)`` of the columns ``flat (m N, c)``."""
    gram = flat.T @ flat
    scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    determined = values > _ROUNDING_EIGENVALUE_SHARE * values[-1]
    return np.asarray(
        flat @ (scale[:, None] * vectors[:, determined] / np.sqrt(values[determined]))
    )


def _integral(u: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Return the integral ``(N,)`` of ``u (N,)`` over time by the trapezoidal rule."""
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (u[1:] + u[:-1]))])
