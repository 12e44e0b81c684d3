"""Kinematic evidence of a diagnosis on sensor faults: what is checked, and what is found."""

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

RECORDS_NAMED = 4  # checked records that are named
AGREEING_SIGMAS = 3.0  # standard deviations within which two values agree
PARAMETERS = {
    "delay": "delay",
    "lag": "time_constant",
    "scale": "scale",
    "drift": "slope",
    "arm": "arm",
}
BIAS = "bias"  # no effect: the fits of a diagnosis leave one of each channel free
AGREES, IN_KIND, DIFFERS = "agrees", "agrees in kind", "differs in size"
CONTRADICTS, NOTHING = "contradicts", "says nothing"
# For kinematics, a vane ahead equals an accelerometer behind: (d/V) q and the integral of
# (g/V) (arm/g) q_dot have the same form.
MIRRORED = {
    "vane-offset": "accelerometer-offset:nz",
    "accelerometer-offset:nz": "vane-offset",
    "accelerometer-offset:ny": "vane-offset",
}
_TIMES = ("delay", "lag")  # sizes of these can be compared, of one channel


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Kinematic check of records of a diagnosis.

    ``records``: names. ``result``: None if not possible, with the reason in ``why``. ``held_out``:
    held-out data were included.
    """

    records: tuple[str, ...]
    result: Compatibility | None
    why: str = ""
    held_out: bool = False

    @property
    def source(self) -> str:
        """The records that were checked, in a sentence."""
        shown = self.records[:RECORDS_NAMED]
        more = len(self.records) - len(shown)
        last = f"{more} more" if more else shown[-1]
        first = shown if more else shown[:-1]
        named = f"{', '.join(first)} and {last}" if first else last
        data = "fitted and held-out data together" if self.held_out else "fitted data alone"
        return f"kinematics were checked on {named}: {data}"


@dataclass(frozen=True)
class Agreement:
    """Comparison of one sensor effect of a diagnosis with the kinematics.

    ``says``: AGREES, IN_KIND (a related effect with another kind of size), DIFFERS, CONTRADICTS or
    NOTHING. ``found``: value from kinematics.
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
    """Return groups of effects that both methods of the check name, the likeliest first."""
    result = None if kinematics is None else kinematics.result
    if result is None:
        return []
    doubted = {each.name for each in result.joint.estimates if not each.agrees}
    stand = [each for each in result.findings if each.stands and each.kind != BIAS]
    groups: dict[frozenset[str], tuple[str, ...]] = {}
    for each in (one for one in stand if one.name not in doubted):
        names = {each.name, *each.group}
        likely = sorted(names, key=lambda name: (-each.probabilities.get(name, 0.0), name))
        groups.setdefault(frozenset(names), tuple(likely))
    return list(groups.values())


def unnamed(kinematics: Kinematics, claims: Sequence[Claim]) -> list[SensorFinding]:
    """Return one kinematic fault of each group without a claim or an equivalent claim."""
    from sim.effects.library import traits_of

    named = {name for claim in claims for name in (claim.name, *claim.alternatives)}
    named |= {
        twin for name in tuple(named) if not _is_sensor(name) for twin in traits_of(name).twins
    }
    out = []
    for finding in kinematics.result.findings if kinematics.result is not None else ():
        if finding.stands and not named.intersection((finding.name, *finding.group)):
            out.append(finding)
            named |= {finding.name, *finding.group}
    return out


def _agreement(claim: Claim, result: Compatibility) -> Agreement:
    mine = next(iter(claim.parameters.values()))
    members = {claim.name, *claim.alternatives}
    standing = [finding for finding in result.findings if finding.stands and finding.kind != BIAS]
    named = sorted(
        (f for f in standing if f.name in members),
        key=lambda f: (f.name != claim.name, not _comparable(f, claim.name)),
    )
    if named and _comparable(named[0], claim.name):
        return _compared(claim, mine, named[0], result)
    kin = next(
        (finding for finding in standing if members.intersection((finding.name, *finding.group))),
        None,
    )
    if kin is not None:
        found = Quantity(kin.value, kin.std, kin.unit)
        if kin.name == MIRRORED.get(claim.name):
            return _on_the_other_side(claim, mine, found, kin)
        words = (
            f"of the group that the diagnosis names with {claim.name}; their sizes cannot be "
            "compared"
        )
        return Agreement(
            claim.name,
            IN_KIND,
            found,
            f"kinematics alone give {kin.name} {with_sigma(found)}: {words}",
        )
    return _ruled_out(claim, result) or _unproven(
        claim,
        mine,
        next((item for item in result.joint.estimates if item.name == claim.name), None),
    )


