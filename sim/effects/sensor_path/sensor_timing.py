"""Timing errors of one output channel: a pure delay, a first-order lag, a lower sample rate; and a
recorder whose clock runs fast or slow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, delays_to_try
from sim.effects.instances import FASTER_MOTION, OfChannel, for_outputs, further_outputs
from sim.effects.loads import each_run_earlier
from sim.maths import linear_recurrence, real, trailing, where

_DELAY_LOOKS_LIKE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"alpha": ("vane-offset",), "nz": ("sensor-scale:alpha",)}
)


@dataclass(frozen=True)
class SensorDelay(OfChannel):
    """The recorded channel is delayed: it is y(t - delay) instead of y(t).

    ``delay`` is in s, not negative. Before the record's start the first value holds. The effect has
    no state form of finite order.
    """

    channel: str

    family: ClassVar[str] = "sensor-delay"
    path_order: ClassVar[int] = 20
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("delay", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"delay": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "One channel is recorded late: y_recorded(t) = y(t - delay), delay >= 0. Digital filters, "
        "buses and recorders with a clock of their own do this. The shape is untouched, only the "
        "time is wrong, and by the same amount at all frequencies; a lag of the sensor also takes "
        "amplitude from fast motion, which slow records do not show. A late angle of attack looks "
        "much like a vane ahead of the centre of gravity. If all channels are late alike it is the "
        "input that is early: see input-delay. A late altitude of a falling body cannot be seen at "
        "all: the same fall begun later is the same fall."
    )

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
            else [Probe({"delay": time}) for time in delays_to_try(context)]
        )

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Return the values at the earlier times, continuous in the delay (`sim.effects.loads`)."""
        return each_run_earlier(steps, begin, end, _delayed_edges, p.delay)

    def memory(self, p: Any) -> tuple[Any, float]:
        """Return time constant and direct share, see `sim.declaration.effect.SensorMemory`."""
        return 0.5 * p.delay, -1.0


def _delayed_edges(edges: np.ndarray, delay: Any) -> Any:
    """Return the time whose value is shown at each edge."""
    return edges - delay


_LAG_LOOKS_LIKE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"alpha": ("vane-offset",), "nz": ("sensor-scale:alpha",)}
)


@dataclass(frozen=True)
class SensorLag(OfChannel):
    """The recorded channel y follows the true one v with a lag: y_dot = (v - y)/time_constant.

    At the start y = v. ``time_constant`` is in s, not negative; at zero y = v. Even a short lag
    removes jumps: if the channel jumps at a sample (nz, when a held input switches), the reading is
    that before the jump, so that the limit for short lags differs from a lag of zero by the jump.
    The state form is stiff for a lag much shorter than the step.
    """

    channel: str

    family: ClassVar[str] = "sensor-lag"
    path_order: ClassVar[int] = 10
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("time_constant", 0.05, "s", bounds=(0.0, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"time_constant": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "The sensor or its filter follows the true value with a first-order lag: time_constant "
        "dy/dt = v - y. A steady value is read rightly, a ramp late by one time constant, an "
        "oscillation late and too small, the more so the faster it is. Records that hold mainly "
        "frequencies well below 1/time_constant cannot tell it from a pure delay of the same "
        "length; for the angle of attack a vane ahead of the centre of gravity looks much the "
        "same. A late altitude of a falling body cannot be seen at all: the same fall begun later "
        "is the same fall."
    )

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
            else [Probe({"time_constant": time}) for time in delays_to_try(context)]
        )

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Return the exact response to a channel that is linear from ``begin`` to ``end`` of each
        sub-step and may jump between sub-steps.

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
        """Return time constant and direct share, see `sim.declaration.effect.SensorMemory`."""
        return p.time_constant, 0.0

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        acts = real(p.time_constant) > 0
        return (where(acts, (v - x[0]) / where(acts, p.time_constant, 1.0), 0.0 * x[0]),)

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return where(real(p.time_constant) > 0, x[0], v)


DELAY_VARIANTS: tuple[Traceable, ...] = tuple(
    kind(channel)
    for kind in (SensorDelay, SensorLag)
    for channel in ("alpha", "q", "nz", "altitude")
)


