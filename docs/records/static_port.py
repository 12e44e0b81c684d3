"""A static port that feels the speed: the recorded height errs with the dynamic pressure.

flightid diagnose RECORD --model ballistic --vehicle V.toml --effects docs/records/static_port.py
"""

from dataclasses import dataclass
from typing import ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.proposal import Probe, Traits


@dataclass(frozen=True)
class StaticPort:
    """The recorded altitude is h - coefficient v^2/(2 g): the port reads coefficient times the
    dynamic pressure too much.
    """

    name = "static-port"
    station = Station.SENSOR_PATH
    channel = "altitude"
    parameters = (Parameter("coefficient", 0.02, "1", bounds=(-1.0, 1.0)),)
    absent: ClassVar = {"coefficient": 0.0}
    regularity = Regularity.REGULAR
    aliases = ("density-scale-height", "drag-mach")
    traits = Traits(
        sentences=("the static port reads {coefficient} of the dynamic pressure too much",),
        plausible={"coefficient": (-0.3, 0.3)},
    )
    explanation = (
        "A barometer takes the pressure in its bay for that of the free air. Holes in the side of "
        "a fast body feel a share of the dynamic "
        "pressure besides: dp = c rho v^2/2, which is a height of c v^2/(2 g) whatever the density."
    )

    def read(self, s, y, vehicle, p):
        return {
            "altitude": y["altitude"]
            - p.coefficient * s.velocity * s.velocity / (2.0 * vehicle.gravity)
        }

    def probes(self, context):
        return [Probe({"coefficient": 0.0}, slopes=("coefficient",))]


EFFECTS = (StaticPort(),)
