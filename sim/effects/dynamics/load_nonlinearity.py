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

DRAG_EXPLANATION = (
    "The drag bends away from the straight line CD = CD_0 + CD_alpha alpha: a polar is a parabola "
    "of the lift at least. CD += f(alpha), a smooth curve (natural cubic spline, four shapes) over "
    "the range flown that is zero with zero slope in its middle, so that CD_0 and CD_alpha are the "
    "tangent there. The axial load factor shows it at once, the airspeed over seconds, the rates "
    "hardly."
)
DRAG_NONLINEARITY = LoadCurve(
    "drag",
    "drag-nonlinearity",
    "the drag",
    "curved drag",
    DRAG_EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("CD_alpha",),
    total=True,
)


LIFT_EXPLANATION = (
    "The lift bends away from the straight line CL = CL_alpha alpha: near separation it falls "
    "short, with vortices it grows faster. CL += f(alpha), a smooth curve (natural cubic spline, "
    "four shapes) over the range flown that is zero with zero slope in trim, so that CL_alpha "
    "stays the slope there. The load factor shows it at once, the path later, the pitch rate "
    "hardly: what is left over in nz depends on alpha alone. Without nz it must be told from the "
    "damping of the short period, and a record rarely can."
)
LIFT_NONLINEARITY = LoadCurve(
    port="lift",
    name="lift-nonlinearity",
    load="the lift",
    short_name="curved lift",
    explanation=LIFT_EXPLANATION,
    unit="1",
    size=0.02,
    needs_constants=("CL_alpha", "airspeed"),
)


MOMENT_EXPLANATION = (
    "The pitching moment bends away from the straight line Cm = Cm_alpha alpha: at larger angles "
    "the aircraft grows stiffer, loses stability or pitches up. Cm += f(alpha), a smooth curve "
    "(natural cubic spline, four shapes) over the range flown that is zero with zero slope in "
    "trim, so that Cm_alpha stays the slope there. Small maneuvers show nothing; the frequency of "
    "the short period changes with the size of the motion, and the residual of the pitch rate "
    "depends on alpha, not on time."
)
MOMENT_NONLINEARITY = LoadCurve(
    "moment",
    "moment-nonlinearity",
    "the pitching moment",
    "curved pitching moment",
    MOMENT_EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("Cm_alpha", "airspeed"),
)


ROLL_EXPLANATION = (
    "The rolling moment bends away from the straight line Cl = Cl_beta beta: the dihedral effect "
    "grows or fades with sideslip, as of a swept wing near stall or a wing in the wake of the "
    "fuselage. Cl += f(beta), a smooth curve (natural cubic spline, four shapes) over the range "
    "flown that is zero with zero slope in trim, so that Cl_beta stays the slope there. What is "
    "left in the roll rate depends on sideslip, not on time; small maneuvers show nothing."
)
ROLL_NONLINEARITY = LoadCurve(
    "roll",
    "roll-nonlinearity",
    "the rolling moment",
    "curved rolling moment",
    ROLL_EXPLANATION,
    unit="1",
    size=0.002,
    needs_constants=("Cl_beta",),
    angle="beta_air",
    flown="beta",
)


SIDE_FORCE_EXPLANATION = (
    "The side force bends away from the straight line CY = CY_beta beta: fin and fuselage at "
    "larger sideslip do not carry in proportion. CY += f(beta), a smooth curve (natural cubic "
    "spline, four shapes) over the range flown that is zero with zero slope in trim, so that "
    "CY_beta stays the slope there. The lateral load factor shows it at once, sideslip later, the "
    "rates hardly."
)
SIDE_FORCE_NONLINEARITY = LoadCurve(
    "side_force",
    "side-force-nonlinearity",
    "the side force",
    "curved side force",
    SIDE_FORCE_EXPLANATION,
    unit="1",
    size=0.01,
    needs_constants=("CY_beta",),
    angle="beta_air",
    flown="beta",
)


YAW_EXPLANATION = (
    "The yawing moment bends away from the straight line Cn = Cn_beta beta: at larger sideslip the "
    "fin stalls, or the fuselage takes its air. Cn += f(beta), a smooth curve (natural cubic "
    "spline, four shapes) over the range flown that is zero with zero slope in trim, so that "
    "Cn_beta stays the slope there. The frequency of the Dutch roll then changes with its size, "
    "and what is left in the yaw rate depends on sideslip, not on time. Small maneuvers show "
    "nothing."
)
YAW_NONLINEARITY = LoadCurve(
    "yaw",
    "yaw-nonlinearity",
    "the yawing moment",
    "curved yawing moment",
    YAW_EXPLANATION,
    unit="1",
    size=0.002,
    needs_constants=("Cn_beta",),
    angle="beta_air",
    flown="beta",
)


