"""Search traits and start values of an effect, for a search that knows no physics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol, runtime_checkable

from sim.declaration.effect import Effect

# ---- Traits of an effect

_ONSETS = 36  # times at which a search starts an event
GUARD = "guard:"  # prefix of a catch-all term's printed name

_NO_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType({})
_NO_SIZES: Mapping[str, float] = MappingProxyType({})
_NO_NAMES: Mapping[str, tuple[str, float]] = MappingProxyType({})
_NO_MANEUVERS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Traits:
    """Properties of an effect for searches and reports; each effect file states its own.

    Names of other effects in ``separating`` are without the part after a colon: ``"sensor-lag"`` is
    that of every channel.

    Attributes
    ----------
    sentences : templates in words, of which the first is taken whose parameters are all there. In
        braces a parameter by local name, or {control}, {sticks}, {channel}, {count_spikes}, {rest}
        (all parameters but times), and of a parameter NAME_percent (its distance from one),
        NAME_change (a share), NAME_direction, NAME_hertz, NAME_side (a length with "ahead of" or
        "behind"). Without any the report prints the parameters.
    grouped : the template where effects that a record cannot tell apart are told together; the
        sentence when empty.
    short_name : what it is called in such a group; its name when empty.
    separating : other effect -> what to fly to tell the two apart. Either of the two may say it. Of
        ``{ (CL_de, L_delta)}`` a report names those that the model has, nothing where it has none.
    twins : names of effects that are another description of the same fault of the same sensor:
        never claimed side by side.
    equivalents : those of the twins that no record tells apart from it, since other values of the
        derivatives make up for the difference: a record is explained alike under each, and only the
        priors say which is likelier.
    same_as : local name -> (effect, least size): where this parameter is larger than that, the
        effect is the same thing under another name, which no record without further channels tells
        apart.
    never_beside : names of effects that are never in one set with it: of one slow fault, or one law
        of the airspeed, a record shows no more.
    plausible : local name -> range within which a value is believed without asking; bounds are the
        physical limits.
    usual : local name -> one standard deviation of what is expected of it before any record is
        seen, about its absence; its declared size where it is not here.
    oscillates : local names of frequencies, rad/s, that a record resolves only well below half its
        sampling rate.
    tried : local names of parameters that only trying finds, since no slope tells them: each is
        known to its prior about the value tried.
    in_input_unit : local names of parameters that are counted in the unit of the input, or that per
        second.
    onset : local name of the time from which it acts, searched for over the record; empty where
        there is none.
    lasts : local name of the time that an event lasts: where it is no longer than two samples, the
        recorder did it, and no force.
    per_record : True where the effect belongs to one record (an event, a drift): its parameters are
        fitted anew for each record, and it needs not act on all of them. Those in ``of_aircraft``
        are excepted.
    of_aircraft : local names of parameters that any aircraft has and that are known beforehand to
        their prior: all records share them.
    guard : True for a generic term that competes like an effect and is never claimed: where it
        wins, the library lacks the cause.
    wrong_samples_of : the output or recorded input whose isolated wrong samples it stands for:
        found by rule, never fitted.
    recorded_as : the input channel that records what this effect would have to guess: with it there
        is nothing to search for.
    within_interval : local name of a time that, where it is shorter than the sampling interval,
        tells how inputs are to be read between samples, and no more.
    background : True for motion that any real record may have whatever else is wrong: its prior
        odds are one half.
    general : True for one of many instances of a general form, less specific than a named cause:
        offered where nothing with a cause of its own explains the records.
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
    usual: Mapping[str, float] = field(default_factory=lambda: _NO_SIZES)
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


# ---- Search traits and probes of an effect

# highest frequency of an oscillation, relative to half the sampling rate: with fewer samples a
# period any derivative fits
RESOLVED_FREQUENCY_SHARE = 0.8

_NONE: Mapping[str, float] = MappingProxyType({})
_proposal_NO_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType({})


