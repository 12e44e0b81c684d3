"""The filter ahead of a recorder's converter: on every channel of a measured flight, and in no
model.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Station
from sim.maths import linear_recurrence


@dataclass(frozen=True)
class AntiAliasFilter:
    """Butterworth's second-order low pass: y_ddot = w^2 (v - y) - sqrt(2) w y_dot, w = 2 pi
    ``corner`` (Hz), settled at the start; none at zero.

    Late by sqrt(2)/w where the signal is slow. The same filter on input and outputs leaves a linear
    model as it is.
    """

    channel: str

    station: ClassVar[Station] = Station.SENSOR_PATH
    path_order: ClassVar[int] = 90
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("corner", 7.0, "Hz", bounds=(0.0, 1000.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"corner": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "The recorder's filter cuts what its sampling could not show. What is left comes late, by "
        "as much in every channel."
    )

    @property
    def name(self) -> str:
        return f"own:anti-alias-filter:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-lag:{self.channel}", f"sensor-delay:{self.channel}")

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Exact response to a channel that runs straight from ``begin`` to ``end`` of each sub-step
        and may jump between.

        Twice the real part of one complex lag: z_dot = r z + c v, r = w (-1 + i)/sqrt(2), c = -i
        w/sqrt(2).
        """
        if p.corner <= 0.0:
            return begin, end
        begin, end, h = np.asarray(begin), np.asarray(end), np.asarray(steps)
        omega = 2.0 * math.pi * p.corner / math.sqrt(2.0)
        r, c = omega * (-1.0 + 1.0j), -1.0j * omega
        grown = np.expm1(r * h)
        v0 = begin[:-1]
        forcing = c / r * (v0 * grown + (end - v0) / h * (grown / r - h))
        y = 2.0 * linear_recurrence(grown + 1.0, forcing, -c / r * begin[0]).real
        return y, y[1:]


TERM = AntiAliasFilter("alpha")
