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
    determined,
    displayed,
    rounded_text,
    spaced,
    with_sigma,
)
from sim.declaration.proposal import Traits

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing


def kind_of_predicted(d: Diagnosis) -> str:
    """Return whether the predicted data are "held out" or "fitted"."""
    return "held out" if d.held_out else "fitted"


def record_labels(tracing: Tracing) -> list[str]:
    """Return the fitted records by name."""
    return [record.name for record in tracing.records]


SENSOR_NOISE, RESIDUAL = "sensor noise (estimated)", "residual"
EQUAL_NOISE_TOLERANCE = 1e-9  # relative difference of residual and noise that is rounding
LARGEST_RESIDUAL = 1e30  # limit of a diverged residual, so that its square is finite


def noise_headings(d: Diagnosis) -> tuple[str, ...]:
    """Return the headings of the columns after the errors: the residual of the fit if it is more
    than noise, and the noise.
    """
    return (RESIDUAL, SENSOR_NOISE) if is_coloured(d) else (SENSOR_NOISE,)


def is_coloured(d: Diagnosis) -> bool:
    """Return whether the residual of any channel differs from its noise."""
    residuals = residual_levels(d)
    return any(
        channel in residuals and abs(residuals[channel] - noise) > EQUAL_NOISE_TOLERANCE * noise
        for channel, noise in d.noise_floor.items()
    )


def residual_levels(d: Diagnosis) -> dict[str, float]:
    """Return the rms residual of the fit by channel.

    Without an accepted effect, it is the residual of the declared model.
    """
    if d.verdict is Verdict.UNEXPLAINED:
        return {name: rms for name in d.noise_floor if (rms := _declared_rms(d, name)) > 0.0}
    return {name: d.residual_std.get(name, noise) for name, noise in d.noise_floor.items()}


def _declared_rms(d: Diagnosis, channel: str) -> float:
    """Return the rms residual of the declared model; 0 if the channel was not fitted."""
    residuals = []
    for item in d.fitted:
        if channel in item.channels and channel in item.record.output_names:
            row = item.channels.index(channel)
            residuals.append(item.before[row][item.used[row] & item.record[channel].valid])
    values = np.concatenate(residuals) if residuals else np.zeros(0)
    if not values.size:
        return 0.0
    return float(np.sqrt(np.mean(np.clip(values, -LARGEST_RESIDUAL, LARGEST_RESIDUAL) ** 2)))


DECLARED = "declared model"  # heading of the single column in place of "before" and "after"
ROUNDING = 1e-3  # difference of two fits that is rounding: in sigmas, or relative
NO_AFTER = ("after", "moved by", "run-to-run")  # columns that the declared model alone leaves empty


def is_unexplained(d: Diagnosis) -> bool:
    """Return whether no effect is accepted although the declared model is incomplete."""
    return d.verdict is Verdict.UNEXPLAINED


def declared_alone(d: Diagnosis) -> bool:
    """Return whether the only results are those of the declared model: no effect is accepted, or
    none was needed and the search changed nothing.
    """
    return is_unexplained(d) or (d.verdict is Verdict.CONSISTENT and _unchanged(d))


def _unchanged(d: Diagnosis) -> bool:
    """Return whether results after the search equal those before, except for rounding."""
    same_parameters = all(
        name in d.after
        and abs(d.after[name].value - old.value) <= ROUNDING * old.std
        and math.isclose(d.after[name].std, old.std, rel_tol=ROUNDING)
        for name, old in d.before.items()
    )
    return same_parameters and all(
        math.isclose(d.error_after.rmse.get(name, math.nan), error, rel_tol=ROUNDING)
        for name, error in d.error_before.rmse.items()
    )


def shown_table(d: Diagnosis, table: Table) -> Table:
    """Return a table of the diagnosis; if only the declared model has results, without the columns
    of the model with effects.
    """
    if not declared_alone(d):
        return table
    kept = [i for i, column in enumerate(table.columns) if column.heading not in NO_AFTER]
    columns = tuple(
        replace(column, heading=DECLARED) if column.heading == "before" else column
        for column in (table.columns[i] for i in kept)
    )
    rows = tuple(tuple(row[i] for i in kept) for row in table.rows)
    return replace(table, columns=columns, rows=rows)


def as_declared(d: Diagnosis) -> Diagnosis:
    """Return the diagnosis as its figures show it.

    If only the declared model has results, its residuals and predictions stand in place of those
    after the search. If no effect is accepted, there are no derivatives after the search.
    """
    if not declared_alone(d):
        return d
    return replace(
        d,
        after={} if is_unexplained(d) else d.after,
        error_after=ErrorFigures({}, {}, {}, {}),
        fitted=tuple(replace(item, after=item.before) for item in d.fitted),
        predictions=tuple(replace(item, after=item.before) for item in d.predictions),
        tests_after=() if is_unexplained(d) else d.tests_after,
    )


_MOST_NAMED_PARAMETERS = 2  # undetermined parameters that are listed one by one
_TIMES = ("time", "start", "begin", "duration")  # parameters that are no size of an effect


