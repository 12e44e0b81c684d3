"""Flow that leaves the wing near stall and returns, both late: lift and moment with hysteresis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.maths import G0, clip, exp, real, sqrt, where

# of a1 (alpha - alpha_star), where the separated share is below rounding: there it is set to none
# at all
ATTACHED = -20.0
# share of the chord. The root of it has no slope at none; lift then is within 2 per cent of that of
# a free stream
LEAST_ATTACHED = 1e-4
# rad from zero lift. chosen: below eight degrees no wing's flow leaves its rear, and no search
# looks for it
NO_STALL_BELOW = 0.15
NEVER = 6.0  # rad, where alpha_star is beyond any flight
SHARES = (0.7, 0.85, 1.0)  # of the largest angle flown, that a search tries
TIMES, STEEPNESS, MOMENTS = (0.1, 0.5), (15.0, 40.0), (0.0, -0.1)  # s, 1/rad, 1


@dataclass(frozen=True)
class FlowSeparation:
    """tau1 X_dot + X = X0(alpha - tau2 alpha_dot), X0 = (1 - tanh(a1 (alpha - alpha_star)))/2; the
    state is 1 - X, none at a record's begin.

    X, from 0 to 1, is the point on the chord up to which the flow is attached (Goman and Khrabrov,
    Journal of Aircraft 31(5), 1994). In Kirchhoff's flow the wing has ((1 + sqrt X)/2)^2 of its
    attached lift; of the moment the field's form is proportional to 1 - X, and so that of the drag:
    CL += (((1 + sqrt X)/2)^2 - 1) CL_wing, Cm += ``moment`` (1 - X), CD += ``drag`` (1 - X)
    (Fischenberg, AIAA 95-3438, 1995; Singh and Jategaonkar, Journal of Aircraft 33(2), 1996;
    Jategaonkar, Flight Vehicle System Identification, ch. 12). ``tau1``, ``tau2`` in s, ``a1`` in
    1/rad, ``alpha_star`` in rad as the model counts alpha, the gust included.

    CL_wing is the declared lift without that of pitch rate and elevator. Of equations about a trim
    it is the lift that carries the weight in level flight and CL_alpha alpha; of totals CL_0 + CL_V
    V/V0 + CL_alpha alpha.

    Attributes
    ----------
    total : whether the equations count totals. ports : that it loads; the names of ``moment`` and
    ``drag`` among the parameters.
    """

    total: bool = False

    name: ClassVar[str] = "flow-separation"
    station: ClassVar[Station] = Station.DYNAMICS
    rates_read: ClassVar[tuple[str, ...]] = ("alpha",)
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ("moment-nonlinearity", "lift-nonlinearity")
    states: ClassVar[tuple[Signal, ...]] = (
        Signal("separated_flow", "1", "share of the chord behind the point of separation"),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"alpha_star": NEVER})
    explanation: ClassVar[str] = (
        "Near stall the flow leaves the rear of the wing. The point X on the chord up to which it "
        "is attached follows the angle of attack late: "
        "tau1 X_dot + X = X0(alpha - tau2 alpha_dot) with X0 = (1 - tanh(a1 (alpha - "
        "alpha_star)))/2. The wing keeps ((1 + sqrt X)/2)^2 of its "
        "lift, the moment changes by moment (1 - X) and where drag is modelled it grows by drag (1 "
        "- X). Going up the lift overshoots, coming "
        "down it returns late: a loop of hysteresis over the angle of attack, which no curve has. "
        "A flight that stays well below alpha_star "
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
            Parameter("alpha_star", 0.1, "rad", bounds=(-1.0, NEVER)),
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
        # (1 + tanh z)/2 is this logistic function, whose exponential stays within range between the
        # two limits.
        share = 1.0 / (1.0 + exp(-2.0 * clip(beyond, ATTACHED, -ATTACHED)))
        return ((where(real(beyond) <= ATTACHED, 0.0, share) - s.separated_flow) / p.tau1,)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Whole changes over a grid about the largest angle flown; none where no wing would stall
        there.
        """
        flown = context.flown_range("alpha")
        if (
            flown is None
            or flown[1] <= 0.0
            or flown[1] + self._from_zero_lift(context.values) < NO_STALL_BELOW
        ):
            return ()
        start = {item.name: item.value for item in self.parameters}
        grid = product(SHARES, TIMES, STEEPNESS, MOMENTS)
        return tuple(
            Probe(
                {
                    **start,
                    "alpha_star": share * flown[1],
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
        """Angle (rad) from zero lift to where the model counts alpha from; so large that it forbids
        nothing where that is not known.
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
    """Lift coefficient of level flight."""
    return 2.0 * mass * G0 / (density * airspeed * airspeed * wing_area)


VARIANTS: tuple[Traceable, ...] = (FlowSeparation(), FlowSeparation(total=True))
