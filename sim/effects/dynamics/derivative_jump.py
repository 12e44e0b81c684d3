"""Jumps in time of derivatives, of the drag of a falling body, or of parameters of a user model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.aerodynamics import AS_TERM, parse_term
from sim.declaration.effect import (
    Parameter,
    Regularity,
    Station,
)
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.declaration.user_equations import UserEquations
from sim.effects.instances import ANOTHER_FALL, WithoutStates, has_its_constants_and_ports, labelled
from sim.effects.loads import SLOW_WIDTH, USUAL_SUB_STEP, edge_width, risen
from sim.maths import log

USUAL_CHANGE_SHARE = 0.3  # typical change, as a share of the declared value
LARGEST_CHANGE_SHARE = 10.0  # largest plausible change, as a share of the declared value


@dataclass(frozen=True)
class ParameterJump:
    """Jump of parameters: from ``time`` (s) on each parameter of a group is increased by an amount.

    The amounts are parameters in the units of the changed ones; some may be zero. Rates and
    readings use the changed parameters. The edge lasts ``width`` s, centred on ``time``.

    Attributes
    ----------
    changing : name and unit of each parameter of the group.
    label : suffix of the effect's name, where there are several groups.
    sizes : usual changes, in these units, from the declared values. If these are unknown, ``sizes``
        is empty and any change is plausible.
    width : duration of an edge, s.
    """

    changing: tuple[tuple[str, str], ...]
    label: str = ""
    sizes: tuple[float, ...] = ()
    width: float = USUAL_SUB_STEP

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()

    @property
    def explanation(self) -> str:
        several = len(self.group) > 1
        return (
            f"From a time on, the parameter{'s' if several else ''} {' and '.join(self.group)} "
            f"{'have' if several else 'has'} other values than declared. Something in the system "
            f"breaks, sticks or is switched. In the model, {self.group[0]} = declared value + "
            "change after that time, where each parameter has a change of its own. The declared "
            "model fits before that time, but not after it. A change after the last maneuver is "
            "not observable, since a parameter acts only while the signal that it multiplies moves."
        )

    @property
    def name(self) -> str:
        return labelled("derivative-jump", self.label)

    @property
    def group(self) -> tuple[str, ...]:
        return tuple(name for name, _ in self.changing)

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return self.group

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        sizes = self.sizes or (1.0,) * len(self.changing)
        changes = (
            Parameter(name, size, unit)
            for (name, unit), size in zip(self.changing, sizes, strict=True)
        )
        return (Parameter("time", 3.0, "s"), *changes)

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(self.group, 0.0))

    @property
    def traits(self) -> Traits:
        largest = {
            name: LARGEST_CHANGE_SHARE / USUAL_CHANGE_SHARE * size
            for name, size in zip(self.group, self.sizes, strict=False)
        }
        return Traits(
            sentences=("from {time} on other parameters hold: {rest}",),
            plausible={name: (-size, size) for name, size in largest.items()},
            onset="time",
            per_record=True,
        )

    def changes(self, s: Any, p: Any) -> Mapping[str, Any]:
        share = risen(s.time, p.time, self.width)
        return {name: share * getattr(p, name) for name in self.group}

    def fitted_to(self, context: SearchContext) -> ParameterJump:
        """Return the effect with an edge of one sub-step of the record, and usual changes for the
        declared values.
        """
        declared = [abs(context.values.get(name, 0.0)) for name in self.group]
        sizes = tuple(USUAL_CHANGE_SHARE * value for value in declared) if all(declared) else ()
        return replace(self, width=edge_width(context.interval), sizes=sizes)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe all changes at 36 times; a later time does not merely shift the response."""
        return tuple(Probe({**self.absent, "time": time}, self.group) for time in context.onsets())


def jumps_of(equations: UserEquations) -> tuple[ParameterJump, ...]:
    """Return a jump of the parameters that act through each port.

    If the ports are coefficients, the derivatives of each coefficient are a group, because each
    rate depends on several ports. A jump of a constant term is the effect `unmeasured-input`.
    """
    acting = (
        _derivatives(equations)
        if equations.terms
        else [(port, name) for port, _, name in equations.products]
    )
    groups: dict[str, list[str]] = {}
    for port, name in acting:
        groups.setdefault(port, []).append(name)
    units, several = equations.factors, len(groups) > 1
    order = {port: sorted({*names}, key=[*units].index) for port, names in groups.items()}
    return tuple(
        ParameterJump(tuple((name, units[name]) for name in names), port if several else "")
        for port, names in order.items()
    )