def _comparable(finding: SensorFinding, name: str) -> bool:
    """Return whether sizes of finding and ``name`` compare: same effect, or both are times."""
    kind, _, channel = name.removeprefix("sensor-").partition(":")
    return finding.name == name or (
        finding.kind in _TIMES and kind in _TIMES and finding.channel == channel
    )


def _as_well(same: SensorFinding, result: Compatibility) -> str:
    """Return the faults that explain the records equally well, and probabilities for arms."""
    from scenarios.compatibility.report import shares

    known = [each for name in same.group for each in result.findings if each.name == name]
    texts = [f"{f.name} {with_sigma(Quantity(f.value, f.std, f.unit))}" for f in known]
    if not texts:
        return ""
    said = [f"{share} {f.name}" for f, share in shares(same, result.findings)]
    usual = f" (by the usual places of sensors {', '.join(said)})" if said else ""
    return f" or, equally well, {' or '.join(texts)}{usual}"


def _compared(
    claim: Claim, mine: Quantity, same: SensorFinding, result: Compatibility
) -> Agreement:
    found = Quantity(same.value, same.std, same.unit)
    sentence = f"kinematics alone give {same.name} {with_sigma(found)}{_as_well(same, result)}"
    group = (
        ""
        if same.name == claim.name
        else f"of the group that the diagnosis names with {claim.name}: "
    )
    if _differ(found, mine, worth_of(same)):
        words = (
            f"differs: {with_sigma(found)} against {with_sigma(mine)} in the diagnosis, "
            f"{_apart(found, mine):.1f} sigmas"
        )
        return Agreement(claim.name, DIFFERS, found, f"{sentence}: {group}{words}")
    return Agreement(
        claim.name,
        AGREES,
        found,
        f"{sentence}: {group}agrees with the diagnosis, {with_sigma(mine)}",
    )


def _on_the_other_side(
    claim: Claim, mine: Quantity, found: Quantity, kin: SensorFinding
) -> Agreement:
    """Return the comparison of an arm with its kinematic equivalent, of opposite sign."""
    as_mine = Quantity(-found.value, found.std, found.unit)
    sentence = (
        f"kinematics alone give {kin.name} {with_sigma(found)}, which they cannot tell from "
        f"{claim.name} {with_sigma(as_mine)}"
    )
    if _differ(as_mine, mine, worth_of(kin)):
        words = (
            f"differs from {with_sigma(mine)} in the diagnosis by {_apart(as_mine, mine):.1f} "
            "sigmas"
        )
        return Agreement(claim.name, DIFFERS, found, f"{sentence}: {words}")
    return Agreement(
        claim.name,
        AGREES,
        found,
        f"{sentence}: agrees with the diagnosis, {with_sigma(mine)}",
    )


def _ruled_out(claim: Claim, result: Compatibility) -> Agreement | None:
    """Return the comparison of a lag or delay for which kinematics find the other kind."""
    own = next((finding for finding in result.findings if finding.name == claim.name), None)
    other = late_instead(own, result) if own is not None else None
    if own is None or other is None or own.lost is None or not math.isfinite(own.lost):
        return None
    found = Quantity(other.value, other.std, other.unit)
    words = (
        f"{claim.name} in its place is less likely by {own.lost:.1f} of log likelihood: "
        "contradicts the diagnosis"
    )
    return Agreement(
        claim.name,
        CONTRADICTS,
        found,
        f"kinematics alone give {other.name} {with_sigma(found)}; {words}",
    )


def late_instead(own: SensorFinding, result: Compatibility) -> SensorFinding | None:
    """Return the finding in whose place ``own`` was rejected: the same channel late otherwise."""
    if own.stands or not _late(own):
        return None
    return next(
        (f for f in result.findings if f.stands and f.channel == own.channel and _late(f)), None
    )


