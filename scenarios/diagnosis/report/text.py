"""Text of a diagnosis for the terminal and the report, and the content of ``diagnosis.json``.

All numbers in ``diagnosis.json`` are finite, and all standard deviations are above zero.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ident.tracing.diagnosis import (
    Claim,
    Diagnosis,
    Verdict,
)
from scenarios.diagnosis.opening import effort_sentence
from scenarios.diagnosis.report.evidence import evidence_sentences, scatter_text, warnings_of
from scenarios.diagnosis.report.tables import (
    MOVED_SIGMAS,
    candidates_table,
    derivatives_table,
    derived_table,
    errors_table,
    few_candidates,
    kinematics_lines,
    level_changes,
    levels_table,
    levels_title,
    member_tables,
    moved,
    moved_title,
    one_step_table,
    short,
    sigma_note,
    simulation_note,
)
from scenarios.diagnosis.report.wording import (
    Wording,
    group_sentence,
    is_unexplained,
    most_likely,
    parameter_text,
    probability_sentence,
    sentence,
    separating_maneuvers,
)
from scenarios.files.user_models import channel_units, is_of_aircraft
from scenarios.preparation.recording import record_lines
from scenarios.report.document import Table
from scenarios.report.quantities import CHANNELS, listed, shown_in, value_text
from scenarios.report.summary import BELOW, WIDTH, Summary, residual_phrase, summary_lines, wrapped
from scenarios.report.terminal import table_as_lines
from sim.errors import instant
from sim.record import extent

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing


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
    errors = errors_table(d, errors_title, channel_units(tracing.model))
    one_step = one_step_table(d, channel_units(tracing.model))
    candidates = candidates_table(d, CANDIDATE_TITLE, few_candidates(d))
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
        _titled(errors, width, simulation_note(d)),
        _titled(one_step, width) if one_step is not None else [],
        _titled(derivatives_table(d, moved_title(d)), width, sigma_note(d)),
        *(_titled(table, width) for table in member_tables(d, MEMBER_TITLE)),
        _titled(derived_table(d, ""), width),
        _titled(levels_table(tracing, levels_title(tracing)), width),
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
        return _headline_without_claims(tracing)
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
    parts += level_changes(tracing)
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
    sentences = kinematics_lines(kinematics, tracing.diagnosis.effects, wording_of(tracing))
    return _wrapped_all(sentences, width)


def _headline_without_claims(tracing: Tracing) -> str:
    if tracing.diagnosis.verdict is Verdict.CONSISTENT:
        return f"the declared model stands; {_error_phrase(tracing)}"
    return f"no effect is named; {_error_phrase(tracing)}"


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
    old, new = short(factor * before[channel]), short(factor * after[channel])
    change = old
    if new != old and not is_unexplained(d):
        change = f"{old} -> {new}"
    word = CHANNELS.get(channel, channel) if is_of_aircraft(tracing.model) else channel
    phrase = f"{word.replace(' ', '-')} error {change} {unit} on {where_predicted(tracing)}"
    if channel in noise:
        phrase += f", estimated sensor noise {short(factor * noise[channel])}"
    return phrase


def _risen_phrase(d: Diagnosis) -> str:
    """Return the channels whose simulation error is larger with the effects; empty if none is."""
    before, after = d.error_before.rmse, d.error_after.rmse
    risen = [name for name in before if after.get(name, 0.0) > LEAST_RISE * before[name]]
    return f"the error of {listed(risen)} rises" if risen else ""


def _most_changed(d: Diagnosis) -> str:
    """Return the name of the parameter that changed most, empty if none changed significantly."""
    changes = {
        name: abs(moved(d.before[name], d.after[name])) for name in d.before if name in d.after
    }
    name = max(changes, key=lambda name: changes[name], default="")
    return name if name and changes[name] > MOVED_SIGMAS else ""


LEAST_RISE = 1.02  # ratio of two errors that is said to be a rise
