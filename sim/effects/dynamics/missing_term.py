"""A term that an aerodynamic coefficient of the declared aircraft lacks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
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
from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.declaration.user_equations import OwnEquations

# What a coefficient reaches in maneuvers, and the signals in them: a term is believed to be worth
# as much as a tenth of the coefficient.
REACHED = {"CX": 0.1, "CY": 0.2, "CZ": 1.0, "CD": 0.1, "CL": 1.0, "Cl": 0.02, "Cm": 0.1, "Cn": 0.02}
FLOWN = {"alpha": 0.1, "beta": 0.1, "mach": 0.1, "p": 0.03, "q": 0.01, "r": 0.01}
DEFLECTED = 0.1
SHARE = 0.1


@dataclass(frozen=True)
class MissingTerm:
    """The coefficient has ``size`` times a term more.

    ``size`` of either sign, per radian, rates non-dimensional.

    Attributes
    ----------
    axis : the coefficient, a port of the equations. term : its text (`sim.aerodynamics`).
    surfaces : names of further signals that stand in terms.
    """

    axis: str
    term: str
    surfaces: tuple[str, ...] = ()

    station: ClassVar[Station] = Station.DYNAMICS
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    states: ClassVar[tuple[Signal, ...]] = ()
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = (
        "The aerodynamic model lacks a term: coefficient += size * term, for example Cm += size "
        "alpha*elevator, an elevator that loses its effect at high angles of attack. Such a term "
        "moves all outputs together, as any load does, and obeys the kinematics; it grows with the "
        "product of the signals that it is made of. flightid structure finds several at once."
    )

    @property
    def name(self) -> str:
        return f"missing-term:{self.axis}({self.term})"

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.axis,)

    @cached_property
    def parsed(self) -> Term:
        """The term."""
        return parse_term(self.term, (*FLOW, *self.surfaces))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        size = SHARE * REACHED[self.axis]
        for factor in self.parsed.factors:
            size /= FLOWN.get(factor.signal, DEFLECTED) ** factor.power
        unit = self.parsed.unit({*FLOW, *self.surfaces} - {"mach"})
        return (Parameter("size", size, unit),)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(f"{self.axis} lacks {self.term}: it has {{size}} times that",),
            short_name=f"{self.axis} lacks {self.term}",
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slope by the size where there is none."""
        return (Probe(self.absent, ("size",)),)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        values = {name: getattr(s, AS_TERM + name) for name in self.parsed.signals}
        return {self.axis: p.size * self.parsed.of(values)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


VARIANTS: tuple[Traceable, ...] = (MissingTerm("Cm", "alpha^3"),)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Terms that a coefficient may lack by the symmetry of an aircraft: linear ones, squares and
    products of two signals, cubes of the air's angles.

    A surface belongs to the motion in whose coefficients the vehicle file has it.
    """
    if not isinstance(equations, OwnEquations) or not equations.terms:
        return ()
    present: dict[str, set[Term]] = {}
    signals = tuple(
        name.removeprefix(AS_TERM) for name in equations.formed_names if name.startswith(AS_TERM)
    )
    surfaces = tuple(name for name in signals if name not in FLOW)
    for axis, text in equations.terms:
        present.setdefault(axis, set()).add(parse_term(text, (*FLOW, *surfaces)))
    along, across = sorted_surfaces(present, surfaces)
    found = []
    for axis, terms in present.items():
        inside = axis in IN_SYMMETRY
        for term in allowed_terms(along, across, symmetric=inside):
            if term not in terms and (axis, term.text) != ("Cm", "alpha^3"):
                found.append(MissingTerm(axis, term.text, surfaces))
    return tuple(found)
