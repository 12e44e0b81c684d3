"""How process noise along a trajectory changes with the parameters: what a fit needs of it beside its values.

Central differences of the linearised motion. Where that bends little from step to step, as it does wherever no limit or dead band acts, the
slopes of the discrete motion are worked out at every eighth step and drawn straight between.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.process_noise.discretised import DiscretisedNoise, Variation, discrete_motion, linear_motion
from ident.whole_record.record_problem import RecordProblem

_SLOPE = 1e-5  # of a parameter's size, for central differences
_APART = 8  # steps from one place to the next where slopes are worked out, if straight lines between them are good enough
_STRAIGHT = 0.005  # of the largest entry: over a step an error of F is a hundredth or tenth of that of Phi


@dataclass(frozen=True, eq=False)
class NoiseSlopes:
    """Derivatives of a DiscretisedNoise by the quantities ``of`` (positions among those asked for) that change it."""

    of: tuple[int, ...]
    motion: DiscretisedNoise


def noise_slopes(problem: RecordProblem, states: np.ndarray, at: Variation, moved: Sequence[tuple[Variation, Variation, float]]) -> NoiseSlopes:
    """Derivatives of the process noise at the given trajectory; that the trajectory moves too is left out.

    ``moved`` holds for each quantity two variations and the distance between them: see ``slope_pairs``.
    """
    F, H, density, stationary = linear_motion(problem, states, [at, *(end for low, high, _ in moved for end in (low, high))])
    parts = (F, H, density[None])
    of = tuple(i for i in range(len(moved)) if any(np.any(part[:, 1 + 2 * i] != part[:, 2 + 2 * i]) for part in parts))
    chosen = [0, *(end for i in of for end in (1 + 2 * i, 2 + 2 * i))]  # the others would only be worked out to be the same
    width = np.array([moved[i][2] for i in of])[:, None, None]

    def slope(part: np.ndarray) -> np.ndarray:
        return np.asarray((part[:, 2::2] - part[:, 1::2]) / width)

    F, steps = F[:, chosen], np.diff(problem.grid.nodes)
    at_these = _where_it_bends(np.concatenate([F[:, :1], slope(F)], axis=1), steps)
    by_Phi, by_Q, start = discrete_motion(F[at_these], steps[at_these] if len(F) > 1 else steps, density[chosen], stationary, slope)
    by_Phi, by_Q = (_between(slopes, at_these, len(steps)) for slopes in (by_Phi, by_Q))
    return NoiseSlopes(of, DiscretisedNoise(by_Phi, by_Q, slope(H[:, chosen]), slope(start[None])[0]))


def slope_pairs(at: Variation, positions: Sequence[int], sizes: Sequence[float], scale: bool) -> list[tuple[Variation, Variation, float]]:
    """Pairs for central differences by the parameters at ``positions``, whose sizes are given, then by the scale if wanted."""
    pairs = []
    for position, size in zip(positions, sizes, strict=True):
        step, ends = _SLOPE * size, []
        for sign in (-1.0, 1.0):
            p = at.p.copy()
            p[position] += sign * step
            ends.append(Variation(p, at.scale))
        pairs.append((ends[0], ends[1], ends[1].p[position] - ends[0].p[position]))
    if scale:
        step = _SLOPE * max(at.scale, 1.0)
        pairs.append((Variation(at.p, at.scale - step), Variation(at.p, at.scale + step), 2.0 * step))
    return pairs


def _where_it_bends(shape: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Steps at which slopes are worked out, straight lines being good enough between them: all, unless every ``shape (K, D, n, n)`` is smooth."""
    every = np.arange(len(shape))
    if len(shape) < 2 * _APART or np.ptp(steps) > 1e-9 * steps.max():
        return every
    some = np.append(every[:-1:_APART], every[-1])
    away = np.abs(_between(shape[some], some, len(shape)) - shape).max(axis=0)
    largest = np.abs(shape).max(axis=0).max(axis=(-2, -1), keepdims=True)
    return some if np.all(away <= _STRAIGHT * largest) else every


def _between(values: np.ndarray, at: np.ndarray, count: int) -> np.ndarray:
    """``values (len(at), ...)`` at ``count`` steps, by straight lines; the same where they are alike everywhere or known at each."""
    if len(values) in (1, count):
        return values
    left = np.clip(np.searchsorted(at, np.arange(count), side="right") - 1, 0, len(at) - 2)
    share = ((np.arange(count) - at[left]) / (at[left + 1] - at[left])).reshape(-1, *(1,) * (values.ndim - 1))
    return np.asarray(values[left] + share * (values[left + 1] - values[left]))
