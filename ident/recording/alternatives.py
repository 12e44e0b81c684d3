"""Every simple way in which columns may be misread: a sign, a unit, two columns exchanged, the unit of time; and how well each fits."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ident.recording.finding import Kind
from ident.recording.motion import Columns, disagreement
from sim.maths import G0

DEGREES = math.degrees(1.0)
PACES = {1e-3: "ms", 1e-6: "us"}
QUICKEST = 5e-4  # s: no recorder of an aircraft's motion takes more than 2000 samples a second
UNITS = {"alpha": "deg", "q": "deg/s", "theta": "deg"}
RENAME = "give each column its own name, or a channel map"
NZ_REMEDY = "name the column nz [m/s2], or say its unit in a channel map"


@dataclass(frozen=True, eq=False)
class Reading:
    """One way to read the columns: what it would mean, the columns so, and the share of the motion that the kinematics then leave unexplained."""

    kind: Kind
    channel: str
    columns: Columns
    sentence: str
    remedy: str
    left: float


def all_readings(columns: Columns) -> list[Reading]:
    """Every simple fault that the columns could have."""
    names, out = list(columns.outputs), []
    for name in names:
        out.append(_reading(Kind.SIGN, name, columns.times({name: -1.0}), "has the sign turned", f"turn the sign of the column of {name}"))
        if name in UNITS:
            remedy = f"name the column {name} [{UNITS[name]}], or say its unit in a channel map"
            what = f"is in {UNITS[name]}, not in {UNITS[name].replace('deg', 'rad')}"
            out.append(_reading(Kind.UNIT, name, columns.times({name: 1.0 / DEGREES}), what, remedy))
    if "nz" in names:
        out.append(_reading(Kind.UNIT, "nz", columns.times({"nz": 1.0 / G0}), "is in m/s2, not in g", NZ_REMEDY))
        out.append(_reading(Kind.UNIT, "nz", columns.times({"nz": G0}), f"is {G0:.2g} times too small", "check its unit"))
    pairs = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    pairs += [(name, columns.control_name) for name in names if columns.control is not None]
    for a, b in pairs:
        out.append(_reading(Kind.EXCHANGED, f"{a} and {b}", columns.exchanged(a, b), "are exchanged", RENAME))
    step = float(np.median(np.diff(columns.time)))
    for factor, unit in PACES.items():
        if factor * step < QUICKEST:
            continue
        remedy = f"name the column time [{unit}], or say its unit in a channel map"
        out.append(_reading(Kind.TIME_BASE, "time", columns.times({"time": factor}), f"is in {unit}, not in s", remedy))
    return out


def _reading(kind: Kind, channel: str, columns: Columns, sentence: str, remedy: str) -> Reading:
    return Reading(kind, channel, columns, sentence, remedy, max(disagreement(columns).values(), default=2.0))
