"""Kinematic check of the sensors in a diagnosis, and its comparison with the claimed effects."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from ident.compatibility.trials import (
    CheckResult,
    Compatibility,
    CompatibilitySettings,
    FaultQuantity,
    SensorEstimate,
    SensorFinding,
)
from ident.statistics.residual_spectrum import effective_share
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.report.quantities import number_text, with_sigma
from sim.errors import FlightidError
from sim.record import Record

if TYPE_CHECKING:
    from scenarios.files.declarations import ColumnChoice
    from scenarios.files.measured.columns import RecordFile
    from scenarios.files.vehicles import VehicleFile
    from scenarios.preparation.plan import Plan, Segment

RECORDS_NAMED = 4  # checked records whose names are printed
AGREEING_SIGMAS = 3.0  # two values agree if they differ by at most this many sigmas
PARAMETERS = {  # sensor fault -> its parameter
    "delay": "delay",
    "lag": "time_constant",
    "scale": "scale",
    "drift": "slope",
    "arm": "arm",
}
BIAS = "bias"  # not an effect: a diagnosis estimates the bias of each channel anyway
AGREES, IN_KIND, DIFFERS = "agrees", "agrees in kind", "differs in size"
CONTRADICTS, NOTHING = "contradicts", "says nothing"
# The kinematic equations cannot separate a vane ahead of the c.g. from an accelerometer behind it:
# (d/V) q has the same form as the integral of (g/V) (arm/g) q_dot.
MIRRORED = {
    "vane-offset": "accelerometer-offset:nz",
    "accelerometer-offset:nz": "vane-offset",
    "accelerometer-offset:ny": "vane-offset",
}
_TIMES = ("delay", "lag")  # faults whose sizes, both in s, can be compared with each other


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Kinematic check of the records of a diagnosis.

    Attributes
    ----------
    records : names of the checked records.
    result : result of the check; None if it was not possible.
    why : the reason, if it was not possible.
    held_out : whether held-out data were included.
    """

    records: tuple[str, ...]
    result: Compatibility | None
    why: str = ""
    held_out: bool = False

    @property
    def source(self) -> str:
        """A sentence that names the checked records."""
        items = list(self.records[:RECORDS_NAMED])
        if more := len(self.records) - len(items):
            items.append(f"{more} more")
        *first, last = items
        named = f"{', '.join(first)} and {last}" if first else last
        data = "fitted and held-out data together" if self.held_out else "fitted data alone"
        return f"kinematics were checked on {named}: {data}"


@dataclass(frozen=True)
class Agreement:
    """Comparison of one sensor effect of a diagnosis with the kinematic check.

    Attributes
    ----------
    effect : name of the claimed effect.
    says : AGREES, IN_KIND (a related effect whose size cannot be compared), DIFFERS, CONTRADICTS
        or NOTHING.
    found : value of the kinematic check, None if it has none.
    sentence : the comparison in words.
    """

    effect: str
    says: str
    found: Quantity | None
    sentence: str


def agreements(kinematics: Kinematics, claims: Sequence[Claim]) -> list[Agreement]:
    """Return the comparison of each claimed sensor effect with the kinematics, in order."""
    result = kinematics.result
    if result is None:
        return []
    return [
        _agreement(claim, result) for claim in claims if _is_sensor(claim.name) and claim.parameters
    ]


def named_by(kinematics: Kinematics | None) -> list[tuple[str, ...]]:
    """Return groups of effects that both methods of the check name.

    The effects of a group explain the records equally well; the most probable is first.
    """
    result = None if kinematics is None else kinematics.result
    if result is None:
        return []
    in_doubt = {estimate.name for estimate in result.joint.estimates if not estimate.agrees}
    groups: dict[frozenset[str], tuple[str, ...]] = {}
    for finding in _accepted(result):
        if finding.name in in_doubt:
            continue
        names = {finding.name, *finding.group}
        odds = finding.probabilities
        ranked = sorted(names, key=lambda name: (-odds.get(name, 0.0), name))
        groups.setdefault(frozenset(names), tuple(ranked))
    return list(groups.values())


def _accepted(result: Compatibility) -> list[SensorFinding]:
    """Return the faults that the check accepts, without biases."""
    return [finding for finding in result.findings if finding.supported and finding.kind != BIAS]