@dataclass(frozen=True)
class SearchContext:
    """Properties of a record that a search uses before any effect is fitted.

    Attributes
    ----------
    begin, end : s, of the record.
    interval : median sampling interval, s.
    input_peak : largest magnitude of each input.
    input_rate : largest step between samples over the interval, unit/s.
    state_peak : largest magnitude of each measured state or output, in its unit.
    flown : lowest and highest value of an input, state or output, spikes left out; ``flown_range``
        falls back on the peaks.
    residual_peaks : frequencies of peaks in the residual's spectrum, rad/s, strongest first.
    update_periods : of each output the period, s, at which it would be held between updates if it
        were.
    airspeed : m/s, where the model has one.
    values : parameters of the model as fitted, by name.
    """

    begin: float
    end: float
    interval: float
    input_peak: Mapping[str, float] = field(default_factory=lambda: _NONE)
    input_rate: Mapping[str, float] = field(default_factory=lambda: _NONE)
    state_peak: Mapping[str, float] = field(default_factory=lambda: _NONE)
    flown: Mapping[str, tuple[float, float]] = field(default_factory=lambda: _proposal_NO_RANGES)
    residual_peaks: tuple[float, ...] = ()
    update_periods: Mapping[str, float] = field(default_factory=lambda: _NONE)
    airspeed: float = 0.0
    values: Mapping[str, float] = field(default_factory=lambda: _NONE)

    @property
    def duration(self) -> float:
        return self.end - self.begin

    def flown_range(self, name: str) -> tuple[float, float] | None:
        """Return the lowest and highest value of a signal in the record; plus and minus its peak if
        only that is known, None if nothing is.
        """
        if name in self.flown:
            return self.flown[name]
        peak = self.state_peak.get(name, self.input_peak.get(name, 0.0))
        return (-peak, peak) if peak > 0 else None

    def onsets(self) -> tuple[float, ...]:
        """Return the times spread evenly over the record without its ends, where an event looks
        like a bias.
        """
        return tuple(self.begin + self.duration * (i + 0.5) / _ONSETS for i in range(_ONSETS))


@dataclass(frozen=True)
class Probe:
    """A point at which a search evaluates an effect.

    Attributes
    ----------
    values : all local parameters.
    slopes : those by which the outputs are differentiated at ``values``; the columns that this
        gives are the effect's signature. When empty, the signature is the whole change from the
        effect's absence.
    shifts : True where a later onset only moves the signature along the record, and the same probe
        therefore stands for all of them.
    sharp : of one that shifts: a fit moves the onset by a sample at most, and the best place is
        looked for to the sample.
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
    """An effect whose form depends on the record (a range, a width); ``fitted_to`` gives it the
    form for that record, under the same name.
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
    """An effect with a freer form under the same name; ``finer`` gives it, its further parameters
    at their absent values.
    """

    def finer(self) -> Traceable: ...


@runtime_checkable
class Underdetermined(Protocol):
    """A part of a vehicle whose parameters do not all leave a trace in its outputs: where
    ``needs_priors`` a fit takes all declared priors.
    """

    @property
    def needs_priors(self) -> bool: ...


def fitted_to(effect: Traceable, context: SearchContext) -> Traceable:
    """The effect in the form that a record asks for: itself unless it is ``FittedToRecord``."""
    return effect.fitted_to(context) if isinstance(effect, FittedToRecord) else effect


def delays_to_try(context: SearchContext) -> tuple[float, ...]:
    """Return the delays and time constants to try, s, a factor of two apart, from a share of the
    sampling interval upward.

    None is a multiple of a usual sampling interval: a step of a held input would then meet a
    sample, and slopes would be one-sided.
    """
    return tuple(
        time for time in (0.0173, 0.0373, 0.0831, 0.1773) if time > 0.3 * context.interval
    ) or (context.interval / 3.0,)


def shares_of_peak(
    context: SearchContext, signal: str, shares: Sequence[float]
) -> tuple[float, ...]:
    """Shares of a signal's largest magnitude, spikes left out; none where it stays at zero."""
    recorded_range = context.flown_range(signal)
    return (
        tuple(share * max(abs(value) for value in recorded_range) for share in shares)
        if recorded_range
        else ()
    )
