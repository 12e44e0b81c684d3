"""A pure delay of one output channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Regularity, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable, late_times
from sim.declaration.traits import Traits
from sim.effects.separating import FASTER_MOTION
from sim.maths.elementary import trailing

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

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} is read {delay} late",),
            short_name="delay",
            separating={"sensor-delay": FASTER_MOTION},
            twins=(f"sensor-lag:{self.channel}",),
            plausible={"delay": (0.0, 0.5)},
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return () if self.channel == "altitude" else [Probe({"delay": time}) for time in late_times(context)]

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Values at the earlier times, for a channel that runs straight from ``begin`` to ``end`` of each sub-step and may jump between.

        Just before an edge at which the channel jumps (within ``APERTURE``) the new ``begin`` goes over from the value before
        the jump to that after it, so that the outputs are continuous in the delay.
        """
        begin, end, delay = np.asarray(begin), np.asarray(end), np.asarray(p.delay)
        steps = np.asarray(steps)
        shape = np.broadcast_shapes(delay.shape, begin.shape[1:], end.shape[1:])
        begin, end = (np.broadcast_to(trailing(row, len(shape)), (len(row), *shape)).reshape(len(row), -1) for row in (begin, end))
        runs = np.broadcast_to(delay, shape).reshape(-1)
        late = np.empty((2, *begin.shape), dtype=np.result_type(begin, end, delay))
        for value in np.unique(runs):  # runs that are as late look at the same earlier times: most do in a batch of differences
            alike = runs == value
            late[0][:, alike], late[1][:, alike] = _later(steps, begin[:, alike], end[:, alike], value)
        return late[0].reshape(-1, *shape), late[1, 1:].reshape(-1, *shape)


def _later(steps: np.ndarray, begin: np.ndarray, end: np.ndarray, delay: Any) -> tuple[np.ndarray, np.ndarray]:
    """Runs ``(M + 1, c)`` and ``(M, c)`` at the edges of the sub-steps as they were ``delay`` before: just after and just before each edge."""
    edges = np.concatenate([[0.0], np.cumsum(steps)])
    then = edges - delay
    # Each earlier time lies in sub-step k, its end included; before the first sub-step k = -1.
    k = np.searchsorted(edges, then.real, side="left") - 1
    inside, k = (k >= 0)[:, None], np.maximum(k, 0)
    gap = (edges[k + 1] - then)[:, None]
    after, before = begin[k + 1], end[k]
    ramp = gap * ((end - begin[:-1]) / steps[:, None])[k]
    aperture = np.minimum(APERTURE, steps[k])[:, None]
    spread = np.where(gap.real < aperture, after - ramp - gap / aperture * (after - before), before - ramp)
    first = begin[:1]
    return np.where(inside, spread, first), np.where(inside, before - ramp, first)


VARIANTS: tuple[Traceable, ...] = tuple(SensorDelay(channel) for channel in ("alpha", "q", "nz", "altitude"))
