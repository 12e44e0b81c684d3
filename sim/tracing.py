"""What an effect tells a search that knows nothing of physics: where to look for it, and where to start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Protocol, runtime_checkable

from sim.effect import Effect

_NONE: Mapping[str, float] = MappingProxyType({})


@dataclass(frozen=True)
class Occasion:
    """What a record offers before any effect is tried.

    Attributes
    ----------
    begin, end : s, of the record. interval : median sampling interval, s.
    input_peak : largest magnitude of each input. input_rate : largest step between samples over the interval, unit/s.
    state_peak : largest magnitude of each measured state or output, in its unit.
    residual_peaks : frequencies of peaks in the residual's spectrum, rad/s, strongest first.
    airspeed : m/s, where the model has one.
    """

    begin: float
    end: float
    interval: float
    input_peak: Mapping[str, float] = field(default_factory=lambda: _NONE)
    input_rate: Mapping[str, float] = field(default_factory=lambda: _NONE)
    state_peak: Mapping[str, float] = field(default_factory=lambda: _NONE)
    residual_peaks: tuple[float, ...] = ()
    airspeed: float = 0.0

    @property
    def duration(self) -> float:
        return self.end - self.begin


@dataclass(frozen=True)
class Probe:
    """One place where a search evaluates an effect.

    Attributes
    ----------
    values : all local parameters. slopes : those by which the outputs are differentiated at ``values``; the columns that
        this gives are the effect's signature. When empty, the signature is the whole change from the effect's absence.
    """

    values: Mapping[str, float]
    slopes: tuple[str, ...] = ()


@runtime_checkable
class Traceable(Effect, Protocol):
    """An effect that a search can propose.

    Attributes
    ----------
    onset : local name of the time from which it acts, where a later time only shifts its signature (one may then
        be computed and shifted over the record); empty where there is none.
    per_record : True where the effect belongs to one record (an event, a drift): its parameters are fitted anew for
        each record, and it needs not act on all of them.
    plausible : local name -> range within which a value is believed without asking; bounds are the physical limits.
    """

    @property
    def onset(self) -> str: ...
    @property
    def per_record(self) -> bool: ...
    @property
    def plausible(self) -> Mapping[str, tuple[float, float]]: ...
    def probes(self, occasion: Occasion) -> Sequence[Probe]: ...
