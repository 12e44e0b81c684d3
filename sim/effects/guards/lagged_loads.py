"""Loads that follow the angle of attack late."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.effects.instances import all_labelled
from sim.effects.loads import LOADS, load_parameters

LAGS = (0.05, 0.15, 0.5, 1.5)  # s, that a search tries: about the short period's time


@dataclass(frozen=True)
class LaggedLoads:
    """late_dot = (alpha - late)/``lag``, lift += ``lift`` (alpha - late), moment += ``moment`` (alpha - late).

    The first term of unsteady aerodynamics: loads that overshoot or build up with time constant ``lag``, s. For a short lag it is a derivative
    by alpha_dot, which the declared derivatives hold already.

    Attributes
    ----------
    units, sizes : of lift and moment. needs_constants : those of the equations it is written for.
    ports : that it loads, and the names of these parameters. angle : the signal that is followed late. label : of the control that it looks
        like late, where there are several. total : whether the angle is one; it then counts from ``middle``, that of the angles of attack
        flown, so that the loads do not begin with a jump.
    """

    units: tuple[str, str]
    sizes: tuple[float, float]
    needs_constants: tuple[str, ...]
    ports: tuple[str, str] = LOADS
    angle: str = "alpha_air"
    label: str = ""
    total: bool = False
    middle: float = 0.0

    name: ClassVar[str] = "guard:lagged-loads"
    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    states: ClassVar[tuple[Signal, ...]] = (Signal("late_angle", "rad", "angle of attack, late"),)
    traits: ClassVar[Traits] = Traits(guard=True)
    explanation: ClassVar[str] = (
        "A generic term: lift and moment take time to follow the angle of attack, CL += lift (alpha - late) with late_dot = (alpha - late)/lag. "
        "No cause of the library stands behind it. Where it explains a record better than every effect does, the cause is none of them."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("actuator-lag", "input-delay"), self.label)

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(self.ports, 0.0))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        loads = load_parameters(self.sizes, self.units, self.ports)
        return (Parameter("lag", 0.3, "s", bounds=(0.01, 20.0)), *loads)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        ahead = self._angle(s) - s.late_angle
        return {port: getattr(p, port) * ahead for port in self.ports}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ((self._angle(s) - s.late_angle) / p.lag,)

    def _angle(self, s: Any) -> Any:
        angle = getattr(s, self.angle)
        return angle - self.middle if self.total else angle

    def fitted_to(self, context: SearchContext) -> LaggedLoads:
        """The same; a total counts from the middle of the angles of attack that the record flew."""
        flown = context.flown_range("alpha")
        return replace(self, middle=0.5 * (flown[0] + flown[1])) if self.total and flown else self

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by both loads at some lags."""
        return tuple(Probe({"lag": lag, **self.absent}, self.ports) for lag in LAGS if lag > context.interval)


GUARDS: tuple[Traceable, ...] = (
    LaggedLoads(("1/rad", "1/rad"), (0.5, 0.3), ("Cm_de", "airspeed")),
    LaggedLoads(("1/s", "1/s2"), (0.3, 2.0), ("M_delta",)),
    LaggedLoads(("1/rad", "1/rad"), (0.1, 0.03), ("Cn_dr",), ("side_force", "yaw"), "beta_air", "rudder"),
    LaggedLoads(("1/rad", "1/rad"), (0.5, 0.3), ("Cm_de", "reference_airspeed"), label="elevator", total=True),
)
