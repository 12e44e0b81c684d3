"""The records of a diagnosis that its kinematics are asked of, and the check: which channels, how
many samples, under which names.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ident.compatibility.trials import (
    CheckResult,
    Compatibility,
    CompatibilitySettings,
    SensorEstimate,
    SensorFinding,
)
from scenarios.diagnosis.kinematics import Kinematics
from sim.errors import FlightidError
from sim.record import Record

if TYPE_CHECKING:
    from scenarios.files.channels import ColumnChoice
    from scenarios.files.measured.columns import RecordFile
    from scenarios.files.vehicles import VehicleFile
    from scenarios.preparation.plan import Plan, Segment

# samples, two records of 25 s at 50 Hz: the cost grows with them, the search has the rest
ENOUGH = 2600
BANK = "phi"
MOST = 12  # records, so that of each some twenty seconds at 10 Hz are left


@dataclass(frozen=True)
class Relations:
    """What the kinematics are asked of the records of one kind of equations.

    ``needed``: channels without which a record is left out. ``channels``: those that take part,
    where they are recorded. ``rates``: those by which a stretch is lively. ``six``: the relations
    of six degrees of freedom, with load factors in the place of accelerometers. ``names``: of a
    fault there, that of the model's effect, where it differs.
    """

    needed: tuple[str, ...]
    channels: tuple[str, ...]
    rates: tuple[str, ...] = ("q",)
    six: bool = True
    names: Mapping[str, str] = field(default_factory=dict)


PITCH = Relations(
    ("alpha", "q", "nz"), ("alpha", "q", "nz", "az", "theta", "airspeed", "ax"), six=False
)
# An airspeed that the equations move is no constant to the kinematics either.
LONGITUDINAL = Relations(
    ("alpha", "q", "nz", "airspeed"),
    ("alpha", "q", "nz", "theta", "airspeed", "nx"),
    names={"accelerometer-offset-below:nx": "accelerometer-offset:nx"},
)
LATERAL = Relations(
    ("p", "phi"),
    ("beta", "p", "r", "phi", "ny", "psi", "theta", "alpha", "airspeed"),
    ("p", "r"),
    names={"vane-offset:beta": "vane-offset"},
)
OF_MODEL: Mapping[str, Relations] = {
    "rigid": PITCH,
    "flexible": PITCH,
    "longitudinal": LONGITUDINAL,
    "lateral": LATERAL,
}


def kinematics_of_files(
    parts: Sequence[tuple[RecordFile, Segment]],
    vehicle: VehicleFile,
    choices: Mapping[str, ColumnChoice] | None = None,
    plan: Plan | None = None,
) -> Kinematics:
    """What ``flightid check`` says of all parts of files that measure what the model's relations
    need, of about ``ENOUGH`` samples; never raised, but told.

    ``choices``: a channel map. ``plan``: how they are prepared; its segments are not asked.
    """
    from scenarios.compatibility.check import record_to_check, settings_of
    from scenarios.preparation.plan import Plan

    plan = plan or Plan()
    try:
        records = (
            record_to_check(file, segment, plan, choices, vehicle)[0] for file, segment in parts
        )
        return kinematics_of(records, settings_of(vehicle), OF_MODEL.get(vehicle.model, PITCH))
    except FlightidError as error:
        return Kinematics((), None, _could_not(error))


def kinematics_of(
    records: Iterable[Record], settings: CompatibilitySettings, asked: Relations = PITCH
) -> Kinematics:
    """Check all records that measure what is needed, each at its own airspeed; of many samples the
    liveliest stretch of each, about ``ENOUGH`` together.

    Several airspeeds tell the arm of a vane from a delay, so that no record is left out but beyond
    ``MOST``. A check that fails is told, never raised.
    """
    from ident.compatibility.check import compatibility

    try:
        records, banked = _level(list(records), settings, asked)
        if banked and not records:
            return Kinematics((), None, banked[0])
        records = [_taking_part(record, asked) for record in records]
        chosen = [
            record for record in records if set(asked.needed) <= set(_measured(record, asked))
        ]
        chosen = shortened(spread(chosen, MOST), ENOUGH, asked.rates)
        names = tuple(record.name for record in chosen)
        if not chosen:
            return Kinematics(
                (),
                None,
                f"no record measures {', '.join(asked.needed)} together: their kinematics cannot "
                "be checked",
            )
    except FlightidError as error:
        return Kinematics((), None, _could_not(error))
    try:
        return Kinematics(
            names, _renamed(compatibility(chosen, settings, each=False, six=asked.six), asked.names)
        )
    except (FlightidError, ArithmeticError, ValueError) as error:
        # Evidence beside a diagnosis must not cost the diagnosis; LinAlgError is a ValueError.
        return Kinematics(names, None, _could_not(error))


def _level(
    records: list[Record], settings: CompatibilitySettings, asked: Relations
) -> tuple[list[Record], list[str]]:
    """Of relations without a bank angle the records in which the wings were level enough for them,
    and what is said of the others.
    """
    from ident.compatibility.six_degrees.kinematics import misled_by_bank

    if BANK in asked.channels:
        return records, []
    kept, told = list[Record](), list[str]()
    for record in records:
        unbanked = replace(
            record, outputs=tuple(channel for channel in record.outputs if channel.name != BANK)
        )
        said = misled_by_bank([unbanked], settings.airspeed, settings.gravity)
        told += said
        kept += [] if said else [record]
    return kept, told


def _taking_part(record: Record, asked: Relations) -> Record:
    """The record's channels that take part: the equations that are fitted know no other."""
    from scenarios.preparation.measured_inputs import with_load_factors

    record = with_load_factors(record)[0] if asked.six else record
    outputs = tuple(channel for channel in record.outputs if channel.name in asked.channels)
    return record if len(outputs) == len(record.outputs) else replace(record, outputs=outputs)


