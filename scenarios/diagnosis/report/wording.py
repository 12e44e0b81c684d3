"""Each effect as a sentence that a flight-test engineer understands at once, with its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from ident.tracing.diagnosis import Claim, Quantity
from scenarios.terminal.quantities import CHANNELS, _number, _spaced, displayed, with_sigma

# By name without its channel: templates of which the first whose parameters are all there is taken. Beside the parameters by
# local name: {control}, {channel}, {rest} (all parameters but times), and of a parameter NAME_percent (its distance from
# one), NAME_change (a share), NAME_direction, NAME_hertz.
SENTENCES: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "input-delay": ("what the {control} does reaches the aircraft {delay} late",),
        "actuator-lag": ("the actuator follows the {control} with a lag of {time_constant}",),
        "actuator-rate-limit": ("the actuator moves no faster than {rate}",),
        "actuator-saturation": ("the actuator stops at +-{limit}",),
        "input-deadband": ("the {control} {sticks} within +-{half_width} of zero (break-out)",),
        "input-backlash": ("the {control} has a play of +-{half_width} (hysteresis)",),
        "moment-nonlinearity": ("the pitching moment is not linear in the angle of attack",),
        "lift-nonlinearity": ("the lift is not linear in the angle of attack",),
        "control-nonlinearity": ("the effect of the {control} is not in proportion to its deflection",),
        "derivative-jump": ("the derivatives change at {time}: {rest}",),
        "elastic-mode": ("the structure bends: a mode of {frequency} ({frequency_hertz}), damping {damping}",),
        "density-scale-height": ("the air density falls off with a scale height {change_change} {change_direction} than declared",),
        "drag-mach": ("the drag changes with the Mach number",),
        "drag-jump": ("the drag is multiplied by {factor} from {time} on",),
        "gust-turbulence": ("the air is turbulent: gusts of {sigma}, length scale {length}",),
        "gust-discrete": ("a single gust of {peak} comes at {start} and lasts {duration}",),
        "speed-variation": ("the airspeed changes by {rate}",),
        "unmeasured-input": (
            "something that is not recorded acts for {duration} from {start}: {rest}",
            "something that is not recorded acts from {start} on: {rest}",
        ),
        "vane-offset": ("the vane sits {arm} ahead of the centre of gravity and feels the pitch rate",),
        "sensor-scale": ("the {channel} is read {scale_percent} {scale_direction}",),
        "sensor-lag": ("the {channel} is read with a lag of {time_constant}",),
        "sensor-delay": ("the {channel} is read {delay} late",),
        "sensor-drift": ("the reading of the {channel} drifts by {slope}",),
        "sensor-spikes": (
            "the reading of the {channel} has {count_spikes} of about {size}",
            "the reading of the {channel} has spikes: {rest}",
            "the reading of the {channel} has spikes",
        ),
    }
)
# What a member of a group is called beside others, by name without its channel.
MEMBERS: Mapping[str, str] = MappingProxyType(
    {
        "input-delay": "delay",
        "actuator-lag": "actuator lag",
        "actuator-rate-limit": "actuator rate limit",
        "actuator-saturation": "actuator stop",
        "input-deadband": "break-out",
        "input-backlash": "hysteresis",
        "moment-nonlinearity": "curved pitching moment",
        "lift-nonlinearity": "curved lift",
        "control-nonlinearity": "curved control",
        "elastic-mode": "bending structure",
        "speed-variation": "changing airspeed",
        "vane-offset": "vane ahead",
        "sensor-lag": "lag",
        "sensor-delay": "delay",
    }
)
_LATE = ("sensor-lag", "sensor-delay")
_TIMES = ("time", "start", "begin", "duration")


@dataclass(frozen=True)
class Wording:
    """What the sentences need to know of the study: the name of the control, the stick's unit where there is one, and ``own``
    templates, by name, of effects that are not the library's.
    """

    control: str = "elevator"
    stick_unit: str = ""
    own: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


def sentence(claim: Claim, wording: Wording) -> str:
    """What an effect does, in words: from the table, else its name and parameters."""
    base, _, channel = claim.name.partition(":")
    fields = _fields(claim, wording)
    sticks = "does nothing" if wording.control == "stick" else "sticks"
    fields |= {"control": wording.control, "sticks": sticks, "channel": CHANNELS.get(channel, channel)}
    own = (wording.own[claim.name],) if claim.name in wording.own else ()
    for template in (*own, *SENTENCES.get(base.partition("#")[0], ())):
        try:
            return template.format_map(fields)
        except (KeyError, ValueError, IndexError, AttributeError):
            continue  # a parameter that is not there, or a template of a user's that cannot be filled in
    numbers = parameter_text(claim, wording)
    return f"{claim.name} acts: {numbers}" if numbers else f"{claim.name} acts"


def group_sentence(claim: Claim, wording: Wording) -> str:
    """The sentence of an effect with what else it may be: ``"the pitch rate is read 0.06 s late (lag or delay: these records cannot tell)"``."""
    told = sentence(claim, wording)
    if not claim.alternatives:
        return told
    base, _, channel = claim.name.partition(":")
    names = (claim.name, *claim.alternatives)
    one_reading = all(name.partition(":")[2] == channel for name in names if name.startswith("sensor-"))
    if base in _LATE and one_reading:
        time = next((displayed(quantity) for quantity in claim.parameters.values()), None)
        told = f"the {CHANNELS.get(channel, channel)} is read {_number(time[0], time[1])} s late" if time is not None else told
    members = [MEMBERS.get(name.partition(":")[0].partition("#")[0], name) if one_reading else name for name in names]
    told = told.removesuffix(f" ({members[0]})")  # "(break-out)" once is enough
    return f"{told} ({', '.join(members[:-1])} or {members[-1]}: these records cannot tell)"


def parameter_text(claim: Claim, wording: Wording) -> str:
    """All parameters with their sigmas: ``"half_width 0.401 +- 0.009 deg"``."""
    return ", ".join(f"{name} {with_sigma(quantity, _stick(claim, quantity, wording), name)}" for name, quantity in claim.parameters.items())


def _fields(claim: Claim, wording: Wording) -> dict[str, str]:
    fields = {}
    for name, quantity in claim.parameters.items():
        value, std, text = displayed(quantity, name)
        fields[name] = _number(value, std) + _spaced(_stick(claim, quantity, wording) or text)
        fields[f"{name}_percent"] = f"{_number(100.0 * abs(quantity.value - 1.0), 100.0 * quantity.std)} %"
        fields[f"{name}_change"] = f"{_number(100.0 * abs(quantity.value), 100.0 * quantity.std)} %"
        above = quantity.value > (0.0 if name == "change" else 1.0)
        fields[f"{name}_direction"] = ("larger" if above else "smaller") if name == "change" else ("too large" if above else "too small")
        if quantity.unit == "rad/s":
            fields[f"{name}_hertz"] = f"{_number(quantity.value / (2 * math.pi), quantity.std / (2 * math.pi))} Hz"
    if "count" in claim.parameters:
        count = round(claim.parameters["count"].value)
        fields["count_spikes"] = f"{count} spike{'s' if count != 1 else ''}"
    rest = [f"{name} {with_sigma(quantity, name=name)}" for name, quantity in claim.parameters.items() if name not in _TIMES]
    return {**fields, "rest": ", ".join(rest)} if rest else fields


def _stick(claim: Claim, quantity: Quantity, wording: Wording) -> str | None:
    """The unit of a number on the input path that is counted in the stick's unit; None for any other."""
    label = wording.stick_unit if wording.stick_unit not in ("", "1") else "stick units"
    if wording.control != "stick" or not claim.name.startswith(("input-", "actuator-")):
        return None
    return {"1": label, "1/s": f"{label}/s"}.get(quantity.unit)
