"""Timing errors of one output channel: a pure delay, a first-order lag, a lower sample rate; and a
recorder whose clock runs fast or slow.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits, delays_to_try
from sim.effects.instances import OfChannel, ProbedAtAbsence, for_outputs
from sim.maths import linear_recurrence, real, trailing, where

CHANNELS = ("alpha", "q", "nz", "altitude")

# ---- Earlier values of a channel

# s; a jump at a sample is spread over this time, as a delayed input is by its cells.
JUMP_SPREAD_TIME = 0.001


def delayed_channel(
    steps: Any, begin: Any, end: Any, shown: Callable[..., Any], *values: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of a channel at the earlier times ``shown(edges, *values)``.

    The channel is linear from ``begin`` to ``end`` of each sub-step. Before the start its first
    value holds. A jump at an edge is spread linearly over the ``JUMP_SPREAD_TIME`` before it, so
    that outputs are continuous in the delay.

    Parameters
    ----------
    steps, begin, end : ``(M,)``, ``(M + 1, ...)`` and ``(M, ...)`` as in ``SensorEffect.act``.
    shown : function of the edges ``(M + 1,)``, s from the record's start, and of ``values``. It
        returns the time whose value is shown at each edge.
    values : parameters of a run, which broadcast with the batch axes. Runs with equal values are
        computed together.
    """
    begin, end, steps = np.asarray(begin), np.asarray(end), np.asarray(steps)
    given = [np.asarray(value) for value in values]
    shape = np.broadcast_shapes(*(value.shape for value in given), begin.shape[1:], end.shape[1:])
    begin, end = (
        np.broadcast_to(trailing(row, len(shape)), (len(row), *shape)).reshape(len(row), -1)
        for row in (begin, end)
    )
    runs = [np.broadcast_to(value, shape).reshape(-1) for value in given]
    edges = np.concatenate([[0.0], np.cumsum(steps)])
    out = np.empty((2, *begin.shape), dtype=np.result_type(begin, end, *given))
    columns_of: dict[tuple[Any, ...], list[int]] = {}
    for column, run in enumerate(zip(*(row.tolist() for row in runs), strict=True)):
        columns_of.setdefault(run, []).append(column)
    for run, columns in columns_of.items():  # most runs of a batch have equal values
        out[0][:, columns], out[1][:, columns] = _values_at(
            edges, steps, begin[:, columns], end[:, columns], shown(edges, *run)
        )
    return out[0].reshape(-1, *shape), out[1, 1:].reshape(-1, *shape)


def _values_at(
    edges: np.ndarray, steps: np.ndarray, begin: np.ndarray, end: np.ndarray, times: Any
) -> tuple[np.ndarray, np.ndarray]:
    """Return the values of c runs just after and just before ``times (M + 1,)``, s.

    ``begin`` is ``(M + 1, c)`` and ``end`` ``(M, c)``. Times after the end are set to the end.
    """
    times = np.where(times.real > edges[-1], edges[-1], times)
    # Each time lies in sub-step k, its end included; before the first sub-step k = -1.
    k = np.searchsorted(edges, times.real, side="left") - 1
    inside, k = (k >= 0)[:, None], np.maximum(k, 0)
    gap = (edges[k + 1] - times)[:, None]
    after, before = begin[k + 1], end[k]
    ramp = gap * ((end - begin[:-1]) / steps[:, None])[k]
    aperture = np.minimum(JUMP_SPREAD_TIME, steps[k])[:, None]
    spread = np.where(
        gap.real < aperture, after - ramp - gap / aperture * (after - before), before - ramp
    )
    first = begin[:1]
    return np.where(inside, spread, first), np.where(inside, before - ramp, first)


# ---- Delay and lag

FASTER_MOTION = (
    "faster motion (short doublets, or a sweep up to the inverse of the lag): a lag loses "
    "amplitude there, a delay does not"
)
_LOOKS_LATE: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {"alpha": ("vane-offset",), "nz": ("sensor-scale:alpha",)}
)


