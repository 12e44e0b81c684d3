"""Lift and moment that nobody recorded, from one time to another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Signal, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.effects.loads import load_parameters
from sim.effects.onset import WIDTH, edge_width, risen

DURATIONS = (0.3, 0.7, 1.5, 3.0, 6.0)  # s, pulses that a search tries


@dataclass(frozen=True)
class UnmeasuredInput:
    """A pulse of lift and moment from ``start`` on for ``duration``, both s; a step where it lasts to the record's end.

    ``lift`` and ``moment`` are free: coefficients on the rigid aircraft, 1/s of alpha_dot and 1/s2 on the low-order
    equivalent system. The edges rise over ``width`` s, centred on their times.

    Attributes
    ----------
    lasting : a step without ``duration``. width : of the edges, s. units, sizes : of lift and moment.
    needs_constants : those of the equations it is written for.
    """

    lasting: bool = False
    width: float = WIDTH
    units: tuple[str, str] = ("1", "1")
    sizes: tuple[float, float] = (0.02, 0.01)
    needs_constants: tuple[str, ...] = ("Cm_alpha",)

    name: ClassVar[str] = "unmeasured-input"
    station: ClassVar[Station] = Station.DISTURBANCE
    needs: ClassVar[tuple[str, ...]] = ("lift", "moment")
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Something pushed the aircraft that no channel shows: a flap, a speed brake, another surface, thrust that pitches, a store let go. CL += "
        "lift and Cm += moment between start and start + duration, or from start on for good. The motion begins without any recorded input and "
        "follows the aircraft's own short period. A gust does so too, but it acts through the angle of attack and moves the vane at once, so that "
        "its lift and moment stand in the ratio of CL_alpha to Cm_alpha."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        duration = () if self.lasting else (Parameter("duration", 1.5, "s", bounds=(0.02, 1000.0)),)
        loads = load_parameters(self.sizes, self.units)
        return (Parameter("start", 2.0, "s"), *duration, *loads)

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType({"lift": 0.0, "moment": 0.0})

    @property
    def traits(self) -> Traits:
        lift, moment = (30.0 * size for size in self.sizes)
        return Traits(
            sentences=(
                "something that is not recorded acts for {duration} from {start}: {rest}",
                "something that is not recorded acts from {start} on: {rest}",
            ),
            plausible={"lift": (-lift, lift), "moment": (-moment, moment)},
            lasts="duration",
            onset="start",
            per_record=True,
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        share = risen(s.time, p.start, self.width)
        if not self.lasting:
            share = share - risen(s.time, p.start + p.duration, self.width)
        return {"lift": share * p.lift, "moment": share * p.moment}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> UnmeasuredInput:
        """The same with edges of one sub-step of that record."""
        return replace(self, width=edge_width(context.interval))

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by lift and moment at the record's begin, for some durations; a later start only shifts them."""
        start = {"start": context.begin + self.width, **self.absent}
        if self.lasting:
            return (Probe(start, ("lift", "moment"), shifts=True),)
        durations = [duration for duration in DURATIONS if 2.0 * context.interval <= duration <= 0.5 * context.duration]
        return tuple(Probe({**start, "duration": duration}, ("lift", "moment"), shifts=True) for duration in durations)


VARIANTS: tuple[Traceable, ...] = (
    UnmeasuredInput(),
    UnmeasuredInput(lasting=True),
    UnmeasuredInput(units=("1/s", "1/s2"), sizes=(0.01, 0.1), needs_constants=("M_alpha",)),
    UnmeasuredInput(lasting=True, units=("1/s", "1/s2"), sizes=(0.01, 0.1), needs_constants=("M_alpha",)),
)
