"""Nonlinear control effectiveness: a smooth curve, and two forms of it with one parameter. In one
form the slope differs between the two sides; in the other the effect falls at large deflections.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, TypeVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import WithoutStates, all_labelled, labelled
from sim.maths import combine, natural_shapes, shape_names, sqrt

# ---- Common part of the three forms

LOOK_ALIKE = ("actuator-saturation", "input-deadband")  # on inputs of a few fixed levels
PLAUSIBLE_SHARE = {"lift_share": (-3.0, 5.0)}


@dataclass(frozen=True)
class NonlinearControl(WithoutStates):
    """Base of nonlinear control effectiveness: a deflection d acts as d + f(d).

    moment += moment_by f(d) and lift += ``lift_share`` lift_by f(d), with the control derivatives
    of the vehicle. ``lift_share`` is one if lift and moment come from one force on the surface, and
    zero if only the moment is nonlinear. A subclass defines f as its ``curve``. The parameter of a
    form with one parameter is ``bend``.

    Attributes
    ----------
    control : signal of the control.
    moment_by, lift_by : names of the control derivatives of moment and lift.
    share_free : whether ``lift_share`` is estimated; it is held for a control with hardly any lift.
    ports : ports of the moment and of the lift.
    further : further ports, each with the name of its control derivative.
    label : suffix of the effect's name, where the vehicle has several controls.
    speed : name of the constant that is the declared airspeed. With a ``reference_airspeed`` the
        deflections are totals, and d is counted from ``middle``.
    middle : middle of the range of total deflections in the record.
    """

    control: str = "elevator"
    moment_by: str = "Cm_de"
    lift_by: str = "CL_de"
    share_free: bool = True
    ports: tuple[str, str] = ("moment", "lift")
    further: tuple[tuple[str, str], ...] = ()
    label: str = ""
    speed: str = "airspeed"
    middle: float = 0.0

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    bend: ClassVar[Parameter]

    @property
    def name(self) -> str:
        return labelled("control-nonlinearity", self.label)

    @property
    def absent(self) -> Mapping[str, float]:
        return {self.bend.name: 0.0}

    @property
    def needs(self) -> tuple[str, ...]:
        return (*self.ports, *(port for port, _ in self.further))

    @property
    def derivative_names(self) -> tuple[str, ...]:
        """Names of the control derivatives of moment, lift and the further ports."""
        return (self.moment_by, self.lift_by, *(derivative for _, derivative in self.further))

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (*self.derivative_names, self.speed)

    @property
    def lift_share(self) -> Parameter:
        return Parameter(
            "lift_share", 1.0, "1", prior_std=1.0, bounds=(-10.0, 10.0), free=self.share_free
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (self.bend, self.lift_share)

    def curve(self, d: Any, p: Any) -> Any:
        """Return f(d)."""
        raise NotImplementedError

    def factors(self, vehicle: Any) -> Sequence[Any]:
        """Return the factors of f in moment, lift and the further ports."""
        return [getattr(vehicle, name) for name in self.derivative_names]

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        d = getattr(s, self.control)
        added = self.curve(d - self.middle if self.middle else d, p)
        moment, lift, *others = self.factors(vehicle)
        return {
            self.ports[0]: moment * added,
            self.ports[1]: p.lift_share * lift * added,
            **{port: by * added for (port, _), by in zip(self.further, others, strict=True)},
        }

    def flown_deflections(self, context: SearchContext) -> tuple[float, float] | None:
        """Return the range of the control in a record, of a pseudo-control that of the stick."""
        return context.flown_range(self.control) or context.flown_range("stick")

    def middle_of(self, low: float, high: float) -> float:
        """Return the deflection from which d is counted; zero unless deflections are totals."""
        return 0.0 if self.speed == "airspeed" else 0.5 * (low + high)

    def widest_and_middle(self, context: SearchContext) -> tuple[float, float]:
        """Return the largest deflection from the middle in a record, and the middle, in the
        control's unit.
        """
        low, high = self.flown_deflections(context) or (0.0, 0.0)
        middle = self.middle_of(low, high)
        return max(abs(low - middle), abs(high - middle)), middle

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the slopes at absence, with lift and moment from one force."""
        return (Probe({**self.absent, "lift_share": 1.0}, tuple(self.absent)),)


Form = TypeVar("Form", bound=NonlinearControl)


