"""Nonlinear control effectiveness: a smooth curve, and two base forms of it, with different slopes
to both sides or less effect at large deflections.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import (
    LATERAL_CONTROLS,
    SHARES,
    LateralControl,
    NonlinearControl,
    all_labelled,
    labelled,
    of_all_controls,
)
from sim.maths import combine, natural_shapes, shape_names, sqrt


@dataclass(frozen=True)
class ControlNonlinearity:
    """Nonlinear control effectiveness: a deflection d acts as d + f(d).

    f is a natural cubic spline over ``[low, high]`` with f(0) = f'(0) = 0. moment += moment_by
    f(d), lift += ``lift_share`` lift_by f(d), with the vehicle's derivatives by the control. f =
    sum of ``shape1`` ... times orthonormal shapes (`sim.maths`); each parameter is the root mean
    square deflection that its shape adds over the range, in the unit of the control. ``lift_share``
    is one if lift and moment come from one force on the surface, and zero if only the moment is
    nonlinear; it has no effect while f is zero.

    Attributes
    ----------
    low, high : range of the deflections in the record.
    fine : use nine shapes instead of four; the first four are the same.
    control, unit, size : signal of the control, its unit, and a usual size.
    moment_by, lift_by : names of its derivatives.
    share_free : whether ``lift_share`` is estimated; it is not for a control with hardly any lift.
    by : fixed factors of f in place of the derivatives moment_by and lift_by; if empty, these. With
        an input of a few levels, f and the derivative compensate each other. A fixed factor makes
        this a linear relation, which a Gaussian can describe.
    ports : ports of the moment and of the lift.
    further : further ports, each with its derivative by the control.
    label : suffix of the effect's name, where the vehicle has several controls.
    speed : name of the constant that is the declared airspeed. With a ``reference_airspeed``
        deflections are totals, and f counts from ``middle``, the middle of the range.
    """

    low: float = -0.1
    high: float = 0.1
    fine: bool = False
    control: str = "elevator"
    unit: str = "rad"
    size: float = 0.01
    moment_by: str = "Cm_de"
    lift_by: str = "CL_de"
    share_free: bool = True
    by: tuple[float, ...] = ()
    ports: tuple[str, str] = ("moment", "lift")
    further: tuple[tuple[str, str], ...] = ()
    label: str = ""
    speed: str = "airspeed"
    middle: float = 0.0

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    states: ClassVar[tuple[Signal, ...]] = ()

    @property
    def explanation(self) -> str:
        moment, lift = (name.partition("_")[0] for name in (self.moment_by, self.lift_by))
        return (
            "The surface works more or less at large deflections than its derivative at zero "
            "tells: the flow separates, a gap opens, up and down "
            f"differ. {moment} = ... + {self.moment_by} (d + f(d)) for a deflection d, {lift} = "
            f"... + {self.lift_by} (d + lift_share f(d)), f a "
            "smooth curve (natural cubic spline, four shapes) over the range used with no value "
            "and no slope at zero. An input of a few fixed levels shows it at these levels only, "
            "and there it cannot be told from a surface that reaches its stops or from break-out; "
            "a multisine can."
        )

    @property
    def name(self) -> str:
        return labelled("control-nonlinearity", self.label)

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("actuator-saturation", "input-deadband"), self.label)

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.ports, *(port for port, _ in self.further))

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (*self._derivatives, self.speed)

    @property
    def _derivatives(self) -> tuple[str, ...]:
        return (self.moment_by, self.lift_by, *(derivative for _, derivative in self.further))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        # The prior regularises shapes outside the range: none adds more than the deflection itself.
        widest = max(abs(self.low - self.middle), abs(self.high - self.middle))
        shapes = tuple(
            Parameter(name, -self.size / (1.0 + i), self.unit, prior_std=widest / (1.0 + i))
            for i, name in enumerate(shape_names(self.fine))
        )
        return (
            *shapes,
            Parameter(
                "lift_share", 1.0, "1", prior_std=1.0, bounds=(-10.0, 10.0), free=self.share_free
            ),
        )

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(shape_names(self.fine), 0.0))

    @property
    def traits(self) -> Traits:
        widest = max(abs(self.low - self.middle), abs(self.high - self.middle))
        return Traits(
            sentences=(
                "the {control} works unequally to both sides, by {unevenness_change} about the "
                "mean (unevenness {unevenness})",
                "the effect of the {control} is not in proportion to its deflection",
            ),
            short_name="curved control",
            plausible=dict.fromkeys(shape_names(self.fine), (-widest, widest))
            | {"lift_share": (-3.0, 5.0)},
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        at, low, high = getattr(s, self.control), self.low, self.high
        if self.middle:
            at, low, high = at - self.middle, low - self.middle, high - self.middle
        more = combine(natural_shapes(low, high, self.fine), at, p[:-1])
        moment, lift, *others = self.by or [getattr(vehicle, name) for name in self._derivatives]
        added = {self.ports[0]: moment * more, self.ports[1]: p.lift_share * lift * more}
        return {
            **added,
            **{port: other * more for (port, _), other in zip(self.further, others, strict=True)},
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> ControlNonlinearity:
        """Return the effect over the deflections of the record, sized by the present derivatives.

        The range of a pseudo-control is that of the stick.
        """
        low, high = (
            context.flown_range(self.control)
            or context.flown_range("stick")
            or (self.low, self.high)
        )
        by = tuple(context.values.get(name, 0.0) for name in self._derivatives)
        middle = 0.0 if self.speed == "airspeed" else 0.5 * (low + high)
        return replace(self, low=low, high=high, middle=middle, by=by if by[0] != 0.0 else ())

    def finer(self) -> ControlNonlinearity:
        """Return the refined form, with five more shapes."""
        return replace(self, fine=True)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the slopes by all shapes at absence, with lift and moment from one force."""
        return (Probe({**self.absent, "lift_share": 1.0}, shape_names(self.fine)),)


