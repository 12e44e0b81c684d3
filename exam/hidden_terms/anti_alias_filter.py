"""The anti-alias filter of a recorder, which acts on every channel of a measured flight and is in
no model.
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
    """Second-order Butterworth low pass: y_ddot = w^2 (v - y) - sqrt(2) w y_dot, w = 2 pi
    ``corner`` (Hz).

    It is settled at the start, and absent at a corner of zero. A slow signal is late by sqrt(2)/w.
    The same filter on input and outputs does not change a linear model.
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
        "The filter of the recorder removes frequencies that its sampling cannot show. The "
        "remaining signal is late, by the same time in every channel."
    )

    @property
    def name(self) -> str:
        return f"own:anti-alias-filter:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-lag:{self.channel}", f"sensor-delay:{self.channel}")

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Return the exact response to a channel that is linear from ``begin`` to ``end`` of each
        sub-step and may jump between sub-steps.

        It is twice the real part of one complex lag: z_dot = r z + c v, r = w (-1 + i)/sqrt(2), c =
        -i w/sqrt(2).
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
