"""A pure delay or a first-order lag of one output channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, late_times
from sim.effects.instances import FASTER_MOTION, for_outputs
from sim.effects.timing import each_run_earlier
from sim.maths import linear_recurrence, real, trailing, where

_DELAY_LOOKS_LIKE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"alpha": ("vane-offset",), "nz": ("sensor-scale:alpha",)}
)


@dataclass(frozen=True)
class SensorDelay:
    """The recorded channel shows what was true ``delay`` seconds before: y(t) -> y(t - delay).

    ``delay`` in s, not negative. Before the record's start the first value holds. It has no state
    form of finite order.
    """

    channel: str

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 20
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"delay": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "One channel is recorded late: y_recorded(t) = y(t - delay), delay >= 0. Digital filters, "
        "buses and recorders with a clock of their own do "
        "this. The shape is untouched, only the time is wrong, and by the same amount at all "
        "frequencies; a lag of the sensor also takes amplitude "
        "from fast motion, which slow records do not show. A late angle of attack looks much like "
        "a vane ahead of the centre of gravity. If all "
        "channels are late alike it is the input that is early: see input-delay. A late altitude "
        "of a falling body cannot be seen at all: the same "
        "fall begun later is the same fall."
    )

    @property
    def name(self) -> str:
        return f"sensor-delay:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-lag:{self.channel}", *_DELAY_LOOKS_LIKE.get(self.channel, ()))

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
        return (
            ()
            if self.channel == "altitude"
            else [Probe({"delay": time}) for time in late_times(context)]
        )

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Values at the earlier times, see ``sim.effects.loads``: continuous in the delay."""
        return each_run_earlier(steps, begin, end, _late, p.delay)

    def memory(self, p: Any) -> tuple[Any, float]:
        """Of random motion, see `sim.declaration.effect.SensorMemory`."""
        return 0.5 * p.delay, -1.0


def _late(edges: np.ndarray, delay: Any) -> Any:
    """The time that shows at each edge."""
    return edges - delay


_LAG_LOOKS_LIKE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"alpha": ("vane-offset",), "nz": ("sensor-scale:alpha",)}
)


@dataclass(frozen=True)
class SensorLag:
    """The recorded channel y follows the true one v as y_dot = (v - y)/time_constant, settled at
    the start.

    ``time_constant`` in s, not negative; at zero y = v. A lag, however short, lets no jump pass:
    where the channel jumps at a sample (nz, when a held input switches) the reading there is that
    before the jump, and the limit at zero differs by the jump. The state form is stiff for a lag
    much shorter than the step.
    """

    channel: str

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 10
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("time_constant", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"time_constant": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "The sensor or its filter follows the true value with a first-order lag: time_constant "
        "dy/dt = v - y. A steady value is read rightly, a "
        "ramp late by one time constant, an oscillation late and too small, the more so the faster "
        "it is. Records that hold mainly frequencies "
        "well below 1/time_constant cannot tell it from a pure delay of the same length; for the "
        "angle of attack a vane ahead of the centre of "
        "gravity looks much the same. A late altitude of a falling body cannot be seen at all: the "
        "same fall begun later is the same fall."
    )

    @property
    def name(self) -> str:
        return f"sensor-lag:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-delay:{self.channel}", *_LAG_LOOKS_LIKE.get(self.channel, ()))

    @property
    def online_states(self) -> tuple[Signal, ...]:
        return (
            Signal(
                f"lagged_{self.channel}",
                f"unit of {self.channel}",
                f"{self.channel} as its sensor shows it",
            ),
        )

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} is read with a lag of {time_constant}",),
            grouped="the {channel} is read {time_constant} late",
            short_name="lag",
            separating={"sensor-lag": FASTER_MOTION, "sensor-delay": FASTER_MOTION},
            twins=(f"sensor-delay:{self.channel}",),
            plausible={"time_constant": (0.0, 0.5)},
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return (
            ()
            if self.channel == "altitude"
            else [Probe({"time_constant": time}) for time in late_times(context)]
        )

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Exact response to a channel that runs straight from ``begin`` to ``end`` of each sub-step
        and may jump between.

        With E = exp(-h/T): y(h) = v1 - (v1 - v0) (T/h) (1 - E) + (y0 - v0) E.
        """
        begin, end, lag = np.asarray(begin), np.asarray(end), np.asarray(p.time_constant)
        depth = max(lag.ndim, begin.ndim - 1)
        begin, end, h = (
            trailing(begin, depth),
            trailing(end, depth),
            trailing(np.asarray(steps), depth),
        )
        # Without a lag E = 0, while the factor T/h carries a derivative towards positive lags.
        acts = lag.real > 0
        decay = np.where(acts, np.exp(-h / np.where(acts, lag, 1.0)), 0.0)
        v0 = begin[:-1]
        y = linear_recurrence(
            decay, end - (end - v0) * (lag / h * (1.0 - decay)) - v0 * decay, begin[0]
        )
        jumping = np.concatenate([y[:1], begin[1:] + (y[1:] - end)])
        return np.where(acts, y, jumping), y[1:]

    def memory(self, p: Any) -> tuple[Any, float]:
        """Of random motion, see `sim.declaration.effect.SensorMemory`."""
        return p.time_constant, 0.0

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        acts = real(p.time_constant) > 0
        return (where(acts, (v - x[0]) / where(acts, p.time_constant, 1.0), 0.0 * x[0]),)

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return where(real(p.time_constant) > 0, x[0], v)


VARIANTS: tuple[Traceable, ...] = tuple(
    kind(channel)
    for kind in (SensorDelay, SensorLag)
    for channel in ("alpha", "q", "nz", "altitude")
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Both for each output that has none yet."""
    return for_outputs(equations, lambda s: SensorDelay(s.name), lambda s: SensorLag(s.name))
