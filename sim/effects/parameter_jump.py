"""Parameters of a user's own model that change at one time, as derivatives of an aircraft do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.aerodynamics.terms import AS_TERM, parse_term
from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, SearchContext, Traits
from sim.declaration.user_equations import OwnEquations
from sim.effects.instances import labelled
from sim.effects.timing import WIDTH, edge_width, risen

USUAL, LARGEST = 0.3, 10.0  # changes, as shares of the declared value


@dataclass(frozen=True)
class ParameterJump:
    """From ``time`` (s) on the parameters of a group are larger by given amounts, each in its own
    unit; any of them may stay as it is.

    What the equations do with a parameter, in rates and readings, they do with its change. The edge
    rises over ``width`` s, centred on ``time``.

    Attributes
    ----------
    changing : name and unit of each parameter. label : of the name, where there are several groups.
    sizes : usual changes, in their units;
        unknown before a record's model gives the declared values, and any size is believed then.
        width : of the edge, s.
    """

    changing: tuple[tuple[str, str], ...]
    label: str = ""
    sizes: tuple[float, ...] = ()
    width: float = WIDTH

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()

    @property
    def explanation(self) -> str:
        return (
            f"Something breaks, sticks or is switched: from a time on {' and '.join(self.group)} "
            f"{'are' if len(self.group) > 1 else 'is'} not what "
            "was declared, by an amount of its own each. Before that time the model fits, after it "
            "no longer. A change after the last maneuver "
            "leaves no trace, since a parameter shows only while the signal that it multiplies "
            "moves."
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
            name: LARGEST / USUAL * size for name, size in zip(self.group, self.sizes, strict=False)
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
        """The same with an edge of one sub-step of that record, and changes as large as the
        declared values let expect.
        """
        declared = [abs(context.values.get(name, 0.0)) for name in self.group]
        sizes = tuple(USUAL * value for value in declared) if all(declared) else ()
        return replace(self, width=edge_width(context.interval), sizes=sizes)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by all changes at 36 times; a later time does not merely shift the signature."""
        return tuple(Probe({**self.absent, "time": time}, self.group) for time in context.onsets())


def jumps_of(equations: OwnEquations) -> tuple[ParameterJump, ...]:
    """One for the parameters that act through each port, labelled by the port where there are
    several.

    Where ports are coefficients that are sums of terms, a group holds the derivatives of one
    coefficient: each rate knows several ports, and all of their parameters would be in all groups.
    A constant that jumps is `unmeasured-input`.
    """
    groups: dict[str, list[str]] = {}
    if equations.terms:
        for axis, name in _derivatives(equations):
            groups.setdefault(axis, []).append(name)
    else:
        for port, _, name in equations.products:
            groups.setdefault(port, []).append(name)
    units, several = equations.factors, len(groups) > 1
    order = {port: sorted({*names}, key=[*units].index) for port, names in groups.items()}
    return tuple(
        ParameterJump(tuple((name, units[name]) for name in names), port if several else "")
        for port, names in order.items()
    )


def _derivatives(equations: OwnEquations) -> list[tuple[str, str]]:
    """Coefficient and parameter of each term that holds a signal."""
    signals = [name.removeprefix(AS_TERM) for name in equations.formed_names]
    terms = [(axis, parse_term(text, signals)) for axis, text in equations.terms]
    named = [(axis, f"{axis}_{term.label}") for axis, term in terms if term.signals]
    known = equations.factors
    return [(axis, name) for axis, name in named if name in known]
