"""Data compatibility on files: records and constants read, the kinematics checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.compatibility.check import compatibility
from ident.compatibility.signals import NO_AIRSPEED, measured_channels
from ident.compatibility.six_degrees.kinematics import CHANNELS, WRAPPED, usable_channels
from ident.compatibility.trials import (
    CheckResult,
    Compatibility,
    CompatibilitySettings,
    SensorFinding,
)
from ident.recording.series import Expectations, measurable_noise
from scenarios.files.declarations import STICK, TIME, ColumnChoice
from scenarios.files.measured.columns import (
    RecordFile,
    all_simulated,
    identities,
    read_record_files,
    refuse_duplicates,
    with_names,
)
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import (
    VehicleFile,
    files_read_unnamed,
    read_any_vehicle,
    vehicle_next_to,
)
from scenarios.preparation.filtering import split_at_gaps
from scenarios.preparation.plan import Plan, Request, Segment, column_choices
from scenarios.preparation.recording import (
    NOTHING_SEEN,
    RecordCheck,
    checked_records,
    expectations_of,
    joined,
)
from sim.declaration.effect import AIRSPEEDS
from sim.errors import RecordError
from sim.maths import G0
from sim.record import Channel, Record

INPUTS = ("elevator", STICK, "aileron", "rudder")
PRESSURE = "dynamic_pressure"
MADE_OF_PRESSURE = "airspeed from the dynamic pressure"
ACCELEROMETERS = ("nz", "az", "ny", "ay")


@dataclass(frozen=True, eq=False)
class CompatibilityCheck:
    """A check with what it was made from. ``vehicle`` is None if no vehicle file was given or
    found.

    ``declared_speed`` (m/s), ``declared_density`` (kg/m3): of the vehicle file; None if not used.
    ``notes``: on the preparation. ``look``: check of the raw columns. ``simulated``: all records
    are simulated, according to their JSON files.
    """

    result: Compatibility
    records: tuple[Record, ...]
    settings: CompatibilitySettings
    files: tuple[InputFile, ...]
    vehicle: InputFile | None
    notes: tuple[str, ...] = ()
    look: RecordCheck = NOTHING_SEEN
    simulated: bool = False
    declared_speed: float | None = None
    declared_density: float | None = None


def equivalent_constant(check: CompatibilityCheck, finding: SensorFinding) -> str:
    """Return the constant of the vehicle file whose error has the effect of a scale error of an
    accelerometer; empty if there is none.

    In alpha_dot = q - g nz/V a factor on the load factor acts like one on 1/V. An airspeed
    V = sqrt(2 q/rho) from a dynamic pressure q depends on the air density rho.
    """
    names = {finding.name, *finding.group}
    if check.vehicle is None or not names & {
        f"sensor-scale:{channel}" for channel in ACCELEROMETERS
    }:
        return ""
    known = finding.kind == "scale" and finding.channel in ACCELEROMETERS and finding.value > 0.0
    for word, unit, value, power in (
        ("airspeed", "m/s", check.declared_speed, 1.0),
        ("air_density", "kg/m3", check.declared_density, -2.0),
    ):
        if value is not None:
            instead = (
                f"{word} = {value * finding.value**power:.4g} {unit} in place of {value:.4g}"
                if known
                else f"another {word} than {value:.4g}"
            )
            return f"{instead} in {check.vehicle.name} would explain it as well"
    return ""


def noise_levels(
    check: CompatibilityCheck, result: CheckResult | None = None
) -> dict[str, float | None]:
    """Return the noise of each channel (SI) from all records together or from one ``result``.

    It is None if the records do not determine it. That of a missing nz is computed from az.
    """
    out: dict[str, float | None] = {}
    for name, level in (result or check.result.joint).noise_std.items():
        source, factor = (
            ("az", 1.0 / G0)
            if name == "nz" and not any(name in record.output_names for record in check.records)
            else (name, 1.0)
        )
        known = [record[source] for record in check.records if source in record.output_names]
        out[name] = measurable_noise(
            level, [factor * channel.values[channel.valid] for channel in known]
        )
    return out


def check_files(request: Request) -> CompatibilityCheck:
    """Read records of one aircraft and check them.

    Of the ``request`` count the record files; any aircraft's vehicle file, of which airspeed,
    gravity and vane arm are used (None takes ``vehicle.toml`` from the folder of the first record
    if it is there); the channel map; the segments of all records and their preparation.

    Raises
    ------
    FlightidError : anything in the files that keeps them from being used.
    """
    refuse_duplicates(request.records)
    beside = vehicle_next_to(request.records[0]) if request.vehicle is None else None
    chosen = request.vehicle if request.vehicle is not None else beside
    declared = read_any_vehicle(chosen) if chosen is not None else None
    settings = settings_of(declared) if declared is not None else CompatibilitySettings()
    choices, plan = column_choices(request, surfaces=True), request.plan
    files = read_record_files(request.records)
    read = [
        record_to_check(file, segment, plan, choices, declared)
        for file in files
        for segment in plan.segments
    ]
    parted = [split_at_gaps(record) for record, _, _ in read]
    records = tuple(part for parts, _ in parted for part in parts)
    look = joined([look for _, _, look in read], trusted=plan.trusted)
    result = compatibility(records, settings)
    vehicle = declared.identity if declared is not None else None
    notes = (
        *files_read_unnamed(files, beside),
        *plan.chosen,
        *(note for _, told, _ in read for note in told),
        *(note for _, note in parted if note),
    )
    notes += _how_to_give_the_airspeed(result, vehicle)
    check = CompatibilityCheck(
        result, records, settings, identities(files), vehicle, notes, look, all_simulated(files)
    )
    if declared is None:
        return check
    recorded_speed = all("airspeed" in record.output_names for record in records)
    density = (
        declared.constants.get("air_density")
        if any(MADE_OF_PRESSURE in note for note in notes)
        else None
    )
    return replace(
        check,
        declared_speed=None if recorded_speed else settings.airspeed,
        declared_density=density,
    )


def lacks_airspeed(result: Compatibility) -> bool:
    """Return whether a relation is left out only because no airspeed is known."""
    return any(note.startswith(NO_AIRSPEED) for note in result.notes)


def _how_to_give_the_airspeed(result: Compatibility, vehicle: InputFile | None) -> tuple[str, ...]:
    """Return remedies for a relation that lacks the airspeed; empty if none does."""
    if not lacks_airspeed(result):
        return ()
    if vehicle is not None:
        return (f"add airspeed (m/s) to {vehicle.name}, or record the airspeed",)
    return (
        "add --vehicle V.toml: the check takes the airspeed from it, gravity and vane_arm where "
        "it has them, and none of its derivatives; or record the airspeed",
    )


def settings_of(vehicle: VehicleFile) -> CompatibilitySettings:
    """Return the constants that the kinematics use."""
    settings = CompatibilitySettings(
        airspeed=_airspeed_of(vehicle),
        vane_arm=vehicle.constants.get("vane_arm", 0.0),
        chord=vehicle.constants.get("chord", 0.0),
    )
    return (
        replace(settings, gravity=vehicle.constants["gravity"])
        if "gravity" in vehicle.constants
        else settings
    )


def _airspeed_of(vehicle: VehicleFile) -> float | None:
    """Return the declared or reference airspeed of the vehicle file."""
    known = [vehicle.constants[name] for name in AIRSPEEDS if name in vehicle.constants]
    if not known and vehicle.own is not None and AIRSPEEDS[0] in vehicle.own.initial:
        known = [vehicle.own.initial[AIRSPEEDS[0]].value]  # where the motion begins
    return known[0] if known else CompatibilitySettings().airspeed


def record_to_check(
    file: RecordFile,
    segment: Segment,
    plan: Plan,
    choices: Mapping[str, ColumnChoice] | None = None,
    vehicle: VehicleFile | None = None,
) -> tuple[Record, tuple[str, ...], RecordCheck]:
    """Return a part of a file for the kinematic check, notes, and the check of raw columns.

    ``choices``: a channel map. ``vehicle``: gives the air density to compute airspeed from dynamic
    pressure.

    Raises
    ------
    RecordError : anything that keeps the file from being used, none of the channels in it, or
        columns that are certainly not what they are called.
    """
    from scenarios.files.records import read_with_notes
    from scenarios.preparation.filtering import filtered, named

    # Inputs show where loads may jump between samples; they are optional and may have gaps.
    known = (*CHANNELS, PRESSURE, *INPUTS)
    named_file = with_names(file, plan.columns)
    read, notes = read_with_notes(
        named_file,
        (),
        (),
        choices,
        segment.start,
        segment.stop,
        optional=known,
        hold=plan.hold,
        rate=plan.rate,
    )
    inputs = tuple(
        channel for channel in read.outputs if channel.name in INPUTS and np.all(channel.valid)
    )
    outputs = tuple(channel for channel in read.outputs if channel.name not in INPUTS)
    record = replace(
        read,
        inputs=inputs,
        outputs=outputs,
        name=named(file.identity.name, segment, several=len(plan.segments) > 1),
    )
    (record,), look = checked_records([_unwrapped(record)], _expected(vehicle), plan)
    record, of_speed = _with_speed(record, vehicle)
    if not measured_channels(record) and not usable_channels(record):
        what = f"none of the channels that the kinematics join ({', '.join(CHANNELS)})"
        raise RecordError(
            what,
            where=file.identity.name,
            remedy=f"name its columns so beside {TIME}, or give --channels a map",
        )
    record, of_filter = filtered(record, plan)
    return record, tuple(note for note in (*notes, of_speed, of_filter) if note), look


def _unwrapped(record: Record) -> Record:
    """Return the record with bank angle and heading without jumps by a full turn."""
    outputs = []
    for channel in record.outputs:
        values = channel.values
        if channel.name in WRAPPED:
            values = np.full(len(record), np.nan)
            values[channel.valid] = np.unwrap(channel.values[channel.valid])
        outputs.append(
            Channel.of(channel.name, channel.unit, values) if channel.name in WRAPPED else channel
        )
    return replace(record, outputs=tuple(outputs))


def _expected(vehicle: VehicleFile | None) -> Expectations:
    """Return the properties of the raw columns that a vehicle file lets one expect."""
    from scenarios.preparation.declared_model import model_of_file

    if vehicle is None or not (vehicle.model or vehicle.own):
        return Expectations()
    return expectations_of(model_of_file(vehicle))


def _with_speed(record: Record, vehicle: VehicleFile | None) -> tuple[Record, str]:
    """Return the record with airspeed computed from dynamic pressure, if needed and possible."""
    if PRESSURE not in record.output_names:
        return record, ""
    pressure = record[PRESSURE]
    rest = replace(
        record, outputs=tuple(channel for channel in record.outputs if channel.name != PRESSURE)
    )
    density = vehicle.constants.get("air_density") if vehicle is not None else None
    if density is None or "airspeed" in rest.output_names:
        return rest, ""
    speed = np.sqrt(
        2.0 * np.maximum(np.where(pressure.valid, pressure.values, np.nan), 0.0) / density
    )
    note = f"{record.name}: {MADE_OF_PRESSURE}, in air of {density:g} kg/m3"
    return replace(rest, outputs=(*rest.outputs, Channel.of("airspeed", "m/s", speed))), note
