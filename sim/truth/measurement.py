"""Recorded samples of outputs, with noise, quantisation and losses; random series for noise and
gusts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from sim.errors import ModelError
from sim.maths import linear_recurrence
from sim.record import Channel

# ---- Random time series


def white_noise(rng: np.random.Generator, count: int, std: float) -> np.ndarray:
    """Return independent Gaussian numbers of standard deviation ``std``, shape ``(count,)``."""
    _not_negative("standard deviation", std)
    return std * rng.standard_normal(count)


def coloured_noise(
    rng: np.random.Generator, time: np.ndarray, std: float, correlation_time: float
) -> np.ndarray:
    """Return a stationary first-order Gauss-Markov process at ``time (N,)``, s.

    Sampling may be uneven.

    n_dot = -n / T + sqrt(2 / T) std w, discretised exactly: autocovariance std^2 exp(-|lag| / T) at
    any sampling. ``correlation_time`` T in s. Returns ``(N,)`` in the unit of ``std``.
    """
    _not_negative("standard deviation", std)
    _positive("correlation time", correlation_time)
    draws = rng.standard_normal(len(time))
    gaps = np.diff(time) / correlation_time
    forcing = std * np.sqrt(-np.expm1(-2.0 * gaps)) * draws[1:]
    return linear_recurrence(np.exp(-gaps), forcing, std * float(draws[0]))


def dryden_gust(
    rng: np.random.Generator,
    time: np.ndarray,
    intensity: float,
    scale_length: float,
    airspeed: float,
) -> np.ndarray:
    """Return the vertical Dryden gust velocity at ``time (N,)``, s, from a stationary start.

    Sampling may be uneven.

    Phi(Omega) = intensity^2 (L / pi) (1 + 3 (L Omega)^2) / (1 + (L Omega)^2)^2 over Omega >= 0 in
    rad/m (MIL-F-8785C, section 3.7.1.2), Omega = omega / airspeed. Discretised exactly as the
    two-state filter intensity / sqrt(lam) (1 + sqrt(3) s / lam) / (1 + s / lam)^2, lam = airspeed /
    L, driven by unit white noise.

    Parameters
    ----------
    intensity : standard deviation, m/s.
    scale_length : L, m (530 m at heights above 530 m in that specification).
    airspeed : m/s.

    Returns
    -------
    ``(N,)`` m/s; its sign is that of the axis chosen, the process is symmetric.
    """
    from scipy.special import gammainc

    _not_negative("intensity", intensity)
    _positive("scale length", scale_length)
    _positive("airspeed", airspeed)
    d = np.diff(time) * airspeed / scale_length
    decay = np.exp(-d)
    # Covariance of the increments of (x, x'/lam) over d = lam dt; incomplete gammas keep it exact
    # for small d.
    g1, g2 = 0.5 * gammainc(1, 2.0 * d), 0.25 * gammainc(2, 2.0 * d)
    g3 = 0.25 * gammainc(3, 2.0 * d)
    q11, q12, q22 = g3, 0.5 * (d * decay) ** 2, g1 - 2.0 * g2 + g3
    l22 = np.sqrt(q22)
    l12 = q12 / l22
    l11 = np.sqrt(np.maximum(q11 - l12**2, 0.0))
    draws = rng.standard_normal((2, len(time)))
    first, second = 0.5 * draws[0, 0], 0.5 * draws[1, 0]
    gust = np.empty(len(time))
    gust[0] = first + math.sqrt(3.0) * second
    steps = zip(
        (l11 * draws[0, 1:] + l12 * draws[1, 1:]).tolist(),
        (l22 * draws[1, 1:]).tolist(),
        d.tolist(),
        decay.tolist(),
        strict=True,
    )
    for k, (noise_1, noise_2, d_k, decay_k) in enumerate(steps, start=1):
        first, second = (
            decay_k * ((1.0 + d_k) * first + d_k * second) + noise_1,
            decay_k * (-d_k * first + (1.0 - d_k) * second) + noise_2,
        )
        gust[k] = first + math.sqrt(3.0) * second
    return intensity * gust


def _not_negative(what: str, value: float) -> None:
    if not (value >= 0 and math.isfinite(value)):
        raise ModelError(
            f"{what} {value} is negative or not finite",
            where="noise",
            remedy="give zero or a positive number",
        )


def _positive(what: str, value: float) -> None:
    if not (value > 0 and math.isfinite(value)):
        raise ModelError(
            f"{what} {value} is not positive", where="noise", remedy="give a positive number"
        )


# ---- How outputs become recorded samples: noise, quantisation, losses

_NO_OUTPUT: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Measurement:
    """Errors of the recording, each as a mapping by output.

    An output without an entry has no such error.

    Attributes
    ----------
    std : standard deviation of the noise, in the unit of the output. If None, ``fly`` uses the
        model's standard deviations, and ``measure`` adds no noise.
    correlation_time : s; the noise of that output is a first-order Gauss-Markov process instead of
        white noise.
    resolution : size of the quantisation step, unit of the output; rounding comes after the noise.
    missing : share of samples lost at random, 0 to 1.
    """

    std: Mapping[str, float] | None = None
    correlation_time: Mapping[str, float] = field(default_factory=lambda: _NO_OUTPUT)
    resolution: Mapping[str, float] = field(default_factory=lambda: _NO_OUTPUT)
    missing: Mapping[str, float] = field(default_factory=lambda: _NO_OUTPUT)

    def __post_init__(self) -> None:
        smallest = np.nextafter(0.0, 1.0)
        for what, table, low, high, allowed in (
            (
                "noise standard deviation",
                self.std or _NO_OUTPUT,
                0.0,
                np.inf,
                "zero or a positive number",
            ),
            ("correlation time", self.correlation_time, smallest, np.inf, "a positive number"),
            ("resolution", self.resolution, smallest, np.inf, "a positive number"),
            ("share of missing samples", self.missing, 0.0, 1.0, "a number from 0 to below 1"),
        ):
            for name, value in table.items():
                if not (low <= value < high):
                    raise ModelError(
                        f"{what} {value:g}", where=f"output {name}", remedy=f"give {allowed}"
                    )


def measure(
    time: np.ndarray,
    outputs: Mapping[str, np.ndarray],
    units: Mapping[str, str],
    rng: np.random.Generator,
    measurement: Measurement,
) -> tuple[Channel, ...]:
    """Return the recorded channels of true outputs ``(N,)`` at ``time (N,)``, s.

    Random numbers are drawn output by output in the order of ``outputs``, those of the noise before
    those of the losses, so that the same generator state gives the same bytes.

    Raises
    ------
    ModelError : ``measurement`` names an output that does not exist.
    """
    noise_std = measurement.std or _NO_OUTPUT
    for table in (
        noise_std,
        measurement.correlation_time,
        measurement.resolution,
        measurement.missing,
    ):
        for key in table:
            if key not in outputs:
                raise ModelError(
                    f"there is no output {key!r}",
                    where="measurement",
                    remedy=f"the outputs are {', '.join(outputs)}",
                )
    channels = []
    for key, clean in outputs.items():
        values, std = clean.copy(), noise_std.get(key, 0.0)
        if std > 0 and key in measurement.correlation_time:
            values += coloured_noise(rng, time, std, measurement.correlation_time[key])
        elif std > 0:
            values += white_noise(rng, len(values), std)
        if key in measurement.resolution:
            values = np.round(values / measurement.resolution[key]) * measurement.resolution[key]
        if measurement.missing.get(key, 0.0) > 0:
            values[rng.random(len(values)) < measurement.missing[key]] = np.nan
        channels.append(Channel.of(key, units[key], values))
    return tuple(channels)
