"""Air whose density falls with altitude faster or slower than declared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import ANOTHER_FALL


@dataclass(frozen=True)
class DensityScaleHeight:
    """rho = rho0 exp(-altitude / (H (1 + change))): the true scale height as a share above the
    declared H; rho0 stays.

    It acts on the logarithm of the drag, the only place where a falling body feels the density.
    """

    name: ClassVar[str] = "density-scale-height"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    needs_constants: ClassVar[tuple[str, ...]] = ("density_scale_height",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("change", 0.05, "1", bounds=(-0.7, 2.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"change": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=(
            "the air density falls off with a scale height {change_change} {change_direction} than "
            "declared",
        ),
        separating=dict.fromkeys(("drag-mach", "drag-jump", "sensor-scale"), ANOTHER_FALL),
        plausible={"change": (-0.4, 0.6)},
    )
    explanation: ClassVar[str] = (
        "The atmosphere is warmer or colder than the declared one, and its density falls with "
        "altitude by another scale height: rho = rho0 "
        "exp(-altitude / (H (1 + change))), with the density at altitude zero as declared. At one "
        "altitude that equals another ballistic "
        "coefficient; a fall through several scale heights tells the two apart, since the error "
        "grows with altitude. A change of temperature by "
        "one per cent changes the scale height by one per cent."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {
            "log_drag": s.altitude * p.change / (vehicle.density_scale_height * (1.0 + p.change))
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """The slope where there is none."""
        return (Probe(self.absent, ("change",)),)


VARIANTS: tuple[Traceable, ...] = (DensityScaleHeight(),)
