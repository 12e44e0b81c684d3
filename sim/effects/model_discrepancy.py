"""Forces and moments that no term of the model gives: a random history of each load."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Effect, Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traits
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.loads import LOADS, SizedOnPorts


@dataclass(frozen=True)
class ModelDiscrepancy(SizedOnPorts):
    """Each load port has a first-order Gauss-Markov process.

    Its standard deviation is the parameter named like the port, its correlation time ``time``.

    It is the model discrepancy of Kennedy and O'Hagan, put where the model of an aircraft errs: in
    its forces and moments.
    """

    units: tuple[str, ...] = ("1", "1")
    sizes: tuple[float, ...] = (0.02, 0.01)
    needs_constants: tuple[str, ...] = ("Cm_alpha",)
    ports: tuple[str, ...] = LOADS
    label: str = ""

    name: ClassVar[str] = "model-discrepancy"
    station: ClassVar[Station] = Station.DISTURBANCE
    regularity: ClassVar[Regularity] = Regularity.PROCESS_NOISE
    aliases: ClassVar[tuple[str, ...]] = ()
    traits: ClassVar[Traits] = Traits(background=True)
    explanation: ClassVar[str] = "What a dozen small causes add to the forces and moments."

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        sizes = tuple(
            Parameter(port, 0.1 * size, unit, bounds=(0.0, 30.0 * size))
            for port, size, unit in zip(self.ports, self.sizes, self.units, strict=True)
        )
        return (*sizes, Parameter("time", 0.5, "s", free=False))

    @property
    def absent(self) -> Mapping[str, float]:
        return MappingProxyType(dict.fromkeys(self.ports, 0.0))

    @property
    def states(self) -> tuple[Signal, ...]:
        return tuple(
            Signal(f"discrepancy_{port}", unit, f"discrepancy of {port.replace('_', ' ')}")
            for port, unit in zip(self.ports, self.units, strict=True)
        )

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {port: getattr(s, f"discrepancy_{port}") for port in self.ports}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return tuple(-getattr(s, f"discrepancy_{port}") / p.time for port in self.ports)

    def density(self, vehicle: Any, p: Any) -> Sequence[Any]:
        """Spectral density of the noise on each state's rate."""
        return tuple(2.0 * getattr(p, port) ** 2 / p.time for port in self.ports)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return ()


def discrepancy_for(effects: Sequence[Effect]) -> ModelDiscrepancy | None:
    """A discrepancy of each load that an unmeasured input can act on; None where none can.

    Parameters
    ----------
    effects : those that apply to a vehicle's equations.
    """
    loads = [each for each in effects if isinstance(each, UnmeasuredInput) and not each.lasting]
    if not loads:
        return None
    constants = dict.fromkeys(name for load in loads for name in load.needs_constants)
    return ModelDiscrepancy(
        tuple(unit for load in loads for unit in load.units),
        tuple(size for load in loads for size in load.sizes),
        tuple(constants),
        tuple(port for load in loads for port in load.ports),
    )
