"""Loads that remember which way the motion went last."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.loads import LOADS, SizedOnPorts, load_parameters
from sim.maths import absolute

WIDTHS = (0.005, 0.02, 0.06)  # rad, that a search tries: from friction to the whole of a maneuver


@dataclass(frozen=True)
class Hysteresis(SizedOnPorts):
    """memory_dot = (rate - |rate| memory)/``width``, lift += ``lift`` memory, moment += ``moment``
    memory.

    Dahl's law of friction and of hysteresis that knows no pace: the memory runs to the sign of the
    ``rate``, rad/s, while the nose turns by ``width``, rad, and stays where the nose rests. Narrow,
    it is friction; wide, flow that attaches later than it left, or a load that slides.

    Attributes
    ----------
    units, sizes : of lift and moment. needs_constants : those of the equations it is written for.
    ports : that it loads, and the names of these parameters. rate : the signal of the motion that
    is remembered.
    """

    units: tuple[str, str]
    sizes: tuple[float, float]
    needs_constants: tuple[str, ...]
    ports: tuple[str, str] = LOADS
    rate: str = "q"

    name: ClassVar[str] = "guard:hysteresis"
    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = (
        Signal("memory", "1", "which way the motion went last, -1 to 1"),
    )
    traits: ClassVar[Traits] = Traits(guard=True)
    explanation: ClassVar[str] = (
        "A generic term: lift and moment differ by which way the nose went last, whatever its "
        "pace, as with friction, flow that attaches later than "
        "it left, or a load that slides. No cause of the library stands behind it. Where it "
        "explains a record better than every effect does, the "
        "cause is none of them."
    )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (
            Parameter("width", 0.02, "rad", bounds=(1e-3, 1.0)),
            *load_parameters(self.sizes, self.units, self.ports),
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {port: getattr(p, port) * s.memory for port in self.ports}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        rate = getattr(s, self.rate)
        return ((rate - absolute(rate) * s.memory) / p.width,)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by both loads at some widths."""
        return tuple(Probe({"width": width, **self.absent}, self.ports) for width in WIDTHS)


GUARDS: tuple[Traceable, ...] = (
    Hysteresis(("1", "1"), (0.01, 0.005), ("Cm_de", "airspeed")),
    Hysteresis(("1/s", "1/s2"), (0.01, 0.1), ("M_delta",)),
    Hysteresis(("1", "1"), (0.01, 0.005), ("Cm_de", "reference_airspeed")),
)
