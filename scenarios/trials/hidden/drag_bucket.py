"""The low drag of a laminar wing section about its design lift: another form than the library's
spline.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station


@dataclass(frozen=True)
class DragBucket:
    """drag += ``depth`` x^2 / (1 + x^2), x = (alpha - ``middle``)/``width``.

    Zero in the middle of the bucket (rad), ``depth`` (1) far outside of its ``width`` (rad); the
    gust included.
    """

    name: ClassVar[str] = "own:drag-bucket"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    parameters: ClassVar[tuple[Parameter, ...]] = (
        Parameter("depth", 0.03, "1"),
        Parameter("middle", 0.0, "rad"),
        Parameter("width", 0.05, "rad", bounds=(1e-6, 10.0)),
    )
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"depth": 0.0})
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ("drag-nonlinearity",)
    states: ClassVar[tuple[Signal, ...]] = ()
    explanation: ClassVar[str] = (
        "Within a narrow range of lift the flow stays laminar and the drag is low; outside it "
        "rises and levels off."
    )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        square = ((s.alpha_air - p.middle) / p.width) ** 2
        return {"drag": p.depth * square / (1.0 + square)}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


TERM = DragBucket()
