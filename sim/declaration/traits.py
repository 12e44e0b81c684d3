"""What is known of an effect beside its equations: how a search treats it, and the words that reports tell it in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

GUARD = "guard:"  # what a guard's printed name begins with

_NO_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType({})
_NO_SIZES: Mapping[str, float] = MappingProxyType({})
_NO_NAMES: Mapping[str, tuple[str, float]] = MappingProxyType({})
_NO_MANEUVERS: Mapping[str, str] = MappingProxyType({})


@dataclass(frozen=True)
class Traits:
    """What a search and its reports ask of an effect; each file states what is special about its own.

    Names of other effects in ``separating`` stand without their part after a colon: ``"sensor-lag"`` is that of every channel.

    Attributes
    ----------
    sentences : templates in words, of which the first is taken whose parameters are all there. In braces a parameter by local name, or
        {control}, {sticks}, {channel}, {count_spikes}, {rest} (all parameters but times), and of a parameter NAME_percent (its distance
        from one), NAME_change (a share), NAME_direction, NAME_hertz, NAME_side (a length with "ahead of" or "behind"). Without any the
        report prints the parameters.
    grouped : the template where effects that a record cannot tell apart are told together; the sentence when empty.
    short_name : what it is called in such a group; its name when empty.
    separating : other effect -> what to fly to tell the two apart. Either of the two may say it.
    twins : names of effects that are another description of the same fault of the same sensor: never claimed side by side.
    equivalents : those of the twins that no record tells apart from it, since other values of the derivatives make up for the difference: a
        record is explained alike under each, and only the priors say which is likelier.
    same_as : local name -> (effect, least size): where this parameter is larger than that, the effect is the same thing under another name, which
        no record without further channels tells apart.
    never_beside : names of effects that are never in one set with it: of one slow fault, or one law of the airspeed, a record shows no more.
    plausible : local name -> range within which a value is believed without asking; bounds are the physical limits.
    usual : local name -> one standard deviation of what is expected of it before any record is seen, about its absence; its declared
        size where it is not here.
    oscillates : local names of frequencies, rad/s, that a record resolves only well below half its sampling rate.
    tried : local names of parameters that only trying finds, since no slope tells them: each is known to its prior about the value tried.
    in_input_unit : local names of parameters that are counted in the unit of the input, or that per second.
    onset : local name of the time from which it acts, searched for over the record; empty where there is none.
    lasts : local name of the time that an event lasts: where it is no longer than two samples, the recorder did it, and no force.
    per_record : True where the effect belongs to one record (an event, a drift): its parameters are fitted anew for each record, and it
        needs not act on all of them. Those in ``of_aircraft`` are excepted.
    of_aircraft : local names of parameters that any aircraft has and that are known beforehand to their prior: all records share them.
    guard : True for a generic term that competes like an effect and is never claimed: where it wins, the library lacks the cause.
    wrong_samples_of : the output or recorded input whose isolated wrong samples it stands for: found by rule, never fitted.
    recorded_as : the input channel that records what this effect would have to guess: with it there is nothing to search for.
    within_interval : local name of a time that, where it is shorter than the sampling interval, tells how inputs are to be read between
        samples, and no more.
    background : True for motion that any real record may have whatever else is wrong: its prior odds are one half.
    general : True for one of many instances of a general form, less specific than a named cause: offered where nothing with a cause of its
        own explains the records.
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
