"""Airspeed that changes along the record, while the vehicle is declared at one speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import STEADY_FLIGHT
from sim.effects.loads import weight_lift


@dataclass(frozen=True)
class SpeedVariation:
    """V(t) = V + ``rate`` (t - begin), V the declared airspeed, ``rate`` in m/s2, ``begin`` the
    time at which V holds, s.

    Pressure and non-dimensional rates follow, and with ``weight`` the lift that carries the weight
    (`sim.effects.loads`): surfaces and attitude stay where they trimmed the aircraft at V. Without,
    it is trimmed anew at every speed, by what no channel shows, and only the perturbations change.
    On the low-order equivalent system the derivatives scale as those of an aircraft at constant
    coefficients: L_alpha, L_delta, M_q with V, M_alpha and M_delta with V^2.
    """

    begin: float = 0.0
    weight: bool = True

    name: ClassVar[str] = "speed-variation"
    station: ClassVar[Station] = Station.DISTURBANCE
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("rate", 1.5, "m/s2", bounds=(-15.0, 15.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"rate": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("the airspeed changes by {rate}",),
        short_name="changing airspeed",
        separating=dict.fromkeys(
            ("sensor-drift", "drag-mach", "density-scale-height"), STEADY_FLIGHT
        ),
        plausible={"rate": (-4.0, 4.0)},
        per_record=True,
        recorded_as="airspeed_change",
    )
    explanation: ClassVar[str] = (
        "The aircraft speeds up or slows down during the record: V(t) = V + rate (t - begin). All "
        "forces grow with V^2, the damping by rates with "
        "V, so the short period becomes faster along the record and the load factor per angle of "
        "attack larger, while a model with one speed fits "
        "the middle of the record best and errs at both ends with opposite sign. The lift that "
        "carries the weight grows with V^2, too: unless "
        "something that is not recorded keeps the aircraft in trim, nz and the angle of attack "
        "drift away together, nz by (V(t)/V)^2 - 1. A "
        "measured airspeed settles the matter; without one it takes maneuvers both early and late "
        "in the record. "
        "On the lateral model, only pressure, damping and the turn under gravity change: the Dutch "
        "roll becomes faster."
    )

    @property
    def needs(self) -> tuple[str, ...]:
        return ("airspeed_change", "lift") if self.weight else ("airspeed_change",)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        change = p.rate * (s.time - self.begin)
        if not self.weight:
            return {"airspeed_change": change}
        density = getattr(s, "density_change", 0.0)
        return {
            "airspeed_change": change,
            "lift": weight_lift(change, vehicle, s.airspeed_change, density),
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> SpeedVariation:
        """The same with the declared airspeed at that record's begin."""
        return replace(self, begin=context.begin)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The slope where there is none."""
        return (Probe(self.absent, ("rate",)),)


VARIANTS: tuple[Traceable, ...] = (SpeedVariation(), SpeedVariation(weight=False))
