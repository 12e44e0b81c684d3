"""A load that is no straight line of the angle of attack: a smooth curve on one port of the equations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext
from sim.declaration.traits import Traits
from sim.maths.splines import combine, natural_shapes, shape_names

_WIDEST = 30.0  # usual sizes up to which a shape is believed


@dataclass(frozen=True)
class LoadCurve:
    """``port`` += f(alpha), f a natural cubic spline over ``[low, high]`` with f(0) = f'(0) = 0; of sideslip, f(beta).

    f = sum of ``shape1`` ... times orthonormal shapes (`sim.maths.splines`): each is the root mean square that its shape adds over
    the range, in the port's unit: a coefficient on the rigid aircraft, 1/s of alpha_dot or 1/s2 on the low-order equivalent system.
    alpha in rad, the gust included; outside the range f goes on straight. The slope at zero stays with the declared derivative.

    Attributes
    ----------
    port : what it adds to. name, load, short_name, explanation : of the effect; ``load`` as a sentence begins with it.
    unit, size : of what is added, and a usual one. needs_constants : those of the equations it is written for.
    angle, flown : what it is a curve of, and the output that shows its range. middle : of that range, from which f counts where the angle
        is a ``total``.
    low, high : the flown range, rad. fine : nine shapes instead of four, the first four the same.
    """

    port: str
    name: str
    load: str
    short_name: str
    explanation: str
    unit: str
    size: float
    needs_constants: tuple[str, ...]
    low: float = -0.15
    high: float = 0.15
    fine: bool = False
    angle: str = "alpha_air"
    flown: str = "alpha"
    middle: float = 0.0
    total: bool = False

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.port,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        # What the model does not reach must not run away: beside an angle that is read wrong it flies less than the record shows.
        names = enumerate(shape_names(self.fine))
        return tuple(Parameter(name, self.size / (1.0 + i), self.unit, prior_std=_WIDEST * self.size / (1.0 + i)) for i, name in names)

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(shape_names(self.fine), 0.0))

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=(f"{self.load} is not linear in the angle of {'attack' if self.flown == 'alpha' else 'sideslip'}",),
            short_name=self.short_name,
            plausible=dict.fromkeys(shape_names(self.fine), (-_WIDEST * self.size, _WIDEST * self.size)),
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        at = getattr(s, self.angle)
        at = at - self.middle if self.total else at
        return {self.port: combine(natural_shapes(self.low - self.middle, self.high - self.middle, self.fine), at, p)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> LoadCurve:
        """The same over the range of angles that the record flew."""
        low, high = context.flown_range(self.flown) or (self.low, self.high)
        middle = 0.5 * (low + high) if self.total else 0.0
        return replace(self, low=low, high=high, middle=middle)

    def finer(self) -> LoadCurve:
        """The same with five finer shapes."""
        return replace(self, fine=True)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by all shapes where there is none."""
        return (Probe(self.absent, shape_names(self.fine)),)
