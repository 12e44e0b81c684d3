"""Data compatibility on files: records and constants read, the kinematics checked."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ident.compatibility.check import compatibility
from ident.compatibility.result import Compatibility, CompatibilitySettings
from ident.compatibility.signals import CHANNELS, measured_channels
from scenarios.files.channel_names import STICK, TIME
from scenarios.files.channels import ColumnChoice
from scenarios.files.vehicles import VehicleFile, read_vehicle
from scenarios.preparation.plan import Plan, Segment
from sim.errors import DeclarationError, RecordError
from sim.record import Channel, Record

BESIDE = "vehicle.toml"
INPUTS = ("elevator", STICK)
PRESSURE = "dynamic_pressure"


@dataclass(frozen=True)
class CheckedFile:
    """A file that a check rests on: its bare name and the SHA-256 of its content."""

    name: str
    sha256: str


@dataclass(frozen=True, eq=False)
class Check:
    """A check with what it was made from. ``vehicle`` is None where no vehicle file was given or found; ``notes`` say how records were prepared."""

    result: Compatibility
    records: tuple[Record, ...]
    settings: CompatibilitySettings
    files: tuple[CheckedFile, ...]
    vehicle: CheckedFile | None
    notes: tuple[str, ...] = ()


def check_files(
    paths: Sequence[Path],
    vehicle: Path | None = None,
    channels: Path | None = None,
    plan: Plan | None = None,
) -> Check:
    """Read records of one aircraft and check them.

    Parameters
    ----------
    paths : record files. vehicle : any aircraft's vehicle file, of which airspeed, gravity and vane arm are used; None takes ``vehicle.toml`` from
        the folder of the first record if it is there.
    channels : a channel map, for all records. plan : segments of all records, and how they are prepared; None: whole, as they stand.

    Raises
    ------
    FlightidError : anything in the files that keeps them from being used, in one line.
    """
    from scenarios.files.channels import read_channel_map

    _refuse_twice(paths)
    beside = paths[0].parent / BESIDE
    chosen = vehicle if vehicle is not None else (beside if beside.is_file() else None)
    declared = read_any_vehicle(chosen) if chosen is not None else None
    settings = settings_of(declared) if declared is not None else CompatibilitySettings()
    choices = read_channel_map(channels) if channels is not None else None
    plan = plan or Plan()
    read = [record_to_check(path, segment, plan, choices, declared) for path in paths for segment in plan.segments]
    records = tuple(record for record, _ in read)
    result = compatibility(records, settings)
    return Check(
        result,
        records,
        settings,
        tuple(_file(path) for path in paths),
        _file(chosen) if chosen is not None else None,
        tuple(note for _, told in read for note in told),
    )


def settings_of(vehicle: VehicleFile) -> CompatibilitySettings:
    """The constants that the kinematics use."""
    settings = CompatibilitySettings(airspeed=vehicle.constants["airspeed"], vane_arm=vehicle.constants.get("vane_arm", 0.0))
    return replace(settings, gravity=vehicle.constants["gravity"]) if "gravity" in vehicle.constants else settings


def read_any_vehicle(path: Path) -> VehicleFile:
    """A vehicle file of whichever model of an aircraft it is written for. Raises DeclarationError where it is for none, or wrong."""
    from scenarios.files.declarations import read_toml

    content = read_toml(path)
    if "density_scale_height" in content or "air_density_reference" in content:
        raise DeclarationError("this is a falling body's file, without an airspeed", where=str(path), remedy="give the file of an aircraft")
    model = "flexible" if "modes" in content else "loes" if "gravity" in content and "mass" not in content else "rigid"
    return read_vehicle(path, model)


def record_to_check(
    path: Path, segment: Segment, plan: Plan, choices: Mapping[str, ColumnChoice] | None = None, vehicle: VehicleFile | None = None
) -> tuple[Record, tuple[str, ...]]:
    """A part of a file with every channel that the kinematics know, and sentences on how it was prepared.

    ``choices``: a channel map. ``vehicle``: its air density makes an airspeed of a recorded dynamic pressure where none is recorded.

    Raises
    ------
    RecordError : anything that keeps the file from being used, or none of the channels in it.
    """
    from scenarios.files.records import read_record
    from scenarios.preparation.filtering import filtered
    from scenarios.preparation.reading import named

    # An input tells where a load may jump between two samples; it may be absent, and may have gaps.
    known = (*CHANNELS, PRESSURE, *INPUTS)
    read = read_record(path, (), (), choices, segment.start, segment.stop, optional=known, hold=plan.hold)
    inputs = tuple(channel for channel in read.outputs if channel.name in INPUTS and np.all(channel.valid))
    outputs = tuple(channel for channel in read.outputs if channel.name not in INPUTS)
    record = replace(read, inputs=inputs, outputs=outputs, name=named(path, segment, several=len(plan.segments) > 1))
    record, of_speed = _with_speed(record, vehicle)
    if not measured_channels(record):
        what = f"none of the channels that the kinematics join ({', '.join(CHANNELS)})"
        raise RecordError(what, where=path.name, remedy=f"name its columns so beside {TIME}, or give --channels a map")
    record, of_filter = filtered(record, plan)
    return record, tuple(said for said in (of_speed, of_filter) if said)


def _with_speed(record: Record, vehicle: VehicleFile | None) -> tuple[Record, str]:
    """The record without its dynamic pressure, but with the airspeed that this makes where none is recorded and the air's density is known."""
    if PRESSURE not in record.output_names:
        return record, ""
    pressure = record[PRESSURE]
    rest = replace(record, outputs=tuple(channel for channel in record.outputs if channel.name != PRESSURE))
    density = vehicle.constants.get("air_density") if vehicle is not None else None
    if density is None or "airspeed" in rest.output_names:
        return rest, ""
    speed = np.sqrt(2.0 * np.maximum(np.where(pressure.valid, pressure.values, np.nan), 0.0) / density)
    said = f"{record.name}: airspeed from the dynamic pressure, in air of {density:g} kg/m3"
    return replace(rest, outputs=(*rest.outputs, Channel.of("airspeed", "m/s", speed))), said


def _refuse_twice(paths: Sequence[Path]) -> None:
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise RecordError("the record is named twice", where=str(path), remedy="name each record once")
        seen.add(path.resolve())


def _file(path: Path) -> CheckedFile:
    return CheckedFile(path.name, hashlib.sha256(path.read_bytes()).hexdigest())
