"""Tables of a diagnosis: errors, derivatives and levels of flying qualities before and after,
candidates, and kinematic findings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.compatibility.kinematics import ARMS
from ident.compatibility.six_degrees.kinematics import WINGS_LEVEL_NOTE
from ident.compatibility.trials import SensorFinding
from ident.flying_qualities.levels import ModeLevel, mode_levels
from ident.tracing.diagnosis import Candidate, Claim, Diagnosis, Quantity
from scenarios.diagnosis.kinematics import BIAS, PARAMETERS, Kinematics, agreements, unnamed
from scenarios.diagnosis.wording import (
    Wording,
    declared_alone,
    group_sentence,
    is_coloured,
    is_unexplained,
    noise_headings,
    residual_levels,
    shown_table,
)
from scenarios.files.declarations import CHANNEL_UNITS
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    SIGMAS,
    Cell,
    Column,
    Number,
    Table,
    brief_estimate,
    formatted,
    table,
)
from scenarios.report.quantities import is_frequency, shown_in, with_sigma
from scenarios.report.summary import changes, level_text, levels_content, levels_heading, limit_text

if TYPE_CHECKING:
    from scenarios.diagnosis.diagnose import Tracing

MOVED_SIGMAS = 2.0  # joint sigmas above which a change is marked
SIMULATION_NOTE = (
    "a simulation cannot follow random gusts: one-step prediction is the measure in turbulence"
)
RANDOM_LOADS_NOTE = (
    "for this table both models were fitted without the model discrepancy; the derivatives below "
    "were found beside it"
)
ONE_STEP_TITLE = (
    "error of predictions one step ahead (rms) on the held-out records, with the model discrepancy "
    "before and after"
)
SIGMA_NOTE = "+- sigma, widened by the scatter between records"
SMALLEST_CHANGE = 0.05  # joint sigmas below which a change is shown as a dash
Change = tuple[str, Quantity, Quantity]  # name of a quantity, its estimates before and after
MOST_CANDIDATES_A_ROUND = 6  # rows for one round in the short table
MOST_ROWS = 15  # rows of the short table
MOST_PARAMETERS = 3  # parameters of a candidate that are printed
MOST_COLLINEAR = 3  # collinear candidates that are named
SMALLEST_STD = 1e-300  # written in place of a standard deviation of zero


def few_candidates(d: Diagnosis) -> int:
    """Return the number of candidates of each round in the short table."""
    rounds = len({(candidate.round, candidate.within) for candidate in d.candidates})
    return max(1, min(MOST_CANDIDATES_A_ROUND, MOST_ROWS // max(rounds, 1)))


def candidates_table(d: Diagnosis, caption: str, count: int, printed: int | None = None) -> Table:
    """Return the best candidates of each round, by gain, with the best form of each effect; where
    one was fitted, without the gain that the linearised model promised.

    Parameters
    ----------
    d : the diagnosis.
    caption : caption of the table.
    count : number of candidates of each round.
    printed : number of rows on paper; None for all.
    """
    shown: list[Candidate] = []
    rounds = dict.fromkeys((candidate.round, candidate.within) for candidate in d.candidates)
    for key in rounds:
        of_round = [
            candidate for candidate in d.candidates if (candidate.round, candidate.within) == key
        ]
        ranked = sorted(of_round, key=lambda candidate: (-candidate.gain, candidate.name))
        # A fit refutes what the linearised model promises.
        fits_last = sorted(reversed(ranked), key=lambda candidate: candidate.fitted)
        best = {candidate.name: candidate for candidate in fits_last}
        shown += [candidate for candidate in ranked if best[candidate.name] is candidate][:count]
    candidates = table(
        caption,
        (Column("round", PURE, left=True), [Number(row.round, digits=0) for row in shown]),
        (Column("candidate"), [row.name for row in shown]),
        (Column("added to"), [" + ".join(row.within) or "declared model" for row in shown]),
        (Column("gain", PURE), [formatted(row.gain, ".1f") for row in shown]),
        (Column("log odds", PURE), [formatted(row.weight, ".1f") for row in shown]),
        (Column("parameters"), [candidate_parameters(row) for row in shown]),
        (Column("remarks"), [candidate_remarks(row) for row in shown]),
    )
    return replace(candidates, printed=printed)


def candidate_parameters(candidate: Candidate) -> str:
    """Return the first parameters of a candidate with their values."""
    parameters = candidate.parameters.items()
    texts = [f"{name} {with_sigma(quantity, name=name)}" for name, quantity in parameters]
    if len(texts) > MOST_PARAMETERS:
        texts[MOST_PARAMETERS:] = ["..."]
    return ", ".join(texts)


def candidate_remarks(candidate: Candidate) -> str:
    """Return whether a candidate was fitted, and which other effects have a similar signature."""
    remarks = [] if candidate.fitted else ["linearised"]
    others = [name for name in candidate.collinear_with if name != candidate.name]
    if others:
        remarks.append(f"like {', '.join(others[:MOST_COLLINEAR])}")
    return "; ".join(remarks)


def errors_table(d: Diagnosis, caption: str, units: Mapping[str, str] = CHANNEL_UNITS) -> Table:
    """Return a table with the error of each channel before and after, and the noise.

    If the residual of the fit is more than noise, it has a column. Angles and angular rates are in
    degrees.
    """
    residuals = [residual_levels(d)] if is_coloured(d) else []
    noise = dict(zip(noise_headings(d), (*residuals, d.noise_floor), strict=True))
    if one_step_table(d) is not None:
        # The residual of the fit is one of predictions one step ahead, not of a simulation.
        noise = {noise_headings(d)[-1]: d.noise_floor}
    columns = {"before": d.error_before.rmse, "after": d.error_after.rmse, **noise}
    return shown_table(d, _levels_by_channel(caption, columns, units))


def one_step_table(d: Diagnosis, units: Mapping[str, str] = CHANNEL_UNITS) -> Table | None:
    """Return a table with the error of predictions one step ahead of each channel before and after,
    and the noise; None where no random loads act, or no effect is claimed.
    """
    if d.one_step is None or not any(claim.claimed for claim in d.effects):
        return None
    before, after, noise = d.one_step.before, d.one_step.after, noise_headings(d)[-1]
    columns = {"before": before.rmse, "after": after.rmse, noise: d.noise_floor}
    return _levels_by_channel(f"{ONE_STEP_TITLE}; {gains_phrase(d.one_step.gains)}", columns, units)


def gains_phrase(gains: Sequence[float]) -> str:
    """Return how the log likelihood of one-step predictions of each held-out record changes."""
    total = sum(gains)
    if not math.isfinite(total):
        return "one of the two models does not predict them"
    by_record = f" ({', '.join(f'{gain:+.0f}' for gain in gains)} by record)"
    change = f"{'rises' if total > 0 else 'falls'} by {abs(total):.0f}"
    return f"their log likelihood {change}{by_record if len(gains) > 1 else ''}"


def _levels_by_channel(
    caption: str, columns: Mapping[str, Mapping[str, float]], units: Mapping[str, str]
) -> Table:
    """Return a table of rms values: one row for each channel of the first column."""
    names = list(next(iter(columns.values())))
    display_units = [shown_in(units.get(name, ""), name) for name in names]
    return table(
        caption,
        (Column("channel", printed="error"), names),
        *(
            (
                Column(heading, BY_ROW),
                [
                    level_cell(unit.factor * values.get(name, math.nan))
                    for name, unit in zip(names, display_units, strict=True)
                ],
            )
            for heading, values in columns.items()
        ),
        units=[unit.unit for unit in display_units],
    )


def derivatives_table(d: Diagnosis, caption: str) -> Table:
    """Return a table of the derivatives before and after, with their change in joint sigmas.

    The scatter between records has a column if it is known.
    """
    changes = [(name, old, d.after[name]) for name, old in d.before.items() if name in d.after]
    return shown_table(d, _changes_table(caption, "derivative", changes, d.scatter))


def derived_table(d: Diagnosis, caption: str) -> Table:
    """Return a table of the quantities that follow from the derivatives.

    A frequency has a row in rad/s and a row in Hz.
    """
    before, after = derived_of(d)
    changes: list[Change] = []
    for name in (name for name in before if name in after):
        old, new, words = before[name], after[name], name.replace("_", " ")
        changes.append((words, old, new))
        if is_frequency(name, old.unit):
            changes.append((words, _hertz(old), _hertz(new)))
    return shown_table(d, _changes_table(caption, "derived", changes, {}))


def _changes_table(
    caption: str, heading: str, changes: Sequence[Change], scatter: Mapping[str, float]
) -> Table:
    before = [brief_estimate(old.value, old.std) for _, old, _ in changes]
    after = [brief_estimate(new.value, new.std) for _, _, new in changes]
    run_to_run = None
    if scatter:
        cells = [formatted(scatter.get(name), ".2g") for name, _, _ in changes]
        run_to_run = (Column("run-to-run", BY_ROW), cells)
    return table(
        caption,
        (Column("name", printed=heading), [name for name, _, _ in changes]),
        (Column("before", BY_ROW, together=True), before),
        (Column("after", BY_ROW, together=True), after),
        run_to_run,
        (Column("moved by", PURE), [move_cell(moved(old, new)) for _, old, new in changes]),
        units=[old.unit for _, old, _ in changes],
    )


def move_cell(sigmas: float) -> Cell:
    """Return a change in joint sigmas, with a star above ``MOVED_SIGMAS``."""
    if abs(sigmas) < SMALLEST_CHANGE:
        return MISSING
    mark = " *" if abs(sigmas) > MOVED_SIGMAS else "  "
    return Number(sigmas, unit=SIGMAS, shown=f"{sigmas:+.1f} sigma{mark}")


def member_tables(d: Diagnosis, caption: str) -> list[Table]:
    """Return, for each effect with alternatives, a table of the derivatives under each of them.

    A star marks a value that differs from that under the first effect by more than
    ``MOVED_SIGMAS``.
    """
    if is_unexplained(d):
        return []
    tables = []
    for claim in d.effects:
        members = claim.derivatives_under
        if len(members) < 2:
            continue
        first = next(iter(members.values()))
        names = [name for name in d.after if any(name in values for values in members.values())]
        columns = [
            (
                Column(member, BY_ROW, together=True),
                [_member_cell(values.get(name), first.get(name)) for name in names],
            )
            for member, values in members.items()
        ]
        units = [d.after[name].unit for name in names]
        tables.append(
            table(caption, (Column("name", printed="derivative"), names), *columns, units=units)
        )
    return [each for each in tables if each.rows]


def _member_cell(quantity: Quantity | None, first: Quantity | None) -> Cell:
    if quantity is None:
        return MISSING
    mark = ""
    if first is not None:
        joint_sigma = math.hypot(quantity.std, first.std)
        if abs(quantity.value - first.value) > MOVED_SIGMAS * joint_sigma:
            mark = "*"
    return brief_estimate(quantity.value, quantity.std, mark)


def derived_of(d: Diagnosis) -> tuple[dict[str, Quantity], dict[str, Quantity]]:
    """Return derived quantities before and after, with the delay of the model if it has one."""
    before, after = dict(d.derived_before), dict(d.derived_after)
    if "delay" in d.before:
        before["delay"] = d.before["delay"]
    if "delay" in d.after:
        after["delay"] = d.after["delay"]
    return before, after


def _hertz(frequency: Quantity) -> Quantity:
    """Return a frequency in rad/s as one in Hz."""
    return Quantity(frequency.value / (2.0 * math.pi), frequency.std / (2.0 * math.pi), "Hz")


def sigma_note(d: Diagnosis) -> str:
    """Return a note if sigmas are widened by scatter; empty without an accepted effect."""
    return SIGMA_NOTE if d.inflation and not is_unexplained(d) else ""


def simulation_note(d: Diagnosis) -> str:
    """Return a note on simulation errors if turbulence is claimed, or random loads were left out;
    else an empty string.
    """
    if any(claim.claimed and claim.one_step_gains for claim in d.effects):
        return SIMULATION_NOTE
    return RANDOM_LOADS_NOTE if one_step_table(d) is not None else ""


def moved_title(d: Diagnosis) -> str:
    """Return the heading of the table of derivatives."""
    if is_unexplained(d):
        return (
            "derivatives of the declared model: something is missing in it, they carry what it "
            "costs"
        )
    if declared_alone(d):
        return "derivatives of the declared model"
    if not any(
        abs(moved(d.before[name], d.after[name])) > MOVED_SIGMAS
        for name in d.before
        if name in d.after
    ):
        return "derivatives"
    return (
        "derivatives (* moved by more than two of their joint sigmas, the root of the sum of both "
        "squared)"
    )


def moved(old: Quantity, new: Quantity) -> float:
    """Return the change in joint sigmas; 0 if the joint sigma is zero or infinite."""
    joint_sigma = math.hypot(old.std, new.std)
    if joint_sigma <= 0.0 or not math.isfinite(joint_sigma):
        return 0.0
    return (new.value - old.value) / joint_sigma


def short(value: float) -> str:
    """Return a number with three digits, without exponent below 1e7; a dash if not finite."""
    if not math.isfinite(value):
        return "-"
    if abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".") if value else "0"
    return f"{value:.0f}" if value < 1e7 else f"{value:.2g}"


def level_cell(value: float) -> Cell:
    """Return a root mean square with three digits; a dash if it is not finite."""
    return Number(value, shown=short(value)) if math.isfinite(value) else MISSING


Levels = tuple[ModeLevel, ...]


def levels_of(tracing: Tracing) -> tuple[Levels, Levels]:
    """Return the levels of the declared model and of the model with the effects; each is empty if
    its modes are unknown.
    """
    d = tracing.diagnosis
    before, after = (
        mode_levels(modes, tracing.flown) if modes is not None else ()
        for modes in (d.modes_before, d.modes_after)
    )
    return before, after


def levels_title(tracing: Tracing) -> str:
    """Return the standard of flying qualities, with aircraft class and flight phase category."""
    return levels_heading(tracing.flown)


def levels_table(tracing: Tracing, caption: str) -> Table:
    """Return a table of the level of each mode before and after.

    The remark is the limit that the accepted model misses.
    """
    before, after = ({level.mode: level for level in levels} for levels in levels_of(tracing))
    accepted = before if is_unexplained(tracing.diagnosis) else after
    modes = list({**before, **after})

    def cells(levels: Mapping[str, ModeLevel]) -> list[Cell]:
        return [level_text(levels[mode]) if mode in levels else MISSING for mode in modes]

    remarks = [_missed_limit(accepted.get(mode)) for mode in modes]
    levels = table(
        caption,
        (Column("mode"), modes),
        (Column("before"), cells(before)),
        (Column("after"), cells(after)),
        (Column("remarks"), remarks) if any(remarks) else None,
    )
    return shown_table(tracing.diagnosis, levels)


def level_changes(tracing: Tracing) -> list[str]:
    """Return a sentence for each mode whose level the effects change, if both are known."""
    return changes(*levels_of(tracing))


def levels_both(tracing: Tracing) -> dict[str, Any]:
    """Return the levels before and after for ``diagnosis.json``; empty if the standard has no
    requirement for a mode of the model.
    """
    before, after = levels_of(tracing)
    if not before and not after:
        return {}
    return {
        "flying_qualities": {
            "before": levels_content(before, tracing.flown),
            "after": levels_content(after, tracing.flown),
        }
    }


def _missed_limit(level: ModeLevel | None) -> str:
    return limit_text(level) if level is not None else ""


FREE = "the fits of a diagnosis leave a bias of each channel free"


def kinematics_lines(
    kinematics: Kinematics, claims: Sequence[Claim], wording: Wording
) -> list[str]:
    """Return the sentences on the kinematic check: comparison with the claims, other faults,
    checked records, and notes.
    """
    if kinematics.result is None:
        return [kinematics.why]
    lines = [agreement.sentence for agreement in agreements(kinematics, claims)]
    lines += [
        f"kinematics alone give {finding_sentence(finding, wording)}; "
        f"{FREE if finding.kind == BIAS else 'the diagnosis does not name it'}"
        for finding in unnamed(kinematics, claims)
    ]
    if not lines:
        lines = ["kinematics alone find no sensor fault"]
    # The declared equations already assume level wings, so this note is left out.
    notes = [f"kinematics: {note}" for note in kinematics.result.notes if note != WINGS_LEVEL_NOTE]
    return [*lines, kinematics.source, *notes]


def finding_sentence(finding: SensorFinding, wording: Wording) -> str:
    """Return name, value and sigma of a finding, and its effect in words."""
    quantity = Quantity(finding.value, finding.std, finding.unit)
    if wording.traits(finding.name).sentences:
        claim = Claim(finding.name, {_parameter(finding): quantity}, finding.group)
        return f"{finding.name} {with_sigma(quantity)}, {group_sentence(claim, wording)}"
    # Some faults, as a bias or the position of the accelerometer package, are not library effects.
    from scenarios.compatibility_report import fault_text, fit_as_well

    group = f" ({fit_as_well(finding.group)})" if finding.group else ""
    return f"{finding.name}, {fault_text(finding)}{group}"


def _parameter(finding: SensorFinding) -> str:
    """Return the effect's parameter that is the size of a finding."""
    return "arm" if finding.kind in ARMS else PARAMETERS.get(finding.kind, finding.kind)