def of_all_controls(form: type[Form], **pseudo_control: Any) -> tuple[Form, ...]:
    """Return a form for the controls of all built-in equations.

    ``pseudo_control`` has the attributes of the form on the pseudo-control of the low-order
    equivalent system.
    """
    lateral = (
        form(
            control=control,
            moment_by=moment_by,
            lift_by=lift_by,
            share_free=False,
            ports=ports,
            further=further,
            label=control,
        )
        # The moment is the main one of the control, and the lift is the side force.
        for control, moment_by, lift_by, ports, further in (
            ("aileron", "Cl_da", "CY_da", ("roll", "side_force"), (("yaw", "Cn_da"),)),
            ("rudder", "Cn_dr", "CY_dr", ("yaw", "side_force"), (("roll", "Cl_dr"),)),
        )
    )
    stick = form(
        control="delta",
        moment_by="M_delta",
        lift_by="L_delta",
        share_free=False,
        **pseudo_control,
    )
    return (form(), stick, *lateral, form(label="elevator", speed="reference_airspeed"))


# ---- A smooth curve


@dataclass(frozen=True)
class ControlNonlinearity(NonlinearControl):
    """Nonlinear control effectiveness: a deflection d acts as d + f(d), with a smooth curve f.

    f is a natural cubic spline over ``[low, high]`` with f(0) = f'(0) = 0. f = sum of ``shape1``
    ... times orthonormal shapes (`sim.maths`). Each parameter is the root mean square deflection
    that its shape adds over the range, in the unit of the control. ``lift_share`` has no effect
    while f is zero.

    Attributes
    ----------
    low, high : range of the deflections in the record.
    fine : use nine shapes instead of four; the first four are the same.
    unit, size : unit of the control, and a usual size of f.
    by : fixed factors of f that replace the control derivatives; empty to use the derivatives. On
        an input of a few levels, f and the derivative compensate each other. With a fixed factor
        this relation is linear, and a Gaussian can describe it.
    """

    low: float = -0.1
    high: float = 0.1
    fine: bool = False
    unit: str = "rad"
    size: float = 0.01
    by: tuple[float, ...] = ()

    @property
    def explanation(self) -> str:
        moment, lift = (name.partition("_")[0] for name in (self.moment_by, self.lift_by))
        return (
            "Nonlinear control effectiveness. The effect of a control surface is not proportional "
            "to its deflection. Causes are flow separation, a gap that opens, or a difference "
            f"between up and down. For a deflection d, {moment} = ... + {self.moment_by} (d + "
            f"f(d)) and {lift} = ... + {self.lift_by} (d + lift_share f(d)). f is a smooth curve "
            "(natural cubic spline, four shapes) over the range of deflections flown, with f = 0 "
            "and zero slope at zero deflection. An input of a few fixed levels shows f at these "
            "levels only. It then cannot distinguish f from an actuator stop or a dead band; a "
            "multisine can."
        )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(LOOK_ALIKE, self.label)

    @property
    def widest(self) -> float:
        """Largest deflection from ``middle`` in the range."""
        return max(abs(self.low - self.middle), abs(self.high - self.middle))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        # The prior regularises shapes outside the range: none adds more than the deflection itself.
        shapes = (
            Parameter(name, -self.size / (1.0 + i), self.unit, prior_std=self.widest / (1.0 + i))
            for i, name in enumerate(shape_names(self.fine))
        )
        return (*shapes, self.lift_share)

    @property
    def absent(self) -> Mapping[str, float]:
        return dict.fromkeys(shape_names(self.fine), 0.0)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(
                "the {control} works unequally to both sides, by {unevenness_change} about the "
                "mean (unevenness {unevenness})",
                "the effect of the {control} is not in proportion to its deflection",
            ),
            short_name="curved control",
            plausible=dict.fromkeys(shape_names(self.fine), (-self.widest, self.widest))
            | PLAUSIBLE_SHARE,
        )

    def curve(self, d: Any, p: Any) -> Any:
        shapes = natural_shapes(self.low - self.middle, self.high - self.middle, self.fine)
        return combine(shapes, d, p[:-1])

    def factors(self, vehicle: Any) -> Sequence[Any]:
        return self.by or super().factors(vehicle)

    def fitted_to(self, context: SearchContext) -> ControlNonlinearity:
        """Return the effect over the deflections of the record, with the fitted control derivatives
        as fixed factors of f.
        """
        low, high = self.flown_deflections(context) or (self.low, self.high)
        by = tuple(context.values.get(name, 0.0) for name in self.derivative_names)
        return replace(
            self,
            low=low,
            high=high,
            middle=self.middle_of(low, high),
            by=by if by[0] != 0.0 else (),
        )

    def finer(self) -> ControlNonlinearity:
        """Return the refined form, with five more shapes."""
        return replace(self, fine=True)


