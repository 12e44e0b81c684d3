"""Noise of one output: white sensor noise and a smooth model discrepancy, and its exact whitening.

The discrepancy is a stationary Gaussian process with Matern's covariance of order 3/2: the sum of
many small causes and of the filters in the instrumentation. In state space it has two states, so
that a Kalman filter turns a residual into independent innovations [1]_.

References
----------
.. [1] J. Hartikainen and S. Sarkka, "Kalman filtering and smoothing solutions to temporal Gaussian
   process regression models", IEEE MLSP, 2010.
.. [2] M. C. Kennedy and A. O'Hagan, "Bayesian calibration of computer models", J. R. Statist. Soc.
   B 63, 2001.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

TYPICAL_TIME, TIMES_WIDER = 0.7, 3.0  # s, factor: prior of the discrepancy's correlation time
TYPICAL_SHARE, SHARE_WIDER = 1.0 / 3.0, 5.0  # prior of the discrepancy's sigma over the white one
_SETTLED = 1e-10  # relative change of the filter's covariance below which its gain is constant


@dataclass(frozen=True)
class NoiseLaw:
    """Noise of one output.

    Attributes
    ----------
    white : standard deviation of the white noise, in the output's unit.
    discrepancy : standard deviation of the discrepancy, in the output's unit; zero where there is
        none.
    time : correlation time of the discrepancy, s.
    """

    white: float
    discrepancy: float = 0.0
    time: float = TYPICAL_TIME

    @property
    def share(self) -> float:
        """Share of the discrepancy in the noise's variance, from 0 to 1."""
        return self.discrepancy**2 / (self.discrepancy**2 + self.white**2)

    def smaller(self, factor: float) -> NoiseLaw:
        """The same law with ``factor`` times the discrepancy."""
        return replace(self, discrepancy=self.discrepancy * factor)

    def log_prior(self, interval: float, duration: float) -> float:
        """Log prior density of the three numbers, but for a constant.

        Flat in ln(white); the other two are log-normal. Times below one and a half sampling
        intervals are white noise, times above a quarter of the record are a bias.
        """
        time, share = math.log(self.time), math.log(max(self.discrepancy, 1e-12) / self.white)
        shortest, longest = math.log(1.5 * interval), math.log(duration / 4.0)
        outside = max(0.0, shortest - time) ** 2 + max(0.0, time - longest) ** 2
        return (
            -0.5 * ((time - math.log(TYPICAL_TIME)) / math.log(TIMES_WIDER)) ** 2
            - 0.5 * ((share - math.log(TYPICAL_SHARE)) / math.log(SHARE_WIDER)) ** 2
            - 50.0 * outside
        )


