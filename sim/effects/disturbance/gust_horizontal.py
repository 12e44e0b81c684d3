"""A single gust from ahead of one-minus-cosine shape."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.airflow import PLAUSIBLE, calm_air, gust_parameters, gust_probes, gust_speed


@dataclass(frozen=True)
class GustHorizontal:
    """The aircraft crosses one gust from ahead, w(t) = (peak/2) (1 - cos(2 pi (t -
    start)/duration)).

    ``peak`` in m/s, positive from ahead; ``start`` and ``duration`` in s. w adds to the airspeed in
    the loads and in the reading of the pitot tube, not to the state.

    Attributes
    ----------
    lasting, fine : as of a gust from below, see ``sim.effects.airflow``: one that stays at its
    peak; a freer course.
    """

    lasting: bool = False
    fine: bool = False

    name: ClassVar[str] = "gust-horizontal"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("headwind",)
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ("unmeasured-input",)
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("a single gust of {peak} from ahead comes at {start} and lasts {duration}",),
        plausible=dict(PLAUSIBLE),
        lasts="duration",
        onset="start",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "The wind from ahead freshens once: w(t) = (peak/2) (1 - cos(2 pi (t - start)/duration)) "
        "between start and start + duration. The air then "
        "meets the aircraft faster by w than it moves: the pitot tube shows V + w at once, lift "
        "and drag grow with (V + w)^2, and the aircraft "
        "itself gains and loses speed only slowly. An airspeed that jumps without any axial load "
        "factor before it, and a load factor that follows "
        "it, are its mark. A second form keeps the peak after half the duration: the wind has "
        "changed for good, as in a shear. Either has a freer "
        "form with three shapes more."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return gust_parameters(self.fine)

    @property
    def absent(self) -> Mapping[str, float]:
        return calm_air(self.fine)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"headwind": gust_speed(s.time, p, self.lasting, self.fine)}

    def finer(self) -> GustHorizontal:
        """The same with a freer course."""
        return replace(self, fine=True)

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return gust_probes(context, self.fine)


VARIANTS: tuple[Traceable, ...] = (GustHorizontal(), GustHorizontal(lasting=True))
