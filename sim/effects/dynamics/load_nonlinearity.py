"""Nonlinear forces and moments over the angle of attack or sideslip, one effect for each axis; and
flow separation near stall with hysteresis of lift and moment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.loads import LoadCurve
from sim.maths import G0, clip, exp, real, sqrt, where

# ---- Smooth curves over an angle of the flow


def _explained(load: str, angle: str, slope: str, cause: str, shown: str) -> str:
    """Return the explanation of a curve of a load.

    Parameters
    ----------
    load : the load in words.
    angle : signal of the angle.
    slope : name of the derivative of the load by the angle.
    cause : sentence about the cause.
    shown : sentences about what a record shows.
    """
    coefficient = slope.partition("_")[0]
    return (
        f"Nonlinear {load}: it is not linear in the angle of "
        f"{'attack' if angle == 'alpha' else 'sideslip'}. {cause} {coefficient} += f({angle}), "
        "where f is a smooth curve (natural cubic spline, four shapes) over the range flown. f is "
        f"zero with zero slope in trim, so that {slope} stays the slope there. {shown}"
    )


DRAG_NONLINEARITY = LoadCurve(
    port="drag",
    name="drag-nonlinearity",
    load="the drag",
    short_name="curved drag",
    explanation=(
        "Nonlinear drag: it is not linear in the angle of attack. The straight line CD = CD_0 + "
        "CD_alpha alpha neglects that a drag polar is at least a parabola of the lift. CD += "
        "f(alpha), where f is a smooth curve (natural cubic spline, four shapes) over the range "
        "flown. f is zero with zero slope in the middle of the range, so that CD_0 and CD_alpha "
        "are the tangent there. The axial load factor shows the curve at once, the airspeed over "
        "seconds, and the rates hardly."
    ),
    unit="1",
    size=0.01,
    needs_constants=("CD_alpha",),
    total=True,
)
LIFT_NONLINEARITY = LoadCurve(
    port="lift",
    name="lift-nonlinearity",
    load="the lift",
    short_name="curved lift",
    explanation=_explained(
        "lift",
        "alpha",
        "CL_alpha",
        "Near flow separation the lift grows more slowly, with vortices faster.",
        "The load factor shows the curve at once, the flight path later, and the pitch rate "
        "hardly: the residual of nz depends on alpha alone. Without nz the curve must be "
        "distinguished from the damping of the short period, which a record rarely allows.",
    ),
    unit="1",
    size=0.02,
    needs_constants=("CL_alpha", "airspeed"),
)
MOMENT_NONLINEARITY = LoadCurve(
    port="moment",
    name="moment-nonlinearity",
    load="the pitching moment",
    short_name="curved pitching moment",
    explanation=_explained(
        "pitching moment",
        "alpha",
        "Cm_alpha",
        "At larger angles the static stability of the aircraft increases or decreases, or it "
        "pitches up.",
        "Small maneuvers do not show the curve. In large ones the frequency of the short period "
        "changes with the size of the motion, and the residual of the pitch rate depends on alpha, "
        "not on time.",
    ),
    unit="1",
    size=0.01,
    needs_constants=("Cm_alpha", "airspeed"),
)
ROLL_NONLINEARITY = LoadCurve(
    port="roll",
    name="roll-nonlinearity",
    load="the rolling moment",
    short_name="curved rolling moment",
    explanation=_explained(
        "rolling moment",
        "beta",
        "Cl_beta",
        "The dihedral effect grows or fades with sideslip, as for a swept wing near stall or a "
        "wing in the wake of the fuselage.",
        "The residual of the roll rate depends on sideslip, not on time. Small maneuvers do not "
        "show the curve.",
    ),
    unit="1",
    size=0.002,
    needs_constants=("Cl_beta",),
    angle="beta_air",
    flown="beta",
)
SIDE_FORCE_NONLINEARITY = LoadCurve(
    port="side_force",
    name="side-force-nonlinearity",
    load="the side force",
    short_name="curved side force",
    explanation=_explained(
        "side force",
        "beta",
        "CY_beta",
        "At larger sideslip the forces of fin and fuselage are not in proportion to it.",
        "The lateral load factor shows the curve at once, sideslip later, and the rates hardly.",
    ),
    unit="1",
    size=0.01,
    needs_constants=("CY_beta",),
    angle="beta_air",
    flown="beta",
)
YAW_NONLINEARITY = LoadCurve(
    port="yaw",
    name="yaw-nonlinearity",
    load="the yawing moment",
    short_name="curved yawing moment",
    explanation=_explained(
        "yawing moment",
        "beta",
        "Cn_beta",
        "At larger sideslip the fin stalls, or is in the wake of the fuselage.",
        "The frequency of the Dutch roll then changes with its size, and the residual of the yaw "
        "rate depends on sideslip, not on time. Small maneuvers do not show the curve.",
    ),
    unit="1",
    size=0.002,
    needs_constants=("Cn_beta",),
    angle="beta_air",
    flown="beta",
)


def _of_loes(curve: LoadCurve, unit: str, size: float, constant: str) -> LoadCurve:
    """Return the curve on the low-order equivalent system."""
    return replace(curve, low=-0.04, high=0.04, unit=unit, size=size, needs_constants=(constant,))


CURVE_VARIANTS: tuple[Traceable, ...] = (
    DRAG_NONLINEARITY,
    LIFT_NONLINEARITY,
    _of_loes(LIFT_NONLINEARITY, "1/s", 0.02, "L_alpha"),
    replace(LIFT_NONLINEARITY, total=True, needs_constants=("CL_alpha", "reference_airspeed")),
    MOMENT_NONLINEARITY,
    _of_loes(MOMENT_NONLINEARITY, "1/s2", 0.1, "M_alpha"),
    replace(MOMENT_NONLINEARITY, total=True, needs_constants=("Cm_alpha", "reference_airspeed")),
    ROLL_NONLINEARITY,
    SIDE_FORCE_NONLINEARITY,
    YAW_NONLINEARITY,
)


# ---- Flow separation near stall

# a1 (alpha - alpha_star) below which the separated share, then less than rounding, is set to zero.
ATTACHED_FLOW_EXPONENT = -20.0
# Smallest attached share of the chord; at zero its square root has no slope. The lift is then
# within 2 per cent of that of fully separated flow.
LEAST_ATTACHED = 1e-4
NO_STALL_BELOW = 0.15  # rad from zero lift (8 deg, chosen); no stall is searched below
UNREACHED_ALPHA = 6.0  # rad, value of alpha_star that no flight reaches
SLOW_AND_QUICK_STALL = (
    "the stall approached slowly and then quickly: a curve is flown through alike, separation lags"
)
# Trial values.
ALPHA_STAR_SHARES = (0.7, 0.85, 1.0)  # of alpha_star, relative to the largest angle flown
TAU1 = (0.1, 0.5)  # s
A1 = (15.0, 40.0)  # 1/rad
MOMENTS = (0.0, -0.1)


@dataclass(frozen=True)
class FlowSeparation:
    """Flow separation near stall: tau1 X_dot + X = X0(alpha - tau2 alpha_dot), X0 = (1 - tanh(a1
    (alpha - alpha_star)))/2.

    X, from 0 to 1, is the point on the chord up to which the flow is attached (Goman and Khrabrov,
    Journal of Aircraft 31(5), 1994). The state is 1 - X, which is zero at the begin of a record. In
    Kirchhoff's flow the wing has ((1 + sqrt X)/2)^2 of its attached lift. Changes of moment and
    drag are usually taken as proportional to 1 - X: CL += (((1 + sqrt X)/2)^2 - 1) CL_wing, Cm +=
    ``moment`` (1 - X), CD += ``drag`` (1 - X) (Fischenberg, AIAA 95-3438, 1995; Singh and
    Jategaonkar, Journal of Aircraft 33(2), 1996; Jategaonkar, Flight Vehicle System Identification,
    ch. 12). ``tau1`` and ``tau2`` are in s, ``a1`` in 1/rad, ``alpha_star`` in rad. alpha is that
    of the model, including the gust.

    CL_wing is the declared lift without the contributions of pitch rate and elevator. In equations
    about a trim it is the lift that carries the weight in level flight plus CL_alpha alpha. In
    equations of totals it is CL_0 + CL_V V/V0 + CL_alpha alpha.

    Attributes
    ----------
    total : whether the signals of the equations are totals.
    """

    total: bool = False

    name: ClassVar[str] = "flow-separation"
    station: ClassVar[Station] = Station.DYNAMICS
    rates_read: ClassVar[tuple[str, ...]] = ("alpha",)
    regularity: ClassVar[Regularity] = Regularity.UNIDENTIFIED_AT_ABSENCE
    aliases: ClassVar[tuple[str, ...]] = ("moment-nonlinearity", "lift-nonlinearity")
    states: ClassVar[tuple[Signal, ...]] = (
        Signal("separated_flow", "1", "share of the chord behind the point of separation"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"alpha_star": UNREACHED_ALPHA})
    explanation: ClassVar[str] = (
        "The flow separates near stall. It leaves the rear of the wing first. The point X on the "
        "chord up to which it is attached follows the angle of attack late: tau1 X_dot + X = "
        "X0(alpha - tau2 alpha_dot) with X0 = (1 - tanh(a1 (alpha - alpha_star)))/2. The wing "
        "keeps ((1 + sqrt X)/2)^2 of its lift, and the moment changes by moment (1 - X). Where "
        "drag is modelled, it increases by drag (1 - X). The lift overshoots while the angle of "
        "attack increases and recovers late while it decreases. This hysteresis loop over the "
        "angle of attack distinguishes separation from a nonlinear curve. A flight that stays well "
        "below alpha_star does not show the effect. A slow approach to the stall shows the curve, "
        "alpha_star and a1; only a quick approach and a quick recovery show the time constants."
    )

    @property
    def ports(self) -> tuple[str, ...]:
        return ("lift", "moment", "drag") if self.total else ("lift", "moment")

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (
            ("CL_0", "CL_alpha", "CL_V", "reference_airspeed")
            if self.total
            else ("CL_alpha", "mass", "wing_area", "airspeed", "air_density")
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        common = (
            Parameter("tau1", 0.2, "s", bounds=(0.01, 10.0)),
            Parameter("tau2", 0.05, "s", bounds=(-5.0, 5.0)),
            Parameter("a1", 25.0, "1/rad", bounds=(5.0, 300.0)),
            Parameter("alpha_star", 0.1, "rad", bounds=(-1.0, UNREACHED_ALPHA)),
            Parameter("moment", -0.05, "1"),
        )
        return (*common, Parameter("drag", 0.05, "1")) if self.total else common

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the flow leaves the wing near {alpha_star} and follows the angle of attack late, "
                "by {tau1}",
            ),
            short_name="flow separation",
            separating=dict.fromkeys(
                ("moment-nonlinearity", "lift-nonlinearity"), SLOW_AND_QUICK_STALL
            ),
            plausible={
                "tau1": (0.01, 5.0),
                "tau2": (-2.0, 2.0),
                "alpha_star": (0.0, 0.8),
                "moment": (-0.5, 0.5),
            },
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        root = sqrt(clip(1.0 - s.separated_flow, LEAST_ATTACHED, 1.0))
        kept = 0.25 * (1.0 + root) * (1.0 + root)
        loads = {
            "lift": (kept - 1.0) * self._attached_lift(s, vehicle),
            "moment": p.moment * s.separated_flow,
        }
        return {**loads, "drag": p.drag * s.separated_flow} if self.total else loads

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        beyond = p.a1 * (s.alpha_air - p.tau2 * s.alpha_dot - p.alpha_star)
        # (1 + tanh z)/2 as a logistic function; within the limits its exponential cannot overflow.
        share = 1.0 / (
            1.0 + exp(-2.0 * clip(beyond, ATTACHED_FLOW_EXPONENT, -ATTACHED_FLOW_EXPONENT))
        )
        return (
            (where(real(beyond) <= ATTACHED_FLOW_EXPONENT, 0.0, share) - s.separated_flow) / p.tau1,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe a grid of values about the largest angle of attack; none if no wing would stall
        there.
        """
        _, largest = context.flown_range("alpha") or (0.0, 0.0)
        if largest <= 0.0 or largest + self._from_zero_lift(context.values) < NO_STALL_BELOW:
            return ()
        start = {item.name: item.value for item in self.parameters}
        return tuple(
            Probe(
                {**start, "alpha_star": share * largest, "tau1": tau1, "a1": a1, "moment": moment}
            )
            for share, tau1, a1, moment in product(ALPHA_STAR_SHARES, TAU1, A1, MOMENTS)
        )

    def _attached_lift(self, s: Any, vehicle: Any) -> Any:
        """Return CL_wing, the lift coefficient of the wing in attached flow."""
        if self.total:
            return vehicle.CL_0 + vehicle.CL_V * s.V_ratio + vehicle.CL_alpha * s.alpha_air
        weight = (vehicle.mass, vehicle.wing_area, vehicle.airspeed, vehicle.air_density)
        return _level_flight_lift(*weight) + vehicle.CL_alpha * s.alpha_air

    def _from_zero_lift(self, values: Mapping[str, float]) -> float:
        """Return the angle of attack from zero lift to alpha = 0, rad.

        If it is unknown, an angle is returned for which a stall is searched.
        """
        if not set(self.needs_constants) <= set(values) or values["CL_alpha"] <= 0.0:
            return NO_STALL_BELOW
        if self.total:
            return (values["CL_0"] + values["CL_V"]) / values["CL_alpha"]
        weight = (values[name] for name in ("mass", "wing_area", "airspeed", "air_density"))
        return float(_level_flight_lift(*weight) / values["CL_alpha"])


def _level_flight_lift(mass: Any, wing_area: Any, airspeed: Any, density: Any) -> Any:
    """Return the lift coefficient of level flight."""
    return 2.0 * mass * G0 / (density * airspeed * airspeed * wing_area)


VARIANTS: tuple[Traceable, ...] = (
    *CURVE_VARIANTS,
    FlowSeparation(),
    FlowSeparation(total=True),
)