def _derivatives(equations: UserEquations) -> list[tuple[str, str]]:
    """Return the coefficient and the parameter of each term that contains a signal."""
    signals = [name.removeprefix(AS_TERM) for name in equations.flow_names]
    terms = [(axis, parse_term(text, signals)) for axis, text in equations.terms]
    named = [(axis, f"{axis}_{term.label}") for axis, term in terms if term.signals]
    known = equations.factors
    return [(axis, name) for axis, name in named if name in known]


PITCH_EXPLANATION = (
    "Derivatives change at one time. Causes are ice that breaks off, damage of a surface, a shift "
    "of the centre of gravity by fuel or a store, or a flap that moves. From the time t0 on the "
    "moment is Cm = (Cm_alpha + change) alpha + ..., and the lift likewise: stability, damping, "
    "control power and lift slope may each change. The declared model fits before t0, but not "
    "after it. A change after the last maneuver is not observable, since a derivative acts only "
    "while its signal moves."
)
LATERAL_EXPLANATION = (
    "Derivatives change at one time. Causes are ice that breaks off, damage of a surface, a store "
    "that leaves one wing, or a fin tank that empties. From the time t0 on one coefficient has "
    "other derivatives: for yaw Cn = (Cn_beta + change) beta + (Cn_dr + change) rudder + ..., for "
    "roll and side force Cl and CY likewise. The declared model fits before t0, but not after it. "
    "A change after the last maneuver is not observable, since a derivative acts only while its "
    "signal moves."
)


@dataclass(frozen=True)
class Change:
    """A derivative that may change at the time of a jump.

    Attributes
    ----------
    derivative, unit : name and unit.
    signal : signal that it multiplies.
    size, largest : usual change, and largest plausible change, in ``unit``.
    """

    derivative: str
    unit: str
    signal: str
    size: float
    largest: float


RIGID_MOMENT = (
    Change("Cm_alpha", "1/rad", "alpha_air", 0.3, 5.0),
    Change("Cm_q", "1/rad", "q_hat", -3.0, 60.0),
    Change("Cm_de", "1/rad", "elevator", 0.3, 5.0),
)
RIGID_LIFT = (Change("CL_alpha", "1/rad", "alpha_air", -0.5, 10.0),)
LOES_MOMENT = (
    Change("M_alpha", "1/s2", "alpha_air", 2.0, 50.0),
    Change("M_q", "1/s", "q", 0.5, 10.0),
    Change("M_delta", "1/s2", "delta", -0.05, 100.0),
)
LOES_LIFT = (Change("L_alpha", "1/s", "alpha_air", 0.2, 5.0),)
_LATERAL_SIGNALS = {"beta": "beta_air", "p": "p_hat", "r": "r_hat", "da": "aileron", "dr": "rudder"}


def _lateral(axis: str, size: float, largest: float) -> tuple[Change, ...]:
    """Return the changes of all derivatives of a lateral coefficient."""
    factors = {"p": 5.0, "r": 5.0}  # derivatives by rates are several times larger
    return tuple(
        Change(f"{axis}_{by}", "1/rad", signal, size * factor, largest * factor)
        for by, signal in _LATERAL_SIGNALS.items()
        for factor in (factors.get(by, 1.0),)
    )


