"""What a check of the kinematics says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sim.maths import G0


@dataclass(frozen=True)
class CompatibilitySettings:
    """What a check needs beside the records.

    ``airspeed`` (m/s) serves where none is recorded; None leaves the relation of alpha out there. ``gravity`` in m/s2; ``vane_arm`` (m)
    that is known, a finding comes on top of it. ``chord`` (m) scales where sensors usually are; zero where it is not known.
    ``false_alarm``: share of clean sets of records in which anything stands, over all faults together.
    ``most``: faults that may stand together.
    """

    airspeed: float | None = None
    gravity: float = G0
    vane_arm: float = 0.0
    chord: float = 0.0
    false_alarm: float = 0.01
    most: int = 3


@dataclass(frozen=True)
class Quantity:
    """A value and its standard deviation."""

    value: float
    std: float


@dataclass(frozen=True)
class SensorEstimate:
    """One fault alone, by both methods; the other sensors are taken as right.

    ``difference``: output error less smoother, in standard deviations of that difference. ``told``: whether the records say
    anything of it, its standard deviation below the size that is common in practice. ``gain`` of the log likelihood, over the colour of
    what is left; ``p_value`` of that gain, one-sided where only one sign can be.
    """

    name: str
    channel: str
    kind: str
    unit: str
    output_error: Quantity
    smoother: Quantity
    difference: float
    gain: float
    p_value: float
    told: bool

    @property
    def agrees(self) -> bool:
        """Whether the two methods agree within three standard deviations."""
        return abs(self.difference) <= 3.0


@dataclass(frozen=True)
class SensorFinding:
    """One fault tested against coloured residuals, beside the faults that stand.

    ``kind``: scale, delay, lag, drift or arm; ``name`` the effect's name. ``value`` is the effect's own parameter: a scale is a factor.
    ``gain`` of the log likelihood. ``stands``: the fault, or one of its ``group`` (names), is needed. ``replicates``: the records by
    themselves agree; always so for one record. ``lost``: log likelihood lost with it in the place of the nearest that stands, zero for the
    best of a group; None where nothing stands, or where it has been refused.
    ``probabilities`` of the fault and its group by name: of their likelihoods and of how far sensors usually are from the centre of gravity.
    """

    channel: str
    kind: str
    value: float
    std: float
    unit: str
    gain: float
    stands: bool
    group: tuple[str, ...]
    name: str = ""
    replicates: bool = True
    lost: float | None = None
    probabilities: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """One record: by output, what was measured, what the kinematics make of the other channels, and what is left. ``(N,)`` each, SI.

    ``recorded`` follows from the measured inputs as they are, ``integrated`` from them less the faults that stand, ``smoothed`` also from the
    output; ``used`` is False where a sample is missing or set aside.
    """

    record: str
    time: np.ndarray
    measured: Mapping[str, np.ndarray]
    recorded: Mapping[str, np.ndarray]
    integrated: Mapping[str, np.ndarray]
    smoothed: Mapping[str, np.ndarray]
    used: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class CheckResult:
    """A check of one record, or of several together (``records``: their names).

    ``biases``: of one record only. ``noise_std`` by channel, unit of the channel: of the outputs, and of the inputs as their integral shows it.
    """

    records: tuple[str, ...]
    estimates: tuple[SensorEstimate, ...]
    biases: tuple[SensorEstimate, ...]
    findings: tuple[SensorFinding, ...]
    noise_std: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Compatibility:
    """The result of ``compatibility``.

    Attributes
    ----------
    channels : all that were looked at. relations : by output, the channels that its relation joins.
    joint : all records together, sensor faults in common; ``single``: each by itself, empty where that was not asked.
    cannot_tell : sentences, from the information of the records. notes : what else there is to say.
    """

    channels: tuple[str, ...]
    relations: Mapping[str, tuple[str, ...]]
    joint: CheckResult
    single: tuple[CheckResult, ...]
    reconstructions: tuple[Reconstruction, ...]
    cannot_tell: tuple[str, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def findings(self) -> tuple[SensorFinding, ...]:
        """Those of all records together, the standing ones first."""
        return self.joint.findings
