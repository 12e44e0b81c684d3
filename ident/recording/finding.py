"""What the raw columns of a record show: one finding, and how certain it is."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

NO_ROWS = np.zeros(0, dtype=bool)


class Kind(Enum):
    """What may be wrong with a recording."""

    HELD = "held"
    INTERPOLATED = "interpolated"
    FILTERED = "filtered"
    STUCK = "stuck"
    CLIPPED = "clipped"
    DROPOUT = "dropout"
    WILD_POINTS = "wild points"
    ROWS_MISSING = "rows missing"
    RESOLUTION = "resolution"
    ZERO_STEP = "zero step"
    NOISE_LEVEL = "noise level"
    HUM = "hum"
    UNIT = "unit"
    SIGN = "sign"
    EXCHANGED = "exchanged"
    TIME_BASE = "time base"


class Certainty(Enum):
    """What follows: a record is refused, the reader is warned, samples are set aside, or it is only said."""

    CERTAIN = "certain"
    LIKELY = "likely"
    COSTS_INFORMATION = "costs information"
    NOTED = "noted"


@dataclass(frozen=True)
class Number:
    """A figure of a finding with its unit, SI and radians, nz in g."""

    value: float
    unit: str


@dataclass(frozen=True, eq=False)
class Finding:
    """One thing that the raw columns show.

    Attributes
    ----------
    channel : the channel's name, several joined by " and ", or ``"time"``.
    sentence : what is seen, as it goes on from the channel's name. remedy : what its user can do; empty where there is nothing to do.
    times : from and to, s, of every place; empty where it is the whole record.
    mask : shape ``(N,)`` of the record's rows, True at samples of ``channel`` that carry no information; of length zero where none are named.
    """

    channel: str
    kind: Kind
    certainty: Certainty
    sentence: str
    remedy: str = ""
    times: tuple[tuple[float, float], ...] = ()
    numbers: Mapping[str, Number] = field(default_factory=dict)
    mask: np.ndarray = field(default_factory=lambda: NO_ROWS)

    @property
    def count(self) -> int:
        """How many samples the mask names."""
        return int(np.count_nonzero(self.mask))


@dataclass(frozen=True)
class Expectations:
    """What a record is compared with beside itself; all of it plain numbers, None where it is not known.

    Attributes
    ----------
    airspeed : m/s. gravity : m/s2.
    control_power : rad/s2 per unit of the control, the pitch acceleration that the first input makes, with its sign.
    angular_control : the first input is an angle, so that ``control_power`` tells radians from degrees.
    scale_height : m, of the air's density, of a body that falls through it; its height then obeys gravity and drag.
    aircraft : channels named alpha, q, nz and so on are those of an aircraft, whose motion ties them together.
    """

    airspeed: float | None = None
    gravity: float = 9.80665
    control_power: float | None = None
    angular_control: bool = False
    aircraft: bool = True
    scale_height: float | None = None


def shown(value: float, unit: str) -> str:
    """A value in the unit in which people read it: angles in degrees."""
    factor, label = (180.0 / math.pi, unit.replace("rad", "deg", 1)) if unit.startswith("rad") else (1.0, unit)
    return f"{factor * value:.3g}{'' if label in ('', '1') else f' {label}'}"
