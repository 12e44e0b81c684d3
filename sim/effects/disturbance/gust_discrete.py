"""A single gust across the flight path of one-minus-cosine shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.airflow import PLAUSIBLE, calm_air, gust_parameters, gust_probes, gust_speed


@dataclass(frozen=True)
class GustDiscrete:
    """The aircraft crosses one gust w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)).

    ``peak`` in m/s, positive upward; ``start`` and ``duration`` in s. Outside the gust w = 0. w/V
    adds to the angle of attack in the loads and in the vane's reading, not to the state; V is the
    declared airspeed.

    Attributes
    ----------
    lasting : the first half only, and w stays at its peak after it (MIL-F-8785C, 3.7.1.3; its
    length is V duration/2). fine : w + the sum of ``shape1`` ... ``shape3`` (m/s) times sin(k pi
    x), x from 0 to 1 over the gust, or over its rise, less what would
        change the peak: gusts that begin with a kink, rise faster than they fall, or are flat on
        top.
    speed : the constant that is the declared airspeed. On lateral equations the air comes from the
    right, and sideslip takes the place of alpha.
    """

    lasting: bool = False
    fine: bool = False
    speed: str = "airspeed"

    name: ClassVar[str] = "gust-discrete"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("gust",)
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("a single gust of {peak} comes at {start} and lasts {duration}",),
        plausible=dict(PLAUSIBLE),
        lasts="duration",
        onset="start",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "Rising air meets the aircraft once: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)) "
        "between start and start + duration, the usual "
        "design gust. The air then comes from below by w/V more than the motion tells, in CL, in "
        "Cm and in the vane's reading, while the angle of "
        "attack as a state only follows. The vane jumps ahead of the pitch rate, which no control "
        "input can do. The length of the gust in the air "
        "is V times its duration. A second form keeps the peak after half the duration: the "
        "aircraft has flown into air that rises for good. "
        "Either has a freer form, with three shapes more: gusts that begin with a kink, rise "
        "faster than they fall, or are flat on top. "
        "On the lateral model the air comes from the right: sideslip, side force, roll and yaw "
        "stand where angle of attack, lift and pitch do here."
    )

    @property
    def needs_constants(self) -> tuple[str, ...]:
        return (self.speed,)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return gust_parameters(self.fine)

    @property
    def absent(self) -> Mapping[str, float]:
        return calm_air(self.fine)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {
            "gust": gust_speed(s.time, p, self.lasting, self.fine) / getattr(vehicle, self.speed)
        }

    def finer(self) -> GustDiscrete:
        """The same with a freer course."""
        return replace(self, fine=True)

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return gust_probes(context, self.fine)


VARIANTS: tuple[Traceable, ...] = tuple(
    GustDiscrete(lasting, speed=speed)
    for speed in ("airspeed", "reference_airspeed")
    for lasting in (False, True)
)