def unnamed(kinematics: Kinematics, claims: Sequence[Claim]) -> list[SensorFinding]:
    """Return the accepted faults that the diagnosis does not claim, one of each group."""
    from sim.effects.library import traits_of

    named = {name for claim in claims for name in (claim.name, *claim.alternatives)}
    named |= {
        twin for name in tuple(named) if not _is_sensor(name) for twin in traits_of(name).twins
    }
    faults = []
    for finding in kinematics.result.findings if kinematics.result is not None else ():
        group = {finding.name, *finding.group}
        if finding.supported and not named & group:
            faults.append(finding)
            named |= group
    return faults


def _agreement(claim: Claim, result: Compatibility) -> Agreement:
    """Return the comparison of a claim with the finding that is closest to it."""
    claimed = next(iter(claim.parameters.values()))
    members = {claim.name, *claim.alternatives}
    accepted = _accepted(result)
    named = sorted(
        (finding for finding in accepted if finding.name in members),
        key=lambda finding: (finding.name != claim.name, not _comparable(finding, claim.name)),
    )
    if named and _comparable(named[0], claim.name):
        return _compared(claim, claimed, named[0], result)
    named = [each for each in accepted if members.intersection((each.name, *each.group))]
    if named:
        related, found = named[0], _size_of(named[0])
        if related.name == MIRRORED.get(claim.name):
            return _mirrored(claim, claimed, found, related)
        sentence = (
            f"kinematics alone give {related.name} {with_sigma(found)}: of the group that the "
            f"diagnosis names with {claim.name}; their sizes cannot be compared"
        )
        return Agreement(claim.name, IN_KIND, found, sentence)
    estimate = next((item for item in result.joint.estimates if item.name == claim.name), None)
    return _ruled_out(claim, result) or _unproven(claim, claimed, estimate)


def _size_of(finding: SensorFinding) -> Quantity:
    return Quantity(finding.value, finding.std, finding.unit)


def _comparable(finding: SensorFinding, name: str) -> bool:
    """Return whether a finding and effect ``name`` have comparable sizes: they are the same effect,
    or both are times of one channel.
    """
    kind, _, channel = name.removeprefix("sensor-").partition(":")
    return finding.name == name or (
        finding.kind in _TIMES and kind in _TIMES and finding.channel == channel
    )


def _equivalents_text(finding: SensorFinding, result: Compatibility) -> str:
    """Return the faults that explain the records equally well, with sizes and probabilities."""
    from scenarios.compatibility_report import shares

    others = [item for name in finding.group for item in result.findings if item.name == name]
    texts = [f"{item.name} {with_sigma(_size_of(item))}" for item in others]
    if not texts:
        return ""
    probable = [f"{share} {other.name}" for other, share in shares(finding, result.findings)]
    usual = f" (by the usual places of sensors {', '.join(probable)})" if probable else ""
    return f" or, equally well, {' or '.join(texts)}{usual}"


def _compared(
    claim: Claim, claimed: Quantity, finding: SensorFinding, result: Compatibility
) -> Agreement:
    """Return the comparison of a claim with a finding of comparable size."""
    found = _size_of(finding)
    equivalents = _equivalents_text(finding, result)
    sentence = f"kinematics alone give {finding.name} {with_sigma(found)}{equivalents}: "
    if finding.name != claim.name:
        sentence += f"of the group that the diagnosis names with {claim.name}: "
    if _differ(found, claimed, systematic_error(finding)):
        sentence += (
            f"differs: {with_sigma(found)} against {with_sigma(claimed)} in the diagnosis, "
            f"{_distance(found, claimed):.1f} sigmas"
        )
        return Agreement(claim.name, DIFFERS, found, sentence)
    sentence += f"agrees with the diagnosis, {with_sigma(claimed)}"
    return Agreement(claim.name, AGREES, found, sentence)


def _mirrored(
    claim: Claim, claimed: Quantity, found: Quantity, finding: SensorFinding
) -> Agreement:
    """Return the comparison of an arm with its kinematic equivalent, of opposite sign."""
    as_claimed = Quantity(-found.value, found.std, found.unit)
    sentence = (
        f"kinematics alone give {finding.name} {with_sigma(found)}, which they cannot tell from "
        f"{claim.name} {with_sigma(as_claimed)}: "
    )
    if _differ(as_claimed, claimed, systematic_error(finding)):
        sentence += (
            f"differs from {with_sigma(claimed)} in the diagnosis by "
            f"{_distance(as_claimed, claimed):.1f} sigmas"
        )
        return Agreement(claim.name, DIFFERS, found, sentence)
    sentence += f"agrees with the diagnosis, {with_sigma(claimed)}"
    return Agreement(claim.name, AGREES, found, sentence)