CURVE_VARIANTS: tuple[Traceable, ...] = (
    DRAG_NONLINEARITY,
    LIFT_NONLINEARITY,
    replace(
        LIFT_NONLINEARITY, low=-0.04, high=0.04, unit="1/s", size=0.02, needs_constants=("L_alpha",)
    ),
    replace(LIFT_NONLINEARITY, total=True, needs_constants=("CL_alpha", "reference_airspeed")),
    MOMENT_NONLINEARITY,
    replace(
        MOMENT_NONLINEARITY,
        low=-0.04,
        high=0.04,
        unit="1/s2",
        size=0.1,
        needs_constants=("M_alpha",),
    ),
    replace(MOMENT_NONLINEARITY, total=True, needs_constants=("Cm_alpha", "reference_airspeed")),
    ROLL_NONLINEARITY,
    SIDE_FORCE_NONLINEARITY,
    YAW_NONLINEARITY,
)


# a1 (alpha - alpha_star) below which the separated share, then less than rounding, is set to zero.
ATTACHED_FLOW_EXPONENT = -20.0
# Smallest attached share of the chord, since its root has no slope at zero. The lift is then within
# 2 per cent of that of fully separated flow.
LEAST_ATTACHED = 1e-4
NO_STALL_BELOW = 0.15  # rad from zero lift (8 deg, chosen); no stall is searched below
UNREACHED_ALPHA = 6.0  # rad, value of alpha_star that no flight reaches
SHARES = (0.7, 0.85, 1.0)  # trial values, relative to the largest angle flown
TIMES = (0.1, 0.5)  # s, time constants that are probed
STEEPNESS = (15.0, 40.0)  # 1/rad, slopes of the separation point that are probed
MOMENTS = (0.0, -0.1)  # moment coefficients by separation that are probed


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
    ch. 12). ``tau1`` and ``tau2`` are in s, ``a1`` in 1/rad, ``alpha_star`` in rad; alpha is that
    of the model, the gust included.

    CL_wing is the declared lift without that of pitch rate and elevator. In equations about a trim
    it is the lift that carries the weight in level flight plus CL_alpha alpha; in equations of
    totals it is CL_0 + CL_V V/V0 + CL_alpha alpha.

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
        "Near stall the flow leaves the rear of the wing. The point X on the chord up to which it "
        "is attached follows the angle of attack late: tau1 X_dot + X = X0(alpha - tau2 alpha_dot) "
        "with X0 = (1 - tanh(a1 (alpha - alpha_star)))/2. The wing keeps ((1 + sqrt X)/2)^2 of its "
        "lift, the moment changes by moment (1 - X) and where drag is modelled it grows by drag (1 "
        "- X). Going up the lift overshoots, coming down it returns late: a loop of hysteresis "
        "over the angle of attack, which no curve has. A flight that stays well below alpha_star "
        "shows nothing. A slow approach to the stall shows the curve, alpha_star and a1; only a "
        "quick one, and a quick recovery, show the times."
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
            separating={
                "moment-nonlinearity": (
                    "the stall approached slowly and then quickly: a curve is flown through alike, "
                    "separation lags"
                ),
                "lift-nonlinearity": (
                    "the stall approached slowly and then quickly: a curve is flown through alike, "
                    "separation lags"
                ),
            },
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
        """Probe a grid of values about the largest angle; nothing if no wing would stall there."""
        recorded_range = context.flown_range("alpha")
        if (
            recorded_range is None
            or recorded_range[1] <= 0.0
            or recorded_range[1] + self._from_zero_lift(context.values) < NO_STALL_BELOW
        ):
            return ()
        start = {item.name: item.value for item in self.parameters}
        grid = product(SHARES, TIMES, STEEPNESS, MOMENTS)
        return tuple(
            Probe(
                {
                    **start,
                    "alpha_star": share * recorded_range[1],
                    "tau1": time,
                    "a1": steepness,
                    "moment": moment,
                }
            )
            for share, time, steepness, moment in grid
        )

    def _attached_lift(self, s: Any, vehicle: Any) -> Any:
        if self.total:
            return vehicle.CL_0 + vehicle.CL_V * s.V_ratio + vehicle.CL_alpha * s.alpha_air
        return (
            _weight_lift(vehicle.mass, vehicle.wing_area, vehicle.airspeed, vehicle.air_density)
            + vehicle.CL_alpha * s.alpha_air
        )

    def _from_zero_lift(self, values: Mapping[str, float]) -> float:
        """Return the angle from zero lift to the zero of alpha, rad; if it is unknown, an angle for
        which a stall is searched.
        """
        if not set(self.needs_constants) <= set(values) or values["CL_alpha"] <= 0.0:
            return NO_STALL_BELOW
        if self.total:
            return (values["CL_0"] + values["CL_V"]) / values["CL_alpha"]
        return (
            _weight_lift(
                *(values[name] for name in ("mass", "wing_area", "airspeed", "air_density"))
            )
            / values["CL_alpha"]
        )


def _weight_lift(mass: Any, wing_area: Any, airspeed: Any, density: Any) -> Any:
    """Return the lift coefficient of level flight."""
    return 2.0 * mass * G0 / (density * airspeed * airspeed * wing_area)


SEPARATION_VARIANTS: tuple[Traceable, ...] = (FlowSeparation(), FlowSeparation(total=True))


VARIANTS: tuple[Traceable, ...] = (*CURVE_VARIANTS, *SEPARATION_VARIANTS)
