"""Catch-all term: a vane in the flow that a control surface turns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Traceable, Traits
from sim.effects.instances import ProbedAtAbsence
from sim.effects.loads import NO_CAUSE


@dataclass(frozen=True)
class VaneNearControl(ProbedAtAbsence):
    """The reading of a flow angle v is v + ``gain`` d, where d is the deflection of a control.

    A canard, a flap, or a surface near the vane turns the flow there. ``gain`` is in rad per unit
    of the control.

    Attributes
    ----------
    channel : name of the flow angle.
    control : signal of the control.
    needs_constants : constants that the equations must have.
    """

    channel: str
    control: str
    needs_constants: tuple[str, ...]

    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("gain", 0.1, "1"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"gain": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    name: ClassVar[str] = "guard:vane-near-control"

    @property
    def explanation(self) -> str:
        return (
            f"A generic term: a share of the {self.control} adds to the reading of {self.channel}: "
            f"{self.channel}_m = {self.channel} + gain {self.control}. The cause is a vane in the "
            f"flow that a control surface turns. {NO_CAUSE}"
        )

    @property
    def traits(self) -> Traits:
        return Traits(guard=True)

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel: y[self.channel] + p.gain * getattr(s, self.control)}


GUARDS: tuple[Traceable, ...] = (
    VaneNearControl("alpha", "elevator", ("Cm_de",)),
    VaneNearControl("alpha", "delta", ("M_delta",)),
    VaneNearControl("beta", "rudder", ("Cn_dr",)),
)
