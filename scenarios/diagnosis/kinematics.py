"""What the kinematics alone say of a diagnosis: evidence of its own for or against the sensor effects that it names."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

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
APART = 3.0  # standard deviations within which two values agree
PARAMETERS = {"delay": "delay", "lag": "time_constant", "scale": "scale", "drift": "slope", "arm": "arm"}
SHORTEST = 20  # samples of a record worth reading
AGREES, DIFFERS, CONTRADICTS, NOTHING = "agrees", "differs in size", "contradicts", "says nothing"


@dataclass(frozen=True, eq=False)
class Kinematics:
    """A check of some of a diagnosis' records (``records``: their names). ``result`` is None where none was possible, ``why`` says it."""

    records: tuple[str, ...]
    result: Compatibility | None
    why: str = ""


@dataclass(frozen=True)
class Agreement:
    """One sensor effect of a diagnosis against the kinematics: ``says`` one of AGREES, DIFFERS, CONTRADICTS, NOTHING; ``found`` their value."""

    effect: str
    says: str
    found: Quantity | None
    sentence: str


def kinematics_of_files(
    parts: Sequence[tuple[RecordFile, Segment]], vehicle: VehicleFile, choices: Mapping[str, ColumnChoice] | None = None, plan: Plan | None = None
) -> Kinematics:
    """What ``flightid check`` says of the first parts of files that measure alpha, q and nz, up to about ``ENOUGH`` samples; never raised, but told.

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
    """Check the first records that measure alpha, q and nz, up to about ``ENOUGH`` samples, beyond which none is even prepared.

    A check that fails is told, never raised.
    """
    from ident.compatibility.check import compatibility
    from ident.compatibility.signals import measured_channels

    chosen: list[Record] = []
    for record in records:
        if set(NEEDED) <= set(measured_channels(record)) and (not chosen or sum(len(each) for each in chosen) + len(record) <= ENOUGH):
            chosen.append(record)
        if sum(len(each) for each in chosen) > ENOUGH - SHORTEST:
            break
    names = tuple(record.name for record in chosen)
    if not chosen:
        return Kinematics((), None, f"no record measures {', '.join(NEEDED)} together: their kinematics cannot be checked")
    try:
        return Kinematics(names, compatibility(chosen, settings))
    except (FlightidError, ArithmeticError, ValueError) as error:
        # Evidence beside a diagnosis must not cost the diagnosis; LinAlgError is a ValueError.
        return Kinematics(names, None, _could_not(error))


def _could_not(error: Exception) -> str:
    return f"the kinematics could not be checked: {str(error).splitlines()[0] if str(error) else type(error).__name__}"


def agreements(kinematics: Kinematics, claims: Sequence[Claim]) -> list[Agreement]:
    """Each sensor effect of the claims, in their order, against what the kinematics make of the same fault."""
    result = kinematics.result
    if result is None:
        return []
    return [_agreement(claim, result) for claim in claims if _is_sensor(claim.name) and claim.parameters]


def unnamed(kinematics: Kinematics, claims: Sequence[Claim]) -> list[SensorFinding]:
    """Faults that stand in the kinematics and belong to the group of no claim, one of each group."""
    said = {name for claim in claims for name in (claim.name, *claim.alternatives)}
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
    same = next((finding for finding in standing if finding.name == claim.name), None)
    if same is not None:
        found = Quantity(same.value, same.std, same.unit)
        apart = _apart(found, mine)
        close = apart <= APART
        words = "agrees with the diagnosis" if close else f"the same fault, but {apart:.1f} sigmas from the {with_sigma(mine)} of the diagnosis"
        return Agreement(claim.name, AGREES if close else DIFFERS, found, f"kinematics alone say: {claim.name} {with_sigma(found)}: {words}")
    kin = next((finding for finding in standing if members.intersection((finding.name, *finding.group))), None)
    if kin is not None:
        found = Quantity(kin.value, kin.std, kin.unit)
        words = f"of the group that the diagnosis names with {claim.name}: agrees"
        return Agreement(claim.name, AGREES, found, f"kinematics alone say: {kin.name} {with_sigma(found)}: {words}")
    return _unproven(claim, mine, next((item for item in result.joint.estimates if item.name == claim.name), None))


def _unproven(claim: Claim, mine: Quantity, item: SensorEstimate | None) -> Agreement:
    """A claim of which nothing stands in the kinematics: their estimate may still agree with it, or rule it out."""
    if item is None or not item.told or not _finite(item.smoother.value, item.smoother.std):
        return Agreement(claim.name, NOTHING, None, f"kinematics alone say nothing of {claim.name}: these channels cannot tell it")
    found = Quantity(item.smoother.value, item.smoother.std, item.unit)
    told = f"kinematics alone say: {claim.name} {with_sigma(found)}"
    absent = Quantity(1.0 if item.kind == "scale" else 0.0, 0.0, item.unit)
    if not item.agrees:
        return Agreement(claim.name, NOTHING, found, f"{told}, but their two methods disagree: says nothing of the diagnosis")
    if _apart(found, mine) > APART:
        return Agreement(claim.name, CONTRADICTS, found, f"{told}: contradicts the {with_sigma(mine)} of the diagnosis")
    if _apart(found, absent) > APART:
        return Agreement(claim.name, AGREES, found, f"{told}: agrees with the diagnosis, though it does not stand there by itself")
    return Agreement(claim.name, NOTHING, found, f"{told}: says nothing, neither against the diagnosis nor for it")


def _apart(a: Quantity, b: Quantity) -> float:
    spread = math.hypot(a.std, b.std)
    return abs(a.value - b.value) / spread if spread > 0.0 else math.inf


def _is_sensor(name: str) -> bool:
    """Whether an effect is a fault that the kinematics know."""
    base = name.partition(":")[0].partition("#")[0]
    return base == "vane-offset" or base in {f"sensor-{kind}" for kind in PARAMETERS}


def _finite(*values: float) -> bool:
    return all(math.isfinite(value) for value in values)
