"""What dead band and backlash share: half a width on one input, in the input's unit, zero where the effect is absent."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, shares_of_peak

ABSENT: Mapping[str, float] = MappingProxyType({"half_width": 0.0})


def half_width(typical: float, unit: str) -> tuple[Parameter, ...]:
    """The one parameter, not negative."""
    return (Parameter("half_width", typical, unit, bounds=(0.0, 1e9)),)


def believed(typical: float) -> Mapping[str, tuple[float, float]]:
    """Up to ten times the typical value: for an elevator some degrees."""
    return {"half_width": (0.0, 10.0 * typical)}


def tried(context: SearchContext, signal: str) -> Sequence[Probe]:
    """From a small share of the input's peak to more than half of it."""
    return [Probe({"half_width": size}) for size in shares_of_peak(context, signal, (0.04, 0.12, 0.3, 0.6))]
