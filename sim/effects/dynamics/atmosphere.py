"""Atmosphere and drag of a falling body: density over altitude, drag over the Mach number."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import SearchContext, Traceable, Traits
from sim.effects.instances import ANOTHER_FALL, ProbedAtAbsence, WithoutStates
from sim.maths import Shapes, absolute, asinh, combine, maximum, natural_shapes, shape_names, sqrt


@dataclass(frozen=True)
class DensityScaleHeight(WithoutStates, ProbedAtAbsence):
    """Scale height of the density: rho = rho0 exp(-altitude / (H (1 + change))).

    H and rho0 are the declared values; ``change`` is a share of H. The effect adds to the logarithm
    of the drag, because the density of the air acts on a falling body through the drag only.
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
    traits: ClassVar[Traits] = Traits(
        sentences=(
            "the air density falls off with a scale height {change_change} {change_direction} than "
            "declared",
        ),
        separating=dict.fromkeys(("drag-mach", "drag-jump", "sensor-scale"), ANOTHER_FALL),
        plausible={"change": (-0.4, 0.6)},
    )
    explanation: ClassVar[str] = (
        "Another density scale height: the density of the air is rho = rho0 exp(-altitude / (H (1 "
        "+ change))). The cause is an atmosphere that is warmer or colder than the declared one; "
        "the density at altitude zero is as declared. At a single altitude this is the same as "
        "another ballistic coefficient. A fall through several scale heights distinguishes the "
        "two, since the error grows with altitude. A change of the temperature by one per cent "
        "changes the scale height by one per cent."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {
            "log_drag": s.altitude * p.change / (vehicle.density_scale_height * (1.0 + p.change))
        }


DRAG_RISE_MACH = 1.1  # Mach number about which drag changes most
DRAG_RISE_HALF_WIDTH = 0.25  # half width of that range, Mach
SEA_LEVEL = 288.15  # K, standard atmosphere
LAPSE_RATE = 0.0065  # K/m, standard atmosphere
TROPOPAUSE_TEMPERATURE = 216.65  # K, standard atmosphere above 11 km
TROPOPAUSE_ALTITUDE = 11000.0  # m, the tropopause of the standard atmosphere
# Prior standard deviation of the logarithm of the drag: one sigma is a factor of e.
LOG_DRAG_STD = 1.0
SOUND_SPEED_PER_ROOT_KELVIN = math.sqrt(1.4 * 287.053)  # (m/s)/sqrt(K), air as a perfect gas


@dataclass(frozen=True)
class DragMach(WithoutStates, ProbedAtAbsence):
    """Drag that depends on the Mach number M: log drag += f(M).

    f is a natural cubic spline over ``[low, high]`` with f = 0 at ``low``, so that beta is the
    ballistic coefficient at the lowest Mach number; f is linear below it. f = sum of ``shape1`` ...
    times orthonormal shapes (`sim.maths`) of asinh((M - 1.1)/0.25). This argument spreads the
    transonic range, where drag changes most. The speed of sound is that of the standard atmosphere,
    a = sqrt(1.4 R T) with T = max(288.15 K - 0.0065 K/m altitude, 216.65 K). An error of a few per
    cent in it stretches f along M and does not change the fit.

    Attributes
    ----------
    low, high : range of the Mach number in the record.
    fine : use ten shapes instead of five; the first five are the same.
    """

    low: float = 0.5
    high: float = 6.0
    fine: bool = False

    name: ClassVar[str] = "drag-mach"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    needs_constants: ClassVar[tuple[str, ...]] = ("beta",)
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("density-scale-height",)
    explanation: ClassVar[str] = (
        "Drag depends on the Mach number M. Shock waves increase it near the speed of sound, and "
        "it decreases again at higher speeds. Drag = exp(f(M)) * 0.5 rho v^2 / beta, where f is a "
        "smooth curve (natural cubic spline). f is zero at the lowest Mach number flown, where "
        "beta is the ballistic coefficient. A body that decelerates through the speed of sound "
        "shows the curve best. Speed and altitude decrease together, so in a single fall the curve "
        "resembles another density profile. Falls of different speed distinguish the two."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        # The prior regularises shapes at high altitude, where there is hardly any air.
        shapes = enumerate(shape_names(self.fine, flat=False))
        return tuple(
            Parameter(name, 0.2 / (1.0 + i), "1", prior_std=LOG_DRAG_STD / (1.0 + i))
            for i, name in shapes
        )

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(shape_names(self.fine, flat=False), 0.0))

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the drag changes with the Mach number",),
            separating={"drag-jump": ANOTHER_FALL, "sensor-scale": ANOTHER_FALL},
            plausible=dict.fromkeys(shape_names(self.fine, flat=False), (-3.0, 3.0)),
        )

    @property
    def shapes(self) -> Shapes:
        """The shapes as functions of the stretched Mach number."""
        low, high = _stretched(self.low), _stretched(self.high)
        return natural_shapes(low, high, self.fine, low, False)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {
            "log_drag": combine(
                self.shapes, _stretched(absolute(s.velocity) / _speed_of_sound(s.altitude)), p
            )
        }

    def fitted_to(self, context: SearchContext) -> DragMach:
        """Return the effect over the Mach numbers of the record.

        The lowest Mach number is at the lowest altitude, where a fall is slowest.
        """
        speeds = context.flown_range("velocity")
        if speeds is None:
            return self
        heights = context.flown.get("altitude", (0.0, TROPOPAUSE_ALTITUDE))
        slowest = 0.0 if speeds[0] < 0.0 < speeds[1] else min(map(abs, speeds))
        low = slowest / _speed_of_sound(heights[0])
        high = max(map(abs, speeds)) / _speed_of_sound(heights[1])
        return replace(self, low=low, high=max(high, low + 0.1))

    def finer(self) -> DragMach:
        """Return the refined form, with five more shapes."""
        return replace(self, fine=True)


def _speed_of_sound(altitude: Any) -> Any:
    """Return the speed of sound of the standard atmosphere, m/s, at an altitude, m."""
    return SOUND_SPEED_PER_ROOT_KELVIN * sqrt(
        maximum(SEA_LEVEL - LAPSE_RATE * altitude, TROPOPAUSE_TEMPERATURE)
    )


def _stretched(mach: Any) -> Any:
    """Return a function of the Mach number that spreads the transonic range."""
    return asinh((mach - DRAG_RISE_MACH) / DRAG_RISE_HALF_WIDTH)


VARIANTS: tuple[Traceable, ...] = (DensityScaleHeight(), DragMach())