@dataclass(frozen=True)
class Wording:
    """Names and units of a study for its sentences.

    Attributes
    ----------
    control : the first input.
    stick_unit : unit of the stick.
    candidates : traits of candidate effects, by name.
    controls : all inputs; the name of an effect has one of them after a colon.
    channels : channel -> its name in words.
    parameters : names of the declared model's parameters.
    """

    control: str = "elevator"
    stick_unit: str = ""
    candidates: Mapping[str, Traits] = field(default_factory=lambda: MappingProxyType({}))
    controls: tuple[str, ...] = ()
    channels: Mapping[str, str] = field(default_factory=lambda: MappingProxyType(CHANNELS))
    parameters: tuple[str, ...] = ()

    def traits(self, name: str) -> Traits:
        """Return the traits of an effect, from the candidates or else from the library.

        A second instance, as ``elastic-mode#2``, has the traits of ``elastic-mode``.
        """
        from sim.effects.library import traits_of

        for candidate in (name, name.partition("#")[0]):
            if candidate in self.candidates:
                return self.candidates[candidate]
        return traits_of(name)

    def control_of(self, name: str) -> str:
        """Return the input in the name of an effect, as in ``"input-delay:rudder"``; without one,
        the first input.
        """
        control = name.partition(":")[2].partition("#")[0]
        return control if control in self.controls else self.control


def sentence(claim: Claim, wording: Wording) -> str:
    """Describe an effect in words: by its templates, else by its name and parameters."""
    return _from_templates(claim, wording, wording.traits(claim.name).sentences)


def group_sentence(claim: Claim, wording: Wording) -> str:
    """Return the sentence of an effect with its alternatives, as in ``"the pitch rate is read
    0.06 s late (lag or delay: both fit these data equally well)"``.
    """
    if not claim.alternatives:
        return sentence(claim, wording)
    names = (claim.name, *claim.alternatives)
    traits = [wording.traits(name) for name in names]
    channel = claim.name.partition(":")[2]
    one_channel = all(name.partition(":")[2] == channel for name in names if ":" in name)
    templates = traits[0].sentences
    members = list(names)
    if one_channel:
        if traits[0].grouped:
            templates = (traits[0].grouped, *templates)
        members = [item.short_name or name for name, item in zip(names, traits, strict=True)]
    # The member's name is in the list that follows, so it is cut off here.
    text = _from_templates(claim, wording, templates).removesuffix(f" ({members[0]})")
    likeliest = max((claim.probability.get(name, 0.0) for name in names[1:]), default=0.0)
    if 0.0 < likeliest < claim.probability.get(claim.name, 0.0) / FAR_LIKELIER:
        return f"{text} ({members[0]}; less likely: {' or '.join(members[1:])})"
    count = "both" if len(members) == 2 else "all"
    return (
        f"{text} ({', '.join(members[:-1])} or {members[-1]}: {count} fit these data equally well)"
    )


def most_likely(text: str, claimed: Sequence[Claim]) -> str:
    """Return ``"most likely TEXT"``, or ``text`` and the alternatives that are more likely than the
    claimed effects.
    """
    likelier = []
    for claim in claimed:
        leader = max(claim.probability, key=claim.probability.__getitem__, default=claim.name)
        if leader != claim.name:
            likelier.append(f"{leader} is more likely than {claim.name}")
    return "; ".join([text, *likelier]) if likelier else f"most likely {text}"


def _from_templates(claim: Claim, wording: Wording, templates: Sequence[str]) -> str:
    """Return the first template that the claim's parameters fill; else its name and parameters."""
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
            continue  # a parameter is missing, or a user's template is wrong
    numbers = parameter_text(claim, wording)
    return f"{claim.name} acts: {numbers}" if numbers else f"{claim.name} acts"


def parameter_text(claim: Claim, wording: Wording) -> str:
    """Return all parameters with their sigmas, as in ``"half_width 0.401 +- 0.009 deg"``.

    Parameters that the data do not determine are last; of more than two only one is named.
    """
    units = _stick_units(claim, wording)
    undetermined = [
        name
        for name, quantity in claim.parameters.items()
        if not determined(quantity.value, quantity.std)
    ]
    texts = [
        f"{name} {with_sigma(quantity, units.get(name), name)}"
        for name, quantity in claim.parameters.items()
        if name not in undetermined
    ]
    if len(undetermined) > _MOST_NAMED_PARAMETERS:
        texts.append(f"{undetermined[0]} and {len(undetermined) - 1} more {UNDETERMINED}")
    else:
        texts += [f"{name} {UNDETERMINED}" for name in undetermined]
    return ", ".join(texts)