def _measured(record: Record, asked: Relations) -> tuple[str, ...]:
    from ident.compatibility.signals import measured_channels
    from ident.compatibility.six_degrees.kinematics import recorded

    return recorded(record) if asked.six else measured_channels(record)


def _renamed(result: Compatibility, names: Mapping[str, str]) -> Compatibility:
    """A check with its faults under the names of the model's effects."""
    if not names:
        return result

    def estimate(item: SensorEstimate) -> SensorEstimate:
        return replace(item, name=names.get(item.name, item.name))

    def finding(item: SensorFinding) -> SensorFinding:
        return replace(
            item,
            name=names.get(item.name, item.name),
            group=tuple(names.get(name, name) for name in item.group),
        )

    def checked(each: CheckResult) -> CheckResult:
        return replace(
            each,
            estimates=tuple(map(estimate, each.estimates)),
            findings=tuple(map(finding, each.findings)),
        )

    return replace(result, joint=checked(result.joint), single=tuple(map(checked, result.single)))


def spread(records: Sequence[Record], most: int) -> list[Record]:
    """No more than ``most`` records, in their order: those whose mean airspeeds are spread widest,
    where it is recorded; else the first.
    """
    if len(records) <= most:
        return list(records)
    speeds = [
        np.nanmean(record["airspeed"].values) if "airspeed" in record.output_names else 0.0
        for record in records
    ]
    ranked = np.argsort(speeds, kind="stable") if np.ptp(speeds) > 0 else np.arange(most)
    kept = set(ranked[np.round(np.linspace(0, len(ranked) - 1, most)).astype(int)].tolist())
    return [record for i, record in enumerate(records) if i in kept]


def shortened(
    records: Sequence[Record], enough: int, rates: Sequence[str] = ("q",)
) -> list[Record]:
    """The records, of about ``enough`` samples together: of those longer than their share the
    stretch in which the ``rates`` move most.
    """
    if sum(len(record) for record in records) <= enough:
        return list(records)
    left, share = enough, {}
    # What short records do not use goes to the longer ones.
    for place, i in enumerate(sorted(range(len(records)), key=lambda i: len(records[i]))):
        share[i] = min(len(records[i]), left // (len(records) - place))
        left -= share[i]
    return [_liveliest(record, share[i], rates) for i, record in enumerate(records)]


def _liveliest(record: Record, count: int, rates: Sequence[str]) -> Record:
    if count >= len(record):
        return record
    moved = np.zeros(len(record))
    for name in (name for name in rates if name in record.output_names):
        rate = np.where(record[name].valid, record[name].values, 0.0)
        moved += (rate - np.median(rate)) ** 2
    power = np.concatenate([[0.0], np.cumsum(moved)])
    first = int(np.argmax(power[count:] - power[:-count]))
    return record.window(float(record.time[first]), float(record.time[first + count - 1]))


def _could_not(error: Exception) -> str:
    return (
        "the kinematics could not be checked: "
        f"{str(error).splitlines()[0] if str(error) else type(error).__name__}"
    )
