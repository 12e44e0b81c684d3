"""General forms of nonlinearity: a parameter that is a smooth curve of a state, an input or the
airspeed; and a term that an aerodynamic coefficient of the declared aircraft lacks.

P. C. Young calls the former a state-dependent parameter (Recursive Estimation and Time-Series
Analysis, 2nd ed., chapter 11). Instances are made from the declaration: one for each parameter that
multiplies a signal (``factors``), over each state, control and recorded airspeed. If a named effect
has the same curve, no instance is made; `other_names` then maps its name to the named effect.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

from sim.aerodynamics import (
    AS_TERM,
    FLOW,
    IN_SYMMETRY,
    Term,
    allowed_terms,
    parse_term,
    sorted_surfaces,
)
from sim.declaration.effect import (
    Parameter,
    Regularity,
    Station,
)
from sim.declaration.model import Equations, Multiplying
from sim.declaration.proposal import SearchContext, Traceable, Traits
from sim.declaration.user_equations import UserEquations
from sim.effects.dynamics.atmosphere import DensityScaleHeight, DragMach
from sim.effects.dynamics.control_nonlinearity import CURVE_VARIANTS as CURVED_CONTROLS
from sim.effects.dynamics.control_nonlinearity import ControlNonlinearity
from sim.effects.dynamics.load_nonlinearity import CURVE_VARIANTS as CURVED_LOADS
from sim.effects.instances import (
    ProbedAtAbsence,
    WithoutStates,
    controls,
    has_its_constants_and_ports,
)
from sim.effects.loads import LoadCurve
from sim.maths import Shapes, combine, first_shapes, natural_shapes, shape_names

# Signal that a derivative of the built-in models multiplies, by the suffix of its name.
MULTIPLIED = {
    "alpha": "alpha",
    "q": "q",
    "V": "airspeed",
    "beta": "beta",
    "p": "p",
    "r": "r",
    "de": "elevator",
    "da": "aileron",
    "dr": "rudder",
    "delta": "delta",
}
# Numbers of shapes of the forms: slope and curvature; all shapes of a spline of five intervals, as
# in named curves; all shapes of ten intervals.
FORMS = (2, 5, 10)
# Advice: how to fly to distinguish two instances.
BEYOND_PRODUCTS = (
    "both signals moved far, together and one after the other: as long as a derivative grows "
    "evenly with a signal, a record shows only the product of two signals, whichever of the two "
    "derivatives it is"
)
AIRSPEED_CHANGE = "airspeed_change"  # port of a recorded airspeed minus its mean
AIRSPEED = "airspeed"  # name of that channel
CURVES = (*CURVED_CONTROLS, *CURVED_LOADS)
# Named effects of a falling body. Altitude and speed change together in a fall: a ballistic
# coefficient over altitude is the density of the air, over speed the drag over the Mach number.
EFFECTS_OF_A_FALL: Mapping[tuple[str, str], Traceable] = {
    ("beta", "altitude"): DensityScaleHeight(),
    ("beta", "velocity"): DragMach(),
}
# Usual changes of the derivatives of a coefficient. Derivatives by rates are several times larger.
_USUAL = {"CL": 0.8, "Cm": 0.3, "CD": 0.1, "CY": 0.2, "Cl": 0.06, "Cn": 0.04}
_BY_RATE = {"q": 20.0, "p": 5.0, "r": 5.0}
# Usual changes of dimensional derivatives: of a low-order equivalent system, then of a multirotor.
_USUAL_DIMENSIONAL = {
    "L_alpha": 0.4,
    "M_alpha": 3.0,
    "L_delta": 0.01,
    "M_delta": 0.1,
    "L_q": 0.1,
    "M_q": 1.0,
    "L_p": 1.0,
    "L_lat": 15.0,
    "M_lon": 15.0,
    "N_r": 0.5,
    "N_ped": 3.0,
    "Z_col": 5.0,
}


@dataclass(frozen=True)
class Varies(ProbedAtAbsence):
    """A parameter that depends on a signal: ``parameter`` += f(signal).

    f is a natural cubic spline over ``[low, high]`` that is zero at an anchor, where the parameter
    has its declared value. The anchor is zero if the range contains it, else the middle of the
    range. Outside the range f is linear. f = ``shape1`` times a straight line + ``shape2`` times
    nearly a parabola. Refined forms have all shapes of a spline of five intervals, as named curves
    have, and of ten (`sim.maths`). Shapes are orthonormal: each parameter of f is the root mean
    square that its shape adds over the range, in the unit of the varying parameter.

    Attributes
    ----------
    parameter, counted_in : name and unit of the varying parameter.
    over : name of the signal in the equations.
    called : name of the signal for users, if it is another one.
    gust : port whose value adds to the signal; empty without one.
    state : whether the signal is a state.
    size : usual change of the parameter.
    guessed : whether ``size`` is a guess, as for a user model.
    alike : name of the instance whose straight line is the same product of two signals; empty
        without one.
    low, high : range of the signal in the records.
    count : number of shapes, one of ``FORMS``.
    """

    parameter: str = "Cm_q"
    counted_in: str = "1/rad"
    over: str = "alpha"
    called: str = ""
    gust: str = "gust"
    state: bool = True
    size: float = 6.0
    guessed: bool = False
    alike: str = "varies:Cm_alpha(q)"
    low: float = -0.15
    high: float = 0.15
    count: int = FORMS[0]

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR

    @property
    def name(self) -> str:
        return name_of(self.parameter, self.called or self.over)

    @property
    def aliases(self) -> tuple[str, ...]:
        return (self.alike,) if self.alike else ()

    @property
    def explanation(self) -> str:
        signal = self.called or self.over
        return (
            f"{self.parameter} varies with {signal}: the parameter is a smooth curve, "
            f"{self.parameter} = declared value + f({signal}). f is a natural cubic spline over "
            "the range flown. It is zero at zero, or in the middle of a range that does not "
            "contain zero. This is the general form of all nonlinearities, for any derivative over "
            "any state, input or airspeed. It is offered only if no effect with a cause of its own "
            "explains the records. If f is a straight line, the product of two signals may belong "
            "to either of two derivatives; only the curvature of f distinguishes them."
        )

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.gust,) if self.gust else ()

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.parameter,)

    @property
    def states_read(self) -> tuple[str, ...]:
        return (self.over,) if self.state else ()

    @property
    def _names(self) -> tuple[str, ...]:
        return shape_names(fine=True, flat=False)[: self.count]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        # The prior regularises shapes outside the range. A refined form starts near the base form.
        starts = [
            self.size / (1.0 + i) * (1.0 if i < FORMS[0] else 1e-3) for i in range(self.count)
        ]
        return tuple(
            Parameter(name, start, self.counted_in, prior_std=3.0 * self.size)
            for name, start in zip(self._names, starts, strict=True)
        )

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(self._names, 0.0))

    @property
    def traits(self) -> Traits:
        signal = self.called or self.over
        return Traits(
            sentences=(f"{self.parameter} depends on {signal}",),
            short_name=f"{self.parameter} over {signal}",
            plausible=dict.fromkeys(self._names, (-30.0 * self.size, 30.0 * self.size)),
            separating={"varies": BEYOND_PRODUCTS},
            general=True,
        )

    @property
    def shapes(self) -> Shapes:
        """The shapes as functions of the signal."""
        anchor = 0.0 if self.low <= 0.0 <= self.high else 0.5 * (self.low + self.high)
        return first_shapes(
            natural_shapes(self.low, self.high, self.count == FORMS[-1], anchor, False), self.count
        )

    def change(self, s: Any, p: Any) -> Any:
        at = getattr(s, self.over)
        return combine(self.shapes, at + getattr(s, self.gust) if self.gust else at, p)

    def fitted_to(self, context: SearchContext) -> Varies:
        """Return the effect over the range of the records.

        The usual change is at least the declared value. A guessed one is replaced by the declared
        value, because results would otherwise depend on the unit.
        """
        low, high = context.flown_range(self.over) or (self.low, self.high)
        if not high > low:
            low, high = self.low, self.high
        declared = abs(context.values.get(self.parameter, 0.0))
        return replace(
            self,
            low=low,
            high=high,
            size=declared if self.guessed and declared > 0.0 else max(self.size, declared),
        )

    def finer(self) -> Varies:
        """Return the next refined form, with more shapes."""
        return replace(self, count=min((n for n in FORMS if n > self.count), default=FORMS[-1]))


def name_of(parameter: str, signal: str) -> str:
    """Return the name of an instance, ``varies:Cm_q(alpha)``."""
    return f"varies:{parameter}({signal})"


def curve_made_for(equations: Equations) -> tuple[Varies, ...]:
    """Return an instance for each parameter that multiplies a signal, over each state, control and
    recorded airspeed, unless a named effect has this curve.
    """
    if isinstance(equations, UserEquations) and equations.terms:
        return ()  # the effects `missing-term` cover these equations
    named = other_names(equations)
    made = {effect.name: effect for effect in _all_instances(equations) if effect.name not in named}
    return tuple(
        replace(effect, alike=effect.alike if effect.alike in made else "")
        for effect in made.values()
    )


def other_names(equations: Equations) -> Mapping[str, str]:
    """Return the names of instances that equal a named effect, with the name of that effect."""
    curves = [
        *((key, curve) for curve in CURVES for key in _parameters_and_signals(curve)),
        *EFFECTS_OF_A_FALL.items(),
    ]
    fitting = [(key, c) for key, c in curves if has_its_constants_and_ports(c, equations)]
    offered = {effect.name for effect in _all_instances(equations)}
    return {
        name: curve.name for key, curve in reversed(fitting) if (name := name_of(*key)) in offered
    }


def _parameters_and_signals(curve: Traceable) -> tuple[tuple[str, str], ...]:
    """Return the pairs of parameter and signal for which a named effect has the curve."""
    if isinstance(curve, LoadCurve):
        return ((curve.needs_constants[0], curve.flown),)
    return (
        tuple((name, curve.control) for name in curve.needs_constants[:-1])
        if isinstance(curve, ControlNonlinearity)
        else ()
    )


def _all_instances(equations: Equations) -> Iterator[Varies]:
    """Yield an instance for each parameter that multiplies a signal, over each signal."""
    factors = equations.factors if isinstance(equations, Multiplying) else {}
    own, ports = isinstance(equations, UserEquations), {port.name for port in equations.ports}
    recorded = [
        (signal.name, AIRSPEED, False)
        for signal in equations.inputs
        if signal.name == AIRSPEED_CHANGE and not own
    ]
    signals = (
        [(s.name, s.name, True) for s in equations.states]
        + [(s.name, s.name, False) for s in controls(equations)]
        + recorded
    )
    angle = next(
        (
            name
            for name in ("alpha", "beta")
            if any(signal.name == name for signal in equations.states)
        ),
        "",
    )
    for parameter, unit in factors.items():
        for over, called, state in signals:
            gust = "gust" if over == angle and "gust" in ports and not own else ""
            alike = "" if own else _instance_with_same_product(parameter, called, factors)
            size = 1.0 if own else _usual(parameter)
            yield Varies(
                parameter,
                unit,
                over,
                called if called != over else "",
                gust,
                state,
                size,
                own,
                alike,
            )


def _instance_with_same_product(parameter: str, signal: str, factors: Mapping[str, str]) -> str:
    """Return the name of the instance with the same product of two signals; empty without one.

    For ``Cl_p(beta)`` it is ``Cl_beta(p)``.
    """
    axis, _, by = parameter.partition("_")
    known = {other.partition("_")[2]: other for other in factors if other.partition("_")[0] == axis}
    back = next((other for suffix, other in known.items() if MULTIPLIED.get(suffix) == signal), "")
    return name_of(back, MULTIPLIED[by]) if back and back != parameter and by in MULTIPLIED else ""


def _usual(parameter: str) -> float:
    """Return a usual change of a parameter, in its unit."""
    axis, _, by = parameter.partition("_")
    return _USUAL_DIMENSIONAL.get(parameter) or _USUAL.get(axis, 1.0) * _BY_RATE.get(by, 1.0)


# Large coefficients and signals in maneuvers.
LARGE_COEFFICIENT = {
    "CX": 0.1,
    "CY": 0.2,
    "CZ": 1.0,
    "CD": 0.1,
    "CL": 1.0,
    "Cl": 0.02,
    "Cm": 0.1,
    "Cn": 0.02,
}
LARGE_SIGNAL = {"alpha": 0.1, "beta": 0.1, "mach": 0.1, "p": 0.03, "q": 0.01, "r": 0.01}
LARGE_DEFLECTION = 0.1
USUAL_SHARE = 0.1  # usual size of a missing term, as a share of the large coefficient


@dataclass(frozen=True)
class MissingTerm(WithoutStates, ProbedAtAbsence):
    """A term that an aerodynamic coefficient lacks: coefficient += ``size`` times the term.

    ``size`` is per radian and of either sign; rates are non-dimensional.

    Attributes
    ----------
    axis : the coefficient, a port of the equations.
    term : text of the term (`sim.aerodynamics`).
    surfaces : names of the control surfaces, which terms may contain.
    """

    axis: str
    term: str
    surfaces: tuple[str, ...] = ()

    station: ClassVar[Station] = Station.DYNAMICS
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "A coefficient lacks a term: coefficient += size * term, for example Cm += size "
        "alpha*elevator for an elevator that loses its effect at high angles of attack. Such a "
        "term changes all outputs together, as any load does, and the motion obeys the kinematics. "
        "It grows with the product of the signals in the term. The command flightid structure "
        "finds several terms at once."
    )

    @property
    def name(self) -> str:
        return f"missing-term:{self.axis}({self.term})"

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.axis,)

    @cached_property
    def parsed(self) -> Term:
        """The term as an object."""
        return parse_term(self.term, (*FLOW, *self.surfaces))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        size = USUAL_SHARE * LARGE_COEFFICIENT[self.axis]
        for factor in self.parsed.factors:
            size /= LARGE_SIGNAL.get(factor.signal, LARGE_DEFLECTION) ** factor.power
        unit = self.parsed.unit({*FLOW, *self.surfaces} - {"mach"})
        return (Parameter("size", size, unit),)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(f"{self.axis} lacks {self.term}: it has {{size}} times that",),
            short_name=f"{self.axis} lacks {self.term}",
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        values = {name: getattr(s, AS_TERM + name) for name in self.parsed.signals}
        return {self.axis: p.size * self.parsed.of(values)}


def term_made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the missing terms that the symmetry of an aircraft allows in its coefficients: linear
    terms, squares, products of two signals, and cubes of the air angles.

    A control surface belongs to the longitudinal or the lateral motion, according to the
    coefficients that have it in the vehicle file.
    """
    if not isinstance(equations, UserEquations) or not equations.terms:
        return ()
    present: dict[str, set[Term]] = {}
    signals = tuple(
        name.removeprefix(AS_TERM) for name in equations.flow_names if name.startswith(AS_TERM)
    )
    surfaces = tuple(name for name in signals if name not in FLOW)
    for axis, text in equations.terms:
        present.setdefault(axis, set()).add(parse_term(text, (*FLOW, *surfaces)))
    along, across = sorted_surfaces(present, surfaces)
    return tuple(
        MissingTerm(axis, term.text, surfaces)
        for axis, terms in present.items()
        for term in allowed_terms(along, across, symmetric=axis in IN_SYMMETRY)
        if term not in terms and (axis, term.text) != ("Cm", "alpha^3")  # of ``VARIANTS``
    )


VARIANTS: tuple[Traceable, ...] = (Varies(), MissingTerm("Cm", "alpha^3"))


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return the instances of both effects for given equations."""
    return (*curve_made_for(equations), *term_made_for(equations))
