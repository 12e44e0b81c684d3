"""What an effect tells a search that knows nothing of physics: where to look for it, and where to start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol, runtime_checkable

from sim.declaration.effect import Effect
from sim.declaration.traits import Traits

RESOLVED = 0.8  # of half the sampling rate: above it a few samples a period are no oscillation, and any derivative can hide in it

_NONE: Mapping[str, float] = MappingProxyType({})
_NO_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType({})


@dataclass(frozen=True)
class SearchContext:
    """What a record offers before any effect is tried.

    Attributes
    ----------
    begin, end : s, of the record. interval : median sampling interval, s.
    input_peak : largest magnitude of each input. input_rate : largest step between samples over the interval, unit/s.
    state_peak : largest magnitude of each measured state or output, in its unit.
    flown : lowest and highest value of an input, state or output, spikes left out; ``flown_range`` falls back on the peaks.
    residual_peaks : frequencies of peaks in the residual's spectrum, rad/s, strongest first.
    update_periods : of each output the period, s, at which it would be held between updates if it were.
    airspeed : m/s, where the model has one. values : parameters of the model as fitted, by name.
    """

    begin: float
    end: float
    interval: float
    input_peak: Mapping[str, float] = field(default_factory=lambda: _NONE)
    input_rate: Mapping[str, float] = field(default_factory=lambda: _NONE)
    state_peak: Mapping[str, float] = field(default_factory=lambda: _NONE)
    flown: Mapping[str, tuple[float, float]] = field(default_factory=lambda: _NO_RANGES)
    residual_peaks: tuple[float, ...] = ()
    update_periods: Mapping[str, float] = field(default_factory=lambda: _NONE)
    airspeed: float = 0.0
    values: Mapping[str, float] = field(default_factory=lambda: _NONE)

    @property
    def duration(self) -> float:
        return self.end - self.begin

    def flown_range(self, name: str) -> tuple[float, float] | None:
        """Lowest and highest value of a signal, by its peak to both sides where no more is known; None where nothing is."""
        if name in self.flown:
            return self.flown[name]
        peak = self.state_peak.get(name, self.input_peak.get(name, 0.0))
        return (-peak, peak) if peak > 0 else None

    def onsets(self, count: int = 36) -> tuple[float, ...]:
        """Times spread evenly over the record, its ends left out: an event at the very edge cannot be told from a bias."""
        return tuple(self.begin + self.duration * (i + 0.5) / count for i in range(count))


@dataclass(frozen=True)
class Probe:
    """One place where a search evaluates an effect.

    Attributes
    ----------
    values : all local parameters. slopes : those by which the outputs are differentiated at ``values``; the columns that
        this gives are the effect's signature. When empty, the signature is the whole change from the effect's absence.
    shifts : True where a later onset only moves the signature along the record, and the same probe therefore stands for all of them.
    sharp : of one that shifts: a fit moves the onset by a sample at most, and the best place is looked for to the sample.
    """

    values: Mapping[str, float]
    slopes: tuple[str, ...] = ()
    shifts: bool = False
    sharp: bool = False


@runtime_checkable
class Traceable(Effect, Protocol):
    """An effect that a search can propose: its ``traits`` say how, ``probes`` where to look for it in a record."""

    @property
    def traits(self) -> Traits: ...
    def probes(self, context: SearchContext) -> Sequence[Probe]: ...


@runtime_checkable
class Fitted(Protocol):
    """An effect whose form depends on the record (a range, a width); ``fitted_to`` gives it the form for that record, under the same name."""

    def fitted_to(self, context: SearchContext) -> Traceable: ...


@runtime_checkable
class Curve(Protocol):
    """A curve over a range: ``low`` and ``high``, in the unit of its argument, are what the records of ``fitted_to`` flew."""

    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...
    def fitted_to(self, context: SearchContext) -> Curve: ...


@runtime_checkable
class Refinable(Protocol):
    """An effect with a freer form under the same name; ``finer`` gives it, its further parameters at their absent values."""

    def finer(self) -> Traceable: ...


@runtime_checkable
class Edged(Protocol):
    """An event with edges of a width; ``blunted`` gives it, under the same name, edges so many times as wide.

    An output that feels the edge at once shows it in single samples: each is a local optimum of its time, of which wide edges have none.
    """

    def blunted(self, times: int) -> Traceable: ...


@runtime_checkable
class Underdetermined(Protocol):
    """A part of a vehicle whose parameters do not all leave a trace in its outputs: where ``needs_priors`` a fit takes all declared priors."""

    @property
    def needs_priors(self) -> bool: ...


def fitted_to(effect: Traceable, context: SearchContext) -> Traceable:
    """The effect in the form that a record asks for: itself unless it is ``Fitted``."""
    return effect.fitted_to(context) if isinstance(effect, Fitted) else effect


def late_times(context: SearchContext) -> tuple[float, ...]:
    """Delays and time constants to try, s, a factor of two apart, from a share of the sampling interval upward.

    None is a multiple of a usual sampling interval: there a held input's jump meets a sample, and slopes are one-sided.
    """
    return tuple(time for time in (0.0173, 0.0373, 0.0831, 0.1773) if time > 0.3 * context.interval) or (context.interval / 3.0,)


def shares_of_peak(context: SearchContext, signal: str, shares: Sequence[float]) -> tuple[float, ...]:
    """Shares of a signal's largest magnitude, spikes left out; none where it stays at zero."""
    flown = context.flown_range(signal)
    return tuple(share * max(abs(value) for value in flown) for share in shares) if flown else ()
