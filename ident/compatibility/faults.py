"""What may be wrong with a sensor, each under its effect's name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

BIAS, SCALE, DELAY, LAG, DRIFT, ARM = "bias", "scale", "delay", "lag", "drift", "arm"
RIGHT, BELOW = "arm-right", "arm-below"  # as ARM is ahead, along the other two axes
ARMS = (ARM, RIGHT, BELOW)
VANES = ("alpha", "beta")
BOOM = "boom"  # both vanes, on one boom
PACKAGE = "accelerometers"  # all of them, on one base
UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g", "theta": "rad", "airspeed": "m/s", "ax": "m/s2"} | {
    **{"beta": "rad", "phi": "rad", "psi": "rad", "p": "rad/s", "r": "rad/s", "ny": "g", "nx": "g", "ay": "m/s2", "az": "m/s2"},
    **{"height": "m", "altitude": "m", "wind": "m/s"},
}
_SIZES = {"alpha": 0.02, "q": 0.005, "nz": 0.05, "theta": 0.02, "airspeed": 3.0, "ax": 0.3} | {  # a bias that is worth a word
    **{"beta": 0.02, "phi": 0.02, "psi": 0.02, "p": 0.005, "r": 0.005, "ny": 0.03, "nx": 0.03, "ay": 0.3, "az": 0.5},
    **{"height": 10.0, "altitude": 10.0, "wind": 3.0},
}


@dataclass(frozen=True)
class SensorFault:
    """One way in which one channel is wrong; its ``size`` is zero where the sensor is right.

    bias: added, channel's unit. scale: the reading is (1 + size) times the true value. delay, lag: s, the reading is late.
    drift: channel's unit/s from the record's begin. arm: m, the vane (alpha, beta) or the accelerometer (nz, all others in six degrees of
    freedom) ahead of the centre of gravity; arm-right, arm-below: m, to the right of it and below.
    """

    channel: str
    kind: str
    chord: float = field(default=0.0, compare=False)  # m, zero where it is not known

    @property
    def spread(self) -> float:
        """Standard deviation of the sizes that aircraft have, infinite where nothing is stated.

        A vane on a boom metres ahead is common: 5 m, or three chords of a large aircraft. An accelerometer is mounted within about half a
        chord of the centre of gravity: 1 m, or a quarter of a chord, so that half a chord is two of these. A delay or lag, which an arm
        looks like, has the size that is common in practice.
        """
        if self.kind in (DELAY, LAG):
            return self.plausible
        if self.kind not in ARMS:
            return float("inf")
        return max(5.0, 3.0 * self.chord) if self.channel in (*VANES, BOOM) else max(1.0, 0.25 * self.chord)

    def surprise(self, size: float | np.ndarray, variance: float | np.ndarray) -> np.ndarray:
        """Log likelihood that an estimated size with its variance loses by what is known of such sizes (``spread``)."""
        return np.asarray(0.5 * np.square(size) / (self.spread**2 + variance))

    @property
    def name(self) -> str:
        """The effect's name; ``bias:CH`` for a bias, which is no effect."""
        if self.kind in ARMS:
            sensor = "vane-offset" if self.channel in (*VANES, BOOM) else "accelerometer-offset"
            of = "" if self.channel == PACKAGE or (self.channel, self.kind) == ("alpha", ARM) else f":{self.channel}"
            return f"{sensor}{self.kind.removeprefix(ARM)}{of}"
        return f"bias:{self.channel}" if self.kind == BIAS else f"sensor-{self.kind}:{self.channel}"

    @property
    def unit(self) -> str:
        """Unit of its size."""
        own = {SCALE: "1", DELAY: "s", LAG: "s"} | dict.fromkeys(ARMS, "m")
        return own.get(self.kind) or (f"{UNITS[self.channel]}/s" if self.kind == DRIFT else UNITS[self.channel])

    @property
    def plausible(self) -> float:
        """A size that is common in practice: the scale of what a record can tell."""
        own = {SCALE: 0.1, DELAY: 0.05, LAG: 0.05} | dict.fromkeys(ARMS, 5.0)
        return own.get(self.kind) or (0.05 * _SIZES[self.channel] if self.kind == DRIFT else _SIZES[self.channel])

    @property
    def worth(self) -> float:
        """The size below which a fault is no finding, however significant: what interpolation and an airspeed slightly wrong make."""
        return 0.1 * self.plausible

    @property
    def largest(self) -> float:
        """The size beyond which no fit looks, either sign."""
        own = {SCALE: 0.6, DELAY: 0.5, LAG: 0.5} | dict.fromkeys(ARMS, 60.0)
        return own.get(self.kind, 1e6)

    @property
    def one_sided(self) -> bool:
        """Whether only a positive size can be: nothing is recorded before it happens, and no vane stands behind."""
        return self.kind in (DELAY, LAG) or (self.kind == ARM and self.channel in (*VANES, BOOM))

    @property
    def rare(self) -> bool:
        """Whether something more common leaves the same trace: an accelerometer ahead is a lag of q or r, one behind an arm of the vane."""
        return self.kind == ARM and self.channel in ("nz", "az", "ny", "ay")

    @property
    def offset(self) -> float:
        """What is added to the size for the effect's own parameter: a scale is given as a factor."""
        return 1.0 if self.kind == SCALE else 0.0


def faults_of(channels: Sequence[str], *, drifts: bool, biases: bool = False, chord: float = 0.0) -> tuple[SensorFault, ...]:
    """All faults of these channels, in their order."""
    kinds = (*([BIAS] if biases else []), SCALE, DELAY, LAG, *([DRIFT] if drifts else []))
    out = [SensorFault(channel, kind) for channel in channels for kind in kinds]
    if {"alpha", "q"} <= set(channels):
        out += [SensorFault(channel, ARM, chord) for channel in ("alpha", "nz") if channel in channels]
    return tuple(out)
