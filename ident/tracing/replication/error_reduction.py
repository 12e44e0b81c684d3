"""By how much an effect lowers the error on records that were not fitted, and how far chance alone moves that figure.

Errors of a simulation are correlated over a second or more, so that single samples say little: whole blocks of a record are drawn
anew (moving-block bootstrap; Kuensch, Annals of Statistics 17(3), 1989).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing import thresholds
from ident.whole_record.gauss_newton import Fit


@dataclass(frozen=True, eq=False)
class Reduction:
    """Change of the simulation error from one fit to another, over records that neither was fitted to.

    ``total`` is the mean over the channels of ln(rms after / rms before), negative where the error falls, ``scatter`` its standard deviation
    under resampling of blocks; ``by_channel`` and ``channel_scatter`` ``(m,)`` the same for each channel, zero where one is not measured;
    ``by_record`` and ``record_scatter`` those of each record.
    """

    total: float
    scatter: float
    by_channel: np.ndarray
    channel_scatter: np.ndarray
    by_record: tuple[float, ...]
    record_scatter: tuple[float, ...]

    @property
    def share(self) -> float:
        """The error that is left over that before, 1 for no change: a geometric mean over the channels."""
        return float(np.exp(self.total))


def reduction(before: Sequence[Fit], after: Sequence[Fit]) -> Reduction:
    """Compare frozen fits of the same held-out records, one Fit a record, pair by pair; the same draws for the same records."""
    blocks = [_block_sums(one, two) for one, two in zip(before, after, strict=True)]
    sums = np.concatenate(blocks)
    rng = np.random.default_rng(0)

    def redrawn(parts: np.ndarray) -> np.ndarray:
        return np.asarray(parts[rng.integers(len(parts), size=(thresholds.BOOTSTRAP_DRAWS, len(parts)))].sum(axis=1))

    drawn = redrawn(sums)
    by_channel = _log_ratio(sums.sum(axis=0))
    resampled = _log_ratio(drawn)
    return Reduction(
        float(_mean(by_channel, sums.sum(axis=0))),
        float(np.std(_mean(resampled, drawn))),
        by_channel,
        np.std(resampled, axis=0),
        tuple(float(_mean(_log_ratio(b.sum(axis=0)), b.sum(axis=0))) for b in blocks),
        tuple(float(np.std(_mean(_log_ratio(d), d))) for d in map(redrawn, blocks)),
    )


def _block_sums(before: Fit, after: Fit) -> np.ndarray:
    """Sums of squared errors in each block of one record, ``(blocks, 2, m)``: before and after."""
    time = before.layout.problems[0].record.time
    interval = (time[-1] - time[0]) / (len(time) - 1)
    size = max(5, round(thresholds.BLOCK / interval))
    edges = np.arange(0, len(time), size)
    squares = np.stack([before.residuals[0] ** 2, after.residuals[0] ** 2])
    return np.add.reduceat(squares, edges, axis=2).transpose(2, 0, 1)


def _log_ratio(sums: np.ndarray) -> np.ndarray:
    """ln(rms after / rms before) from ``(..., 2, m)``; zero where nothing was measured."""
    measured = np.all(sums > 0, axis=-2)
    safe = np.where(measured[..., None, :], sums, 1.0)
    return np.asarray(0.5 * np.log(safe[..., 1, :] / safe[..., 0, :]))


def _mean(ratios: np.ndarray, sums: np.ndarray) -> np.ndarray:
    measured = np.all(sums > 0, axis=-2)
    return np.asarray(ratios.sum(axis=-1) / np.maximum(measured.sum(axis=-1), 1))
