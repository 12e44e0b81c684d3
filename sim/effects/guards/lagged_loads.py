"""Loads that follow the angle of attack late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.effects.loads import load_parameters

LAGS = (0.05, 0.15, 0.5, 1.5)  # s, that a search tries: about the short period's time


@dataclass(frozen=True)
class LaggedLoads:
    """late_dot = (alpha - late)/``lag``, lift += ``lift`` (alpha - late), moment += ``moment`` (alpha - late).

    The first term of unsteady aerodynamics: loads that overshoot or build up with time constant ``lag``, s. For a short lag it is a derivative
    by alpha_dot, which the declared derivatives hold already.

    Attributes
    ----------
    units, sizes : of lift and moment. needs_constants : those of the equations it is written for.
    """

    units: tuple[str, str]
    sizes: tuple[float, float]
    needs_constants: tuple[str, ...]

    name: ClassVar[str] = "guard:lagged-loads"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("lift", "moment")
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"lift": 0.0, "moment": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ("actuator-lag", "input-delay")
    states: ClassVar[tuple[Signal, ...]] = (Signal("late_angle", "rad", "angle of attack, late"),)
    traits: ClassVar[Traits] = Traits(guard=True)
    explanation: ClassVar[str] = (
        "A generic term: lift and moment take time to follow the angle of attack, CL += lift (alpha - late) with late_dot = (alpha - late)/lag. "
        "No cause of the library stands behind it. Where it explains a record better than every effect does, the cause is none of them."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        loads = load_parameters(self.sizes, self.units)
        return (Parameter("lag", 0.3, "s", bounds=(0.01, 20.0)), *loads)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        ahead = s.alpha_air - s.late_angle
        return {"lift": p.lift * ahead, "moment": p.moment * ahead}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ((s.alpha_air - s.late_angle) / p.lag,)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by both loads at some lags."""
        return tuple(Probe({"lag": lag, **self.absent}, ("lift", "moment")) for lag in LAGS if lag > context.interval)


GUARDS: tuple[Traceable, ...] = (
    LaggedLoads(("1/rad", "1/rad"), (0.5, 0.3), ("Cm_de",)),
    LaggedLoads(("1/s", "1/s2"), (0.3, 2.0), ("M_delta",)),
)
