"""The white noise of a sensor, read off a residual that holds other things besides: from its spectrum at high frequencies.

The coefficients of the orthonormal cosine transform (DCT-II) of white noise are independent, each with the noise's variance; what a
model leaves of a motion is smooth and has its power at low frequencies. With x = 4 sin^2(w / 2), w the frequency in rad a sample, the
squared coefficients have the expectation

    S(w) = s^2 + a / x,    s, a >= 0,

the spectrum of white noise and of a random walk beside it (Harvey, Forecasting, Structural Time Series Models and the Kalman Filter,
1989, sections 2.4 and 4.3), to which that of any motion of first order comes down above its corner. s^2 and a are those of Whittle's
likelihood: I(w) / S(w) is chi-square with one degree of freedom. The band begins at half the Nyquist frequency and is extended
downwards as long as the next block has the power that the band foretells. The cosine transform as a sieve of noise from what is smooth:
Garcia, Computational Statistics and Data Analysis 54, 2010, p. 1167.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.special import fdtri

SHORTEST = 16  # samples of a run that is looked at
FEWEST = 32  # coefficients in the band; a standard deviation of fewer is known to worse than an eighth
BEGIN = 0.5  # of the Nyquist frequency, above which no residual of a rigid body's motion has power
BLOCKS = 12  # in which the band grows to the whole spectrum
CHANCE = 0.01  # that a block of what belongs to the band is left out
LARGEST_GAP = 10.0  # sample intervals: a longer pause in the samples begins another run
ITERATIONS = 12
NOTHING = 1e-9  # of the power, below which none of it is white


def sensor_noise(series: Sequence[np.ndarray]) -> float | None:
    """Standard deviation of the white part of residuals; None where they are too short to tell, or have no white part.

    ``series``: runs of residuals at even intervals, each ``(N,)`` and finite; of several, as of several records, one noise is estimated.
    """
    runs = [np.asarray(each, dtype=float) for each in series if len(each) >= SHORTEST]
    if not runs:
        return None
    share = np.concatenate([np.arange(1, len(run)) / len(run) for run in runs])  # of the Nyquist frequency
    power = np.concatenate([_cosine_transform(run)[1:] ** 2 for run in runs])
    order = np.argsort(-share, kind="stable")
    share, power = share[order], power[order]
    count = int(np.count_nonzero(share >= BEGIN))
    if count < FEWEST or not power[:count].any():
        return None
    walk = 0.25 / np.sin(0.5 * np.pi * share) ** 2
    ends = np.unique(np.linspace(count, len(share), BLOCKS).astype(int)).tolist()
    white, random = _fitted(power[:count], walk[:count])
    for end, further in pairwise(ends):
        block = power[end:further] / (white + random * walk[end:further])
        if np.mean(block) > fdtri(further - end, end, 1.0 - CHANCE):
            break
        white, random = _fitted(power[:further], walk[:further])
    return float(np.sqrt(white)) if white > NOTHING * float(np.mean(power)) else None


def _cosine_transform(x: np.ndarray) -> np.ndarray:
    """The orthonormal cosine transform of the second kind, ``(N,)`` from ``(N,)``, but for its first coefficient, which is larger by root two.

    By NumPy's Fourier transform of the even samples, then the odd ones backwards (Makhoul 1980); loading scipy.fft takes a tenth of a second.
    """
    turned = np.exp(-0.5j * np.pi * np.arange(len(x)) / len(x))
    return np.asarray(np.sqrt(2.0 / len(x)) * (np.fft.fft(np.concatenate([x[::2], x[1::2][::-1]])) * turned).real)


def used_runs(time: np.ndarray, residual: np.ndarray, used: np.ndarray) -> list[np.ndarray]:
    """The used samples of a residual ``(N,)`` at ``time`` (s), as runs without a long pause; what was set aside in between is closed up."""
    t, r = time[used], residual[used]
    if len(t) < 2:
        return []
    steps = np.diff(t)
    return np.split(r, np.flatnonzero(steps > LARGEST_GAP * float(np.median(steps))) + 1)


def _fitted(power: np.ndarray, walk: np.ndarray) -> tuple[float, float]:
    """s^2 and a of Whittle's likelihood, by weighted least squares with the weights of the last step; neither below zero."""
    white, random = float(np.mean(power)), 0.0
    for _ in range(ITERATIONS):
        weight = (white + random * walk) ** -2.0
        n, u, v = float(weight.sum()), float(weight @ walk), float((weight * walk) @ walk)
        y, z = float(weight @ power), float((weight * walk) @ power)
        determinant = n * v - u * u
        slope = (n * z - u * y) / determinant if determinant > 0.0 else 0.0
        level = (y - u * slope) / n
        slope, level = (slope, level) if slope > 0.0 else (0.0, y / n)
        if level <= 0.0:  # all of it is the motion
            level, slope = 1e-3 * NOTHING * float(np.mean(power)), z / v
        white, random = level, slope
    return white, random
