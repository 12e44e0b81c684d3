"""What the kinematics alone say of a diagnosis: evidence of its own for or against the sensor effects that it names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ident.compatibility.result import Compatibility, CompatibilitySettings, SensorEstimate, SensorFinding
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.terminal.quantities import with_sigma
from sim.errors import FlightidError
from sim.record import Record

if TYPE_CHECKING:
    from scenarios.files.channels import ColumnChoice
    from scenarios.files.measured.record_file import RecordFile
    from scenarios.files.vehicles import VehicleFile
    from scenarios.preparation.plan import Plan, Segment

NEEDED = ("alpha", "q", "nz")
ENOUGH = 2600  # samples, two records of 25 s at 50 Hz: the cost grows with them, the search has the rest
MOST = 12  # records, so that of each some twenty seconds at 10 Hz are left
APART = 3.0  # standard deviations within which two values agree
PARAMETERS = {"delay": "delay", "lag": "time_constant", "scale": "scale", "drift": "slope", "arm": "arm"}
AGREES, IN_KIND, DIFFERS, CONTRADICTS, NOTHING = "agrees", "agrees in kind", "differs in size", "contradicts", "says nothing"
_TIMES = ("delay", "lag")  # sizes of these can be compared, of one channel


@dataclass(frozen=True, eq=False)
class Kinematics:
    """A check of some of a diagnosis' records (``records``: their names). ``result`` is None where none was possible, ``why`` says it."""

    records: tuple[str, ...]
    result: Compatibility | None
    why: str = ""


@dataclass(frozen=True)
class Agreement:
    """One sensor effect of a diagnosis against the kinematics: ``says`` one of AGREES, IN_KIND (another of its group,
    whose size is of another nature), DIFFERS, CONTRADICTS, NOTHING; ``found`` their value."""

    effect: str
    says: str
    found: Quantity | None
    sentence: str


def kinematics_of_files(
    parts: Sequence[tuple[RecordFile, Segment]], vehicle: VehicleFile, choices: Mapping[str, ColumnChoice] | None = None, plan: Plan | None = None
) -> Kinematics:
    """What ``flightid check`` says of all parts of files that measure alpha, q and nz, of about ``ENOUGH`` samples; never raised, but told.

    Every channel that the kinematics know is used as it is recorded: theta, ax, airspeed or dynamic pressure too. ``choices``: a channel
    map. ``plan``: how they are prepared; its segments are not asked.
    """
    from scenarios.compatibility.check import record_to_check, settings_of
    from scenarios.preparation.plan import Plan

    plan = plan or Plan()
    try:
        records = (record_to_check(file, segment, plan, choices, vehicle)[0] for file, segment in parts)
        return kinematics_of(records, settings_of(vehicle))
    except FlightidError as error:
        return Kinematics((), None, _could_not(error))


def kinematics_of(records: Iterable[Record], settings: CompatibilitySettings) -> Kinematics:
    """Check all records that measure alpha, q and nz, each at its own airspeed; of many samples the liveliest stretch of each, about ``ENOUGH``
    together.

    Several airspeeds tell the arm of a vane from a delay, so that no record is left out but beyond ``MOST``. A check that fails is told,
    never raised.
    """
    from ident.compatibility.check import compatibility
    from ident.compatibility.signals import measured_channels

    records = [_longitudinal(record) for record in records]
    chosen = [record for record in records if set(NEEDED) <= set(measured_channels(record))]
    chosen = shortened(spread(chosen, MOST), ENOUGH)
    names = tuple(record.name for record in chosen)
    if not chosen:
        return Kinematics((), None, f"no record measures {', '.join(NEEDED)} together: their kinematics cannot be checked")
    try:
        return Kinematics(names, compatibility(chosen, settings, each=False))
    except (FlightidError, ArithmeticError, ValueError) as error:
        # Evidence beside a diagnosis must not cost the diagnosis; LinAlgError is a ValueError.
        return Kinematics(names, None, _could_not(error))


def _longitudinal(record: Record) -> Record:
    """The record's channels of longitudinal motion: the equations that are fitted know no other."""
    from ident.compatibility.signals import CHANNELS

    outputs = tuple(channel for channel in record.outputs if channel.name in CHANNELS)
    return record if len(outputs) == len(record.outputs) else replace(record, outputs=outputs)