def _ruled_out(claim: Claim, result: Compatibility) -> Agreement | None:
    """Return the contradiction of a claimed lag or delay if the check finds the other kind."""
    rejected = next((finding for finding in result.findings if finding.name == claim.name), None)
    if rejected is None or rejected.lost is None or not math.isfinite(rejected.lost):
        return None
    accepted = late_instead(rejected, result)
    if accepted is None:
        return None
    found = _size_of(accepted)
    sentence = (
        f"kinematics alone give {accepted.name} {with_sigma(found)}; {claim.name} in its place is "
        f"less likely by {rejected.lost:.1f} of log likelihood: contradicts the diagnosis"
    )
    return Agreement(claim.name, CONTRADICTS, found, sentence)


def late_instead(rejected: SensorFinding, result: Compatibility) -> SensorFinding | None:
    """Return the accepted finding that delays the channel of a rejected one in another way."""
    if rejected.supported or not _delays(rejected):
        return None
    return next(
        (
            finding
            for finding in result.findings
            if finding.supported and finding.channel == rejected.channel and _delays(finding)
        ),
        None,
    )


def _delays(finding: SensorFinding) -> bool:
    return finding.kind in _TIMES or finding.name == "vane-offset"


def _unproven(claim: Claim, claimed: Quantity, estimate: SensorEstimate | None) -> Agreement:
    """Return the comparison of a claim with the estimate of a fault that is not accepted."""
    if estimate is None or not estimate.determined or not _finite(estimate.smoother):
        sentence = f"kinematics alone say nothing of {claim.name}: these channels cannot tell it"
        return Agreement(claim.name, NOTHING, None, sentence)
    found = Quantity(estimate.smoother.value, estimate.smoother.std, estimate.unit)
    sentence = f"kinematics alone give {claim.name} {with_sigma(found)}"
    absent = Quantity(1.0 if estimate.kind == "scale" else 0.0, 0.0, estimate.unit)
    if not estimate.agrees:
        sentence += ", but their two methods disagree: says nothing of the diagnosis"
        return Agreement(claim.name, NOTHING, found, sentence)
    if _differ(found, claimed, systematic_error(estimate)):
        sentence += f": contradicts the {with_sigma(claimed)} of the diagnosis"
        return Agreement(claim.name, CONTRADICTS, found, sentence)
    if _distance(found, absent) > AGREEING_SIGMAS:
        sentence += (
            f": agrees with the diagnosis, {with_sigma(claimed)}, though it does not stand there "
            "by itself"
        )
        return Agreement(claim.name, AGREES, found, sentence)
    sentence += ": says nothing, neither against the diagnosis nor for it"
    return Agreement(claim.name, NOTHING, found, sentence)


def _finite(estimate: FaultQuantity) -> bool:
    return math.isfinite(estimate.value) and math.isfinite(estimate.std)


def systematic_error(item: SensorEstimate | SensorFinding) -> float:
    """Return the error of a fault's size from interpolation and a slightly wrong airspeed, in
    addition to its standard deviation.
    """
    from ident.compatibility.kinematics import SensorFault

    return SensorFault(item.channel, item.kind).smallest_finding


def _differ(a: Quantity, b: Quantity, error: float) -> bool:
    """Return whether two values differ significantly and by more than a systematic ``error``."""
    return _distance(a, b) > AGREEING_SIGMAS and abs(a.value - b.value) > error


def _distance(a: Quantity, b: Quantity) -> float:
    std = math.hypot(a.std, b.std)
    return abs(a.value - b.value) / std if std > 0.0 else math.inf


def _is_sensor(name: str) -> bool:
    """Return whether an effect is a sensor fault of the kinematic check."""
    base = name.partition(":")[0].partition("#")[0]
    return base in ("vane-offset", "accelerometer-offset") or base in {
        f"sensor-{kind}" for kind in PARAMETERS
    }


MOST_SAMPLES = 2600  # samples checked: two records of 25 s at 50 Hz; the time grows with them
MOST_RECORDS = 12  # records checked: each keeps about 20 s at 10 Hz
BANK = "phi"


