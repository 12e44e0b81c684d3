"""Loads that swing at one frequency, whatever the aircraft does."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.declaration.user_equations import OwnEquations
from sim.effects.instances import labelled, ports_without
from sim.effects.loads import LOADS
from sim.maths import cos, once_for_alike

SPACING = 1.12  # of the frequencies tried, besides the peaks of the residual's spectrum
FASTEST = 60.0  # rad/s
# ports that swing as one, as lift and moment do; each further one has two more sizes to pay for
TOGETHER = 2


@dataclass(frozen=True)
class PeriodicLoads:
    """lift += ``lift_cos`` cos(w t) + ``lift_sin`` sin(w t), moment alike, w the ``frequency`` in
    rad/s.

    A rotor, a limit cycle of the control system, somebody who pumps the stick: forcing that does
    not depend on the state.

    Attributes
    ----------
    units, sizes : of lift and moment. needs_constants : those of the equations it is written for.
    ports : that it loads; they name the parameters. label : of the name, where there are several.
    """

    units: tuple[str, ...]
    sizes: tuple[float, ...]
    needs_constants: tuple[str, ...]
    ports: tuple[str, ...] = LOADS
    label: str = ""

    station: ClassVar[Station] = Station.DYNAMICS
    regularity: ClassVar[Regularity] = Regularity.UNDEFINED
    aliases: ClassVar[tuple[str, ...]] = ("elastic-mode",)
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits(
        per_record=True,
        guard=True,
    )

    @property
    def name(self) -> str:
        return labelled("guard:periodic-loads", self.label)

    @property
    def explanation(self) -> str:
        loads, of = " and ".join(port.replace("_", " ") for port in self.ports), self.ports[-1]
        return (
            f"A generic term: {loads} swing{'' if len(self.ports) > 1 else 's'} at one frequency "
            "all through the record, "
            f"{of.replace('_', ' ')} += {of}_cos cos(w t) + {of}_sin sin(w t), whatever the "
            "controls and the vehicle do. No cause of the library "
            "does that. Where it explains a record better than every effect does, the cause is "
            "none of them."
        )

    @property
    def needs(self) -> tuple[str, ...]:
        return self.ports

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(
            {f"{port}_{part}": 0.0 for port in self.ports for part in ("cos", "sin")}
        )

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        sized = zip(self.ports, self.sizes, self.units, strict=True)
        loads = (
            Parameter(f"{port}_{part}", size, unit)
            for port, size, unit in sized
            for part in ("cos", "sin")
        )
        return (Parameter("frequency", 6.0, "rad/s", bounds=(0.2, 400.0)), *loads)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        even = once_for_alike(lambda frequency: cos(frequency * s.time), p.frequency)
        odd = once_for_alike(lambda frequency: cos(frequency * s.time - 0.5 * math.pi), p.frequency)
        return {
            port: getattr(p, f"{port}_cos") * even + getattr(p, f"{port}_sin") * odd
            for port in self.ports
        }

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Slopes by all four sizes at the peaks of the residual's spectrum, then over a grid."""
        slowest, fastest = (
            max(1.0, 6.0 * math.pi / max(context.duration, 1.0)),
            min(0.5 * math.pi / context.interval, FASTEST),
        )
        count = max(2, math.ceil(math.log(max(fastest / slowest, 1.1)) / math.log(SPACING)))
        grid = [slowest * (fastest / slowest) ** (i / (count - 1)) for i in range(count)]
        peaks = [
            frequency for frequency in context.residual_peaks if slowest <= frequency <= fastest
        ]
        return tuple(
            Probe({"frequency": frequency, **self.absent}, tuple(self.absent))
            for frequency in (*peaks, *grid)
        )


GUARDS: tuple[Traceable, ...] = (
    PeriodicLoads(("1", "1"), (0.01, 0.01), ("Cm_de",)),
    PeriodicLoads(("1/s", "1/s2"), (0.01, 0.1), ("M_delta",)),
    PeriodicLoads(("1", "1"), (0.002, 0.002), ("Cn_dr",), ("roll", "yaw")),
)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One on the ports of a user's own model whose rates an estimated parameter is part of; one
    each where there are more than two.
    """
    if not isinstance(equations, OwnEquations):
        return ()
    moved = {port for port, _, _ in equations.products}
    ports = [port for port in ports_without(GUARDS, equations) if port.name in moved]
    together = [ports] if 0 < len(ports) <= TOGETHER else [[port] for port in ports]
    return tuple(
        PeriodicLoads(
            tuple(p.unit for p in some),
            (1.0,) * len(some),
            (),
            tuple(p.name for p in some),
            some[0].name if len(together) > 1 else "",
        )
        for some in together
    )
