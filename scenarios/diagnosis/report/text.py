"""A diagnosis in words and small tables, for the terminal and for the report.

The content of ``diagnosis.json``: finite numbers only, every standard deviation above zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
from scenarios.diagnosis.opening import effort_sentence
from scenarios.diagnosis.report.evidence import evidence_sentences, scatter_text, warnings_of
from scenarios.diagnosis.report.tables import (
    MOVED_SIGMAS,
    candidates_table,
    derivatives_table,
    derived_of,
    derived_table,
    errors_table,
    few_candidates,
    kinematics_content,
    kinematics_lines,
    level_changes,
    levels_both,
    levels_table,
    levels_title,
    member_tables,
    moved,
    moved_title,
    short,
    sigma_note,
    simulation_note,
)
from scenarios.diagnosis.report.wording import (
    Wording,
    group_sentence,
    most_likely,
    nothing_stands,
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
from scenarios.report.quantities import CHANNELS, shown_in, value_text
from scenarios.report.summary import BELOW, WIDTH, Summary, residual_phrase, summary_lines, wrapped
from scenarios.report.terminal import table_as_lines
from sim.errors import instant
from sim.record import extent

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing
    from scenarios.maneuver_design.design import DesignResult


def diagnosis_text(tracing: Tracing, width: int = WIDTH, details: str = BELOW) -> str:
    """Return the text for a terminal of this width: a summary, then everything."""
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
    moved_most = _most_moved(d) if claimed else ""
    sentences += (
        [f"{moved_most} {value_text(d.after[moved_most].value, d.after[moved_most].std)}"]
        if moved_most
        else []
    )
    tests = d.tests_before if nothing_stands(d) else d.tests_after
    return Summary(
        subject(tracing),
        f"{d.verdict.value.upper()}: {names or d.verdict.sentence}",
        "; ".join(sentences) or _error_phrase(tracing),
        residual_phrase(tests),
        details,
    )


def details_text(tracing: Tracing, width: int = WIDTH) -> str:
    """Verdict and headline, effects, errors, derivatives, candidates, warnings."""
    d = tracing.diagnosis
    blocks = [
        [
            *wrapped(subject(tracing), width),
            *wrapped(f"{d.verdict.value.upper()}: {d.verdict.sentence}", width),
            *wrapped(headline(tracing), width),
        ],
        [line for doubt in tracing.doubts for line in wrapped(f"warning: {doubt}", width)],
        [
            line
            for record_line in record_lines(tracing.look)
            for line in wrapped(record_line, width)
        ],
        _effect_lines(tracing, width),
        _kinematic_lines(tracing, width),
        _titled(
            errors_table(
                d,
                f"simulation error (rms) on {where_predicted(tracing)}",
                channel_units(tracing.model),
            ),
            width,
            simulation_note(d),
        ),
        _titled(derivatives_table(d, moved_title(d)), width, sigma_note(d)),
        *(_titled(each, width) for each in member_tables(d, MEMBER_TITLE)),
        _titled(derived_table(d, ""), width),
        _titled(levels_table(tracing, levels_title(tracing)), width),
        _titled(
            candidates_table(d, CANDIDATE_TITLE, few_candidates(d)), width, CANDIDATE_LEGEND, keys=3
        ),
        [
            line
            for warning in warnings_of(tracing)
            for line in wrapped(f"warning: {warning}", width)
        ],
        [line for note in tracing.notes for line in wrapped(f"note: {note}", width)],
        wrapped(effort_sentence(tracing.effort, d), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks if block) + "\n"


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
    """Return the properties of a study that sentences about effects need."""
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
    """Which vehicle, model and records this is about, in one line."""
    fitted = ", ".join(f"{r.name} ({extent(r)})" for r in tracing.records)
    return f"{tracing.vehicle.name}, {tracing.vehicle.model} model: {fitted}"


def where_predicted(tracing: Tracing) -> str:
    """Return the source of the errors, as in ``"the held-out record validate.csv"``; a record is
    held out only if it took no part in choosing.
    """
    names = [record.name for record in tracing.validation]
    if not tracing.diagnosis.held_out:
        return "the fitted record"
    if tracing.held_out_from is not None:
        return f"the held-out part of {names[0]}, from {instant(tracing.held_out_from, 6)} s on"
    return f"the held-out record{'s' if len(names) > 1 else ''} {', '.join(names)}"


def headline(tracing: Tracing) -> str:
    """Return the finding in one sentence: effect, the error that fell most, the derivative that
    moved most.
    """
    d, wording = tracing.diagnosis, wording_of(tracing)
    claimed = [claim for claim in d.effects if claim.claimed]
    text = " and ".join(group_sentence(claim, wording) for claim in claimed)
    if not claimed:
        return _untouched(tracing)
    proven = [claim for claim in claimed if claim.spread is not None]
    parts = [text if d.verdict is not Verdict.AMBIGUOUS else most_likely(text, claimed)]
    if proven:
        parts = [
            "; ".join([group_sentence(claim, wording), *evidence_sentences(claim)])
            for claim in proven
        ]
        parts = [
            group_sentence(claim, wording) for claim in claimed if claim.spread is None
        ] + parts
    error, rough = _error_phrase(tracing), [claim for claim in claimed if claim.one_step_gains]
    if rough:
        # Gusts are unknown, so no free simulation has tested them.
        parts.append("; ".join(one_step_phrase(claim, tracing, len(claimed)) for claim in rough))
    elif error:
        parts.append(f"with {'these effects' if len(claimed) > 1 else 'this effect'}, {error}")
    name = _most_moved(d)
    if name:
        old, new = d.before[name], d.after[name]
        parts.append(
            f"{name} was {value_text(old.value, old.std)}, is "
            f"{value_text(new.value, new.std)}{scatter_text(d, name)}"
        )
    parts += level_changes(tracing)
    return "; ".join(
        [*parts, *(["part of the misfit is not explained"] if d.verdict is Verdict.PARTIAL else [])]
    )


def verdict_advice(tracing: Tracing) -> list[str]:
    """Return lines on effects that cannot be separated, and on the maneuver that would do it."""
    lines = []
    for claim in tracing.diagnosis.effects:
        for names, maneuver in separating_maneuvers(
            claim.name, claim.alternatives, wording_of(tracing)
        ):
            lines.append(
                f"{claim.name} or {' or '.join(names)}: these data fit both. To tell them apart: "
                f"{maneuver}"
            )
    return [*lines, *deciding_lines(tracing)]


def deciding_lines(tracing: Tracing) -> list[str]:
    """Return the designed maneuver that would decide an ambiguous diagnosis, with its chance, and
    the command that designs it again.
    """
    if tracing.decides is None:
        return []
    from scenarios.maneuver_design.report import verdict_of

    word, _, told = verdict_of(tracing.decides).partition(": ")
    return [
        f"{'the next flight' if word == 'FLY' else 'no flight helps'}: {told}",
        f"designed by: {tracing.decides.request.command()}",
    ]


def effect_heading(claim: Claim, wording: Wording) -> str:
    """Name, sentence, and what has to be said with it."""
    hint = "" if claim.claimed else "hint only, not claimed: "
    where = (
        f" (in record {', '.join(str(number + 1) for number in claim.records)})"
        if claim.records
        else ""
    )
    return f"{hint}{group_sentence(claim, wording) if claim.spread is not None else sentence(claim, wording)}{where}"  # noqa: E501


def _titled(shown: Table, width: int, note: str = "", keys: int = 1) -> list[str]:
    """Return a table under its caption and a note on it, both folded."""
    lines = table_as_lines(shown, width, keys, titled=False)
    return [*wrapped(shown.caption, width), *wrapped(note, width, "  "), *lines] if lines else []


def _effect_lines(tracing: Tracing, width: int) -> list[str]:
    wording, lines = wording_of(tracing), []
    for claim in tracing.diagnosis.effects:
        heading = effect_heading(claim, wording)
        lines += wrapped(
            heading if heading.startswith(claim.name) else f"{claim.name}: {heading}", width
        )
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
    """Return why nothing is claimed although the model is incomplete: requirements and numbers."""
    if d.verdict is not Verdict.UNEXPLAINED:
        return []
    given = {reason for claim in d.effects for reason in claim.reasons}
    return [requirement.sentence for requirement in d.not_met if requirement.sentence not in given]


def _kinematic_lines(tracing: Tracing, width: int) -> list[str]:
    some = tracing.kinematics
    told = kinematics_lines(some, tracing.diagnosis.effects, wording_of(tracing)) if some else []
    return [line for sentence in told for line in wrapped(sentence, width)]


def _untouched(tracing: Tracing) -> str:
    d = tracing.diagnosis
    if d.verdict is Verdict.CONSISTENT:
        return f"the declared model stands; {_error_phrase(tracing)}"
    return f"no effect is named; {_error_phrase(tracing)}"


def one_step_phrase(claim: Claim, tracing: Tracing, count: int = 1) -> str:
    """Return the gain of a claim, one of ``count``, that was judged by predictions of one step."""
    gains = ", ".join(f"{gain:.0f}" for gain in claim.one_step_gains)
    return (
        f"with {claim.name if count > 1 else 'this effect'}, the log likelihood of one-step "
        f"predictions rises by {gains} on {where_predicted(tracing)}"
    )


def _error_phrase(tracing: Tracing) -> str:
    d = tracing.diagnosis
    before, after, floors = d.error_before.rmse, d.error_after.rmse, d.noise_floor
    channels = [name for name in before if name in after]
    if not channels:
        return ""
    fell = max(
        channels,
        key=lambda name: (before[name] - after[name]) / (floors.get(name) or before[name] or 1.0),
    )
    factor, unit = shown_in(channel_units(tracing.model).get(fell, ""), fell)
    old, new = short(factor * before[fell]), short(factor * after[fell])
    change = old if nothing_stands(d) else f"{old} -> {new}" if old != new else new
    tail = f", estimated sensor noise {short(factor * floors[fell])}" if fell in floors else ""
    word = CHANNELS.get(fell, fell) if is_of_aircraft(tracing.model) else fell
    return f"{word.replace(' ', '-')} error {change} {unit} on {where_predicted(tracing)}{tail}"


def _most_moved(d: Diagnosis) -> str:
    moves = {
        name: abs(moved(d.before[name], d.after[name])) for name in d.before if name in d.after
    }
    name = max(moves, key=lambda each: moves[each], default="")
    return name if name and moves[name] > MOVED_SIGMAS else ""


# Written instead of infinite numbers; its square is finite.
LARGEST = 1e30
SCHEMA = "flightid/diagnosis/2"
DECIDES = "decides.csv"  # the input to fly, in the folder of the diagnosis


def diagnosis_content(tracing: Tracing, created: str) -> dict[str, Any]:
    """Return everything of a diagnosis but its time series. ``created`` is the time stamp, the one
    entry that differs between two runs.

    A standard deviation that is not finite (the data say nothing of the parameter) is written as
    ``LARGEST`` and told in ``warnings``.
    """
    d, wording = tracing.diagnosis, wording_of(tracing)
    derived_before, derived_after = derived_of(d)
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
        "derived": {
            name: {"estimate": entry["value"], **entry}
            for name, entry in quantities(derived_after).items()
        },
        "derived_before": {
            name: {"estimate": entry["value"], **entry}
            for name, entry in quantities(derived_before).items()
        },
        **levels_both(tracing),
        "error": {
            "held_out": d.held_out,
            "unit": {name: units[name] for name in d.error_before.rmse if name in units},
            "before": _errors(d.error_before),
            "after": _errors(d.error_after),
            "noise_floor": _finite_only(d.noise_floor),
            "residual": _finite_only(residual_levels(d)),
        },
        "residual_tests": {
            "before": [test_content(test) for test in d.tests_before],
            "after": [test_content(test) for test in d.tests_after],
        },
        "steps": [_step(step) for step in d.steps],
        "candidates": [_candidate(candidate) for candidate in d.candidates],
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
    kinematics = tracing.kinematics
    return content | (
        {"compatibility": kinematics_content(kinematics, d.effects, wording)}
        if kinematics is not None
        else {}
    )


def _decides(found: DesignResult) -> dict[str, Any]:
    """Return the deciding maneuver, as in ``design.json``, and its file."""
    from scenarios.maneuver_design.report import maneuver_content

    names = [each.effect.name for each in found.acting]
    best = found.best
    return {
        "tell": names,
        "chance": best.chance,
        "maneuver": maneuver_content(found, best),
        "file": DECIDES,
        "command": found.request.command(),
    }


def quantities(some: Mapping[str, Quantity]) -> dict[str, dict[str, Any]]:
    """Name -> value, std, unit."""
    return {
        name: {"value": bounded(q.value), "std": positive(q.std), "unit": q.unit}
        for name, q in some.items()
    }


def bounded(value: float) -> float:
    """Return the number, or one of ``LARGEST`` size where it has run away; zero for none at all."""
    if math.isnan(value):
        return 0.0
    return float(min(max(value, -LARGEST), LARGEST))


def positive(std: float) -> float:
    """Return a standard deviation above zero and finite."""
    return float(min(max(std, 1e-300), LARGEST)) if not math.isnan(std) else LARGEST


def _not_met(requirement: Requirement) -> dict[str, Any]:
    """Return an unmet requirement on a claim: text, number found, number required."""
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
    out: dict[str, Any] = {
        "name": claim.name,
        "alternatives": list(claim.alternatives),
        "parameters": quantities(claim.parameters),
        "sentence": sentence(claim, wording),
    }
    out |= {} if claim.claimed else {"claimed": False}
    out |= {"reasons": list(claim.reasons)} if claim.reasons else {}
    out |= {"probability": shown_probability(claim)} if claim.probability else {}
    out |= {"one_step_gains": list(claim.one_step_gains)} if claim.one_step_gains else {}
    out |= {"records": list(claim.records)} if claim.records else {}
    out |= (
        {
            "derivatives_under": {
                member: quantities(each) for member, each in claim.derivatives_under.items()
            }
        }
        if claim.derivatives_under
        else {}
    )
    out |= {"spread": bounded(claim.spread)} if claim.spread is not None else {}
    out |= (
        {
            "by_record": {
                label: quantities(each)
                for label, each in zip(records, claim.by_record, strict=False)
            }
        }
        if claim.by_record
        else {}
    )
    return out | ({"explanation": claim.explanation} if claim.explanation else {})


def _errors(figures: ErrorFigures) -> dict[str, dict[str, float]]:
    """Return the root mean squares are there for every channel; the relative figures where they can
    be formed.
    """
    return {
        "rmse": {name: bounded(value) for name, value in figures.rmse.items()},
        "nrmse": _finite_only(figures.nrmse),
        "r2": _finite_only(figures.r2),
        "theil": _finite_only(figures.theil),
    }


def _finite_only(some: Mapping[str, float]) -> dict[str, float]:
    return {name: float(value) for name, value in some.items() if math.isfinite(value)}


def test_content(test: ResidualTest) -> dict[str, Any]:
    """Return one residual test, its numbers within what JSON can say."""
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
    names = [
        name
        for name, q in {**d.before, **d.after}.items()
        if not (math.isfinite(q.std) and math.isfinite(q.value))
    ]
    return (
        [f"{', '.join(names)}: these data do not determine {'it' if len(names) == 1 else 'them'}"]
        if names
        else []
    )


def _inputs(tracing: Tracing) -> dict[str, Any]:
    inputs = tracing.inputs
    out: dict[str, Any] = {
        "records": [file.name for file in inputs.records],
        "sha256": [file.sha256 for file in inputs.records],
        "validate": [file.name for file in inputs.validation],
        "validate_sha256": [file.sha256 for file in inputs.validation],
        "vehicle": inputs.vehicle.name,
        "vehicle_sha256": inputs.vehicle.sha256,
    }
    if inputs.effects:
        out |= {"effects": inputs.effects[0].name, "effects_sha256": inputs.effects[0].sha256}
    if inputs.model is not None:
        out |= {"model": inputs.model.name, "model_sha256": inputs.model.sha256}
    out |= {"held_out": [record.name for record in tracing.validation]}
    return out | (
        {"held_out_from": tracing.held_out_from} if tracing.held_out_from is not None else {}
    )
