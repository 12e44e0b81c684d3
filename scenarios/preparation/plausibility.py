"""What no fit should start from: a channel that is stuck, controls that never move, degrees that are read as radians."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scenarios.preparation.ports import PORTS
from sim.errors import RecordError
from sim.model import Model
from sim.record import Channel, Record

SMALL_ANGLES = ("alpha", "elevator")  # in rad, perturbations of a short-period motion
LARGEST = 1.5  # rad away from the middle that a hundredth of the samples may reach
SHARE = 99.0  # per cent


def refuse_still(records: Sequence[Record], model: Model) -> None:
    """Nothing where something happens in the records.

    Raises
    ------
    RecordError : an output whose samples are all the same; controls that rest in every record.
    """
    for record in records:
        for channel in record.outputs:
            if _still(channel):
                what, remedy = "all samples are the same", "leave the column out: a sensor at work shows noise at least"
                raise RecordError(what, where=f"{record.name}, channel {channel.name}", remedy=remedy)
    controls = [signal.name for signal in model.equations.inputs if signal.name not in PORTS]
    if controls and all(_still(record[name]) for record in records for name in controls):
        what = f"the {' and the '.join(controls)} never moves: nothing shows what it does"
        raise RecordError(what, where=", ".join(dict.fromkeys(r.name for r in records)), remedy="give a record with a maneuver, or more of this one")


def refuse_degrees(records: Sequence[Record]) -> None:
    """Nothing where angles are those of a short-period motion. Raises RecordError for one that moves too far for radians."""
    for record in records:
        for name in SMALL_ANGLES:
            if name in (*record.input_names, *record.output_names):
                _refuse_degrees(record, record[name])


def _still(channel: Channel) -> bool:
    values = channel.values[channel.valid]
    return len(values) > 1 and float(np.ptp(values)) == 0.0


def _refuse_degrees(record: Record, channel: Channel) -> None:
    values = channel.values[channel.valid]
    reach = float(np.percentile(np.abs(values - np.median(values)), SHARE)) if len(values) else 0.0
    if reach > LARGEST:
        what = f"it moves by {reach:.3g} rad ({math.degrees(reach):.3g} deg)"
        remedy = f"if the column is in degrees, name it {channel.name}_deg or say so in a channel map"
        raise RecordError(what, where=f"{record.name}, channel {channel.name}", remedy=remedy)
