"""Loads that grow with the product of two signals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.effects.loads import load_parameters


@dataclass(frozen=True)
class ProductLoads:
    """lift += ``lift`` a b, moment += ``moment`` a b, a and b two signals of the equations.

    Attributes
    ----------
    label : after ``guard:``. first, second : the signals, which may be the same. aliases, within : effects that contain it.
    units, sizes : of lift and moment. needs_constants : those of the equations it is written for.
    """

    label: str
    first: str
    second: str
    units: tuple[str, str]
    sizes: tuple[float, float]
    needs_constants: tuple[str, ...]
    aliases: tuple[str, ...] = ()

    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("lift", "moment")
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"lift": 0.0, "moment": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    states: ClassVar[tuple[Signal, ...]] = ()

    @property
    def name(self) -> str:
        return f"guard:{self.label}"

    @property
    def traits(self) -> Traits:
        return Traits(
            guard=True,
            within=self.aliases,
        )

    @property
    def explanation(self) -> str:
        return (
            f"A generic term: lift and moment grow with the product {self.first} * {self.second}, CL += lift {self.first} {self.second} and "
            f"Cm += moment {self.first} {self.second}. No cause of the library stands behind it. Where it explains a record better than every "
            "effect does, the cause is none of them."
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return load_parameters(self.sizes, self.units)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        product = getattr(s, self.first) * getattr(s, self.second)
        return {"lift": p.lift * product, "moment": p.moment * product}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by both where there is none."""
        return (Probe(self.absent, ("lift", "moment")),)


_CONTROL = ("control-nonlinearity",)
GUARDS: tuple[Traceable, ...] = (
    ProductLoads("alpha-control", "alpha_air", "elevator", ("1/rad2", "1/rad2"), (5.0, 5.0), ("Cm_de",)),
    ProductLoads("control-squared", "elevator", "elevator", ("1/rad2", "1/rad2"), (3.0, 3.0), ("Cm_de",), _CONTROL),
    ProductLoads("alpha-q", "alpha_air", "q_hat", ("1/rad2", "1/rad2"), (100.0, 100.0), ("Cm_de",)),
    ProductLoads("alpha-control", "alpha_air", "delta", ("1/s", "1/s2"), (1.0, 10.0), ("M_delta",)),
    ProductLoads("control-squared", "delta", "delta", ("1/s", "1/s2"), (0.02, 0.1), ("M_delta",), _CONTROL),
    ProductLoads("alpha-q", "alpha_air", "q", ("1/rad", "1/(rad s)"), (5.0, 20.0), ("M_delta",)),
)