@dataclass(frozen=True)
class Relations:
    """Channels and names of the kinematic check for one kind of equations.

    Attributes
    ----------
    needed : channels that a record must have.
    channels : channels that are used if recorded.
    rates : angular rates that show where a record moves most.
    six : whether the check has six degrees of freedom, with load factors instead of
        accelerometers.
    names : fault of the check -> effect of the model, where their names differ.
    """

    needed: tuple[str, ...]
    channels: tuple[str, ...]
    rates: tuple[str, ...] = ("q",)
    six: bool = True
    names: Mapping[str, str] = field(default_factory=dict)


PITCH = Relations(
    ("alpha", "q", "nz"), ("alpha", "q", "nz", "az", "theta", "airspeed", "ax"), six=False
)
# If airspeed is a state of the equations, it is not constant in the kinematics either.
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
    """Return the kinematic check of segments of files, as ``flightid check`` makes it.

    ``choices`` is the channel map. ``plan`` is the preparation; its segments are ignored. A failure
    is reported in the result, not raised.
    """
    from scenarios.compatibility import record_to_check, settings_of
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
    records: Iterable[Record], settings: CompatibilitySettings, relations: Relations = PITCH
) -> Kinematics:
    """Check up to ``MOST_RECORDS`` records that have the needed channels, each at its airspeed.

    Records at several airspeeds separate the arm of a vane from a delay. Long records are cut to
    the stretch with most motion, ``MOST_SAMPLES`` in all. A failure is reported, not raised.
    """
    from ident.compatibility.check import compatibility

    try:
        records, bank_notes = _level(list(records), settings, relations)
        if bank_notes and not records:
            return Kinematics((), None, bank_notes[0])
        records = [_with_used_channels(record, relations) for record in records]
        needed = set(relations.needed)
        usable = [record for record in records if needed <= set(_measured(record, relations))]
        chosen = shortened(spread(usable, MOST_RECORDS), MOST_SAMPLES, relations.rates)
        names = tuple(record.name for record in chosen)
        if not chosen:
            why = (
                f"no record measures {', '.join(relations.needed)} together: their kinematics "
                "cannot be checked"
            )
            return Kinematics((), None, why)
    except FlightidError as error:
        return Kinematics((), None, _could_not(error))
    try:
        result = compatibility(chosen, settings, each=False, six=relations.six)
        return Kinematics(names, _renamed(result, relations.names))
    except (FlightidError, ArithmeticError, ValueError) as error:
        # A failed check must not stop the diagnosis. LinAlgError is a ValueError.
        return Kinematics(names, None, _could_not(error))


def _level(
    records: list[Record], settings: CompatibilitySettings, relations: Relations
) -> tuple[list[Record], list[str]]:
    """Return the records with nearly level wings, and sentences on the others.

    Relations with the bank angle take all records.
    """
    from ident.compatibility.check import bank_angle_warnings

    if BANK in relations.channels:
        return records, []
    level, notes = list[Record](), list[str]()
    for record in records:
        unbanked = replace(
            record, outputs=tuple(channel for channel in record.outputs if channel.name != BANK)
        )
        sentences = bank_angle_warnings([unbanked], settings.airspeed, settings.gravity)
        notes += sentences
        if not sentences:
            level.append(record)
    return level, notes


def _with_used_channels(record: Record, relations: Relations) -> Record:
    """Return the record with the outputs that the check uses."""
    from scenarios.preparation.measured_inputs import with_load_factors

    record = with_load_factors(record)[0] if relations.six else record
    outputs = tuple(channel for channel in record.outputs if channel.name in relations.channels)
    return record if len(outputs) == len(record.outputs) else replace(record, outputs=outputs)


def _measured(record: Record, relations: Relations) -> tuple[str, ...]:
    from ident.compatibility.signals import measured_channels
    from ident.compatibility.six_degrees.kinematics import usable_channels

    return usable_channels(record) if relations.six else measured_channels(record)


def _renamed(result: Compatibility, names: Mapping[str, str]) -> Compatibility:
    """Return a check whose faults have the names of the model's effects."""
    if not names:
        return result

    def estimate(item: SensorEstimate) -> SensorEstimate:
        return replace(item, name=names.get(item.name, item.name))

    def finding(item: SensorFinding) -> SensorFinding:
        return replace(
            item,
            name=names.get(item.name, item.name),
            group=tuple(names.get(name, name) for name in item.group),
            probabilities={
                names.get(name, name): share for name, share in item.probabilities.items()
            },
            instead_of=names.get(item.instead_of, item.instead_of),
        )

    def check(part: CheckResult) -> CheckResult:
        return replace(
            part,
            estimates=tuple(map(estimate, part.estimates)),
            findings=tuple(map(finding, part.findings)),
        )

    return replace(result, joint=check(result.joint), single=tuple(map(check, result.single)))


