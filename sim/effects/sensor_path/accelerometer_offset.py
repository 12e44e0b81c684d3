"""An accelerometer away from the centre of gravity."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

from sim.declaration.effect import Regularity, Station
from sim.declaration.parameters import Parameter
from sim.declaration.proposal import Probe, SearchContext, Traceable
from sim.declaration.traits import Traits
from sim.maths.constants import G0

MEASURE_IT = (
    "no maneuver does while lift and moment are linear: measure where the instruments sit, or ask which lift of the control surface can be "
    "(CL_de, L_delta; it differs most)"
)


@dataclass(frozen=True)
class AccelerometerOffset:
    """The accelerometer sits ``arm`` metres ahead of the centre of gravity: nz_m = nz + (arm/g0) q_dot.

    ``arm`` in m, either sign, positive ahead. q_dot is that of the equations of motion at the same time, with what elastic modes, gusts and
    other effects add to it; with a held input it jumps as the input does.
    """

    name: ClassVar[str] = "accelerometer-offset:nz"
    channel: ClassVar[str] = "nz"
    rates_read: ClassVar[tuple[str, ...]] = ("q",)
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("arm", 3.0, "m", bounds=(-100.0, 100.0)),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"arm": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ("vane-offset",)
    traits: ClassVar[Traits] = Traits(
        sentences=("the accelerometer sits {arm_side} the centre of gravity and feels the pitch acceleration",),
        short_name="accelerometer away from the centre of gravity",
        separating={"vane-offset": MEASURE_IT},
        twins=("vane-offset",),
        equivalents=("vane-offset", "guard:vane-behind"),
        plausible={"arm": (-40.0, 40.0)},
    )
    explanation: ClassVar[str] = (
        "An accelerometer ahead of the centre of gravity is lifted when the nose accelerates upward: nz_m = nz + (arm/g0) q_dot, arm in m, positive "
        "ahead, negative behind. The pitch acceleration answers the elevator at once, so the reading jumps when the elevator does, down first for "
        "one that is ahead. To the kinematics alpha_dot = q - (g/V) nz an accelerometer at arm is the same as a vane at -arm, and the short period "
        "keeps its form with alpha - (arm/V) q in the place of alpha: CL_de, CL_q, CL_alpha and Cm_q take other values and every sample is the same. "
        "No maneuver tells the two apart while lift and moment are linear; only where the instruments sit does, or a CL_de that no tail could make. "
        "The library has no vane behind the centre of gravity: where the declared derivatives speak for one, an accelerometer ahead is not claimed."
    )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"arm": 0.0}, ("arm",))]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"nz": y["nz"] + p.arm / G0 * s.q_dot}


VARIANTS: tuple[Traceable, ...] = (AccelerometerOffset(),)