def _late(finding: SensorFinding) -> bool:
    return finding.kind in _TIMES or finding.name == "vane-offset"


def _unproven(claim: Claim, mine: Quantity, item: SensorEstimate | None) -> Agreement:
    """Return the comparison of a claim without an accepted kinematic fault, by its estimate."""
    if item is None or not item.determined or not _finite(item.smoother.value, item.smoother.std):
        return Agreement(
            claim.name,
            NOTHING,
            None,
            f"kinematics alone say nothing of {claim.name}: these channels cannot tell it",
        )
    found = Quantity(item.smoother.value, item.smoother.std, item.unit)
    sentence = f"kinematics alone give {claim.name} {with_sigma(found)}"
    absent = Quantity(1.0 if item.kind == "scale" else 0.0, 0.0, item.unit)
    if not item.agrees:
        return Agreement(
            claim.name,
            NOTHING,
            found,
            f"{sentence}, but their two methods disagree: says nothing of the diagnosis",
        )
    if _differ(found, mine, worth_of(item)):
        return Agreement(
            claim.name,
            CONTRADICTS,
            found,
            f"{sentence}: contradicts the {with_sigma(mine)} of the diagnosis",
        )
    if _apart(found, absent) > AGREEING_SIGMAS:
        words = (
            f"agrees with the diagnosis, {with_sigma(mine)}, though it does not stand there by "
            "itself"
        )
        return Agreement(claim.name, AGREES, found, f"{sentence}: {words}")
    return Agreement(
        claim.name,
        NOTHING,
        found,
        f"{sentence}: says nothing, neither against the diagnosis nor for it",
    )


def worth_of(item: SensorEstimate | SensorFinding) -> float:
    """Return the error of a fault's size from interpolation and a slightly wrong airspeed, in
    addition to its standard deviation.
    """
    from ident.compatibility.kinematics import SensorFault

    return SensorFault(item.channel, item.kind).smallest_finding


def _differ(a: Quantity, b: Quantity, worth: float) -> bool:
    return _apart(a, b) > AGREEING_SIGMAS and abs(a.value - b.value) > worth


def _apart(a: Quantity, b: Quantity) -> float:
    spread = math.hypot(a.std, b.std)
    return abs(a.value - b.value) / spread if spread > 0.0 else math.inf


def _is_sensor(name: str) -> bool:
    """Return whether an effect is a fault in the kinematic check."""
    base = name.partition(":")[0].partition("#")[0]
    return base in ("vane-offset", "accelerometer-offset") or base in {
        f"sensor-{kind}" for kind in PARAMETERS
    }


def _finite(*values: float) -> bool:
    return all(math.isfinite(value) for value in values)


# samples, two records of 25 s at 50 Hz: the cost grows with them, the search has the rest
MOST_SAMPLES = 2600
BANK = "phi"
MOST_RECORDS = 12  # records, so that of each some twenty seconds at 10 Hz are left