def spread(records: Sequence[Record], most: int) -> list[Record]:
    """Return at most ``most`` records: spread over the airspeeds if recorded, else the first."""
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
    records: Sequence[Record], samples: int, rates: Sequence[str] = ("q",)
) -> list[Record]:
    """Return the records cut to about ``samples`` samples in all, where the ``rates`` move most."""
    if sum(len(record) for record in records) <= samples:
        return list(records)
    remaining, counts = samples, {}
    # Shortest records first: longer ones get the samples that short ones do not need.
    for rank, i in enumerate(sorted(range(len(records)), key=lambda i: len(records[i]))):
        counts[i] = min(len(records[i]), remaining // (len(records) - rank))
        remaining -= counts[i]
    return [_most_moving(record, counts[i], rates) for i, record in enumerate(records)]


def _most_moving(record: Record, count: int, rates: Sequence[str]) -> Record:
    """Return the window of ``count`` samples with the largest variance of the rates."""
    if count >= len(record):
        return record
    square = np.zeros(len(record))
    for name in (name for name in rates if name in record.output_names):
        rate = np.where(record[name].valid, record[name].values, 0.0)
        square += (rate - np.median(rate)) ** 2
    integral = np.concatenate([[0.0], np.cumsum(square)])
    first = int(np.argmax(integral[count:] - integral[:-count]))
    return record.window(float(record.time[first]), float(record.time[first + count - 1]))


def _could_not(error: Exception) -> str:
    reason = str(error).splitlines()[0] if str(error) else type(error).__name__
    return f"the kinematics could not be checked: {reason}"


CLOCK = "time-base"  # the effect of a clock that is too fast or too slow
# The clock is right if the slope of pitch attitude against the integral of pitch rate is 1.
LARGEST_SLOPE_STD = 0.005  # largest sigma of this slope for a judgement
LARGEST_SLOPE_DEVIATION = 3.0  # sigmas by which the slope of a right clock may differ from 1
FEWEST_SAMPLES = 50  # of attitude and of rate
TINY = 1e-300  # keeps a quotient finite


def right_clock(records: Sequence[Record]) -> str:
    """Return a sentence if the records show that their clock is right; else an empty string.

    With a wrong clock, the measured pitch attitude is not the integral of the measured pitch rate
    over the recorded time.
    """
    parts = []
    for record in records:
        if not {"theta", "q"} <= set(record.output_names):
            return ""
        theta, q = record["theta"], record["q"]
        valid = theta.valid
        if min(np.count_nonzero(valid), np.count_nonzero(q.valid)) < FEWEST_SAMPLES:
            return ""
        rate = np.interp(record.time, record.time[q.valid], q.values[q.valid])
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(record.time)
        time = record.time[valid] - record.time[0]
        # A bias of the rate adds a trend to its integral, a bias of the attitude a constant.
        trend = np.column_stack([np.ones(len(time)), time])
        integral = np.append(0.0, np.cumsum(steps))[valid]
        both = np.column_stack([integral, theta.values[valid]])
        parts.append(both - trend @ np.linalg.lstsq(trend, both, rcond=None)[0])
    if not parts:
        return ""
    integral, attitude = np.concatenate(parts).T
    square = float(integral @ integral)
    slope = float(integral @ attitude) / square if square > 0.0 else 0.0
    rows = [(part[:, 1] - slope * part[:, 0])[None] for part in parts]
    share = effective_share(rows, [np.ones(row.shape, dtype=bool) for row in rows])
    residual = np.concatenate(rows, axis=1)
    std = float(np.std(residual)) / math.sqrt(max(square * share, TINY))
    if std > LARGEST_SLOPE_STD or abs(slope - 1.0) > LARGEST_SLOPE_DEVIATION * std:
        return ""
    slope_text = f"{number_text(slope, std)} +- {number_text(std, std)}"
    return (
        f"the measured pitch attitude is {slope_text} times "
        f"the integral of the pitch rate: the clock is right, and {CLOCK} is no candidate"
    )
