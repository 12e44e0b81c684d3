"""The phugoid: the slow exchange of speed and height that any aircraft has and a short period at constant speed leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.effects.separating import STEADY_FLIGHT
from sim.effects.trim_lift import weight_lift
from sim.maths.constants import G0

SPEED, ATTITUDE = "phugoid_speed", "phugoid_attitude"
STEEPEST = 0.35  # rad, of a flight path that perturbations about level flight still describe
TRIED = (-0.12, -0.03, 0.03, 0.12)  # rad: the speed is almost linear in the attitude, so few places reach all


@dataclass(frozen=True)
class Phugoid:
    """u_dot = -gravity (theta - alpha) - speed_damping u - induced_drag alpha,  theta_dot = q,  V = airspeed + u.

    Perturbations about level flight at the declared airspeed. The trim lift, which carries the weight, follows the dynamic pressure
    (``weight_lift``): alpha_dot gains -(2 g0/V^2) u and nz gains 2 u/V to first order, and all other loads go with (1 + u/V)^2.
    A record begins at u = 0; ``attitude`` (rad, nose up) is theta against the level flight path there, each record's own. A steady
    deceleration is the same as an attitude: u_dot = -gravity attitude. With ``gravity`` = 0 there is no exchange, and no effect.

    Attributes
    ----------
    fine : with the drag's terms as well, ``speed_damping`` (1/s) and ``induced_drag`` (m/s2 per rad).
    recorded : the pitch attitude is an input of the equations, ``theta`` (rad, from its value at the record's begin), and no state.
    needs_constants : those of the equations it is written for.
    """

    fine: bool = False
    recorded: bool = False
    needs_constants: tuple[str, ...] = ("mass", "wing_area", "airspeed")

    name: ClassVar[str] = "phugoid"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("airspeed_change", "lift")
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ("speed-variation",)
    traits: ClassVar[Traits] = Traits(
        sentences=("the aircraft exchanges speed and height (phugoid), its flight path {attitude} nose up at the record's begin",),
        short_name="phugoid",
        separating={"speed-variation": STEADY_FLIGHT, "sensor-drift": STEADY_FLIGHT},
        plausible={"attitude": (-STEEPEST, STEEPEST)},
        per_record=True,
        background=True,
        recorded_as="airspeed_change",
    )
    explanation: ClassVar[str] = (
        "Pull the nose up and the aircraft climbs, loses speed, loses lift and sinks again: u_dot = -g (theta - alpha) and theta_dot = q. Over the "
        "tens of seconds of a maneuver this is the beginning of the phugoid, the slow oscillation of speed and height with a frequency near "
        "sqrt(2) g/V. As the speed falls, the lift that carries the weight falls with the dynamic pressure: the load factor gains 2 u/V, the angle "
        "of attack the rate -(2 g/V^2) u, and all other loads and dampings go with the speed. A model at constant speed leaves it out, and a slow "
        "drift of the accelerometer or of the vane, a jump of a derivative or a load that nobody measured will imitate it. Any real aircraft has "
        "it, whatever else is wrong with the model, so it is offered before them. A recorded airspeed takes its place, a recorded pitch attitude "
        "that of its second state."
    )

    @property
    def states(self) -> tuple[Signal, ...]:
        speed = Signal(SPEED, "m/s", "airspeed above that at the record's begin")
        return (speed,) if self.recorded else (speed, Signal(ATTITUDE, "rad", "pitch attitude above that at the record's begin"))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        base = (Parameter("gravity", G0, "m/s2", free=False), Parameter("attitude", 0.03, "rad", bounds=(-0.6, 0.6)))
        if not self.fine:
            return base
        damping = Parameter("speed_damping", 0.01, "1/s", bounds=(-0.3, 0.3))
        return (*base, damping, Parameter("induced_drag", 2.0, "m/(s2 rad)", bounds=(-60.0, 60.0)))

    @property
    def absent(self) -> Mapping[str, float]:
        further = {"speed_damping": 0.0, "induced_drag": 0.0} if self.fine else {}
        return MappingProxyType({"gravity": 0.0, **further})

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        speed = getattr(s, SPEED)
        return {"airspeed_change": speed, "lift": weight_lift(speed, vehicle)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        theta = p.attitude + (s.theta if self.recorded else getattr(s, ATTITUDE))
        rate = -p.gravity * (theta - s.alpha)
        if self.fine:
            rate = rate - p.speed_damping * getattr(s, SPEED) - p.induced_drag * s.alpha
        return (rate,) if self.recorded else (rate, s.q)

    def finer(self) -> Phugoid:
        """The same with the terms of the drag."""
        return replace(self, fine=True)

    def fitted_to(self, context: SearchContext) -> Phugoid:
        """The same with the attitude as a state, or as the input that it is where a record has it."""
        return replace(self, recorded="theta" in context.input_peak)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Flight paths up and down, each with its slope: at none at all there is an exchange already."""
        start = {item.name: item.value for item in self.parameters} | ({"speed_damping": 0.0, "induced_drag": 0.0} if self.fine else {})
        return tuple(Probe({**start, "attitude": attitude}, ("attitude",)) for attitude in TRIED)


VARIANTS: tuple[Traceable, ...] = (Phugoid(),)