def delay_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return a delay and a lag for each output that ``VARIANTS`` lacks."""
    return for_outputs(equations, lambda s: SensorDelay(s.name), lambda s: SensorLag(s.name))


EVERY = (2, 3, 4, 5, 8, 10)  # samples between updates that a search tries
LONGEST_DELAY = 0.5  # s
CLOSER = (
    "a fast and steady motion (a sweep), or the raw column before any smoothing: a channel that is "
    "held goes in stairs, a late one does not"
)


@dataclass(frozen=True)
class SensorHold(OfChannel):
    """The recorded channel is held between updates, which come ``phase + k period`` seconds after
    the record's start.

    ``period`` is in s, not negative; a period up to the sampling ``interval`` changes nothing.
    ``phase`` is in s. The noise of the recorder is added after the hold. Each record has its own
    period and phase.

    Approximation: a sample also shows an update that comes up to half an ``interval`` later. This
    is exact if updates coincide with samples. Then a small change of period or phase does not
    change which update a sample shows, so that slopes and sigmas exist: d y/d period = -k y_dot at
    the update. If the sensor has its own clock, samples just before an update show it early, by
    half an interval at most; the phase partly compensates this. A search tries periods of whole
    samples, and the period found in the residual.

    Attributes
    ----------
    channel : name of the output.
    interval : sampling interval of the record, s.
    """

    channel: str
    interval: float = 0.02

    family: ClassVar[str] = "sensor-hold"
    path_order: ClassVar[int] = 30
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"period": 0.0})
    regularity: ClassVar[Regularity] = Regularity.INACTIVE
    explanation: ClassVar[str] = (
        "The sensor delivers a new value every period and the recorder, which is faster, writes "
        "the last one again: y_recorded(t) = y(t_k), t_k = phase + k period the last update. A "
        "slow bus or telemetry frame does this; without noise of its own behind it the raw column "
        "shows repeated values. In the mean the channel is late by half a period. The steps "
        "between updates change it less than this delay does, so that a delay or a lag of half the "
        "period is nearly the same where the motion is slow. The phase belongs to one record."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters.

        The prior of the phase has the width of a sampling interval, which the updates determine; a
        wider one would stand for a delay of the channel.
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
        """Probe periods of whole samples and the period found in the residual, at every phase.

        A fit cannot move an update from one sample to another.
        """
        interval = context.interval
        periods = [every * interval for every in EVERY if 0 < every * interval <= LONGEST_DELAY]
        result = context.update_periods.get(self.channel)
        if result is not None and 1.5 * interval < result <= LONGEST_DELAY:
            periods.append(result)
        tried = [
            (period, first * interval)
            for period in periods
            for first in range(round(period / interval))
        ]
        return [Probe({"period": period, "phase": phase}) for period, phase in tried]

    def fitted_to(self, context: SearchContext) -> SensorHold:
        """Return the effect with the sampling interval of the record."""
        return replace(self, interval=context.interval if context.interval > 0 else self.interval)

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Return the values at the last updates; before the first one, the first value.

        A period up to the sampling interval gives the channel itself.
        """
        held = each_run_earlier(steps, begin, end, self._updated, p.period, p.phase)
        depth = held[0].ndim - 1
        acts = np.asarray(p.period).real > self.interval
        rows = (trailing(np.asarray(row), depth) for row in (begin, end))
        return tuple(np.where(acts, new, old) for new, old in zip(held, rows, strict=True))  # type: ignore[return-value]

    def memory(self, p: Any) -> tuple[Any, float]:
        """Return time constant and direct share of a delay by half a period, the mean delay."""
        return 0.25 * p.period, -1.0

    def _updated(self, edges: np.ndarray, period: Any, phase: Any) -> Any:
        """Return the time of the last update at each edge."""
        if period.real <= self.interval:
            return edges
        number = np.floor((edges + 0.5 * self.interval - phase.real) / period.real)
        return phase + number * period


HOLD_VARIANTS: tuple[Traceable, ...] = tuple(
    SensorHold(channel) for channel in ("alpha", "q", "nz", "altitude")
)


def sampling_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return a hold for each output that ``VARIANTS`` lacks."""
    return tuple(SensorHold(signal.name) for signal in further_outputs(equations))


@dataclass(frozen=True)
class TimeBase:
    """The clock of the record is wrong: recorded time = ``factor`` times true time.

    The rates of all states are then 1/factor of the true ones. ``factor`` is positive, without
    unit; it is 1 for a right clock and above 1 for a fast one. Times of events, delays and lags are
    in the record's time. The effect is for equations with a given airspeed: of a falling body a
    wrong clock equals another gravity.
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
        "sampling rate or a file resampled by mistake. Every motion then seems slower than it is, "
        "and a measured rate is no longer the slope of the measured angle. The kinematics say "
        "alpha_dot = (q - (g/V) nz) / factor. A record of alpha, q and nz is therefore the same as "
        "one whose angle of attack is read too small by the factor, under other derivatives; that "
        "is named, since such clocks are rare. Equal scales of q and of nz give the same record "
        "too, and a scale of nz is as good as a wrong airspeed in the vehicle file. Without nz it "
        "only "
        "changes the derivatives and leaves no trace. A pitch attitude in the record, or another "
        "clock, tells."
    )

    def pace(self, p: Any) -> Any:
        return p.factor

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return (Probe(self.absent, ("factor",)),)


SAMPLING_VARIANTS: tuple[Traceable, ...] = (*HOLD_VARIANTS, TimeBase())


VARIANTS: tuple[Traceable, ...] = (*DELAY_VARIANTS, *SAMPLING_VARIANTS)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the instances of this file that ``VARIANTS`` lacks."""
    return (*delay_made_for(equations), *sampling_made_for(equations))