def _lateral(c: LateralControl) -> ControlNonlinearity:
    return ControlNonlinearity(
        control=c.control,
        moment_by=c.moment_by,
        lift_by=c.lift_by,
        share_free=False,
        ports=c.ports,
        further=c.further,
        label=c.control,
    )


# Forms with one parameter, `ControlUnevenness` and `ControlWeakening`, have the same name.
CURVE_VARIANTS: tuple[Traceable, ...] = (
    ControlNonlinearity(),
    ControlNonlinearity(
        low=-1.0,
        high=1.0,
        control="delta",
        unit="1",
        size=0.1,
        moment_by="M_delta",
        lift_by="L_delta",
        share_free=False,
    ),
    *map(_lateral, LATERAL_CONTROLS),
    ControlNonlinearity(label="elevator", speed="reference_airspeed"),
)


# Width of the rounded kink, relative to the largest deflection; without it there were no slope.
KINK_WIDTH_SHARE = 0.001


@dataclass(frozen=True)
class ControlUnevenness(NonlinearControl):
    """Uneven control effectiveness: a deflection d acts as d + ``unevenness`` |d|.

    The slope is 1 + unevenness on the positive side and 1 - unevenness on the other, so that the
    vehicle's derivatives are the means of both sides. |d| is computed as sqrt(d^2 + w^2) - w, where
    w is ``width``, that of the rounded kink, in the unit of the control.
    """

    width: float = 0.00005

    aliases: ClassVar[tuple[str, ...]] = ()
    bend: ClassVar[Parameter] = Parameter("unevenness", 0.2, "1", bounds=(-1.0, 1.0))
    traits: ClassVar[Traits] = Traits(
        sentences=(
            "the {control} works unequally to both sides, by {unevenness_change} about the mean "
            "(unevenness {unevenness})",
        ),
        short_name="uneven control",
        plausible={"unevenness": (-0.7, 0.7), **SHARES},
    )

    @property
    def explanation(self) -> str:
        moment = self.moment_by.partition("_")[0]
        return (
            f"The surface works more to one side than to the other: {moment} = ... + "
            f"{self.moment_by} (d + unevenness |d|) for a deflection d from "
            "trim, its other coefficients likewise. A tail near its stall, a gap that one side "
            "opens, or an actuator with two gains do this. The derivative is then the mean of both "
            "sides, and a model with one slope errs with the same sign for up and down: after a "
            "doublet it ends at another attitude than the aircraft. An input to one side alone "
            "only shows another derivative; it takes steps to both."
        )

    def curve(self, d: Any, p: Any) -> Any:
        return p.unevenness * (sqrt(d * d + self.width * self.width) - self.width)

    def fitted_to(self, context: SearchContext) -> ControlUnevenness:
        """Return the effect with a kink as narrow as the deflections of the record require."""
        widest, middle = self.used(context)
        return replace(self, width=KINK_WIDTH_SHARE * widest or self.width, middle=middle)


UNEVENNESS_VARIANTS: tuple[Traceable, ...] = of_all_controls(ControlUnevenness, width=0.0005)


@dataclass(frozen=True)
class ControlWeakening(NonlinearControl):
    """Control effectiveness that falls with deflection: d acts as d - ``loss`` d (d/D)^2.

    D is ``widest``, the largest deflection in the record, in the unit of the control. At D the
    surface has lost the share ``loss`` of its effect; a negative loss is a gain. The vehicle's
    derivatives are those at zero.
    """

    widest: float = 0.1

    bend: ClassVar[Parameter] = Parameter("loss", 0.2, "1", bounds=(-3.0, 1.0))
    traits: ClassVar[Traits] = Traits(
        sentences=(
            "the {control} loses the share {loss} of its effect towards its largest deflection",
        ),
        short_name="weakening control",
        plausible={"loss": (-0.7, 0.7), **SHARES},
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(("actuator-saturation", "input-deadband"), self.label)

    @property
    def explanation(self) -> str:
        moment = self.moment_by.partition("_")[0]
        return (
            "Each further degree of the surface turns the flow by less, to both sides alike: "
            f"{moment} = ... + {self.moment_by} (d - loss d (d/D)^2) "
            "for a deflection d, D the largest that was used, its other coefficients likewise. A "
            "gap that opens and flow that begins to separate do this. Under an input of a few "
            "fixed levels a surface that reaches its stops looks the same; a multisine tells."
        )

    def curve(self, d: Any, p: Any) -> Any:
        return -p.loss * d * (d / self.widest) ** 2

    def fitted_to(self, context: SearchContext) -> ControlWeakening:
        """Return the effect with the largest deflection of the record."""
        widest, middle = self.used(context)
        return replace(self, widest=widest or self.widest, middle=middle)


WEAKENING_VARIANTS: tuple[Traceable, ...] = of_all_controls(ControlWeakening, widest=1.0)


VARIANTS: tuple[Traceable, ...] = (*CURVE_VARIANTS, *UNEVENNESS_VARIANTS, *WEAKENING_VARIANTS)
