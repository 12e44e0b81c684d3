"""How far chance moves the change of an error on data that were not fitted."""

from __future__ import annotations

import numpy as np

from ident.tracing import thresholds
from ident.whole_record.gauss_newton import Fit


def scatter_of_change(before: Fit, after: Fit) -> float:
    """Standard deviation of ln(error after / error before) under resampling of blocks of time, the same for the same two fits.

    Of frozen fits of the same records; the error is a geometric mean over the samples, as ``with_held_out_change`` has it.
    """
    sums, counts = _blocks(before, after)
    draws = np.random.default_rng(0).integers(len(sums), size=(thresholds.BOOTSTRAP_DRAWS, len(sums)))
    drawn, weight = sums[draws].sum(axis=1), counts[draws].sum(axis=1)  # (draws, 2, m), (draws, m)
    measured = np.all(drawn > 0.0, axis=1)
    safe = np.where(measured[:, None, :], drawn, 1.0)
    logs = 0.5 * np.log(safe[:, 1] / safe[:, 0])
    return float(np.std(np.sum(weight * logs, axis=1) / np.maximum(np.sum(weight * measured, axis=1), 1.0)))


def _blocks(before: Fit, after: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squared errors before and after ``(blocks, 2, m)`` and samples ``(blocks, m)`` of all records."""
    sums, counts = [], []
    for problem, one, two in zip(before.layout.problems, before.residuals, after.residuals, strict=True):
        time = problem.record.time
        size = max(5, round(thresholds.BLOCK * (len(time) - 1) / (time[-1] - time[0])))
        edges = np.arange(0, len(time), size)
        sums.append(np.add.reduceat(np.stack([one**2, two**2]), edges, axis=2).transpose(2, 0, 1))
        counts.append(np.add.reduceat((one != 0.0).astype(float), edges, axis=1).T)
    return np.concatenate(sums), np.concatenate(counts)
