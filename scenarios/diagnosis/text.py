"""Text of a diagnosis for the terminal and the report, and the content of ``diagnosis.json``.

All numbers in ``diagnosis.json`` are finite, and all standard deviations are above zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from ident.statistics.residuals import ErrorFigures, ResidualTest
from ident.tracing.diagnosis import (
    Candidate,
    Claim,
    Diagnosis,
    Quantity,
    Requirement,
    Step,
    Verdict,
)
from scenarios.diagnosis import tables
from scenarios.diagnosis.evidence import evidence_sentences, scatter_text, warnings_of
from scenarios.diagnosis.opening import effort_sentence
from scenarios.diagnosis.wording import (
    Wording,
    group_sentence,
    is_unexplained,
    most_likely,
    parameter_text,
    probability_sentence,
    record_labels,
    residual_levels,
    sentence,
    separating_maneuvers,
    shown_probability,
)
from scenarios.files.sources import versions
from scenarios.files.user_models import channel_units, is_of_aircraft
from scenarios.preparation.recording import record_content, record_lines
from scenarios.report.document import Table
from scenarios.report.quantities import CHANNELS, listed, shown_in, value_text
from scenarios.report.summary import BELOW, WIDTH, Summary, residual_phrase, summary_lines, wrapped
from scenarios.report.terminal import table_as_lines
from sim.errors import instant
from sim.record import extent

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing
    from scenarios.maneuver_design.design import DesignResult


def diagnosis_text(tracing: Tracing, width: int = WIDTH, details: str = BELOW) -> str:
    """Return the text for a terminal of ``width`` characters: the summary, then the details."""
    return "\n".join(
        [
            *summary_lines(diagnosis_summary(tracing, details), width),
            "",
            details_text(tracing, width),
        ]
    )


def diagnosis_summary(tracing: Tracing, details: str = BELOW) -> Summary:
    """Return the summary: vehicle, records, verdict, effects, largest change, residual."""
    d, wording = tracing.diagnosis, wording_of(tracing)
    claimed = [claim for claim in d.effects if claim.claimed]
    names = ", ".join(" or ".join((claim.name, *claim.alternatives)) for claim in claimed)
    sentences = [
        f"{claim.name} {parameter_text(claim, wording)}" for claim in claimed if claim.parameters
    ]
    most_changed = _most_changed(d) if claimed else ""
    if most_changed:
        value = d.after[most_changed]
        sentences.append(f"{most_changed} {value_text(value.value, value.std)}")
    tests = d.tests_before if is_unexplained(d) else d.tests_after
    return Summary(
        subject(tracing),
        f"{d.verdict.value.upper()}: {names or d.verdict.sentence}",
        "; ".join(sentences) or _error_phrase(tracing),
        residual_phrase(tests),
        details,
    )


def details_text(tracing: Tracing, width: int = WIDTH) -> str:
    """Return verdict, headline, effects, errors, derivatives, candidates and warnings.

    Blank lines separate these blocks.
    """
    d = tracing.diagnosis
    errors_title = f"simulation error (rms) on {where_predicted(tracing)}"
    errors = tables.errors_table(d, errors_title, channel_units(tracing.model))
    one_step = tables.one_step_table(d, channel_units(tracing.model))
    candidates = tables.candidates_table(d, CANDIDATE_TITLE, tables.few_candidates(d))
    blocks = [
        [
            *wrapped(subject(tracing), width),
            *wrapped(f"{d.verdict.value.upper()}: {d.verdict.sentence}", width),
            *wrapped(headline(tracing), width),
        ],
        _wrapped_all([f"warning: {doubt}" for doubt in tracing.doubts], width),
        _wrapped_all(record_lines(tracing.look), width),
        _effect_lines(tracing, width),
        _kinematic_lines(tracing, width),
        _titled(errors, width, tables.simulation_note(d)),
        _titled(one_step, width) if one_step is not None else [],
        _titled(tables.derivatives_table(d, tables.moved_title(d)), width, tables.sigma_note(d)),
        *(_titled(table, width) for table in tables.member_tables(d, MEMBER_TITLE)),
        _titled(tables.derived_table(d, ""), width),
        _titled(tables.levels_table(tracing, tables.levels_title(tracing)), width),
        _titled(candidates, width, CANDIDATE_LEGEND, keys=3),
        _wrapped_all([f"warning: {warning}" for warning in warnings_of(tracing)], width),
        _wrapped_all([f"note: {note}" for note in tracing.notes], width),
        wrapped(effort_sentence(tracing.effort, d), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


def _wrapped_all(sentences: Sequence[str], width: int) -> list[str]:
    return [line for sentence in sentences for line in wrapped(sentence, width)]


MEMBER_TITLE = (
    "derivatives under each effect that these data cannot tell apart (* differs from the first "
    "by more than two of their joint sigmas, the root of the sum of both squared)"
)
CANDIDATE_TITLE = "best candidates of each round of the search (all of them are in evidence.csv)"
CANDIDATE_LEGEND = (
    "added to: the set of effects without the candidate (within, in evidence.csv); gain: increase "
    "of the log evidence when the candidate is added to it; log odds: log posterior odds, "
    "gain plus the log of its prior odds, above zero where the candidate is more probable than its "
    "absence; linearised: gain from the linearised model, not fitted; like: changes the outputs in "
    "nearly the same way; guard: catch-all term of no effect of the library, which is never named"
)


def wording_of(tracing: Tracing) -> Wording:
    """Return the names of inputs and channels that sentences on effects use."""
    inputs = tuple(signal.name for signal in tracing.model.equations.inputs)
    return Wording(
        inputs[0] if inputs else "control",
        tracing.stick_unit,
        tracing.traits,
        inputs,
        CHANNELS if is_of_aircraft(tracing.model) else {},
        tuple(tracing.model.equations.parameter_names),
    )


def subject(tracing: Tracing) -> str:
    """Return vehicle, model and fitted records in one line."""
    fitted = ", ".join(f"{record.name} ({extent(record)})" for record in tracing.records)
    return f"{tracing.vehicle.name}, {tracing.vehicle.model} model: {fitted}"


def where_predicted(tracing: Tracing) -> str:
    """Return the record that was predicted, as in ``"the held-out record validate.csv"``.

    A record that took part in the search is called fitted.
    """
    names = [record.name for record in tracing.validation]
    if not tracing.diagnosis.held_out:
        return "the fitted record"
    if tracing.held_out_from is not None:
        return f"the held-out part of {names[0]}, from {instant(tracing.held_out_from, 6)} s on"
    return f"the held-out record{'s' if len(names) > 1 else ''} {', '.join(names)}"


def headline(tracing: Tracing) -> str:
    """Return the finding in one sentence: the effects, the simulation error that fell most, and the
    derivative that changed most.
    """
    d, wording = tracing.diagnosis, wording_of(tracing)
    claimed = [claim for claim in d.effects if claim.claimed]
    if not claimed:
        standing = d.verdict is Verdict.CONSISTENT
        outcome = "the declared model stands" if standing else "no effect is named"
        return f"{outcome}; {_error_phrase(tracing)}"
    text = " and ".join(group_sentence(claim, wording) for claim in claimed)
    parts = [text if d.verdict is not Verdict.AMBIGUOUS else most_likely(text, claimed)]
    vuong_tested = [claim for claim in claimed if claim.spread is not None]
    if vuong_tested:
        parts = [group_sentence(claim, wording) for claim in claimed if claim.spread is None]
        parts += [
            "; ".join([group_sentence(claim, wording), *evidence_sentences(claim)])
            for claim in vuong_tested
        ]
    error = "; ".join(each for each in (_error_phrase(tracing), _risen_phrase(d)) if each)
    judged_by_one_step = [claim for claim in claimed if claim.one_step_gains]
    if judged_by_one_step:
        # A free simulation cannot test an effect of unknown gusts.
        parts.append(
            "; ".join(one_step_phrase(claim, tracing, len(claimed)) for claim in judged_by_one_step)
        )
    elif error:
        parts.append(f"with {'these effects' if len(claimed) > 1 else 'this effect'}, {error}")
    name = _most_changed(d)
    if name:
        before, after = d.before[name], d.after[name]
        parts.append(
            f"{name} changes from {value_text(before.value, before.std)} to "
            f"{value_text(after.value, after.std)}{scatter_text(d, name)}"
        )
    parts += tables.level_changes(tracing)
    if d.verdict is Verdict.PARTIAL:
        parts.append("part of the misfit is not explained")
    return "; ".join(parts)


def verdict_advice(tracing: Tracing) -> list[str]:
    """Return lines on effects that the records cannot separate, and on maneuvers that can."""
    lines = []
    for claim in tracing.diagnosis.effects:
        for names, maneuver in separating_maneuvers(
            claim.name, claim.alternatives, wording_of(tracing)
        ):
            lines.append(f"to tell {claim.name} from {' and '.join(names)}: {maneuver}")
    return [*lines, *deciding_lines(tracing)]


DESIGNED_BY = "designed by: "  # begins the line with the command of a deciding maneuver


def deciding_lines(tracing: Tracing) -> list[str]:
    """Return the designed maneuver that would decide an ambiguous diagnosis, with its chance, and
    the command that designs it again.
    """
    if tracing.decides is None:
        return []
    from scenarios.maneuver_design.report import verdict_of

    word, _, sentence = verdict_of(tracing.decides).partition(": ")
    return [
        f"{'the next flight' if word == 'FLY' else 'no flight helps'}: {sentence}",
        f"{DESIGNED_BY}{tracing.decides.request.command()}",
    ]


def effect_heading(claim: Claim, wording: Wording) -> str:
    """Return the sentence on an effect, with its records if it acts in some only."""
    heading = "" if claim.claimed else "hint only, not claimed: "
    heading += (
        group_sentence(claim, wording) if claim.spread is not None else sentence(claim, wording)
    )
    if claim.records:
        heading += f" (in record {', '.join(str(number + 1) for number in claim.records)})"
    return heading


def _titled(table: Table, width: int, note: str = "", keys: int = 1) -> list[str]:
    """Return caption, note and rows of a table; nothing if it has no rows."""
    lines = table_as_lines(table, width, keys, titled=False)
    return [*wrapped(table.caption, width), *wrapped(note, width, "  "), *lines] if lines else []


def _effect_lines(tracing: Tracing, width: int) -> list[str]:
    wording, lines = wording_of(tracing), []
    for claim in tracing.diagnosis.effects:
        heading = effect_heading(claim, wording)
        if not heading.startswith(claim.name):
            heading = f"{claim.name}: {heading}"
        lines += wrapped(heading, width)
        lines += wrapped(probability_sentence(claim), width, "    ")
        if claim.parameters:
            lines += wrapped(parameter_text(claim, wording), width, "    ")
        for reason in claim.reasons:
            lines += wrapped(f"not claimed: {reason}", width, "    ")
    for reason in unclaimed_reasons(tracing.diagnosis):
        lines += wrapped(f"not claimed: {reason}", width)
    for line in verdict_advice(tracing):
        lines += wrapped(line, width)
    return lines


def unclaimed_reasons(d: Diagnosis) -> list[str]:
    """Return the requirements that prevent a claim of an UNEXPLAINED diagnosis.

    Requirements that a hint already names as its reason are left out.
    """
    if d.verdict is not Verdict.UNEXPLAINED:
        return []
    hint_reasons = {reason for claim in d.effects for reason in claim.reasons}
    unmet = [requirement.sentence for requirement in d.not_met]
    return [sentence for sentence in unmet if sentence not in hint_reasons]


def _kinematic_lines(tracing: Tracing, width: int) -> list[str]:
    kinematics = tracing.kinematics
    if kinematics is None:
        return []
    sentences = tables.kinematics_lines(kinematics, tracing.diagnosis.effects, wording_of(tracing))
    return _wrapped_all(sentences, width)


def one_step_phrase(claim: Claim, tracing: Tracing, count: int = 1) -> str:
    """Return the gain of a claim, one of ``count``, in log likelihood of one-step predictions."""
    where, effect = where_predicted(tracing), claim.name if count > 1 else "this effect"
    if any(math.isinf(gain) for gain in claim.one_step_gains):
        return f"without {effect}, one-step predictions diverge on {where}"
    gains = ", ".join(f"{gain:.0f}" for gain in claim.one_step_gains)
    return f"with {effect}, the log likelihood of one-step predictions rises by {gains} on {where}"


def _error_phrase(tracing: Tracing) -> str:
    """Return the simulation error of the channel whose error fell most."""
    d = tracing.diagnosis
    before, after, noise = d.error_before.rmse, d.error_after.rmse, d.noise_floor

    def relative_fall(channel: str) -> float:
        scale = noise.get(channel) or before[channel] or 1.0
        return (before[channel] - after[channel]) / scale

    channel = max((name for name in before if name in after), key=relative_fall, default="")
    if not channel:
        return ""
    factor, unit = shown_in(channel_units(tracing.model).get(channel, ""), channel)
    old, new = tables.short(factor * before[channel]), tables.short(factor * after[channel])
    change = old if new == old or is_unexplained(d) else f"{old} -> {new}"
    word = CHANNELS.get(channel, channel) if is_of_aircraft(tracing.model) else channel
    phrase = f"{word.replace(' ', '-')} error {change} {unit} on {where_predicted(tracing)}"
    if channel in noise:
        phrase += f", estimated sensor noise {tables.short(factor * noise[channel])}"
    return phrase


def _risen_phrase(d: Diagnosis) -> str:
    """Return the channels whose simulation error is larger with the effects; empty if none is."""
    before, after = d.error_before.rmse, d.error_after.rmse
    risen = [name for name in before if after.get(name, 0.0) > LEAST_RISE * before[name]]
    return f"the error of {listed(risen)} rises" if risen else ""


def _most_changed(d: Diagnosis) -> str:
    """Return the name of the parameter that changed most, empty if none changed significantly."""
    changes = {
        name: abs(tables.moved(d.before[name], d.after[name]))
        for name in d.before
        if name in d.after
    }
    name = max(changes, key=lambda name: changes[name], default="")
    return name if name and changes[name] > tables.MOVED_SIGMAS else ""


LEAST_RISE = 1.02  # ratio of two errors that is said to be a rise


# ---- The content of diagnosis.json

LARGEST = 1e30  # written in place of an infinite number; its square is finite
SCHEMA = "flightid/diagnosis/2"
DECIDES = "decides.csv"  # the designed input, in the folder of the diagnosis


def diagnosis_content(tracing: Tracing, created: str) -> dict[str, Any]:
    """Return the content of ``diagnosis.json``: everything of a diagnosis but its time series.

    ``created`` is the time stamp, the only entry that differs between two runs. A parameter that
    the data do not determine has the standard deviation ``LARGEST`` and an entry in ``warnings``.
    """
    d, wording = tracing.diagnosis, wording_of(tracing)
    derived_before, derived = (
        {name: {"estimate": entry["value"], **entry} for name, entry in quantities(part).items()}
        for part in tables.derived_of(d)
    )
    units = channel_units(tracing.model)
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "created": created,
        "model": tracing.vehicle.model,
        "vehicle": tracing.vehicle.name,
        "verdict": d.verdict.value,
        "verdict_sentence": d.verdict.sentence,
        "headline": headline(tracing),
        "effects": [_claim(claim, wording, record_labels(tracing)) for claim in d.effects],
        "parameters": {"before": quantities(d.before), "after": quantities(d.after)},
        "scatter": {name: positive(std) for name, std in d.scatter.items()},
        "growth": {name: bounded(factor) for name, factor in d.inflation.items()},
        "derived": derived,
        "derived_before": derived_before,
        **tables.levels_both(tracing),
        "error": {
            "held_out": d.held_out,
            "unit": {name: units[name] for name in d.error_before.rmse if name in units},
            "before": _errors(d.error_before),
            "after": _errors(d.error_after),
            "noise_floor": _finite_only(d.noise_floor),
            "residual": _finite_only(residual_levels(d)),
            **(
                {
                    "one_step": {
                        "before": _errors(d.one_step.before),
                        "after": _errors(d.one_step.after),
                        "gains": [bounded(gain) for gain in d.one_step.gains],
                    }
                }
                if d.one_step is not None
                else {}
            ),
        },
        "residual_tests": {
            "before": [test_content(test) for test in d.tests_before],
            "after": [test_content(test) for test in d.tests_after],
        },
        "steps": [_step(step) for step in d.steps],
        "candidates": [_candidate(candidate) for candidate in d.candidates],
        "sets": [asdict(each) for each in d.sets],
        "warnings": [
            *tracing.doubts,
            *tracing.look.set_aside,
            *warnings_of(tracing),
            *_undetermined(d),
        ],
        **({"not_met": [_not_met(requirement) for requirement in d.not_met]} if d.not_met else {}),
        "notes": list(tracing.notes),
        "record": record_content(tracing.look),
        "advice": verdict_advice(tracing),
        "effort": {"name": tracing.effort, "stopped": d.stopped},
        **({"overflows": tracing.overflows} if tracing.overflows else {}),
        "inputs": _inputs(tracing),
        "versions": versions(),
    }
    if tracing.decides is not None:
        content |= {"decides": _decides(tracing.decides)}
    if tracing.kinematics is not None:
        compatibility = tables.kinematics_content(tracing.kinematics, d.effects, wording)
        content |= {"compatibility": compatibility}
    return content


def _decides(result: DesignResult) -> dict[str, Any]:
    """Return the deciding maneuver, as in ``design.json``, and its file."""
    from scenarios.maneuver_design.report import maneuver_content

    return {
        "tell": [acting.effect.name for acting in result.acting],
        "chance": result.best.chance,
        "maneuver": maneuver_content(result, result.best),
        "file": DECIDES,
        "command": result.request.command(),
    }


def quantities(values: Mapping[str, Quantity]) -> dict[str, dict[str, Any]]:
    """Return value, standard deviation and unit of each quantity, by name."""
    return {
        name: {
            "value": bounded(quantity.value),
            "std": positive(quantity.std),
            "unit": quantity.unit,
        }
        for name, quantity in values.items()
    }


def bounded(value: float) -> float:
    """Return the value limited to +-``LARGEST``; 0 for NaN."""
    if math.isnan(value):
        return 0.0
    return float(min(max(value, -LARGEST), LARGEST))


def positive(std: float) -> float:
    """Return a standard deviation limited to positive finite numbers; ``LARGEST`` for NaN."""
    return float(min(max(std, tables.SMALLEST_STD), LARGEST)) if not math.isnan(std) else LARGEST


def _not_met(requirement: Requirement) -> dict[str, Any]:
    """Return an unmet requirement on a claim: its text, the value and the required value."""
    return {
        "asked": requirement.asked,
        "value": bounded(requirement.value),
        "required": bounded(requirement.bar),
        "at_least": requirement.at_least,
        "unit": requirement.unit,
        "effects": list(requirement.effects),
        "sentence": requirement.sentence,
    }


def _claim(claim: Claim, wording: Wording, records: Sequence[str]) -> dict[str, Any]:
    """Return the entry of a claim; ``records`` are the labels of the fitted records."""
    content: dict[str, Any] = {
        "name": claim.name,
        "alternatives": list(claim.alternatives),
        "parameters": quantities(claim.parameters),
        "sentence": sentence(claim, wording),
    }
    if not claim.claimed:
        content["claimed"] = False
    if claim.reasons:
        content["reasons"] = list(claim.reasons)
    if claim.probability:
        content["probability"] = shown_probability(claim)
    if claim.one_step_gains:
        content["one_step_gains"] = [bounded(gain) for gain in claim.one_step_gains]
    if claim.records:
        content["records"] = list(claim.records)
    if claim.derivatives_under:
        content["derivatives_under"] = {
            member: quantities(values) for member, values in claim.derivatives_under.items()
        }
    if claim.spread is not None:
        content["spread"] = bounded(claim.spread)
    if claim.by_record:
        content["by_record"] = {
            label: quantities(values)
            for label, values in zip(records, claim.by_record, strict=False)
        }
    if claim.explanation:
        content["explanation"] = claim.explanation
    return content


def _errors(figures: ErrorFigures) -> dict[str, dict[str, float]]:
    """Return the root mean square of every channel, and the relative figures that are finite."""
    return {
        "rmse": {name: bounded(value) for name, value in figures.rmse.items()},
        "nrmse": _finite_only(figures.nrmse),
        "r2": _finite_only(figures.r2),
        "theil": _finite_only(figures.theil),
    }


def _finite_only(values: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in values.items() if math.isfinite(value)}


def test_content(test: ResidualTest) -> dict[str, Any]:
    """Return the entry of a residual test, with finite numbers."""
    return {
        "name": test.name,
        "channel": test.channel,
        "statistic": bounded(test.statistic),
        "p_value": bounded(test.p_value),
        "passed": test.passed,
        "sentence": test.sentence,
    }


def _step(step: Step) -> dict[str, Any]:
    return {
        "effects": list(step.effects),
        "log_evidence": bounded(step.log_evidence),
        "log_likelihood": bounded(step.log_likelihood),
        "sentence": step.sentence,
    }


def _candidate(c: Candidate) -> dict[str, Any]:
    return {
        "round": c.round,
        "within": list(c.within),
        "name": c.name,
        "gain": bounded(c.gain),
        "weight": bounded(c.weight),
        "fitted": c.fitted,
        "parameters": quantities(c.parameters),
        "collinear_with": list(c.collinear_with),
    }


def _undetermined(d: Diagnosis) -> list[str]:
    """Return a warning on the parameters that the data do not determine."""
    names = [
        name
        for name, quantity in {**d.before, **d.after}.items()
        if not (math.isfinite(quantity.std) and math.isfinite(quantity.value))
    ]
    if not names:
        return []
    pronoun = "it" if len(names) == 1 else "them"
    return [f"{', '.join(names)}: these data do not determine {pronoun}"]


def _inputs(tracing: Tracing) -> dict[str, Any]:
    inputs = tracing.inputs
    content: dict[str, Any] = {
        "records": [file.name for file in inputs.records],
        "sha256": [file.sha256 for file in inputs.records],
        "validate": [file.name for file in inputs.validation],
        "validate_sha256": [file.sha256 for file in inputs.validation],
        "vehicle": inputs.vehicle.name,
        "vehicle_sha256": inputs.vehicle.sha256,
    }
    if inputs.effects:
        content |= {"effects": inputs.effects[0].name, "effects_sha256": inputs.effects[0].sha256}
    if inputs.model is not None:
        content |= {"model": inputs.model.name, "model_sha256": inputs.model.sha256}
    content["held_out"] = [record.name for record in tracing.validation]
    if tracing.held_out_from is not None:
        content["held_out_from"] = tracing.held_out_from
    return content
