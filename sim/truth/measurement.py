"""How outputs become recorded samples: noise, quantisation, losses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from sim.errors import ModelError
from sim.record import Channel
from sim.truth.noise import coloured_noise, white_noise

_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Measurement:
    """How outputs are recorded; each mapping is by output, and one that it lacks is recorded exactly in that respect.

    Attributes
    ----------
    std : standard deviation of the noise, unit of the output; None takes the model's.
    correlation_time : s; noise on that output is first-order coloured instead of white.
    resolution : size of the quantisation step, unit of the output; rounding comes after the noise.
    missing : share of samples lost at random, 0 to 1.
    """

    std: Mapping[str, float] | None = None
    correlation_time: Mapping[str, float] = field(default_factory=lambda: _NONE)
    resolution: Mapping[str, float] = field(default_factory=lambda: _NONE)
    missing: Mapping[str, float] = field(default_factory=lambda: _NONE)

    def __post_init__(self) -> None:
        for what, table, low, high in (
            ("noise standard deviation", self.std or _NONE, 0.0, np.inf),
            ("correlation time", self.correlation_time, np.nextafter(0.0, 1.0), np.inf),
            ("resolution", self.resolution, np.nextafter(0.0, 1.0), np.inf),
            ("share of missing samples", self.missing, 0.0, 1.0),
        ):
            for name, value in table.items():
                if not (low <= value < high):
                    raise ModelError(f"{what} {value:g}", where=f"output {name}", remedy=f"give a number from {low:.3g} to below {high:g}")


def measure(
    time: np.ndarray, outputs: Mapping[str, np.ndarray], units: Mapping[str, str], rng: np.random.Generator, measurement: Measurement
) -> tuple[Channel, ...]:
    """Recorded channels of known outputs ``(N,)`` each at ``time (N,)``, s.

    ``measurement.std`` None means no noise. Draws come output by output in the order of ``outputs``, those of
    the noise before those of the losses, so the same generator state gives the same bytes.

    Raises ModelError for an output that is not there.
    """
    std_of = measurement.std or _NONE
    for table in (std_of, measurement.correlation_time, measurement.resolution, measurement.missing):
        for key in table:
            if key not in outputs:
                raise ModelError(f"there is no output {key!r}", where="measurement", remedy=f"the outputs are {', '.join(outputs)}")
    channels = []
    for key, clean in outputs.items():
        values, std = clean.copy(), std_of.get(key, 0.0)
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