def spread(records: Sequence[Record], most: int) -> list[Record]:
    """No more than ``most`` records, in their order: those whose mean airspeeds are spread widest, where it is recorded; else the first."""
    if len(records) <= most:
        return list(records)
    speeds = [np.nanmean(record["airspeed"].values) if "airspeed" in record.output_names else 0.0 for record in records]
    ranked = np.argsort(speeds, kind="stable") if np.ptp(speeds) > 0 else np.arange(most)
    kept = set(ranked[np.round(np.linspace(0, len(ranked) - 1, most)).astype(int)].tolist())
    return [record for i, record in enumerate(records) if i in kept]


def shortened(records: Sequence[Record], enough: int) -> list[Record]:
    """The records, of about ``enough`` samples together: of those longer than their share the stretch in which q moves most."""
    if sum(len(record) for record in records) <= enough:
        return list(records)
    left, share = enough, {}
    # What short records do not use goes to the longer ones.
    for place, i in enumerate(sorted(range(len(records)), key=lambda i: len(records[i]))):
        share[i] = min(len(records[i]), left // (len(records) - place))
        left -= share[i]
    return [_liveliest(record, share[i]) for i, record in enumerate(records)]


def _liveliest(record: Record, count: int) -> Record:
    if count >= len(record):
        return record
    q = np.where(record["q"].valid, record["q"].values, 0.0)
    power = np.concatenate([[0.0], np.cumsum((q - np.median(q)) ** 2)])
    first = int(np.argmax(power[count:] - power[:-count]))
    return record.window(float(record.time[first]), float(record.time[first + count - 1]))


def _could_not(error: Exception) -> str:
    return f"the kinematics could not be checked: {str(error).splitlines()[0] if str(error) else type(error).__name__}"


def agreements(kinematics: Kinematics, claims: Sequence[Claim]) -> list[Agreement]:
    """Each sensor effect of the claims, in their order, against what the kinematics make of the same fault."""
    result = kinematics.result
    if result is None:
        return []
    return [_agreement(claim, result) for claim in claims if _is_sensor(claim.name) and claim.parameters]


def unnamed(kinematics: Kinematics, claims: Sequence[Claim]) -> list[SensorFinding]:
    """Faults that stand in the kinematics and belong to the group of no claim and are no twin of one, one of each group."""
    from sim.effects.library import traits_of

    said = {name for claim in claims for name in (claim.name, *claim.alternatives)}
    said |= {twin for name in tuple(said) if not _is_sensor(name) for twin in traits_of(name).twins}
    out = []
    for finding in kinematics.result.findings if kinematics.result is not None else ():
        if finding.stands and not said.intersection((finding.name, *finding.group)):
            out.append(finding)
            said |= {finding.name, *finding.group}
    return out


def _agreement(claim: Claim, result: Compatibility) -> Agreement:
    mine = next(iter(claim.parameters.values()))
    members = {claim.name, *claim.alternatives}
    standing = [finding for finding in result.findings if finding.stands]
    named = sorted((f for f in standing if f.name in members), key=lambda f: (f.name != claim.name, not _comparable(f, claim.name)))
    if named and _comparable(named[0], claim.name):
        return _compared(claim, mine, named[0])
    kin = next((finding for finding in standing if members.intersection((finding.name, *finding.group))), None)
    if kin is not None:
        found = Quantity(kin.value, kin.std, kin.unit)
        words = f"of the group that the diagnosis names with {claim.name}; their sizes cannot be compared"
        return Agreement(claim.name, IN_KIND, found, f"kinematics alone say: {kin.name} {with_sigma(found)}: {words}")
    return _ruled_out(claim, result) or _unproven(claim, mine, next((item for item in result.joint.estimates if item.name == claim.name), None))


def _comparable(finding: SensorFinding, name: str) -> bool:
    """Whether the size of a finding is of the nature of that of the effect ``name``: the same, or both times of one channel."""
    kind, _, channel = name.removeprefix("sensor-").partition(":")
    return finding.name == name or (finding.kind in _TIMES and kind in _TIMES and finding.channel == channel)


def _compared(claim: Claim, mine: Quantity, same: SensorFinding) -> Agreement:
    found = Quantity(same.value, same.std, same.unit)
    told = f"kinematics alone say: {same.name} {with_sigma(found)}"
    group = "" if same.name == claim.name else f"of the group that the diagnosis names with {claim.name}: "
    if _differ(found, mine, worth_of(same)):
        words = f"differs: {with_sigma(found)} against {with_sigma(mine)} in the diagnosis, {_apart(found, mine):.1f} sigmas"
        return Agreement(claim.name, DIFFERS, found, f"{told}: {group}{words}")
    return Agreement(claim.name, AGREES, found, f"{told}: {group}agrees with the diagnosis, {with_sigma(mine)}")


def _ruled_out(claim: Claim, result: Compatibility) -> Agreement | None:
    """A way of being late in whose place the kinematics see another, of the same channel."""
    own = next((finding for finding in result.findings if finding.name == claim.name), None)
    other = late_instead(own, result) if own is not None else None
    if own is None or other is None or own.lost is None or not math.isfinite(own.lost):
        return None
    found = Quantity(other.value, other.std, other.unit)
    words = f"{claim.name} in its place is less likely by {own.lost:.1f} of log likelihood: contradicts the diagnosis"
    return Agreement(claim.name, CONTRADICTS, found, f"kinematics alone say: {other.name} {with_sigma(found)}; {words}")


def late_instead(own: SensorFinding, result: Compatibility) -> SensorFinding | None:
    """What stands in the place of a finding that does not: another way for the same channel to be late."""
    if own.stands or not _late(own):
        return None
    return next((f for f in result.findings if f.stands and f.channel == own.channel and _late(f)), None)


def _late(finding: SensorFinding) -> bool:
    return finding.kind in _TIMES or finding.name == "vane-offset"


def _unproven(claim: Claim, mine: Quantity, item: SensorEstimate | None) -> Agreement:
    """A claim of which nothing stands in the kinematics: their estimate may still agree with it, or rule it out."""
    if item is None or not item.told or not _finite(item.smoother.value, item.smoother.std):
        return Agreement(claim.name, NOTHING, None, f"kinematics alone say nothing of {claim.name}: these channels cannot tell it")
    found = Quantity(item.smoother.value, item.smoother.std, item.unit)
    told = f"kinematics alone say: {claim.name} {with_sigma(found)}"
    absent = Quantity(1.0 if item.kind == "scale" else 0.0, 0.0, item.unit)
    if not item.agrees:
        return Agreement(claim.name, NOTHING, found, f"{told}, but their two methods disagree: says nothing of the diagnosis")
    if _differ(found, mine, worth_of(item)):
        return Agreement(claim.name, CONTRADICTS, found, f"{told}: contradicts the {with_sigma(mine)} of the diagnosis")
    if _apart(found, absent) > APART:
        words = f"agrees with the diagnosis, {with_sigma(mine)}, though it does not stand there by itself"
        return Agreement(claim.name, AGREES, found, f"{told}: {words}")
    return Agreement(claim.name, NOTHING, found, f"{told}: says nothing, neither against the diagnosis nor for it")


def worth_of(item: SensorEstimate | SensorFinding) -> float:
    """What interpolation and an airspeed slightly wrong make of the size of a fault, beside its standard deviation."""
    from ident.compatibility.faults import SensorFault

    return SensorFault(item.channel, item.kind).worth


def _differ(a: Quantity, b: Quantity, worth: float) -> bool:
    return _apart(a, b) > APART and abs(a.value - b.value) > worth


def _apart(a: Quantity, b: Quantity) -> float:
    spread = math.hypot(a.std, b.std)
    return abs(a.value - b.value) / spread if spread > 0.0 else math.inf


def _is_sensor(name: str) -> bool:
    """Whether an effect is a fault that the kinematics know."""
    base = name.partition(":")[0].partition("#")[0]
    return name in ("vane-offset", "accelerometer-offset:nz") or base in {f"sensor-{kind}" for kind in PARAMETERS}


def _finite(*values: float) -> bool:
    return all(math.isfinite(value) for value in values)
