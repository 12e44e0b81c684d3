"""Airspeed that differs from the declared one: the phugoid, and a change along the record."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import STEADY_FLIGHT, ProbedAtAbsence, WithoutStates
from sim.maths import G0

# Names of the states of the phugoid.
SPEED = "phugoid_speed"
ATTITUDE = "phugoid_attitude"
STEEPEST_FLIGHT_PATH = 0.35  # rad, steepest flight path for perturbations about level flight
PLAUSIBLE = {  # three to five sigmas of the prior
    "trim_moment": (-0.06, 0.06),
    "speed_damping": (-0.03, 0.05),
    "induced_drag": (-15.0, 25.0),
}
# Attitude, rad, above which a claimed phugoid also counts as the effect speed-variation: its
# deceleration g attitude is then 0.1 m/s2.
LEAST_ATTITUDE_OF_SPEED_CHANGE = 0.01
# Trial attitudes, rad; few suffice, since the speed is almost linear in the attitude.
TRIAL_ATTITUDES = (0.0, -0.12, -0.03, 0.03, 0.12)


def weight_lift(
    change: Any, vehicle: Any, airspeed_change: Any = 0.0, density_change: Any = 0.0
) -> Any:
    """Return the increment of the port ``lift`` by a change of the airspeed at trim.

    The lift that carries the weight is proportional to the dynamic pressure qbar, with surfaces and
    attitude at trim. About level flight nz increases by qbar/qbar_0 - 1, and alpha_dot decreases by
    (g/V) (qbar/qbar_0 - 1). V is the changed airspeed, and qbar_0 is the dynamic pressure at the
    declared airspeed and density. In equations with a mass the port is a coefficient, and its
    increment is m g0/S (1/qbar_0 - 1/qbar). In equations with a dimensional lift the increment is
    the change of alpha_dot, 1/s, which is negative for a faster aircraft.

    Parameters
    ----------
    change : change of the airspeed, m/s, in addition to ``airspeed_change``.
    vehicle : constants of the equations.
    airspeed_change, density_change : m/s and kg/m3, values of the ports of these names. The result
        does not include the lift that they cause.
    """
    V = vehicle.airspeed + airspeed_change
    if hasattr(vehicle, "mass"):
        density = vehicle.air_density
        loading = 2.0 * vehicle.mass * G0 / (vehicle.wing_area * (density + density_change))
        # qbar_0 drops out of the difference: m g0/S (1/qbar_before - 1/qbar_after).
        return loading * (1.0 / (V * V) - 1.0 / ((V + change) * (V + change)))
    return _excess_lift_rate(V, vehicle) - _excess_lift_rate(V + change, vehicle)


def _excess_lift_rate(V: Any, vehicle: Any) -> Any:
    """Return (g/V) (qbar/qbar_0 - 1), the decrease of alpha_dot at the airspeed V, 1/s."""
    return vehicle.gravity / V * (V * V / (vehicle.airspeed * vehicle.airspeed) - 1.0)


@dataclass(frozen=True)
class Phugoid:
    """Phugoid: u_dot = -gravity (theta - alpha + (speed_damping u + induced_drag alpha)/g0),
    theta_dot = q, V = airspeed + u.

    Signals are perturbations about level flight at the declared airspeed. The lift that carries the
    weight is proportional to the dynamic pressure (``weight_lift``): to first order alpha_dot
    changes by -(2 g0/V^2) u and nz by 2 u/V. The moment of the engines stays constant, while the
    aerodynamic moment that balances it at trim is proportional to the dynamic pressure. The
    difference adds ``trim_moment`` (1 - qbar_0/qbar) to Cm, to first order 2 trim_moment u/V. All
    other loads are proportional to (1 + u/V)^2.

    A record begins at u = 0. ``attitude`` (rad, nose up) is theta at the beginning of the record
    minus theta in level flight; each record has its own value. A steady deceleration is equivalent
    to an attitude: u_dot = -gravity attitude. With ``gravity`` = 0 the effect is absent.

    ``speed_damping`` (1/s), ``induced_drag`` (m/(s2 rad)) and ``trim_moment`` (1, nose up) belong
    to the aircraft. Their priors are those of usual aircraft. D/m changes with the speed by 2 g0
    D/(L V), and with the angle of attack by g0 times the slope of D/L. Thrust at an arm of one
    chord gives a moment coefficient of the size of CD.

    Attributes
    ----------
    attitude_recorded : whether the pitch attitude is an input of the equations instead of a state:
        ``theta`` (rad, minus its value at the record's begin).
    speed_recorded : whether the airspeed is an input, too. The model then already includes the
        effect of the airspeed on the lift that carries the weight, and only ``trim_moment`` is a
        parameter.
    """

    attitude_recorded: bool = False
    speed_recorded: bool = False

    name: ClassVar[str] = "phugoid"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("airspeed_change", "lift", "moment")
    needs_constants: ClassVar[tuple[str, ...]] = ("mass", "wing_area", "chord", "airspeed")
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ("speed-variation",)
    explanation: ClassVar[str] = (
        "Phugoid, speed against height. After a pitch-up the aircraft climbs, loses speed, loses "
        "lift and sinks again: u_dot = -g (theta - alpha) and theta_dot = q. Over the tens of "
        "seconds of a maneuver this is the beginning of the phugoid, the slow oscillation with a "
        "frequency near sqrt(2) g/V. The lift that carries the weight is proportional to the "
        "dynamic pressure: the load factor changes by 2 u/V and alpha_dot by -(2 g/V^2) u. All "
        "other loads and dampings also depend on the speed. The moment of the engines does not, so "
        "the aerodynamic moment that balanced it at trim changes the pitching moment. A model at "
        "constant speed neglects all this. A slow drift of the accelerometer or of the vane, a "
        "jump of a derivative or an unmeasured load can then imitate the phugoid. Every real "
        "aircraft has a phugoid, so the search offers it before those effects. If the airspeed is "
        "recorded, it replaces the phugoid except for its moment. If only the pitch attitude is "
        "recorded, it replaces the state theta."
    )

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the aircraft exchanges speed and height (phugoid) and loses speed as in a climb "
                "of {attitude}, by its flight path or by drag beyond that of trim",
                "the aerodynamic moment that balances the engines changes with the airspeed; at "
                "trim its coefficient is {trim_moment}",
            ),
            short_name="phugoid",
            separating={"speed-variation": STEADY_FLIGHT, "sensor-drift": STEADY_FLIGHT},
            plausible={"trim_moment": PLAUSIBLE["trim_moment"]}
            if self.speed_recorded
            else {"attitude": (-STEEPEST_FLIGHT_PATH, STEEPEST_FLIGHT_PATH), **PLAUSIBLE},
            same_as={}
            if self.speed_recorded
            else {"attitude": ("speed-variation", LEAST_ATTITUDE_OF_SPEED_CHANGE)},
            never_beside=("speed-variation",),
            per_record=not self.speed_recorded,
            of_aircraft=()
            if self.speed_recorded
            else ("speed_damping", "induced_drag", "trim_moment"),
            background=True,
        )

    @property
    def states(self) -> tuple[Signal, ...]:
        speed = Signal(SPEED, "m/s", "airspeed above that at the record's begin")
        attitude = Signal(ATTITUDE, "rad", "pitch attitude above that at the record's begin")
        if self.speed_recorded:
            return ()
        return (speed,) if self.attitude_recorded else (speed, attitude)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        moment = Parameter("trim_moment", 0.0, "1", prior_std=0.02, bounds=(-0.5, 0.5))
        if self.speed_recorded:
            return (replace(moment, value=0.01),)
        return (
            Parameter("gravity", G0, "m/s2", free=False),
            Parameter("attitude", 0.03, "rad", bounds=(-0.6, 0.6)),
            Parameter("speed_damping", 0.01, "1/s", prior_std=0.01, bounds=(-0.3, 0.3)),
            Parameter("induced_drag", 5.0, "m/(s2 rad)", prior_std=6.0, bounds=(-60.0, 60.0)),
            moment,
        )

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType({"trim_moment" if self.speed_recorded else "gravity": 0.0})

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        change = s.airspeed_change if self.speed_recorded else getattr(s, SPEED)
        ratio = vehicle.airspeed / (vehicle.airspeed + change)
        moment = {"moment": p.trim_moment * (1.0 - ratio * ratio)}
        return (
            moment
            if self.speed_recorded
            else {"airspeed_change": change, "lift": weight_lift(change, vehicle), **moment}
        )

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        if self.speed_recorded:
            return ()
        theta = p.attitude + (s.theta if self.attitude_recorded else getattr(s, ATTITUDE))
        drag = (p.speed_damping * getattr(s, SPEED) + p.induced_drag * s.alpha) / G0
        rate = -p.gravity * (theta - s.alpha + drag)
        return (rate,) if self.attitude_recorded else (rate, s.q)

    def fitted_to(self, context: SearchContext) -> Phugoid:
        """Return the effect without the states that are inputs of the records."""
        return replace(
            self,
            attitude_recorded="theta" in context.input_peak,
            speed_recorded="airspeed_change" in context.input_peak,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe some attitudes, which are climbs and descents.

        The signature is the derivative of the outputs with respect to the attitude. The attitude
        zero is a probe, too, since level flight also exchanges speed and height.
        """
        start = {item.name: item.value for item in self.parameters}
        if self.speed_recorded:
            return (Probe(self.absent, ("trim_moment",)),)
        return tuple(
            Probe({**start, "attitude": attitude}, ("attitude",)) for attitude in TRIAL_ATTITUDES
        )


@dataclass(frozen=True)
class SpeedVariation(WithoutStates, ProbedAtAbsence):
    """Steady change of the airspeed: V(t) = V + ``rate`` (t - begin).

    V is the declared airspeed and ``rate`` is in m/s2. Dynamic pressure and non-dimensional rates
    follow the airspeed. On the low-order equivalent system the derivatives scale as those of an
    aircraft with constant coefficients: L_alpha, L_delta and M_q with V, M_alpha and M_delta with
    V^2.

    Attributes
    ----------
    begin : time at which the airspeed is V, s.
    weight : whether the lift that carries the weight follows the airspeed (``weight_lift``), with
        surfaces and attitude as trimmed at V. Otherwise the lift does not change: an unrecorded
        input keeps the aircraft in trim at every speed.
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
        "The airspeed changes steadily: V(t) = V + rate (t - begin). All forces are proportional "
        "to V^2 and the damping by rates to V. In an acceleration the short period becomes faster "
        "along the record, and the load factor per angle of attack increases. A model with one "
        "speed fits the middle of the record best, and its errors at the two ends have opposite "
        "signs. The lift that carries the weight also increases with V^2. Unless an unrecorded "
        "input keeps the aircraft in trim, nz and the angle of attack drift together, nz by "
        "(V(t)/V)^2 - 1. A measured airspeed settles the question. Without one, maneuvers both "
        "early and late in the record are needed. On the lateral model only pressure, damping and "
        "the turn under gravity change, and the Dutch roll becomes faster."
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

    def fitted_to(self, context: SearchContext) -> SpeedVariation:
        """Return the effect with the declared airspeed at the begin of the record."""
        return replace(self, begin=context.begin)


VARIANTS: tuple[Traceable, ...] = (Phugoid(), SpeedVariation(), SpeedVariation(weight=False))
