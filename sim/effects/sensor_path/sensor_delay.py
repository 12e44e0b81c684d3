"""A pure delay of one output channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, late_times
from sim.effects.instances import FASTER_MOTION, further_outputs
from sim.effects.timing import each_run_earlier

_LOOKS_LIKE: Mapping[str, tuple[str, ...]] = MappingProxyType(
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
        return (
            ()
            if self.channel == "altitude"
            else [Probe({"delay": time}) for time in late_times(context)]
        )

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Values at the earlier times, see ``sim.effects.timing``: continuous in the delay."""
        return each_run_earlier(steps, begin, end, _late, p.delay)

    def memory(self, p: Any) -> tuple[Any, float]:
        """Of random motion, see `sim.declaration.effect.SensorMemory`."""
        return 0.5 * p.delay, -1.0


def _late(edges: np.ndarray, delay: Any) -> Any:
    """The time that shows at each edge."""
    return edges - delay


VARIANTS: tuple[Traceable, ...] = tuple(
    SensorDelay(channel) for channel in ("alpha", "q", "nz", "altitude")
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each output that has none yet."""
    return tuple(SensorDelay(signal.name) for signal in further_outputs(equations))
