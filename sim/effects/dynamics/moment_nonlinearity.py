"""Pitching moment that is no straight line of the angle of attack."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.maths.splines import combine, natural_shapes, shape_names


@dataclass(frozen=True)
class MomentNonlinearity:
    """moment += f(alpha), f a natural cubic spline over ``[low, high]`` with f(0) = f'(0) = 0.

    f = sum of ``shape1`` ... times orthonormal shapes (`sim.maths.splines`): each is the root mean square that its shape adds over
    the range, in Cm on the rigid aircraft, in 1/s2 on the low-order equivalent system. alpha in rad, the gust included;
    outside the range f goes on straight. The slope at zero stays with the declared derivative.

    Attributes
    ----------
    low, high : the flown range, rad. fine : nine shapes instead of four, the first four the same.
    unit, size : of the added moment, and a usual one. needs_constants : those of the equations it is written for.
    """

    low: float = -0.15
    high: float = 0.15
    fine: bool = False
    unit: str = "1"
    size: float = 0.01
    needs_constants: tuple[str, ...] = ("Cm_alpha",)

    name: ClassVar[str] = "moment-nonlinearity"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "The pitching moment bends away from the straight line Cm = Cm_alpha alpha: at larger angles the aircraft grows stiffer, loses stability "
        "or pitches up. Cm += f(alpha), a smooth curve (natural cubic spline, four shapes) over the range flown that is zero with zero slope in "
        "trim, so that Cm_alpha stays the slope there. Small maneuvers show nothing; the frequency of the short period changes with the size of "
        "the motion, and the residual of the pitch rate depends on alpha, not on time."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return tuple(Parameter(name, self.size / (1.0 + i), self.unit) for i, name in enumerate(shape_names(self.fine)))

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(shape_names(self.fine), 0.0))

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the pitching moment is not linear in the angle of attack",),
            short_name="curved pitching moment",
            plausible=dict.fromkeys(shape_names(self.fine), (-30.0 * self.size, 30.0 * self.size)),
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": combine(natural_shapes(self.low, self.high, self.fine), s.alpha_air, p)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> MomentNonlinearity:
        """The same over the range of angles that the record flew."""
        low, high = context.flown_range("alpha") or (self.low, self.high)
        return replace(self, low=low, high=high)

    def finer(self) -> MomentNonlinearity:
        """The same with five finer shapes."""
        return replace(self, fine=True)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by all shapes where there is none."""
        return (Probe(self.absent, shape_names(self.fine)),)


VARIANTS: tuple[Traceable, ...] = (
    MomentNonlinearity(),
    MomentNonlinearity(low=-0.04, high=0.04, unit="1/s2", size=0.1, needs_constants=("M_alpha",)),
)
