"""Backlash in the bearing of a vane, and the threshold of a gyro."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sim.declaration.model import Equations
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.instances import (
    HalfWidth,
    OfChannel,
    backlash,
    further_outputs,
    large_output,
)
from sim.maths import clip, each_column, trailing

# Trial half widths: shares of half the range of a vane's readings, or of a gyro's largest reading.
TRIAL_SHARES = (0.04, 0.12, 0.3)
VANES = ("alpha", "beta")


@dataclass(frozen=True)
class SensorBacklash(HalfWidth, OfChannel):
    """Backlash: the recorded angle y follows the true angle v at a distance of ``half_width``.

    y does not move while |v - y| < half_width. ``half_width`` is in rad, not negative. The record
    starts at the true value, in the middle of the play.

    Attributes
    ----------
    channel, unit : name and unit of the output.
    typical : starting half width.
    """

    channel: str
    unit: str = "rad"
    typical: float = 0.005

    family: ClassVar[str] = "sensor-backlash"
    path_order: ClassVar[int] = 8
    explanation: ClassVar[str] = (
        "Play of a vane, in its bearing or its linkage. The pick-off rests until the vane has "
        "crossed the play, and then follows: y_recorded = y - half_width while the angle y rises "
        "and y + half_width while it falls. After each reversal the angle changes by twice the "
        "half width before the reading changes, so the reading is too small and late. A delay is "
        "the same for all sizes of motion, whereas play has a larger effect on small motion. The "
        "kinematics, with a rate and a load factor, show that only this channel is wrong."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-lag:{self.channel}", f"sensor-delay:{self.channel}")

    @property
    def traits(self) -> Traits:
        small = "small and large motion: play loses the same angle at each reversal, a delay more"
        return Traits(
            sentences=("the {channel} sensor has a play of +-{half_width} (hysteresis)",),
            short_name="play of the sensor",
            separating=dict.fromkeys(("sensor-lag", "sensor-delay"), small),
            plausible=self.plausible,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe shares of half the range of the readings."""
        recorded = context.flown_range(self.channel)
        half = 0.5 * (recorded[1] - recorded[0]) if recorded else 10.0 * self.typical
        return [Probe({"half_width": share * half}) for share in TRIAL_SHARES]

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        """Return the recorded channel; exact for one that is linear in time within sub-steps."""
        begin, end = np.asarray(begin), np.asarray(end)
        depth = max(begin.ndim, end.ndim) - 1
        begin, end = trailing(begin, depth), trailing(end, depth)
        shape = np.broadcast_shapes(begin.shape[1:], end.shape[1:])
        row = np.empty((2 * len(end) + 1, *shape), dtype=np.result_type(begin, end))
        row[::2], row[1::2] = begin, end
        out = each_column(backlash, row, p.half_width)
        return out[::2], out[1::2]


@dataclass(frozen=True)
class SensorDeadband(HalfWidth, OfChannel):
    """Dead band: the recorded rate is sign(v) max(|v| - half_width, 0) plus the bias, where v is
    the true rate.

    ``half_width`` is in the unit of the channel, not negative.

    Attributes
    ----------
    channel, unit : name and unit of the output.
    typical : starting half width.
    """

    channel: str
    unit: str = "rad/s"
    typical: float = 0.01

    family: ClassVar[str] = "sensor-deadband"
    path_order: ClassVar[int] = 6
    explanation: ClassVar[str] = (
        "Threshold of a gyro: because of friction in its gimbal or a dead zone of its electronics, "
        "y_recorded = sign(y) max(|y| - half_width, 0). Slow motion is not recorded at all, and "
        "fast motion is recorded too small by the half width. The kinematics between the rate and "
        "the other sensors show that only this channel is wrong. A nonlinear load, in contrast, "
        "changes the motion, and all channels then agree."
    )

    @property
    def aliases(self) -> tuple[str, ...]:
        return (f"sensor-curve:{self.channel}",)

    @property
    def traits(self) -> Traits:
        return Traits(
            sentences=("the {channel} is not shown below +-{half_width} and too small above",),
            short_name="threshold of the sensor",
            separating={
                "sensor-curve": "motion of many sizes: a threshold takes the same off all of them"
            },
            plausible=self.plausible,
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        """Probe shares of the largest reading."""
        recorded = context.flown_range(self.channel)
        peak = max(map(abs, recorded)) if recorded else 10.0 * self.typical
        return [Probe({"half_width": share * peak}) for share in TRIAL_SHARES]

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        true = y[self.channel]
        return {self.channel: true - clip(true, -p.half_width, p.half_width)}


VARIANTS: tuple[Traceable, ...] = (SensorBacklash("alpha"), SensorDeadband("q"))


def made_for(equations: Equations) -> tuple[Traceable, ...]:
    """Return a backlash for each vane and a threshold for each rate that ``VARIANTS`` does not
    cover.
    """
    further = further_outputs(equations)
    return (
        *(SensorBacklash(s.name, s.unit) for s in further if s.name in VANES and s.unit == "rad"),
        *(
            SensorDeadband(s.name, s.unit, 0.05 * large_output(s.unit))
            for s in further
            if s.unit == "rad/s"
        ),
    )