@dataclass(frozen=True)
class Relations:
    """Kinematic check for one kind of equations.

    Attributes
    ----------
    needed : required channels of a record.
    channels : channels that are used if recorded.
    rates : channels that measure how much a stretch moves.
    six : six degrees of freedom, with load factors instead of accelerometers.
    names : fault of the check -> effect of the model, where they differ.
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
    """Return the results of ``flightid check`` for all parts of files that measure the channels of
    the model's relations, with about ``MOST_SAMPLES`` samples; failures are reported, not raised.

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
    """Check all records with the needed channels, each at its own airspeed.

    Long records are shortened to the stretch with most motion, ``MOST_SAMPLES`` in all. Up to
    ``MOST_RECORDS`` are used, since several airspeeds separate the arm of a vane from a delay.
    Failures are reported, not raised.
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
        chosen = shortened(spread(chosen, MOST_RECORDS), MOST_SAMPLES, asked.rates)
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
        # Must not stop the diagnosis; LinAlgError is a ValueError.
        return Kinematics(names, None, _could_not(error))


def _level(
    records: list[Record], settings: CompatibilitySettings, asked: Relations
) -> tuple[list[Record], list[str]]:
    """Return the records with nearly level wings, and remarks on the others."""
    from ident.compatibility.six_degrees.kinematics import misled_by_bank

    if BANK in asked.channels:
        return records, []
    kept, notes = list[Record](), list[str]()
    for record in records:
        unbanked = replace(
            record, outputs=tuple(channel for channel in record.outputs if channel.name != BANK)
        )
        sentences = misled_by_bank([unbanked], settings.airspeed, settings.gravity)
        notes += sentences
        kept += [] if sentences else [record]
    return kept, notes


def _taking_part(record: Record, asked: Relations) -> Record:
    """Return the record with the channels that are used."""
    from scenarios.preparation.measured_inputs import with_load_factors

    record = with_load_factors(record)[0] if asked.six else record
    outputs = tuple(channel for channel in record.outputs if channel.name in asked.channels)
    return record if len(outputs) == len(record.outputs) else replace(record, outputs=outputs)


def _measured(record: Record, asked: Relations) -> tuple[str, ...]:
    from ident.compatibility.signals import measured_channels
    from ident.compatibility.six_degrees.kinematics import recorded

    return recorded(record) if asked.six else measured_channels(record)


def _renamed(result: Compatibility, names: Mapping[str, str]) -> Compatibility:
    """Return a check with its faults under the names of the model's effects."""
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

    def checked(each: CheckResult) -> CheckResult:
        return replace(
            each,
            estimates=tuple(map(estimate, each.estimates)),
            findings=tuple(map(finding, each.findings)),
        )

    return replace(result, joint=checked(result.joint), single=tuple(map(checked, result.single)))


def spread(records: Sequence[Record], most: int) -> list[Record]:
    """Return at most ``most`` records, with widely spread airspeeds if recorded, else the first."""
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
    """Return the records cut to about ``enough`` samples in all, where the ``rates`` move most."""
    if sum(len(record) for record in records) <= enough:
        return list(records)
    left, share = enough, {}
    # Longer records get the samples that short ones do not need.
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


CLOCK = "time-base"  # the effect of a clock that is too fast or too slow
SURE = 0.005  # largest sigma of the slope of attitude against the integral of the rate
FEWEST = 50  # samples of attitude and of rate
RIGHT = 3.0  # sigmas of that slope from one, within which the clock is right


def right_clock(records: Sequence[Record]) -> str:
    """A sentence where a measured pitch attitude is the integral of the measured pitch rate over
    the record's own time, which a wrong clock does not leave so; else empty.
    """
    parts = []
    for record in records:
        if not {"theta", "q"} <= set(record.output_names):
            return ""
        theta, q = record["theta"], record["q"]
        known = theta.valid
        if np.count_nonzero(known) < FEWEST or np.count_nonzero(q.valid) < FEWEST:
            return ""
        rate = np.interp(record.time, record.time[q.valid], q.values[q.valid])
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(record.time)
        since = record.time[known] - record.time[0]
        # A bias of the rate is a trend, a bias of the attitude a constant.
        trend = np.column_stack([np.ones(len(since)), since])
        both = np.column_stack([np.append(0.0, np.cumsum(steps))[known], theta.values[known]])
        parts.append(both - trend @ np.linalg.lstsq(trend, both, rcond=None)[0])
    if not parts:
        return ""
    x, y = np.concatenate(parts).T
    size = float(x @ x)
    slope = float(x @ y) / size if size > 0.0 else 0.0
    rows = [(each[:, 1] - slope * each[:, 0])[None] for each in parts]
    share = effective_share(rows, [np.ones(row.shape, dtype=bool) for row in rows])
    residual = np.concatenate(rows, axis=1)
    std = float(np.std(residual)) / math.sqrt(max(size * share, 1e-300))
    if std > SURE or abs(slope - 1.0) > RIGHT * std:
        return ""
    slope_text = f"{number_text(slope, std)} +- {number_text(std, std)}"
    return (
        f"the measured pitch attitude is {slope_text} times "
        f"the integral of the pitch rate: the clock is right, and {CLOCK} is no candidate"
    )
