"""Traits and trial values that an effect declares for a search that is independent of physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol, runtime_checkable

from sim.declaration.effect import Effect

# ---- Traits of an effect

_ONSETS = 36  # number of times at which a search tries an event
GUARD = "guard:"  # prefix of a catch-all term's printed name

_NO_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType({})
_NO_NUMBERS: Mapping[str, float] = MappingProxyType({})
_NO_NAMES: Mapping[str, tuple[str, float]] = MappingProxyType({})
_NO_MANEUVERS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Traits:
    """Properties of an effect for searches and reports; each effect file states its own.

    Names of other effects in ``separating`` have no part after a colon: ``"sensor-lag"`` stands for
    the lags of all channels.

    Attributes
    ----------
    sentences : templates of the sentence in a report. The first one whose parameters all exist is
        used; without a template the report prints the parameters. Braces contain a parameter by its
        local name, or {control}, {sticks}, {channel}, {count_spikes}, {rest} (all parameters but
        times). For a parameter NAME there are also NAME_percent (its distance from one),
        NAME_change (a share), NAME_direction, NAME_hertz, and NAME_side (a length with "ahead of"
        or "behind").
    grouped : template for effects that a record cannot distinguish and that are reported together;
        the sentence if empty.
    short_name : name of the effect in such a group; its name if empty.
    separating : other effect -> maneuver that distinguishes the two. One of the two effects may
        declare it for both. Of parameters in ``{ (CL_de, L_delta)}`` a report names those that the
        model has.
    twins : names of effects that describe the same fault of the same sensor in another form; only
        one of them is claimed.
    equivalents : those ``twins`` that no record distinguishes from the effect, because other values
        of the derivatives compensate the difference. Only the priors separate them.
    same_as : local name -> (effect, least size). If the parameter is larger than the size, the
        other effect describes the same motion, and only further channels could distinguish the two.
    never_beside : names of effects that are never in one set with this one. For example, a record
        can show only one slow fault, or one law of the airspeed.
    plausible : local name -> plausible range; bounds are the physical limits.
    usual : local name -> standard deviation of the prior about the absent value; the declared value
        of the parameter for a name that is not given.
    oscillates : local names of frequencies, rad/s. A record resolves such a frequency only well
        below half its sampling rate.
    tried : local names of parameters that are found by trial values, since the likelihood has no
        useful slope. The prior about the trial value is their uncertainty.
    in_input_unit : local names of parameters in the unit of the input, or in this unit per second.
    onset : local name of the time from which an event acts, which is searched over the record;
        empty if the effect is no event.
    lasts : local name of the duration of an event. An event of at most two samples is an error of
        the recorder and no force.
    per_record : True if the effect belongs to one record (an event, a drift). Its parameters,
        except those in ``of_aircraft``, are fitted for each record, and it need not act on all
        records.
    of_aircraft : local names of parameters that belong to the aircraft and have a prior; they are
        common to all records.
    guard : True for a catch-all term, which competes like an effect and is never claimed. If it
        wins, the library lacks the cause.
    wrong_samples_of : output or recorded input whose isolated wrong samples the effect describes.
        Such an effect is found by a rule and never fitted.
    recorded_as : input channel that would record the cause. The effect is not searched if a record
        has this channel.
    within_interval : local name of a time. A time shorter than the sampling interval only shows how
        inputs move between samples.
    background : True for motion that any real record may have; its prior odds are one half.
    general : True for one of many instances of a general form, without a cause of its own. It is
        offered only if no effect with a cause explains the records.
    """

    sentences: tuple[str, ...] = ()
    grouped: str = ""
    short_name: str = ""
    separating: Mapping[str, str] = field(default_factory=lambda: _NO_MANEUVERS)
    twins: tuple[str, ...] = ()
    equivalents: tuple[str, ...] = ()
    same_as: Mapping[str, tuple[str, float]] = field(default_factory=lambda: _NO_NAMES)
    never_beside: tuple[str, ...] = ()
    plausible: Mapping[str, tuple[float, float]] = field(default_factory=lambda: _NO_RANGES)
    usual: Mapping[str, float] = field(default_factory=lambda: _NO_NUMBERS)
    oscillates: tuple[str, ...] = ()
    tried: tuple[str, ...] = ()
    in_input_unit: tuple[str, ...] = ()
    onset: str = ""
    lasts: str = ""
    per_record: bool = False
    of_aircraft: tuple[str, ...] = ()
    guard: bool = False
    wrong_samples_of: str = ""
    recorded_as: str = ""
    within_interval: str = ""
    background: bool = False
    general: bool = False


# ---- Properties of a record for a search, and probes of an effect

# Highest frequency of an oscillation that a record resolves, relative to half the sampling rate.
RESOLVED_FREQUENCY_SHARE = 0.8


@dataclass(frozen=True)
class SearchContext:
    """Properties of a record that a search uses before any effect is fitted.

    Attributes
    ----------
    begin, end : times of the first and last sample, s.
    interval : median sampling interval, s.
    input_peak : largest magnitude of each input.
    input_rate : largest rate of each input between samples, in its unit per s.
    state_peak : largest magnitude of each measured state or output, in its unit.
    flown : lowest and highest value of an input, state or output without spikes. For signals that
        are not named here, ``flown_range`` uses the peaks.
    residual_peaks : frequencies of peaks in the residual's spectrum, rad/s, strongest first.
    update_periods : output -> period between updates, s, if its sensor may hold its value between
        updates.
    airspeed : airspeed of the model, m/s; zero without one.
    values : fitted parameters of the model, by name.
    """

    begin: float
    end: float
    interval: float
    input_peak: Mapping[str, float] = field(default_factory=lambda: _NO_NUMBERS)
    input_rate: Mapping[str, float] = field(default_factory=lambda: _NO_NUMBERS)
    state_peak: Mapping[str, float] = field(default_factory=lambda: _NO_NUMBERS)
    flown: Mapping[str, tuple[float, float]] = field(default_factory=lambda: _NO_RANGES)
    residual_peaks: tuple[float, ...] = ()
    update_periods: Mapping[str, float] = field(default_factory=lambda: _NO_NUMBERS)
    airspeed: float = 0.0
    values: Mapping[str, float] = field(default_factory=lambda: _NO_NUMBERS)

    @property
    def duration(self) -> float:
        return self.end - self.begin

    def flown_range(self, name: str) -> tuple[float, float] | None:
        """Return the lowest and highest value of a signal in the record.

        If only the peak of the signal is known, the range is from minus to plus this peak. None if
        nothing is known.
        """
        if name in self.flown:
            return self.flown[name]
        peak = self.state_peak.get(name, self.input_peak.get(name, 0.0))
        return (-peak, peak) if peak > 0 else None

    def onsets(self) -> tuple[float, ...]:
        """Return the trial times of an event, spread evenly over the record.

        The ends of the record are left out, because an event there looks like a bias.
        """
        return tuple(self.begin + self.duration * (i + 0.5) / _ONSETS for i in range(_ONSETS))


@dataclass(frozen=True)
class Probe:
    """A point at which a search evaluates an effect.

    Attributes
    ----------
    values : value of each parameter, by local name.
    slopes : parameters by which the outputs are differentiated at ``values``; these derivatives are
        the effect's signature. If empty, the signature is the change of the outputs from the
        effect's absence.
    shifts : True if a later onset only shifts the signature along the record; the probe then stands
        for all onsets.
    sharp : for a probe that shifts: True if a fit moves the onset by a sample at most. The best
        onset then has to be searched at every sample.
    """

    values: Mapping[str, float]
    slopes: tuple[str, ...] = ()
    shifts: bool = False
    sharp: bool = False


@runtime_checkable
class Traceable(Effect, Protocol):
    """An effect that a search can propose, with its ``traits`` and its ``probes`` of a record."""

    @property
    def traits(self) -> Traits: ...
    def probes(self, context: SearchContext) -> Sequence[Probe]: ...


@runtime_checkable
class FittedToRecord(Protocol):
    """An effect whose form depends on the record (a range, a width).

    ``fitted_to`` returns the effect in the form for a record, under the same name.
    """

    def fitted_to(self, context: SearchContext) -> Traceable: ...


@runtime_checkable
class RangedCurve(Protocol):
    """A curve over the range of the records: ``low`` and ``high``, in the unit of its argument."""

    @property
    def low(self) -> float: ...
    @property
    def high(self) -> float: ...
    def fitted_to(self, context: SearchContext) -> RangedCurve: ...


@runtime_checkable
class Refinable(Protocol):
    """An effect with a refined form under the same name.

    ``finer`` returns the refined form; its further parameters have their absent values.
    """

    def finer(self) -> Traceable: ...


@runtime_checkable
class Underdetermined(Protocol):
    """A part of a vehicle whose parameters are not all observable in its outputs.

    If ``needs_priors``, a fit uses all declared priors.
    """

    @property
    def needs_priors(self) -> bool: ...


def fitted_to(effect: Traceable, context: SearchContext) -> Traceable:
    """Return the effect in the form for a record; itself unless it is ``FittedToRecord``."""
    return effect.fitted_to(context) if isinstance(effect, FittedToRecord) else effect


def delays_to_try(context: SearchContext) -> tuple[float, ...]:
    """Return the delays and time constants to try, s, a factor of two apart, from a share of the
    sampling interval upward.

    No value is a multiple of a usual sampling interval. With such a value, a step of a held input
    would reach the vehicle at a sample, where the derivative is one-sided.
    """
    return tuple(
        time for time in (0.0173, 0.0373, 0.0831, 0.1773) if time > 0.3 * context.interval
    ) or (context.interval / 3.0,)


def shares_of_peak(
    context: SearchContext, signal: str, shares: Sequence[float]
) -> tuple[float, ...]:
    """Return shares of a signal's largest magnitude without spikes; none if the signal is zero."""
    recorded_range = context.flown_range(signal)
    return (
        tuple(share * max(abs(value) for value in recorded_range) for share in shares)
        if recorded_range
        else ()
    )
