"""The atmosphere of a falling body: density over altitude, and drag over the Mach number."""

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

    H and rho0 are the declared values; ``change`` is a share of H. The effect acts on the logarithm
    of the drag, the only place where the density acts on a falling body.
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
        "The atmosphere is warmer or colder than the declared one, and its density falls with "
        "altitude by another scale height: rho = rho0 exp(-altitude / (H (1 + change))), with the "
        "density at altitude zero as declared. At one altitude that equals another ballistic "
        "coefficient; a fall through several scale heights tells the two apart, since the error "
        "grows with altitude. A change of temperature by one per cent changes the scale height by "
        "one per cent."
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
LOG_DRAG_STD = 1.0  # prior standard deviation of the logarithm of the drag
SPEED_PER_ROOT = math.sqrt(1.4 * 287.053)  # (m/s)/sqrt(K): air as a perfect gas


@dataclass(frozen=True)
class DragMach(WithoutStates, ProbedAtAbsence):
    """Drag that depends on the Mach number M: log drag += f(M).

    f is a natural cubic spline over ``[low, high]`` with f = 0 at ``low``, so that beta is the
    ballistic coefficient at the lowest Mach number; f is linear below it. f = sum of ``shape1`` ...
    times orthonormal shapes (`sim.maths`) of asinh((M - 1.1)/0.25), which spreads the transonic
    range, where drag changes most. The speed of sound is that of the standard atmosphere, a =
    sqrt(1.4 R T) with T = max(288.15 K - 0.0065 K/m altitude, 216.65 K). An error of it by a few
    per cent stretches f along M, without an effect on the fit.

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
        "The drag coefficient is no constant: near the speed of sound shock waves raise it, faster "
        "still it falls again. Drag = exp(f(M)) * 0.5 rho v^2 / beta, f a smooth curve of the Mach "
        "number (natural cubic spline), zero at the lowest Mach number flown, where beta holds. A "
        "body that slows down through the speed of sound shows it best. Speed and altitude fall "
        "together, so that along a single fall it resembles another density profile; falls of "
        "different speed tell the two apart."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        # The prior regularises shapes at high altitude, where there is hardly any air. A sigma of
        # one changes the drag by a factor of e.
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
        recorded_range, heights = (
            context.flown_range("velocity"),
            context.flown.get("altitude", (0.0, TROPOPAUSE_ALTITUDE)),
        )
        if recorded_range is None:
            return self
        slowest = (
            0.0
            if recorded_range[0] < 0.0 < recorded_range[1]
            else min(abs(recorded_range[0]), abs(recorded_range[1]))
        )
        low = slowest / _speed_of_sound(heights[0])
        high = max(abs(recorded_range[0]), abs(recorded_range[1])) / _speed_of_sound(heights[1])
        return replace(self, low=low, high=max(high, low + 0.1))

    def finer(self) -> DragMach:
        """Return the refined form, with five more shapes."""
        return replace(self, fine=True)


def _speed_of_sound(altitude: Any) -> Any:
    return SPEED_PER_ROOT * sqrt(maximum(SEA_LEVEL - LAPSE_RATE * altitude, TROPOPAUSE_TEMPERATURE))


def _stretched(mach: Any) -> Any:
    """Return a function of the Mach number that spreads the transonic range."""
    return asinh((mach - DRAG_RISE_MACH) / DRAG_RISE_HALF_WIDTH)


VARIANTS: tuple[Traceable, ...] = (DensityScaleHeight(), DragMach())
