"""Which maneuver tells apart what a record could not."""

from __future__ import annotations

from collections.abc import Sequence

_LATE_SENSOR = ("sensor-lag", "sensor-delay")
# Two families of names (without channel) and what to fly; the first that fits both names is taken.
_MANEUVERS: tuple[tuple[tuple[str, ...], tuple[str, ...], str], ...] = (
    (
        ("input-delay",),
        ("actuator-lag",),
        "quick inputs (short doublets, or a sweep up to the inverse of the lag): a lag loses amplitude there, a delay does not",
    ),
    (
        ("input-delay", "actuator-lag"),
        ("actuator-rate-limit",),
        "the same maneuver at half and at twice the size: only a rate limit makes large inputs later than small ones",
    ),
    (
        ("input-deadband", "actuator-saturation", "control-nonlinearity"),
        ("input-deadband", "actuator-saturation", "control-nonlinearity"),
        "inputs of many sizes (a multisine, or steps of five sizes): on three levels these are one and the same function",
    ),
    (
        ("input-deadband",),
        ("input-backlash",),
        "small slow reversals about a deflected control: a play acts there, a dead band about zero does not",
    ),
    (
        ("vane-offset",),
        _LATE_SENSOR,
        "the same maneuver at another airspeed: the error of a vane goes with q/V, a lag or a delay stays",
    ),
    (
        _LATE_SENSOR,
        _LATE_SENSOR,
        "faster motion (short doublets, or a sweep up to the inverse of the lag): a lag loses amplitude there, a delay does not",
    ),
    (
        ("sensor-scale",),
        (*_LATE_SENSOR, "lift-nonlinearity"),
        "slow pull-ups beside quick doublets, small and large: a scale is the same in all of them",
    ),
    (
        ("sensor-scale",),
        ("sensor-scale",),
        "a record with the load factor as well: kinematics then tie the channels together",
    ),
    (
        ("speed-variation", "sensor-drift"),
        ("speed-variation", "sensor-drift", "drag-mach", "density-scale-height"),
        "steady flight before and after the maneuver, and the airspeed recorded",
    ),
    (
        ("density-scale-height", "drag-mach", "drag-jump", "sensor-scale"),
        ("density-scale-height", "drag-mach", "drag-jump", "sensor-scale"),
        "a fall that begins higher or faster: it meets the same density at another Mach number",
    ),
)
_ANY = "a record with inputs of other sizes and other frequencies"


def separating_maneuver(name: str, other: str) -> str:
    """What to fly so that two effects can be told apart."""
    a, b = (each.partition(":")[0].partition("#")[0] for each in (name, other))
    for first, second, maneuver in _MANEUVERS:
        if (a in first and b in second) or (b in first and a in second):
            return maneuver
    return _ANY


def separating_maneuvers(name: str, others: Sequence[str]) -> list[tuple[tuple[str, ...], str]]:
    """The same for several alternatives, those that need the same maneuver together."""
    grouped: dict[str, list[str]] = {}
    for other in others:
        grouped.setdefault(separating_maneuver(name, other), []).append(other)
    return [(tuple(names), maneuver) for maneuver, names in grouped.items()]
