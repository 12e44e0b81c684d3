"""What the recorded controls have moved: the part of a record in which a gust cannot pass for a fault of a sensor.

A gust w stands in the vane's reading as w/V, and the load answers to it at once: what is left of the kinematics then goes with nz and with the
rate of alpha, and a regression on these is biased. The controls know nothing of the gust. Filtered in any way they are instruments: regression
after projection on them is unbiased, whatever the aircraft's response is (two-stage least squares; Sargan, Econometrica 26(3), 1958).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise

import numpy as np

from ident.compatibility.noise import NoiseModel, whitener
from ident.compatibility.signals import Signals, differences
from sim.record import Record

# s back from now, in which the mean of a control is taken: an impulse response in steps.
_BACK = (0.0, 0.08, 0.16, 0.28, 0.4, 0.55, 0.75, 1.0, 1.3, 1.7, 2.2, 2.8, 3.5, 4.5)
_SHARE = 6  # samples for each instrument, at least
_ALIKE = 1e-9  # of the largest eigenvalue: such a combination of instruments is rounding

Weigher = Callable[[np.ndarray], np.ndarray]


def instruments_of(record: Record, every: int = 1) -> np.ndarray:
    """Columns ``(N, L)``: means of each control over stretches of the past, its integrals, a parabola; without a control that moves none.

    ``every``: of the times that bound the stretches, only every so many.
    """
    t = record.time - record.time[0]
    moved = [channel.values - channel.values[0] for channel in record.inputs if np.ptp(channel.values) > 0]
    if not moved:
        return np.empty((len(t), 0))
    back: tuple[float, ...] = _BACK[::every]
    while len(moved) * len(back) * _SHARE > len(t) and len(back) > 3:
        back = back[::2]
    columns = [np.ones(len(t)), t, t**2]
    for u in moved:
        once = _integral(u, t)
        past = [np.interp(t - ago, t, once) for ago in back]
        columns += [newer - older for newer, older in pairwise(past)]
        columns += [once, _integral(once, t)]
    return np.array([column / max(float(np.abs(column).max()), 1e-300) for column in columns]).T


def instrumented(signals: Sequence[Signals]) -> bool:
    """Whether every record has controls that tell a gust from a fault."""
    return all(s.instruments.shape[1] for s in signals)


@lru_cache(maxsize=24)  # many faults are tried under one noise; the records of a check and a few noises stay
def weigher(s: Signals, noise: NoiseModel) -> Weigher:
    """Columns ``(m, N, c)``, zero where a sample is missing, as those of independent samples of variance one, with instruments only their part."""
    white = whitener(s, noise)
    if not s.instruments.shape[1]:
        return white
    m, n = s.valid.shape
    flat = white.of_differences(s.instrument_differences).reshape(n, m, -1)
    part = _projection(_orthonormal(flat.transpose(1, 0, 2).reshape(m * n, -1)))
    return lambda columns: part(white(columns))


@lru_cache(maxsize=24)
def shortened(s: Signals, noise: NoiseModel) -> Callable[[np.ndarray], np.ndarray]:
    """What ``weigher`` makes of columns ``(m, N, c)``, in fewer rows ``(K, c)`` of the same products."""
    white = whitener(s, noise)
    if not s.instruments.shape[1]:
        return lambda columns: white.of_differences(differences(columns))
    basis = _orthonormal(white.of_differences(s.instrument_differences))
    return lambda columns: basis.T @ white.of_differences(differences(columns))


def part_of_controls(s: Signals) -> Weigher:
    """Columns ``(m, N, c)`` to the part that the instruments explain, every sample alike; without instruments the columns themselves."""
    if not s.instruments.shape[1]:
        return lambda columns: columns
    wide = s.instruments_by_output
    return _projection(_orthonormal(wide.reshape(-1, wide.shape[2])))


def _projection(basis: np.ndarray) -> Weigher:
    def part(columns: np.ndarray) -> np.ndarray:
        return np.asarray((basis @ (basis.T @ columns.reshape(-1, columns.shape[2]))).reshape(columns.shape))

    return part


def _orthonormal(flat: np.ndarray) -> np.ndarray:
    """Orthonormal columns ``(m N, r)`` that span what columns ``(m N, c)`` span."""
    gram = flat.T @ flat
    scale = 1.0 / np.sqrt(np.where(np.diag(gram) > 0, np.diag(gram), 1.0))
    values, vectors = np.linalg.eigh(gram * np.outer(scale, scale))
    told = values > _ALIKE * values[-1]
    return np.asarray(flat @ (scale[:, None] * vectors[:, told] / np.sqrt(values[told])))


def _integral(u: np.ndarray, t: np.ndarray) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * np.diff(t) * (u[1:] + u[:-1]))])
