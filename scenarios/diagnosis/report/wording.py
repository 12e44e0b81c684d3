"""Sentences of a diagnosis: effects with numbers, data, noise, and probabilities of causes."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from ident.statistics.residuals import ErrorFigures
from ident.tracing.diagnosis import Claim, Diagnosis, Verdict
from scenarios.report.document import Table
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

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing


def kind_of_predicted(d: Diagnosis) -> str:
    """Return a name of the predicted data in two words."""
    return "held out" if d.held_out else "fitted"


def record_labels(tracing: Tracing) -> list[str]:
    """Return the fitted records by name."""
    return [record.name for record in tracing.records]


SENSOR_NOISE, RESIDUAL = "sensor noise (estimated)", "residual"
EQUAL_NOISE_TOLERANCE = 1e-9  # relative, to which a residual is its noise


def noise_headings(d: Diagnosis) -> tuple[str, ...]:
    """Return the headings next to an error: the noise, and the residual of the fit if different."""
    return (RESIDUAL, SENSOR_NOISE) if is_coloured(d) else (SENSOR_NOISE,)


def is_coloured(d: Diagnosis) -> bool:
    """Return whether the residual of any channel is more than its noise."""
    left = residual_levels(d)
    return any(_apart(d, channel, left) for channel in d.noise_floor)


def residual_levels(d: Diagnosis) -> dict[str, float]:
    """Return the rms residual of the fit by channel; of the declared model without an effect."""
    if d.verdict is Verdict.UNEXPLAINED:
        return {name: rms for name in d.noise_floor if (rms := _declared(d, name)) > 0.0}
    return {name: d.residual_std.get(name, floor) for name, floor in d.noise_floor.items()}


def _apart(d: Diagnosis, channel: str, left: Mapping[str, float]) -> bool:
    noise = d.noise_floor.get(channel)
    return (
        noise is not None
        and channel in left
        and abs(left[channel] - noise) > EQUAL_NOISE_TOLERANCE * noise
    )


def _declared(d: Diagnosis, channel: str) -> float:
    parts = [
        item
        for item in d.fitted
        if channel in item.channels and channel in item.record.output_names
    ]
    rows = [
        (
            item.before[item.channels.index(channel)],
            item.used[item.channels.index(channel)] & item.record[channel].valid,
        )
        for item in parts
    ]
    values = np.concatenate([residual[used] for residual, used in rows]) if rows else np.zeros(0)
    return float(np.sqrt(np.mean(np.clip(values, -1e30, 1e30) ** 2))) if values.size else 0.0


# heading of a single column instead of before and after
DECLARED = "declared model"
AFTER, MOVED = "after", "moved by"
SAME_SIGMAS = 1e-3  # difference of two fits that is rounding, in sigmas, and of sigmas
NO_AFTER = (AFTER, MOVED, "run-to-run")


def nothing_stands(d: Diagnosis) -> bool:
    """Return whether no effect is accepted, so that only the declared model exists."""
    return d.verdict is Verdict.UNEXPLAINED


def declared_alone(d: Diagnosis) -> bool:
    """Return whether there are no numbers but those of the declared model: no effect is accepted,
    or none was needed and nothing differs after the search.
    """
    return nothing_stands(d) or (d.verdict is Verdict.CONSISTENT and _unchanged(d))


def _unchanged(d: Diagnosis) -> bool:
    """Return whether a second fit of the declared model has the numbers of the first, but for
    rounding."""
    return all(
        name in d.after
        and abs(d.after[name].value - old.value) <= SAME_SIGMAS * old.std
        and math.isclose(d.after[name].std, old.std, rel_tol=SAME_SIGMAS)
        for name, old in d.before.items()
    ) and all(
        math.isclose(d.error_after.rmse.get(name, math.nan), error, rel_tol=SAME_SIGMAS)
        for name, error in d.error_before.rmse.items()
    )


def shown_table(d: Diagnosis, whole: Table) -> Table:
    """Return a table of the diagnosis, without the columns that a further model would fill where
    the declared model is the only one.
    """
    if not declared_alone(d):
        return whole
    kept = [at for at, each in enumerate(whole.columns) if each.heading not in NO_AFTER]
    columns = [
        replace(column, heading=DECLARED) if column.heading == "before" else column
        for column in (whole.columns[at] for at in kept)
    ]
    rows = tuple(tuple(row[at] for at in kept) for row in whole.rows)
    return replace(whole, columns=tuple(columns), rows=rows)


def as_declared(d: Diagnosis) -> Diagnosis:
    """Return the diagnosis as its figures show it: where the declared model is the only one, its
    residuals and predictions alone, and under ``unexplained`` no derivatives after it.
    """
    if not declared_alone(d):
        return d
    return replace(
        d,
        after={} if nothing_stands(d) else d.after,
        error_after=ErrorFigures({}, {}, {}, {}),
        fitted=tuple(replace(item, after=item.before) for item in d.fitted),
        predictions=tuple(replace(item, after=item.before) for item in d.predictions),
        tests_after=() if nothing_stands(d) else d.tests_after,
    )


_MOST_NAMED_PARAMETERS = 2  # undetermined parameters that are listed one by one
_TIMES = ("time", "start", "begin", "duration")


@dataclass(frozen=True)
class Wording:
    """Names and units of a study for its sentences.

    Control, unit of the stick, and traits of candidate effects. ``controls``: all inputs, named
    after the colon of an effect. ``channels``: their words. ``parameters``: names of the declared
    model's parameters.
    """

    control: str = "elevator"
    stick_unit: str = ""
    candidates: Mapping[str, Traits] = field(default_factory=lambda: MappingProxyType({}))
    controls: tuple[str, ...] = ()
    channels: Mapping[str, str] = field(default_factory=lambda: MappingProxyType(CHANNELS))
    parameters: tuple[str, ...] = ()

    def traits(self, name: str) -> Traits:
        """Return the traits of an effect, or of its first instance (``elastic-mode`` for
        ``elastic-mode#2``): a candidate's, else the library's.
        """
        from sim.effects.library import traits_of

        known = next(
            (each for each in (name, name.partition("#")[0]) if each in self.candidates), None
        )
        return self.candidates[known] if known is not None else traits_of(name)

    def control_of(self, name: str) -> str:
        """Return the input of an effect, as in ``"input-delay:rudder"``; default: the first."""
        acted_on = name.partition(":")[2].partition("#")[0]
        return acted_on if acted_on in self.controls else self.control


def sentence(claim: Claim, wording: Wording) -> str:
    """Describe an effect in words: by its templates, else by its name and parameters."""
    return _told(claim, wording, wording.traits(claim.name).sentences)


def group_sentence(claim: Claim, wording: Wording) -> str:
    """The sentence of an effect with what else it may be: ``"the pitch rate is read 0.06 s late
    (lag or delay: both fit these data equally well)"``.
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
    count = "both" if len(members) == 2 else "all"
    return (
        f"{told} ({', '.join(members[:-1])} or {members[-1]}: {count} fit these data equally well)"
    )


def most_likely(told: str, claimed: Sequence[Claim]) -> str:
    """Return ``"most likely ..."``, or the effects ``told`` with more likely alternatives."""
    likelier = []
    for claim in claimed:
        leader = max(claim.probability, key=claim.probability.__getitem__, default=claim.name)
        if leader != claim.name:
            likelier.append(f"{leader} is more likely than {claim.name}")
    return "; ".join([told, *likelier]) if likelier else f"most likely {told}"


def _told(claim: Claim, wording: Wording, templates: Sequence[str]) -> str:
    """Return the first of some templates that the claim's parameters fill in, else its name and
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
    """All parameters with their sigmas, ``"half_width 0.401 +- 0.009 deg"``; after them those that
    are not determined, of more than two one and how many others."""
    units = _stick_units(claim, wording)
    vague = [
        name
        for name, quantity in claim.parameters.items()
        if not determined(quantity.value, quantity.std)
    ]
    sentences = [
        f"{name} {with_sigma(quantity, units.get(name), name)}"
        for name, quantity in claim.parameters.items()
        if name not in vague
    ]
    if len(vague) > _MOST_NAMED_PARAMETERS:
        sentences.append(f"{vague[0]} and {len(vague) - 1} more {UNDETERMINED}")
    return ", ".join(
        [
            *sentences,
            *(f"{name} {UNDETERMINED}" for name in vague if len(vague) <= _MOST_NAMED_PARAMETERS),
        ]
    )


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
    """Return the units of those parameters that are counted in the stick's unit, by name; none if
    another control flies.
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


_ANY = "a record with inputs of other sizes and other frequencies"


def separating_maneuver(name: str, other: str, wording: Wording | None = None) -> str:
    """Return the maneuver that separates two effects, declared by one of them or generic."""
    wording = wording or Wording()
    for one, two in ((name, other), (other, name)):
        base = two.partition(":")[0].partition("#")[0]
        maneuvers = wording.traits(one).separating
        if base in maneuvers:
            return _with_names_of_model(maneuvers[base], wording.parameters)
    return _ANY


_NAMES = re.compile(r"\{ \(([^)]*)\)\}")


def _with_names_of_model(text: str, parameters: Collection[str]) -> str:
    """Return an advice that names only parameters of the model: ``"{ (CL_de, L_delta)}"`` becomes
    ``" (CL_de)"`` or nothing.
    """

    def of_model(found: re.Match[str]) -> str:
        names = [name for name in found[1].split(", ") if name in parameters]
        return f" ({', '.join(names)})" if names else ""

    return _NAMES.sub(of_model, text)


def separating_maneuvers(
    name: str, others: Sequence[str], wording: Wording | None = None
) -> list[tuple[tuple[str, ...], str]]:
    """Return the same for several alternatives, those that need the same maneuver together."""
    grouped: dict[str, list[str]] = {}
    for other in others:
        grouped.setdefault(separating_maneuver(name, other, wording), []).append(other)
    return [(tuple(names), maneuver) for maneuver, names in grouped.items()]


LEAST_PRINTED_SHARE = 0.005  # half a per cent rounds to nothing


def shown_probability(claim: Claim) -> dict[str, float]:
    """Return probabilities of the claim, then of its alternatives in descending order.

    Without those below ``LEAST_PRINTED_SHARE``; empty for hints.
    """
    found = {
        name: p
        for name, p in claim.probability.items()
        if math.isfinite(p) and p >= LEAST_PRINTED_SHARE
    }
    return {
        name: round(found[name], 3)
        for name in sorted(found, key=lambda name: (name != claim.name, -found[name], name))
    }


def probability_sentence(claim: Claim) -> str:
    """``"Probability of this cause: 93 %; sensor-lag:q 5 %"``; empty of hints.

    An alternative of no probability is one that fits as well: then the priors alone decide.
    """
    mine = claim.probability.get(claim.name, math.nan)
    if not math.isfinite(mine):
        return ""
    rest = ", ".join(
        f"{name} {_percent(p)}"
        for name, p in shown_probability(claim).items()
        if name != claim.name
    )
    sentence = f"Probability of this cause: {_percent(mine)}{f'; {rest}' if rest else ''}"
    equal = [
        name
        for name in claim.alternatives
        if claim.probability.get(name, 1.0) < LEAST_PRINTED_SHARE
    ]
    if not equal:
        return sentence
    many = " and ".join(equal)
    fits = f"{many} {'fits' if len(equal) == 1 else 'fit'} these data equally well"
    return f"{sentence}; {fits}, and only the prior probabilities favour {claim.name}"


def _percent(p: float) -> str:
    """Whole per cents; neither none nor all of it, which is never known."""
    if p < LEAST_PRINTED_SHARE:
        return "below 1 %"
    return f"{max(1.0, 100.0 * p):.0f} %" if p < 1.0 - LEAST_PRINTED_SHARE else "above 99 %"
