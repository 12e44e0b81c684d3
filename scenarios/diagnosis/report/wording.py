"""Each effect as a sentence that a flight-test engineer understands at once, with its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from ident.tracing.diagnosis import Claim
from scenarios.report.quantities import (
    CHANNELS,
    UNDETERMINED,
    _number,
    determined,
    displayed,
    spaced,
    with_sigma,
)
from sim.declaration.proposal import Traits

_NAMED = 2  # parameters that are not determined, up to which each is told
_TIMES = ("time", "start", "begin", "duration")


@dataclass(frozen=True)
class Wording:
    """What the sentences need to know of the study: the name of the control, the stick's unit where
    there is one, and the traits of the effects that were candidates, by name; those of all others
    stand with the library's. ``controls``: all inputs, of which the part of an effect's name behind
    the colon says on which it acts. ``channels`` in words, those that have some.
    """

    control: str = "elevator"
    stick_unit: str = ""
    candidates: Mapping[str, Traits] = field(default_factory=lambda: MappingProxyType({}))
    controls: tuple[str, ...] = ()
    channels: Mapping[str, str] = field(default_factory=lambda: MappingProxyType(CHANNELS))

    def traits(self, name: str) -> Traits:
        """What is known of an effect, or of its first instance (``elastic-mode`` for
        ``elastic-mode#2``): a candidate's, else the library's.
        """
        from sim.effects.library import traits_of

        known = next(
            (each for each in (name, name.partition("#")[0]) if each in self.candidates), None
        )
        return self.candidates[known] if known is not None else traits_of(name)

    def control_of(self, name: str) -> str:
        """The input that an effect acts on, ``"input-delay:rudder"``; the first of all where its
        name does not say.
        """
        acted_on = name.partition(":")[2].partition("#")[0]
        return acted_on if acted_on in self.controls else self.control


def sentence(claim: Claim, wording: Wording) -> str:
    """What an effect does, in words: by the templates that stand with it, else its name and
    parameters.
    """
    return _told(claim, wording, wording.traits(claim.name).sentences)


def group_sentence(claim: Claim, wording: Wording) -> str:
    """The sentence of an effect with what else it may be: ``"the pitch rate is read 0.06 s late
    (lag or delay: these records cannot tell)"``.
    """
    if not claim.alternatives:
        return sentence(claim, wording)
    names = (claim.name, *claim.alternatives)
    known = [wording.traits(name) for name in names]
    channel = claim.name.partition(":")[2]
    one_reading = all(name.partition(":")[2] == channel for name in names if ":" in name)
    grouped = (known[0].grouped,) if known[0].grouped and one_reading else ()
    told = _told(claim, wording, (*grouped, *known[0].sentences))
    members = [
        traits.short_name or name if one_reading else name
        for name, traits in zip(names, known, strict=True)
    ]
    told = told.removesuffix(f" ({members[0]})")  # "(break-out)" once is enough
    return f"{told} ({', '.join(members[:-1])} or {members[-1]}: these records cannot tell)"


def _told(claim: Claim, wording: Wording, templates: Sequence[str]) -> str:
    """The first of some templates that the claim's parameters fill in, else its name and
    parameters.
    """
    channel = claim.name.partition(":")[2]
    fields = _fields(claim, wording)
    control = wording.control_of(claim.name)
    sticks = "does nothing" if control == "stick" else "sticks"
    fields |= {
        "control": control,
        "sticks": sticks,
        "channel": wording.channels.get(channel, channel),
    }
    for template in templates:
        try:
            return template.format_map(fields)
        except (KeyError, ValueError, IndexError, AttributeError):
            # a parameter that is not there, or a template of a user's that cannot be filled in
            continue
    numbers = parameter_text(claim, wording)
    return f"{claim.name} acts: {numbers}" if numbers else f"{claim.name} acts"


def parameter_text(claim: Claim, wording: Wording) -> str:
    """All parameters with their sigmas, ``"half_width 0.401 +- 0.009 deg"``; behind them those that
    are not determined, of more than two one and how many others."""
    units = _stick_units(claim, wording)
    vague = [
        name
        for name, quantity in claim.parameters.items()
        if not determined(quantity.value, quantity.std)
    ]
    told = [
        f"{name} {with_sigma(quantity, units.get(name), name)}"
        for name, quantity in claim.parameters.items()
        if name not in vague
    ]
    if len(vague) > _NAMED:
        told.append(f"{vague[0]} and {len(vague) - 1} more {UNDETERMINED}")
    return ", ".join([*told, *(f"{name} {UNDETERMINED}" for name in vague if len(vague) <= _NAMED)])


def _fields(claim: Claim, wording: Wording) -> dict[str, str]:
    fields, units = {}, _stick_units(claim, wording)
    for name, quantity in claim.parameters.items():
        value, std, text = displayed(quantity, name)
        fields[name] = _number(value, std) + spaced(units.get(name) or text)
        fields[f"{name}_percent"] = (
            f"{_number(100.0 * abs(quantity.value - 1.0), 100.0 * quantity.std)} %"
        )
        fields[f"{name}_change"] = f"{_number(100.0 * abs(quantity.value), 100.0 * quantity.std)} %"
        above = quantity.value > (0.0 if name == "change" else 1.0)
        fields[f"{name}_direction"] = (
            ("larger" if above else "smaller")
            if name == "change"
            else ("too large" if above else "too small")
        )
        if quantity.unit == "m":
            side = "ahead of" if quantity.value >= 0.0 else "behind"
            fields[f"{name}_side"] = f"{_number(abs(quantity.value), quantity.std)} m {side}"
        if quantity.unit == "rad/s":
            fields[f"{name}_hertz"] = (
                f"{_number(quantity.value / (2 * math.pi), quantity.std / (2 * math.pi))} Hz"
            )
    if "count" in claim.parameters:
        count = round(claim.parameters["count"].value)
        fields["count_spikes"] = f"{count} spike{'s' if count != 1 else ''}"
    rest = [
        f"{name} {with_sigma(quantity, name=name)}"
        for name, quantity in claim.parameters.items()
        if name not in _TIMES
    ]
    return {**fields, "rest": ", ".join(rest)} if rest else fields


def _stick_units(claim: Claim, wording: Wording) -> dict[str, str]:
    """Units of those parameters that are counted in the stick's unit, by name; none where another
    control flies.
    """
    if wording.control != "stick":
        return {}
    label = wording.stick_unit if wording.stick_unit not in ("", "1") else "stick units"
    shown = {"1": label, "1/s": f"{label}/s"}
    counted = wording.traits(claim.name).in_input_unit
    return {
        name: shown[q.unit]
        for name, q in claim.parameters.items()
        if name in counted and q.unit in shown
    }