# The two forms below have the same name as these effects.
CURVE_VARIANTS: tuple[Traceable, ...] = of_all_controls(
    ControlNonlinearity, low=-1.0, high=1.0, unit="1", size=0.1
)


# ---- Forms with one parameter

# Width of the rounded kink of |d|, relative to the largest deflection. A sharp kink has no slope.
KINK_WIDTH_SHARE = 0.001


@dataclass(frozen=True)
class ControlUnevenness(NonlinearControl):
    """Uneven control effectiveness: a deflection d acts as d + ``unevenness`` |d|.

    The slope is 1 + unevenness on the positive side and 1 - unevenness on the negative side. The
    control derivatives of the vehicle are therefore the means of both sides.

    Attributes
    ----------
    width : width w of the rounded kink, in the unit of the control: |d| is computed as sqrt(d^2 +
        w^2) - w.
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
        plausible={"unevenness": (-0.7, 0.7), **PLAUSIBLE_SHARE},
    )

    @property
    def explanation(self) -> str:
        moment = self.moment_by.partition("_")[0]
        return (
            "Uneven control effectiveness. A control surface is more effective to one side than "
            f"to the other. For a deflection d from trim, {moment} = ... + {self.moment_by} (d + "
            "unevenness |d|); the other coefficients change likewise. Causes are a tail near its "
            "stall, a gap that opens on one side, or an actuator with two gains. The declared "
            "derivative is the mean of both sides. A model with one slope then has errors of the "
            "same sign for deflections up and down, and its attitude after a doublet differs from "
            "that of the aircraft. Inputs to one side only merely change the derivative, so steps "
            "to both sides are needed."
        )

    def curve(self, d: Any, p: Any) -> Any:
        return p.unevenness * (sqrt(d * d + self.width * self.width) - self.width)

    def fitted_to(self, context: SearchContext) -> ControlUnevenness:
        """Return the effect with a kink that is narrow for the deflections of the record."""
        widest, middle = self.widest_and_middle(context)
        return replace(self, width=KINK_WIDTH_SHARE * widest or self.width, middle=middle)


UNEVENNESS_VARIANTS: tuple[Traceable, ...] = of_all_controls(ControlUnevenness, width=0.0005)


@dataclass(frozen=True)
class ControlWeakening(NonlinearControl):
    """Control effectiveness that falls with deflection: d acts as d - ``loss`` d (d/D)^2.

    At the deflection D the surface has lost the share ``loss`` of its effect; a negative loss is a
    gain. The control derivatives of the vehicle are those at zero deflection.

    Attributes
    ----------
    widest : D, the largest deflection in the record, in the unit of the control.
    """

    widest: float = 0.1

    bend: ClassVar[Parameter] = Parameter("loss", 0.2, "1", bounds=(-3.0, 1.0))
    traits: ClassVar[Traits] = Traits(
        sentences=(
            "the {control} loses the share {loss} of its effect towards its largest deflection",
        ),
        short_name="weakening control",
        plausible={"loss": (-0.7, 0.7), **PLAUSIBLE_SHARE},
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return all_labelled(LOOK_ALIKE, self.label)

    @property
    def explanation(self) -> str:
        moment = self.moment_by.partition("_")[0]
        return (
            "Falling control effectiveness. The effectiveness of a control surface falls with its "
            f"deflection, equally to both sides. For a deflection d, {moment} = ... + "
            f"{self.moment_by} (d - loss d (d/D)^2), where D is the largest deflection flown; the "
            "other coefficients change likewise. Causes are a gap that opens and flow that begins "
            "to separate. With an input of a few fixed levels an actuator stop looks the same; a "
            "multisine distinguishes the two."
        )

    def curve(self, d: Any, p: Any) -> Any:
        return -p.loss * d * (d / self.widest) ** 2

    def fitted_to(self, context: SearchContext) -> ControlWeakening:
        """Return the effect with the largest deflection of the record."""
        widest, middle = self.widest_and_middle(context)
        return replace(self, widest=widest or self.widest, middle=middle)


WEAKENING_VARIANTS: tuple[Traceable, ...] = of_all_controls(ControlWeakening, widest=1.0)


VARIANTS: tuple[Traceable, ...] = (*CURVE_VARIANTS, *UNEVENNESS_VARIANTS, *WEAKENING_VARIANTS)
