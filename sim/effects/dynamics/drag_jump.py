"""Drag of a falling body that changes at one time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import ANOTHER_FALL
from sim.effects.timing import SLOW_WIDTH, edge_width, risen
from sim.maths import log


@dataclass(frozen=True)
class DragJump:
    """From ``time`` (s) on the drag is ``factor`` times as large; beta is the ballistic coefficient
    before.

    log drag += ln(1 + (factor - 1) e), e an edge that rises over ``width`` s, centred on ``time``.
    """

    width: float = SLOW_WIDTH

    name: ClassVar[str] = "drag-jump"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("log_drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("time", 8.0, "s"),
        Parameter("factor", 1.3, "1", bounds=(1e-3, 1e3)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"factor": 1.0})
    regularity: ClassVar[Regularity] = Regularity.CHANGE_POINT
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        sentences=("the drag is multiplied by {factor} from {time} on",),
        separating={"sensor-scale": ANOTHER_FALL},
        plausible={"factor": (0.05, 20.0)},
        onset="time",
        per_record=True,
    )
    explanation: ClassVar[str] = (
        "At one time the body changes: a heat shield is dropped, a drogue opens, a fin breaks, it "
        "starts to tumble. From then on the drag is "
        "another multiple of the dynamic pressure, drag = factor * 0.5 rho v^2 / beta. The "
        "altitude itself shows no step, only its curvature does: "
        "the residual bends from that time on. High up, where there is hardly any air, a change "
        "leaves no trace until the air thickens."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"log_drag": log(1.0 + risen(s.time, p.time, self.width) * (p.factor - 1.0))}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def fitted_to(self, context: SearchContext) -> DragJump:
        """The same with an edge that sub-steps of that record resolve."""
        return replace(self, width=edge_width(context.interval, SLOW_WIDTH))

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slope by the factor at 36 times."""
        return tuple(Probe({"time": time, "factor": 1.0}, ("factor",)) for time in context.onsets())


VARIANTS: tuple[Traceable, ...] = (DragJump(),)