def kinematics_content(
    kinematics: Kinematics, claims: Sequence[Claim], wording: Wording
) -> dict[str, Any]:
    """Return the entry ``compatibility`` of ``diagnosis.json``.

    Findings with numbers that are not finite are left out.
    """
    lines = kinematics_lines(kinematics, claims, wording)
    if kinematics.result is None:
        return {"records": list(kinematics.records), "checked": False, "sentences": lines}
    findings = [
        finding
        for finding in kinematics.result.findings
        if finding.supported and np.all(np.isfinite([finding.value, finding.std, finding.gain]))
    ]
    return {
        "records": list(kinematics.records),
        "checked": True,
        "findings": [
            {
                "name": finding.name,
                "channel": finding.channel,
                "parameters": {
                    _parameter(finding): _number(Quantity(finding.value, finding.std, finding.unit))
                },
                "alternatives": list(finding.group),
                "gain": finding.gain,
                "replicates": finding.replicates,
                "sentence": finding_sentence(finding, wording),
            }
            for finding in findings
        ],
        "agreement": [
            {
                "effect": agreement.effect,
                "says": agreement.says,
                "sentence": agreement.sentence,
                **({"found": _number(agreement.found)} if agreement.found else {}),
            }
            for agreement in agreements(kinematics, claims)
        ],
        "cannot_tell": list(kinematics.result.unobservable),
        "notes": list(kinematics.result.notes),
        "sentences": lines,
    }


def _number(quantity: Quantity) -> dict[str, Any]:
    return {"value": quantity.value, "std": max(quantity.std, SMALLEST_STD), "unit": quantity.unit}
