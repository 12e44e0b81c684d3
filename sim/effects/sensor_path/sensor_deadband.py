"""A gyro that shows nothing below a threshold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from sim.declaration.effect import Parameter, Regularity, Station
from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.controls import ABSENT, believed, half_width
from sim.effects.instances import KNOWN_OUTPUTS, large_output
from sim.maths import clip

SHARES = (0.04, 0.12, 0.3)  # of the largest reading, tried as widths


@dataclass(frozen=True)
class SensorDeadband:
    """The recorded rate is sign(v) max(|v| - half_width, 0), v the true one, before the bias is
    added.

    ``half_width`` in the unit of the channel, not negative.

    Attributes
    ----------
    channel, unit : the output it acts on. typical : the starting half width.
    """

    channel: str
    unit: str = "rad/s"
    typical: float = 0.01

    station: ClassVar[Station] = Station.SENSOR_PATH
    rank: ClassVar[int] = 6
    absent: ClassVar[Mapping[str, float]] = ABSENT
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    explanation: ClassVar[str] = (
        "A gyro does not move below a threshold, from friction in its gimbal or a dead zone of its "
        "electronics: y_recorded = sign(y) max(|y| - half_width, 0). Slow motion is not shown at "
        "all, and fast motion is shown too small by the half width. The kinematics between the "
        "rate and the other sensors show it in the one channel; a bent load obeys them."
    )

    @property
    def name(self) -> str:
        return f"sensor-deadband:{self.channel}"

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-curve:{self.channel}",)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return half_width(self.typical, self.unit)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} is not shown below +-{half_width} and too small above",),
            short_name="threshold of the sensor",
            separating={
                "sensor-curve": "motion of many sizes: a threshold takes the same off all of them"
            },
            plausible=believed(self.typical),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Shares of the largest reading."""
        flown = context.flown_range(self.channel)
        peak = max(map(abs, flown)) if flown is not None else 10.0 * self.typical
        return [Probe({"half_width": share * peak}) for share in SHARES]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        true = y[self.channel]
        return {self.channel: true - clip(true, -p.half_width, p.half_width)}


VARIANTS: tuple[Traceable, ...] = (SensorDeadband("q"),)


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """One for each rate that has none yet."""
    return tuple(
        SensorDeadband(signal.name, signal.unit, 0.05 * large_output(signal.unit))
        for signal in equations.outputs
        if signal.unit == "rad/s" and (signal.name, signal.unit) not in KNOWN_OUTPUTS
    )
