"""An output channel that is updated at a lower rate than it is recorded; a recorder whose clock
runs fast or slow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import further_outputs
from sim.effects.timing import each_run_earlier
from sim.maths import trailing

EVERY = (2, 3, 4, 5, 8, 10)  # samples between updates that a search tries
LONGEST = 0.5  # s
CLOSER = (
    "a fast and steady motion (a sweep), or the raw column before any smoothing: a channel that is "
    "held goes in stairs, a late one does not"
)


@dataclass(frozen=True)
class SensorHold:
    """The recorded channel shows its value at the last update; updates come ``phase + k period``
    seconds after the record's start.

    y(t) -> y(time of the last update). ``period`` in s, not negative; one not above the sampling
    ``interval`` changes nothing. ``phase`` in s. The noise of the recorder comes after. Each record
    has its own period and phase.

    Two things are approximated. A sample belongs to the update that is at most half of ``interval``
    later than itself: where updates meet samples (a period of whole samples, in step with the
    recorder) this is exact, and lets period and phase move a little without any sample changing its
    update, so that slopes and sigmas exist: they are those of the value interpolated at the time of
    the update, d y/d period = -k y_dot there. Where the sensor runs on a clock of its own, samples
    just before an update show it too early, by half an interval at most; the fit spreads that over
    the phase. Which update a sample shows is found by trying: only periods of whole samples are
    proposed to a search, and the period that the residual shows.

    Attributes
    ----------
    channel : the output it acts on. interval : of the record's samples, s.
    """

    channel: str
    interval: float = 0.02

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 30
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"period": 0.0})
    regularity: ClassVar[Regularity] = Regularity.INACTIVE
    explanation: ClassVar[str] = (
        "The sensor delivers a new value every period and the recorder, which is faster, writes "
        "the last one again: y_recorded(t) = y(t_k), t_k = "
        "phase + k period the last update. A slow bus or telemetry frame does this; without noise "
        "of its own behind it the raw column shows "
        "repeated values. In the mean the channel is late by half a period, which is most of what "
        "is seen; the stairs themselves are the smaller "
        "part, so that a delay or a lag of half the period is nearly the same where the motion is "
        "slow. The phase belongs to one record."
    )

    @property
    def name(self) -> str:
        return f"sensor-hold:{self.channel}"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Which update a sample shows tells the phase to half an interval: nothing else tells it
        from a delay of the same channel.
        """
        return (
            Parameter("period", 0.25, "s", bounds=(0.0, 2.0)),
            Parameter(
                "phase", 0.0087, "s", prior_std=self.interval / math.sqrt(12.0), bounds=(-2.0, 2.0)
            ),
        )

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-delay:{self.channel}", f"sensor-lag:{self.channel}")

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} is updated only every {period} and held between",),
            short_name="held between updates",
            separating=dict.fromkeys(("sensor-delay", "sensor-lag"), CLOSER),
            plausible={"period": (0.0, 1.0)},
            per_record=True,
            tried=("phase",),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The whole change at periods of whole samples and that of the residual, at every phase: a
        fit moves no update from sample to sample.
        """
        interval = context.interval
        periods = [every * interval for every in EVERY if 0 < every * interval <= LONGEST]
        found = context.update_periods.get(self.channel)
        if found is not None and 1.5 * interval < found <= LONGEST:
            periods.append(found)
        tried = [
            (period, first * interval)
            for period in periods
            for first in range(round(period / interval))
        ]
        return [Probe({"period": period, "phase": phase}) for period, phase in tried]

    def fitted_to(self, context: SearchContext) -> SensorHold:
        """The same for that record's sampling interval."""
        return replace(self, interval=context.interval if context.interval > 0 else self.interval)

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """The values at the last updates, before which the first value holds; the channel itself
        where the period is no longer than a sample's.
        """
        held = each_run_earlier(steps, begin, end, self._updated, p.period, p.phase)
        depth = held[0].ndim - 1
        acts = np.asarray(p.period).real > self.interval
        rows = (trailing(np.asarray(row), depth) for row in (begin, end))
        return tuple(np.where(acts, new, old) for new, old in zip(held, rows, strict=True))  # type: ignore[return-value]

    def memory(self, p: Any) -> tuple[Any, float]:
        """Of random motion: late by half a period in the mean."""
        return 0.25 * p.period, -1.0

    def _updated(self, edges: np.ndarray, period: Any, phase: Any) -> Any:
        """The time of the update that shows at each edge."""
        if period.real <= self.interval:
            return edges
        number = np.floor((edges + 0.5 * self.interval - phase.real) / period.real)
        return phase + number * period


HOLD_VARIANTS: tuple[Traceable, ...] = tuple(
    SensorHold(channel) for channel in ("alpha", "q", "nz", "altitude")
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each output that has none yet."""
    return tuple(SensorHold(signal.name) for signal in further_outputs(equations))


@dataclass(frozen=True)
class TimeBase:
    """Recorded time = ``factor`` x true time, for all channels alike: the rates of all states are
    1/factor of the true ones.

    ``factor`` without unit, positive; 1 where the clock is right, above it where it runs fast.
    Times of events, and those of delays and lags on the input and sensor paths, stay in the
    record's time. Written for equations with a given airspeed: a fall on another time is one under
    another gravity.
    """

    name: ClassVar[str] = "time-base"
    station: ClassVar[Station] = Station.SENSOR_PATH
    needs_constants: ClassVar[tuple[str, ...]] = ("airspeed",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("factor", 1.05, "1", bounds=(0.5, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"factor": 1.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("sensor-scale:alpha", "sensor-scale:q", "sensor-scale:nz")
    traits: ClassVar[Traits] = Traits(
        sentences=("the times of the record are {factor_percent} {factor_direction}",),
        short_name="clock of the record",
        separating={
            "sensor-scale": (
                "the pitch attitude recorded as well, or the record's time held against another "
                "clock"
            )
        },
        twins=("sensor-scale:alpha", "sensor-scale:q", "sensor-scale:nz"),
        equivalents=("sensor-scale:alpha",),
        plausible={"factor": (0.8, 1.25)},
    )
    explanation: ClassVar[str] = (
        "The clock of the recorder is wrong: recorded time = factor x true time, from a wrong "
        "sampling rate or a file resampled by mistake. Every "
        "motion then seems slower than it is, and a rate that is measured no longer is the slope "
        "of what it is the rate of. The kinematics say "
        "alpha_dot = (q - (g/V) nz) / factor: with alpha, q and nz that is word for word an angle "
        "of attack read too small by the factor, with "
        "other derivatives, and as rare as such clocks are that is what is named. It is a scale of "
        "q and one of nz alike, the latter as good as an "
        "airspeed that is wrong in the vehicle file. Without nz it only changes the derivatives "
        "and leaves no trace. A pitch attitude in the record, "
        "or another clock, tells."
    )

    def pace(self, p: Any) -> Any:
        return p.factor

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return (Probe(self.absent, ("factor",)),)


VARIANTS: tuple[Traceable, ...] = (*HOLD_VARIANTS, TimeBase())
