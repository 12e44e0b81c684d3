"""A pure delay of one output channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.effect import Effect, Regularity, Station
from sim.maths import trailing
from sim.parameters import Parameter
from sim.tracing import Occasion, Probe, late_times

APERTURE = 0.001  # s; a jump that meets a sample is spread over it, as cells do for a delayed input

_LOOKS_LIKE: Mapping[str, tuple[str, ...]] = MappingProxyType({"alpha": ("vane-offset",), "nz": ("sensor-scale:alpha",)})


@dataclass(frozen=True)
class SensorDelay:
    """The recorded channel shows what was true ``delay`` seconds before: y(t) -> y(t - delay).

    ``delay`` in s, not negative. Before the record's start the first value holds. It has no state form of finite order.
    """

    channel: str

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 20
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("delay", 0.05, "s", bounds=(0.0, 2.0)),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"delay": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    onset: ClassVar[str] = ""
    per_record: ClassVar[bool] = False
    plausible: ClassVar[Mapping[str, tuple[float, float]]] = MappingProxyType({"delay": (0.0, 0.5)})
    explanation: ClassVar[str] = (
        "One channel is recorded late: y_recorded(t) = y(t - delay), delay >= 0. Digital filters, buses and recorders with a clock of their own do "
        "this. The shape is untouched, only the time is wrong, and by the same amount at all frequencies; a lag of the sensor also takes amplitude "
        "from fast motion, which slow records do not show. A late angle of attack looks much like a vane ahead of the centre of gravity. If all "
        "channels are late alike it is the input that is early: see input-delay. A late altitude of a falling body cannot be seen at all: the same "
        "fall begun later is the same fall."
    )

    @property
    def name(self) -> str:
        return f"sensor-delay:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-lag:{self.channel}", *_LOOKS_LIKE.get(self.channel, ()))

    def probes(self, occasion: Occasion) -> Sequence[Probe]:
        return () if self.channel == "altitude" else [Probe({"delay": time}) for time in late_times(occasion)]

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Values at the earlier times, for a channel that runs straight from ``begin`` to ``end`` of each sub-step and may jump between.

        Just before an edge at which the channel jumps (within ``APERTURE``) the new ``begin`` goes over from the value before
        the jump to that after it, so that the outputs are continuous in the delay.
        """
        begin, end, delay = np.asarray(begin), np.asarray(end), np.asarray(p.delay)
        depth = max(delay.ndim, begin.ndim - 1)
        begin, end, h = trailing(begin, depth), trailing(end, depth), trailing(np.asarray(steps), depth)
        flat = np.concatenate([[0.0], np.cumsum(steps)])
        then = trailing(flat, depth) - delay
        # Each earlier time lies in sub-step k, its end included; before the first sub-step k = -1.
        k = np.searchsorted(flat, then.real, side="left") - 1
        inside, k = k >= 0, np.maximum(k, 0)
        gap = flat[k + 1] - then
        after, before = np.take_along_axis(begin, k + 1, 0), np.take_along_axis(end, k, 0)
        ramp = gap * np.take_along_axis((end - begin[:-1]) / h, k, 0)
        aperture = np.minimum(APERTURE, np.asarray(steps)[k])
        spread = np.where(gap.real < aperture, after - ramp - gap / aperture * (after - before), before - ramp)
        first = begin[:1]
        return np.where(inside, spread, first), np.where(inside, before - ramp, first)[1:]


VARIANTS: tuple[Effect, ...] = tuple(SensorDelay(channel) for channel in ("alpha", "q", "nz", "altitude"))
