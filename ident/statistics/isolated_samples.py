"""Isolated wrong samples: found and set aside before anything is ranked, claimed only against the
final residual.

One spike dominates every score; but in runs, or all over a channel, large residuals are a model's
fault or heavy-tailed noise, and neither is a spike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.statistics.noise_levels import robust_sigma
from sim.record import Record

# in robust sigmas
SPIKE_WHILE_SEARCHING = 8.0  # before the model is complete a residual is not Gaussian
SPIKE_AT_THE_END = 5.5  # Gaussian noise exceeds it once in 3e7 samples
HEAVY_TAIL = (3.7, 6.5)  # Gaussian noise puts 2 of 10,000 samples there; more is a heavy tail
HEAVY_TAIL_CHANCE = 1e-3  # p-value of that count, by Poisson's law
FEWEST_AT_EDGES = 9  # samples near the edges of an input, three of which are one edge


@dataclass(frozen=True)
class Spikes:
    """Spikes of one channel of one record: sample numbers and sizes in the channel's unit."""

    record: int
    channel: str
    samples: tuple[int, ...]
    sizes: tuple[float, ...]


def provisional_mask(residual: np.ndarray, valid: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """False at samples that stand alone above their six neighbours, ``(m, N)``; ``edges (N,)`` True
    near a switch of an input.
    """
    keep = np.ones_like(valid)
    for i in range(len(residual)):
        away = from_neighbours(residual[i], valid[i])
        sigma = robust_sigma(away[valid[i]])
        if sigma > 0:
            keep[i] = ~(_isolated(np.abs(away) > SPIKE_WHILE_SEARCHING * sigma) & ~edges)
    return keep


def final_spikes(
    records: Sequence[Record],
    channels: Sequence[str],
    residuals: Sequence[np.ndarray],
    measured: Sequence[np.ndarray],
    blocked: Sequence[np.ndarray],
) -> tuple[list[np.ndarray], list[Spikes]]:
    """Masks rebuilt from the final residuals of all samples, and the spikes that may be claimed.

    ``residuals`` and ``measured`` (validity) are ``(m, N)`` a record, ``blocked (N,)`` True near
    the edge of a fitted event: a sample there is set aside but not claimed.
    """
    masks, claims = [np.ones_like(valid) for valid in measured], []
    for i, channel in enumerate(channels):
        pooled = np.concatenate(
            [residual[i][valid[i]] for residual, valid in zip(residuals, measured, strict=True)]
        )
        sigma = robust_sigma(pooled)
        if sigma == 0.0:
            continue
        heavy = _heavy_tailed(pooled / sigma)
        for r, (residual, valid) in enumerate(zip(residuals, measured, strict=True)):
            large = valid[i] & (np.abs(residual[i]) > SPIKE_AT_THE_END * sigma)
            alone = _isolated(large)
            if heavy:
                continue
            masks[r][i] = ~alone
            samples = np.flatnonzero(alone & ~blocked[r])
            if samples.size:
                claims.append(
                    Spikes(
                        r, channel, tuple(samples.tolist()), tuple(residual[i][samples].tolist())
                    )
                )
    return masks, claims


def isolated_wrong(
    residuals: Sequence[np.ndarray], valid: Sequence[np.ndarray], edges: Sequence[np.ndarray]
) -> list[np.ndarray]:
    """True at the isolated wrong samples of one channel in each record, ``(N,)``, from the
    residuals of a fit that may lack something.

    A sample that is alone above its neighbours, as while searching, or above the residual, as at
    the end; none where the residual has heavy tails. Near the ``edges`` of an input, where a model
    that lacks something is off every time, it is compared with the other edges.
    """
    away = [
        from_neighbours(residual, known) for residual, known in zip(residuals, valid, strict=True)
    ]
    wrong = [np.zeros(len(residual), dtype=bool) for residual in residuals]
    for series, times in (
        (away, SPIKE_WHILE_SEARCHING),
        (residuals, SPIKE_AT_THE_END),
    ):
        pooled = np.concatenate([some[known] for some, known in zip(series, valid, strict=True)])
        sigma = robust_sigma(pooled)
        if sigma == 0.0 or _heavy_tailed(pooled / sigma):
            continue
        wrong = [
            found | (_isolated(known & (np.abs(some) > times * sigma)) & ~near)
            for found, some, known, near in zip(wrong, series, valid, edges, strict=True)
        ]
        at_edges = np.concatenate(
            [some[known & near] for some, known, near in zip(series, valid, edges, strict=True)]
        )
        if at_edges.size < FEWEST_AT_EDGES:
            continue
        largest = float(np.max(np.abs(at_edges)))
        others = float(np.sqrt((np.sum(at_edges**2) - largest**2) / (at_edges.size - 1)))
        if largest > times * max(others, sigma):
            wrong = [
                found | (known & near & (np.abs(some) >= largest))
                for found, some, known, near in zip(wrong, series, valid, edges, strict=True)
            ]
    return wrong


def input_edges(record: Record, reach: int = 1) -> np.ndarray:
    """True within ``reach`` samples of a switch of an input, ``(N,)``."""
    near = np.zeros(len(record), dtype=bool)
    for channel in record.inputs:
        step = np.abs(np.diff(channel.values, prepend=channel.values[0]))
        span = float(np.ptp(channel.values))
        near |= step > 0.2 * span if span > 0 else False
    wide = near.copy()
    for shift in range(1, reach + 1):
        wide[shift:] |= near[:-shift]
        wide[:-shift] |= near[shift:]
    return wide


def input_spikes(values: np.ndarray) -> np.ndarray:
    """Samples of a recorded input that differ from both neighbours alike, while these agree: no
    held maneuver does that.
    """
    before, after = values[:-2], values[2:]
    height = values[1:-1] - 0.5 * (before + after)
    wander = np.abs(after - before)
    usual = max(robust_sigma(np.diff(values)), 1e-3 * float(np.ptp(values)))
    found = (np.abs(height) > SPIKE_WHILE_SEARCHING * usual) & (wander < 0.25 * np.abs(height))
    return np.flatnonzero(found) + 1


def from_neighbours(series: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Each sample minus the median of its six valid neighbours; zero where it is missing."""
    at = np.flatnonzero(valid)
    out = np.zeros_like(series)
    if len(at) < 7:
        return out
    values = series[at]
    padded = np.pad(values, 3, mode="reflect")
    around = np.stack([padded[k : k + len(values)] for k in (0, 1, 2, 4, 5, 6)])
    out[at] = values - np.median(around, axis=0)
    return out


def _isolated(large: np.ndarray) -> np.ndarray:
    """Large samples without a large neighbour within two samples: outliers in runs are no
    spikes.
    """
    count = np.convolve(np.pad(large, 2), np.ones(5), mode="valid")
    return large & (count < 1.5)


def _heavy_tailed(normalised: np.ndarray) -> bool:
    """Whether more samples lie in the tail's range than Gaussian noise explains, at one in a
    thousand (Poisson).
    """
    (low, high), size = HEAVY_TAIL, np.abs(normalised)
    count = int(np.sum((size > low) & (size < high)))
    expected = len(normalised) * (math.erfc(low / math.sqrt(2)) - math.erfc(high / math.sqrt(2)))
    tail = 1.0 - sum(
        math.exp(k * math.log(expected) - expected - math.lgamma(k + 1)) for k in range(count)
    )
    return tail < HEAVY_TAIL_CHANCE