class _Late(OfChannel):
    """Base of a delay and a lag of one channel: one time, which is not negative."""

    time_name: ClassVar[str]
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    other_family: ClassVar[str]

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"{self.other_family}:{self.channel}", *_LOOKS_LATE.get(self.channel, ()))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter(self.time_name, 0.05, "s", bounds=(0.0, 2.0)),)

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType({self.time_name: 0.0})

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe some times; none for an altitude, where a late sensor is not observable."""
        times = () if self.channel == "altitude" else delays_to_try(context)
        return [Probe({self.time_name: time}) for time in times]


@dataclass(frozen=True)
class SensorDelay(_Late):
    """The recorded channel is delayed: it is y(t - delay) instead of y(t).

    ``delay`` is in s, not negative. Before the record's start the first value holds. The effect has
    no state form of finite order.

    Attributes
    ----------
    channel : name of the output.
    """

    channel: str

    family: ClassVar[str] = "sensor-delay"
    other_family: ClassVar[str] = "sensor-lag"
    time_name: ClassVar[str] = "delay"
    path_order: ClassVar[int] = 20
    explanation: ClassVar[str] = (
        "One channel is recorded late: y_recorded(t) = y(t - delay), delay >= 0. Causes are "
        "digital filters, data buses and recorders with separate clocks. The delay is the same at "
        "all frequencies, and amplitudes stay unchanged. A sensor lag also reduces the amplitude "
        "of fast motion, which slow records do not show. A late angle of attack resembles a vane "
        "ahead of the centre of gravity. If all channels are late by the same time, the record is "
        "the same as with an input delay (see input-delay). A late altitude of a falling body is "
        "not observable, because the same fall begun later gives the same record."
    )

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} is read {delay} late",),
            short_name="delay",
            separating={"sensor-delay": FASTER_MOTION},
            twins=(f"sensor-lag:{self.channel}",),
            plausible={"delay": (0.0, 0.5)},
        )

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Return the values at the earlier times, continuous in the delay."""
        return delayed_channel(steps, begin, end, _delayed_edges, p.delay)

    def memory(self, p: Any) -> tuple[Any, float]:
        """Return time constant and direct share, see `sim.declaration.effect.SensorMemory`."""
        return 0.5 * p.delay, -1.0


def _delayed_edges(edges: np.ndarray, delay: Any) -> Any:
    """Return the time whose value is shown at each edge."""
    return edges - delay


@dataclass(frozen=True)
class SensorLag(_Late):
    """The recorded channel y follows the true one v with a lag: y_dot = (v - y)/time_constant.

    At the start y = v. ``time_constant`` is in s, not negative; at zero y = v. Even a short lag
    removes jumps. If the channel jumps at a sample (as nz does when a held input switches), the
    reading is the value before the jump. The limit for short lags therefore differs from a lag of
    zero by the jump. The state form is stiff for a lag much shorter than the step.

    Attributes
    ----------
    channel : name of the output.
    """

    channel: str

    family: ClassVar[str] = "sensor-lag"
    other_family: ClassVar[str] = "sensor-delay"
    time_name: ClassVar[str] = "time_constant"
    path_order: ClassVar[int] = 10
    explanation: ClassVar[str] = (
        "First-order lag of a sensor: the reading y follows the true value v with time_constant "
        "dy/dt = v - y. A steady value is read correctly. A ramp is read late by one time "
        "constant. An oscillation is read late and with too small an amplitude, the more so the "
        "faster it is. Records that mainly contain frequencies well below 1/time_constant cannot "
        "distinguish a lag from a delay of the same length. For the angle of attack, a vane ahead "
        "of the centre of gravity looks much the same. A late altitude of a falling body is not "
        "observable, because the same fall begun later gives the same record."
    )

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


# ---- A lower sample rate

