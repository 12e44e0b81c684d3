"""What the kinematics alone say of a diagnosis: evidence of its own for or against the sensor
effects that it names.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ident.compatibility.trials import Compatibility, SensorEstimate, SensorFinding
from ident.tracing.diagnosis import Claim, Quantity
from scenarios.report.quantities import with_sigma

APART = 3.0  # standard deviations within which two values agree
PARAMETERS = {
    "delay": "delay",
    "lag": "time_constant",
    "scale": "scale",
    "drift": "slope",
    "arm": "arm",
}
BIAS = "bias"  # no effect: the fits of a diagnosis leave one of each channel free
AGREES, IN_KIND, DIFFERS, CONTRADICTS, NOTHING = (
    "agrees",
    "agrees in kind",
    "differs in size",
    "contradicts",
    "says nothing",
)
# The arm of a vane is to the kinematics that of an accelerometer on the other side: (d/V) q against
# the integral of (g/V) (arm/g) q_dot.
MIRRORED = {
    "vane-offset": "accelerometer-offset:nz",
    "accelerometer-offset:nz": "vane-offset",
    "accelerometer-offset:ny": "vane-offset",
}
_TIMES = ("delay", "lag")  # sizes of these can be compared, of one channel


@dataclass(frozen=True, eq=False)
class Kinematics:
    """A check of some of a diagnosis' records (``records``: their names). ``result`` is None where
    none was possible, ``why`` says it.
    """

    records: tuple[str, ...]
    result: Compatibility | None
    why: str = ""


@dataclass(frozen=True)
class Agreement:
    """One sensor effect of a diagnosis against the kinematics: ``says`` one of AGREES, IN_KIND
    (another of its group, whose size is of another nature), DIFFERS, CONTRADICTS, NOTHING;
    ``found`` their value."""

    effect: str
    says: str
    found: Quantity | None
    sentence: str


def agreements(kinematics: Kinematics, claims: Sequence[Claim]) -> list[Agreement]:
    """Each sensor effect of the claims, in their order, against what the kinematics make of the
    same fault.
    """
    result = kinematics.result
    if result is None:
        return []
    return [
        _agreement(claim, result) for claim in claims if _is_sensor(claim.name) and claim.parameters
    ]


def named_by(kinematics: Kinematics | None) -> list[tuple[str, ...]]:
    """Names of the effects that the kinematics alone name, each with those of its group."""
    if kinematics is None or kinematics.result is None:
        return []
    found = [each for each in kinematics.result.findings if each.stands and each.kind != BIAS]
    groups: dict[frozenset[str], tuple[str, ...]] = {}
    for each in found:
        names = {each.name, *each.group}
        likely = sorted(names, key=lambda name: (-each.probabilities.get(name, 0.0), name))
        groups.setdefault(frozenset(names), tuple(likely))
    return list(groups.values())


def unnamed(kinematics: Kinematics, claims: Sequence[Claim]) -> list[SensorFinding]:
    """Faults that stand in the kinematics and belong to the group of no claim and are no twin of
    one, one of each group.
    """
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
    standing = [finding for finding in result.findings if finding.stands and finding.kind != BIAS]
    named = sorted(
        (f for f in standing if f.name in members),
        key=lambda f: (f.name != claim.name, not _comparable(f, claim.name)),
    )
    if named and _comparable(named[0], claim.name):
        return _compared(claim, mine, named[0])
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
            f"kinematics alone say: {kin.name} {with_sigma(found)}: {words}",
        )
    return _ruled_out(claim, result) or _unproven(
        claim,
        mine,
        next((item for item in result.joint.estimates if item.name == claim.name), None),
    )


def _comparable(finding: SensorFinding, name: str) -> bool:
    """Whether the size of a finding is of the nature of that of the effect ``name``: the same, or
    both times of one channel.
    """
    kind, _, channel = name.removeprefix("sensor-").partition(":")
    return finding.name == name or (
        finding.kind in _TIMES and kind in _TIMES and finding.channel == channel
    )


def _compared(claim: Claim, mine: Quantity, same: SensorFinding) -> Agreement:
    found = Quantity(same.value, same.std, same.unit)
    told = f"kinematics alone say: {same.name} {with_sigma(found)}"
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
        return Agreement(claim.name, DIFFERS, found, f"{told}: {group}{words}")
    return Agreement(
        claim.name, AGREES, found, f"{told}: {group}agrees with the diagnosis, {with_sigma(mine)}"
    )


def _on_the_other_side(
    claim: Claim, mine: Quantity, found: Quantity, kin: SensorFinding
) -> Agreement:
    """An arm where the kinematics found its twin, whose arm points the other way."""
    as_mine = Quantity(-found.value, found.std, found.unit)
    told = (
        f"kinematics alone say: {kin.name} {with_sigma(found)}, which they cannot tell from "
        f"{claim.name} {with_sigma(as_mine)}"
    )
    if _differ(as_mine, mine, worth_of(kin)):
        words = (
            f"differs from {with_sigma(mine)} in the diagnosis by {_apart(as_mine, mine):.1f} "
            "sigmas"
        )
        return Agreement(claim.name, DIFFERS, found, f"{told}: {words}")
    return Agreement(
        claim.name, AGREES, found, f"{told}: agrees with the diagnosis, {with_sigma(mine)}"
    )


def _ruled_out(claim: Claim, result: Compatibility) -> Agreement | None:
    """A way of being late in whose place the kinematics see another, of the same channel."""
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
        f"kinematics alone say: {other.name} {with_sigma(found)}; {words}",
    )


def late_instead(own: SensorFinding, result: Compatibility) -> SensorFinding | None:
    """What stands in the place of a finding that does not: another way for the same channel to be
    late.
    """
    if own.stands or not _late(own):
        return None
    return next(
        (f for f in result.findings if f.stands and f.channel == own.channel and _late(f)), None
    )


def _late(finding: SensorFinding) -> bool:
    return finding.kind in _TIMES or finding.name == "vane-offset"


def _unproven(claim: Claim, mine: Quantity, item: SensorEstimate | None) -> Agreement:
    """A claim of which nothing stands in the kinematics: their estimate may still agree with it, or
    rule it out.
    """
    if item is None or not item.told or not _finite(item.smoother.value, item.smoother.std):
        return Agreement(
            claim.name,
            NOTHING,
            None,
            f"kinematics alone say nothing of {claim.name}: these channels cannot tell it",
        )
    found = Quantity(item.smoother.value, item.smoother.std, item.unit)
    told = f"kinematics alone say: {claim.name} {with_sigma(found)}"
    absent = Quantity(1.0 if item.kind == "scale" else 0.0, 0.0, item.unit)
    if not item.agrees:
        return Agreement(
            claim.name,
            NOTHING,
            found,
            f"{told}, but their two methods disagree: says nothing of the diagnosis",
        )
    if _differ(found, mine, worth_of(item)):
        return Agreement(
            claim.name,
            CONTRADICTS,
            found,
            f"{told}: contradicts the {with_sigma(mine)} of the diagnosis",
        )
    if _apart(found, absent) > APART:
        words = (
            f"agrees with the diagnosis, {with_sigma(mine)}, though it does not stand there by "
            "itself"
        )
        return Agreement(claim.name, AGREES, found, f"{told}: {words}")
    return Agreement(
        claim.name,
        NOTHING,
        found,
        f"{told}: says nothing, neither against the diagnosis nor for it",
    )


def worth_of(item: SensorEstimate | SensorFinding) -> float:
    """What interpolation and an airspeed slightly wrong make of the size of a fault, beside its
    standard deviation.
    """
    from ident.compatibility.kinematics import SensorFault

    return SensorFault(item.channel, item.kind).worth


def _differ(a: Quantity, b: Quantity, worth: float) -> bool:
    return _apart(a, b) > APART and abs(a.value - b.value) > worth


def _apart(a: Quantity, b: Quantity) -> float:
    spread = math.hypot(a.std, b.std)
    return abs(a.value - b.value) / spread if spread > 0.0 else math.inf


def _is_sensor(name: str) -> bool:
    """Whether an effect is a fault that the kinematics know."""
    base = name.partition(":")[0].partition("#")[0]
    return base in ("vane-offset", "accelerometer-offset") or base in {
        f"sensor-{kind}" for kind in PARAMETERS
    }


def _finite(*values: float) -> bool:
    return all(math.isfinite(value) for value in values)