def _fields(claim: Claim, wording: Wording) -> dict[str, str]:
    """Return the fields that templates may contain: each parameter in several forms."""
    fields, units = {}, _stick_units(claim, wording)
    for name, quantity in claim.parameters.items():
        value, std, unit = displayed(quantity, name)
        percent_std = 100.0 * quantity.std
        percent_of_one = rounded_text(100.0 * abs(quantity.value - 1.0), percent_std)
        fields[name] = rounded_text(value, std) + spaced(units.get(name) or unit)
        fields[f"{name}_percent"] = f"{percent_of_one} %"
        fields[f"{name}_change"] = f"{rounded_text(100.0 * abs(quantity.value), percent_std)} %"
        if name == "change":
            direction = "larger" if quantity.value > 0.0 else "smaller"
        else:
            direction = "too large" if quantity.value > 1.0 else "too small"
        fields[f"{name}_direction"] = direction
        if quantity.unit == "m":
            side = "ahead of" if quantity.value >= 0.0 else "behind"
            fields[f"{name}_side"] = f"{rounded_text(abs(quantity.value), quantity.std)} m {side}"
        if quantity.unit == "rad/s":
            hertz = rounded_text(quantity.value / (2 * math.pi), quantity.std / (2 * math.pi))
            fields[f"{name}_hertz"] = f"{hertz} Hz"
    if "count" in claim.parameters:
        count = round(claim.parameters["count"].value)
        fields["count_spikes"] = f"{count} spike{'s' if count != 1 else ''}"
    sizes = [
        f"{name} {with_sigma(quantity, name=name)}"
        for name, quantity in claim.parameters.items()
        if name not in _TIMES
    ]
    if sizes:
        fields["rest"] = ", ".join(sizes)
    return fields


def _stick_units(claim: Claim, wording: Wording) -> dict[str, str]:
    """Return the unit of each parameter that has the unit of the stick; empty if the control is not
    a stick.
    """
    if wording.control != "stick":
        return {}
    stick = wording.stick_unit if wording.stick_unit not in ("", "1") else "stick units"
    labels = {"1": stick, "1/s": f"{stick}/s"}
    in_stick_unit = wording.traits(claim.name).in_input_unit
    return {
        name: labels[quantity.unit]
        for name, quantity in claim.parameters.items()
        if name in in_stick_unit and quantity.unit in labels
    }


_USUAL_MANEUVER = "a record with inputs of other sizes and other frequencies"


def separating_maneuver(name: str, other: str, wording: Wording | None = None) -> str:
    """Return the maneuver that separates two effects; a general one if neither declares it."""
    wording = wording or Wording()
    for effect, rival in ((name, other), (other, name)):
        rival_base = rival.partition(":")[0].partition("#")[0]
        maneuvers = wording.traits(effect).separating
        if rival_base in maneuvers:
            return _with_names_of_model(maneuvers[rival_base], wording.parameters)
    return _USUAL_MANEUVER


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
    """Return the alternatives of an effect, grouped by the maneuver that separates them from it."""
    by_maneuver: dict[str, list[str]] = {}
    for other in others:
        by_maneuver.setdefault(separating_maneuver(name, other, wording), []).append(other)
    return [(tuple(names), maneuver) for maneuver, names in by_maneuver.items()]


LEAST_PRINTED_SHARE = 0.005  # a smaller probability is rounded to 0 %
LEAST_REST = 0.02  # smallest probability of all other causes that is printed
FAR_LIKELIER = 3.0  # ratio of probabilities above which two effects do not fit equally well


def shown_probability(claim: Claim) -> dict[str, float]:
    """Return probabilities of the claim, then of its alternatives in descending order.

    Those below ``LEAST_PRINTED_SHARE`` are left out. A hint has none.
    """
    shown = {
        name: probability
        for name, probability in claim.probability.items()
        if math.isfinite(probability) and probability >= LEAST_PRINTED_SHARE
    }
    return {
        name: round(shown[name], 3)
        for name in sorted(shown, key=lambda name: (name != claim.name, -shown[name], name))
    }


def probability_sentence(claim: Claim) -> str:
    """Return ``"Probability of this cause: 93 %; sensor-lag:q 5 %"``; an empty text for a hint.

    An alternative whose probability is about zero may fit as well as the claim. Then the prior
    probabilities alone decide, and the sentence says so.
    """
    probability = claim.probability.get(claim.name, math.nan)
    if not math.isfinite(probability):
        return ""
    sentence = f"Probability of this cause: {_percent(probability)}"
    others = [
        f"{name} {_percent(value)}"
        for name, value in shown_probability(claim).items()
        if name != claim.name
    ]
    if others:
        sentence += f"; {', '.join(others)}"
    rest = 1.0 - sum(value for value in claim.probability.values() if math.isfinite(value))
    if rest >= LEAST_REST:
        sentence += f"; others {_percent(rest)}"
    equal = [
        name
        for name in claim.alternatives
        if claim.probability.get(name, 1.0) < LEAST_PRINTED_SHARE
    ]
    if not equal:
        return sentence
    verb = "fits" if len(equal) == 1 else "fit"
    return (
        f"{sentence}; {' and '.join(equal)} {verb} these data equally well, and only the prior "
        f"probabilities favour {claim.name}"
    )


def _percent(probability: float) -> str:
    """Return a probability in whole per cents; near 0 and 1, as below or above a limit."""
    if probability < LEAST_PRINTED_SHARE:
        return "below 1 %"
    if probability >= 1.0 - LEAST_PRINTED_SHARE:
        return "above 99 %"
    return f"{max(1.0, 100.0 * probability):.0f} %"