SAMPLES_BETWEEN_UPDATES = (2, 3, 4, 5, 8, 10)  # trial values
LONGEST_PERIOD = 0.5  # s, longest period that a search tries
STEPS_OR_NO_STEPS = (
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
    is exact if updates coincide with samples. A small change of period or phase then does not
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
        "Lower sample rate of a sensor: it delivers a new value once in a period, and a faster "
        "recorder repeats the last value, y_recorded(t) = y(t_k), where t_k = phase + k period is "
        "the time of the last update. The cause is a slow data bus or telemetry frame. If no noise "
        "is added after the hold, the raw column shows repeated values. On average the channel is "
        "late by half a period. The steps between updates change the channel less than this mean "
        "delay. Where motion is slow, a delay or a lag of half the period is therefore nearly the "
        "same. Each record has its own phase."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters.

        The prior of the phase has the width of a sampling interval. The times of the updates
        determine the phase within this width. A wider prior would let the phase represent a delay
        of the channel.
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
            separating=dict.fromkeys(("sensor-delay", "sensor-lag"), STEPS_OR_NO_STEPS),
            plausible={"period": (0.0, 1.0)},
            per_record=True,
            tried=("phase",),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe periods of whole samples and the period found in the residual, at every phase.

        A fit cannot move an update from one sample to another.
        """
        interval = context.interval
        periods = [n * interval for n in SAMPLES_BETWEEN_UPDATES]
        periods = [period for period in periods if 0 < period <= LONGEST_PERIOD]
        from_residual = context.update_periods.get(self.channel)
        if from_residual is not None and 1.5 * interval < from_residual <= LONGEST_PERIOD:
            periods.append(from_residual)
        return [
            Probe({"period": period, "phase": first * interval})
            for period in periods
            for first in range(round(period / interval))
        ]

    def fitted_to(self, context: SearchContext) -> SensorHold:
        """Return the effect with the sampling interval of the record."""
        return replace(self, interval=context.interval if context.interval > 0 else self.interval)

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Return the values at the last updates; before the first one, the first value.

        A period up to the sampling interval gives the channel itself.
        """
        held = delayed_channel(steps, begin, end, self._last_update, p.period, p.phase)
        depth = held[0].ndim - 1
        acts = np.asarray(p.period).real > self.interval
        rows = (trailing(np.asarray(row), depth) for row in (begin, end))
        return tuple(np.where(acts, new, old) for new, old in zip(held, rows, strict=True))  # type: ignore[return-value]

    def memory(self, p: Any) -> tuple[Any, float]:
        """Return time constant and direct share of a delay by half a period, the mean delay."""
        return 0.25 * p.period, -1.0

    def _last_update(self, edges: np.ndarray, period: Any, phase: Any) -> Any:
        """Return the time of the last update at each edge."""
        if period.real <= self.interval:
            return edges
        number = np.floor((edges + 0.5 * self.interval - phase.real) / period.real)
        return phase + number * period


# ---- A wrong clock of the recorder

_SCALES = ("sensor-scale:alpha", "sensor-scale:q", "sensor-scale:nz")


@dataclass(frozen=True)
class TimeBase(ProbedAtAbsence):
    """The clock of the record is wrong: recorded time = ``factor`` times true time.

    The rates of all states are then 1/factor of the true ones. ``factor`` is positive, without
    unit; it is 1 for a right clock and above 1 for a fast one. Times of events, delays and lags are
    in the record's time. The effect is only for equations with a declared airspeed. For a falling
    body, a wrong clock is the same as another gravity.
    """

    name: ClassVar[str] = "time-base"
    station: ClassVar[Station] = Station.SENSOR_PATH
    needs_constants: ClassVar[tuple[str, ...]] = ("airspeed",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("factor", 1.05, "1", bounds=(0.5, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"factor": 1.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = _SCALES
    traits: ClassVar[Traits] = Traits(
        sentences=("the times of the record are {factor_percent} {factor_direction}",),
        short_name="clock of the record",
        separating={
            "sensor-scale": (
                "the pitch attitude recorded as well, or the record's time held against another "
                "clock"
            )
        },
        twins=_SCALES,
        equivalents=("sensor-scale:alpha",),
        plausible={"factor": (0.8, 1.25)},
    )
    explanation: ClassVar[str] = (
        "The clock of the recorder is wrong: recorded time = factor x true time. Causes are a "
        "wrong sampling rate, or a file that was resampled by mistake. Every motion then seems "
        "slower than it is, and a measured rate is not the slope of the measured angle: the "
        "kinematics become alpha_dot = (q - (g/V) nz) / factor. A record of alpha, q and nz is the "
        "same as one whose angle of attack is read too small by the factor, with other "
        "derivatives. The scale of the angle of attack is then reported, since wrong clocks are "
        "rare. Equal scales of q and of nz also give the same record, and a scale of nz is the "
        "same as a wrong airspeed in the vehicle file. Without nz a wrong clock only changes the "
        "derivatives and is not observable. A recorded pitch attitude or a second clock settles "
        "the question."
    )

    def pace(self, p: Any) -> Any:
        return p.factor


VARIANTS: tuple[Traceable, ...] = (
    *(kind(channel) for kind in (SensorDelay, SensorLag, SensorHold) for channel in CHANNELS),
    TimeBase(),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return a delay, a lag and a hold for each output that ``VARIANTS`` does not cover."""
    return for_outputs(
        equations,
        lambda signal: SensorDelay(signal.name),
        lambda signal: SensorLag(signal.name),
        lambda signal: SensorHold(signal.name),
    )