def whiten(
    law: NoiseLaw, time: np.ndarray, valid: np.ndarray, columns: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Turn columns with the noise of a law into columns with independent noise of variance one.

    Parameters
    ----------
    law : the noise. time : ``(N,)``, s. valid : ``(N,)``, False where a sample does not count.
    columns : ``(N, c)`` in the output's unit.

    Returns
    -------
    ``(N, c)`` and the logarithms ``(N,)`` of the innovations' variances, both zero where a sample
    does not count.
    """
    if law.discrepancy <= 1e-9 * law.white:
        weight = valid / law.white
        return columns * weight[:, None], 2.0 * math.log(law.white) * valid
    steps = np.diff(time)
    gains, variances, slopes = _filter(law, steps, valid)
    predicted = _predictions(gains, slopes, columns)
    weight = valid / np.sqrt(variances)
    return (columns - predicted) * weight[:, None], np.log(variances) * valid


def covariance(law: NoiseLaw, time: np.ndarray) -> np.ndarray:
    """Covariance ``(N, N)`` of the noise at the times ``(N,)``; for short records and for tests."""
    away = np.abs(time[:, None] - time[None]) * math.sqrt(3.0) / law.time
    smooth = law.discrepancy**2 * (1.0 + away) * np.exp(-away)
    return np.asarray(law.white**2 * np.eye(len(time)) + smooth)


def _filter(
    law: NoiseLaw, steps: np.ndarray, valid: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gains ``(N, 2)``, innovation variances ``(N,)`` and transitions ``(N - 1, 4)``."""
    rate = math.sqrt(3.0) / law.time
    fall = np.exp(-rate * steps)
    slopes = np.stack(
        [
            fall * (1.0 + rate * steps),
            fall * steps,
            -fall * rate * rate * steps,
            fall * (1.0 - rate * steps),
        ],
        axis=1,
    )
    count = len(valid)
    even = bool(len(steps) == 0 or np.ptp(steps) < 1e-6 * steps[0])
    gaps = np.flatnonzero(~valid)
    gains, variances = np.zeros((count, 2)), np.empty(count)
    s2, d2 = law.white**2, law.discrepancy**2
    v2 = d2 * rate * rate
    p00, p01, p11 = d2, 0.0, v2
    rows, seen = slopes.tolist(), valid.tolist()
    t = 0
    while t < count:
        f = p00 + s2
        variances[t] = f
        a, b, c = p00, p01, p11
        if seen[t]:
            k0, k1 = p00 / f, p01 / f
            gains[t] = k0, k1
            a, b, c = p00 - k0 * p00, p01 - k0 * p01, p11 - k1 * p01
        if t == count - 1:
            break
        f00, f01, f10, f11 = rows[t]
        # The stationary covariance is kept by the process: Q = P - F P F'.
        q00 = d2 - (f00 * f00 * d2 + f01 * f01 * v2)
        q01 = -(f00 * f10 * d2 + f01 * f11 * v2)
        q11 = v2 - (f10 * f10 * d2 + f11 * f11 * v2)
        n00 = f00 * f00 * a + 2.0 * f00 * f01 * b + f01 * f01 * c + q00
        n01 = f00 * f10 * a + (f00 * f11 + f01 * f10) * b + f01 * f11 * c + q01
        n11 = f10 * f10 * a + 2.0 * f10 * f11 * b + f11 * f11 * c + q11
        settled = abs(n00 - p00) < _SETTLED * d2 and abs(n11 - p11) < _SETTLED * v2
        p00, p01, p11 = n00, n01, n11
        t += 1
        if even and settled and seen[t - 1]:
            later = gaps[gaps >= t]
            end = int(later[0]) if len(later) else count
            gains[t:end], variances[t:end] = gains[t - 1], variances[t - 1]
            t = end
    return gains, variances, slopes


def _predictions(gains: np.ndarray, slopes: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """One-step predictions of the discrepancy in each column, ``(N, c)``: one banded solve."""
    from scipy.linalg.lapack import dtbtrs

    count, width = columns.shape
    # x[t+1] = F (I - K H) x[t] + F K y[t]; the states of all times are one vector.
    forward = np.empty((count - 1, 2))
    forward[:, 0] = slopes[:, 0] * gains[:-1, 0] + slopes[:, 1] * gains[:-1, 1]
    forward[:, 1] = slopes[:, 2] * gains[:-1, 0] + slopes[:, 3] * gains[:-1, 1]
    band = np.zeros((4, 2 * count))
    band[0] = 1.0
    first, second = slice(0, 2 * (count - 1), 2), slice(1, 2 * (count - 1), 2)
    band[2, first] = -(slopes[:, 0] - forward[:, 0])
    band[3, first] = -(slopes[:, 2] - forward[:, 1])
    band[1, second] = -slopes[:, 1]
    band[2, second] = -slopes[:, 3]
    right = np.zeros((2 * count, width), order="F")
    right[2::2] = forward[:, :1] * columns[:-1]
    right[3::2] = forward[:, 1:] * columns[:-1]
    states, _ = dtbtrs(band, right, uplo="L", diag="U")
    return np.asarray(states[0::2])