@dataclass(frozen=True)
class DerivativeJump(WithoutStates):
    """Jump of derivatives: from ``time`` (s) on some derivatives are increased by given amounts.

    The moment increases by the sum of the changes times their signals, and so does the lift. The
    amounts have the names and units of the derivatives; some may be zero. The edge lasts ``width``
    s, centred on ``time``. Changes act on perturbations about the same trim. A jump of the moment
    itself is the effect `unmeasured-input`.

    Attributes
    ----------
    moment, lift : derivatives of the moment and of the lift that may change.
    width : duration of an edge, s.
    ports : ports of the moment and of the lift.
    label : suffix of the effect's name, where an aircraft has several groups of derivatives: yaw,
        roll, side force.
    """

    moment: tuple[Change, ...] = RIGID_MOMENT
    lift: tuple[Change, ...] = RIGID_LIFT
    width: float = USUAL_SUB_STEP
    ports: tuple[str, str] = ("moment", "lift")
    label: str = ""

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()

    @property
    def explanation(self) -> str:
        return LATERAL_EXPLANATION if self.label else PITCH_EXPLANATION

    @property
    def name(self) -> str:
        return labelled("derivative-jump", self.label)

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports if self.lift else self.ports[:1]

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return tuple(change.derivative for change in (*self.moment, *self.lift))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        sizes = tuple(
            Parameter(change.derivative, change.size, change.unit)
            for change in (*self.moment, *self.lift)
        )
        return (Parameter("time", 3.0, "s"), *sizes)

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(self.needs_constants, 0.0))

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the derivatives change at {time}: {rest}",),
            plausible={
                change.derivative: (-change.largest, change.largest)
                for change in (*self.moment, *self.lift)
            },
            onset="time",
            per_record=True,
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        share = risen(s.time, p.time, self.width)
        groups = zip(self.ports, (self.moment, self.lift), strict=True)
        added = {
            port: sum(
                getattr(p, change.derivative) * getattr(s, change.signal) for change in changes
            )
            for port, changes in groups
            if changes
        }
        return {port: share * load for port, load in added.items()}

    def fitted_to(self, context: SearchContext) -> DerivativeJump:
        """Return the effect with an edge of one sub-step of the record."""
        return replace(self, width=edge_width(context.interval))

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe all changes at 36 times; a later time does not merely shift the response."""
        return tuple(
            Probe({**self.absent, "time": time}, self.needs_constants) for time in context.onsets()
        )


DERIVATIVE_VARIANTS: tuple[Traceable, ...] = (
    DerivativeJump(),
    DerivativeJump(moment=LOES_MOMENT, lift=LOES_LIFT),
    *(
        DerivativeJump(
            moment=_lateral(axis, size, 10.0 * size), lift=(), ports=(port, port), label=port
        )
        for axis, port, size in (
            ("Cn", "yaw", 0.02),
            ("Cl", "roll", 0.03),
            ("CY", "side_force", 0.1),
        )
    ),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return a jump of each group of parameters of a user model, unless ``VARIANTS`` have one."""
    covered = any(has_its_constants_and_ports(each, equations) for each in DERIVATIVE_VARIANTS)
    return jumps_of(equations) if isinstance(equations, UserEquations) and not covered else ()


@dataclass(frozen=True)
class DragJump(WithoutStates):
    """Jump of the drag: from ``time`` (s) on the drag is multiplied by ``factor``.

    beta is the ballistic coefficient before the jump. log drag += ln(1 + (factor - 1) e), where the
    edge e rises from 0 to 1 over ``width`` s, centred on ``time``.
    """

    width: float = SLOW_WIDTH

    name: ClassVar[str] = "drag-jump"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("time", 8.0, "s"),
        Parameter("factor", 1.3, "1", bounds=(1e-3, 1e3)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"factor": 1.0})
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("the drag is multiplied by {factor} from {time} on",),
        separating={"sensor-scale": ANOTHER_FALL},
        plausible={"factor": (0.05, 20.0)},
        onset="time",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "The drag changes at one time. Causes are a heat shield that is dropped, a drogue that "
        "opens, a fin that breaks, or the begin of tumbling. From then on the drag is another "
        "multiple of the dynamic pressure, drag = factor * 0.5 rho v^2 / beta. The altitude has no "
        "step, only its curvature has: the residual bends from that time on. At high altitude, "
        "where there is hardly any air, a change is not observable until the density increases."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"log_drag": log(1.0 + risen(s.time, p.time, self.width) * (p.factor - 1.0))}

    def fitted_to(self, context: SearchContext) -> DragJump:
        """Return the effect with an edge that sub-steps of the record resolve."""
        return replace(self, width=edge_width(context.interval, SLOW_WIDTH))

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe the factor at 36 times."""
        return tuple(Probe({"time": time, "factor": 1.0}, ("factor",)) for time in context.onsets())


VARIANTS: tuple[Traceable, ...] = (*DERIVATIVE_VARIANTS, DragJump())
