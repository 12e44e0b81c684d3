"""Tables of a diagnosis: errors, derivatives and levels of flying qualities before and after,
candidates, and kinematic findings.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ident.compatibility.kinematics import ARMS
from ident.compatibility.six_degrees.kinematics import LEVEL
from ident.compatibility.trials import SensorFinding
from ident.flying_qualities.levels import ModeLevel, mode_levels
from ident.tracing.diagnosis import Candidate, Claim, Diagnosis, Quantity
from scenarios.diagnosis.kinematics import (
    BIAS,
    PARAMETERS,
    Kinematics,
    _finite,
    agreements,
    unnamed,
)
from scenarios.diagnosis.report.wording import (
    Wording,
    declared_alone,
    group_sentence,
    is_coloured,
    noise_headings,
    nothing_stands,
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

MOVED_SIGMAS = 2.0  # sigmas
SIMULATION_NOTE = (
    "a simulation cannot follow random gusts: one-step prediction is the measure in turbulence"
)
SIGMA_NOTE = "+- sigma, widened by the scatter between records"
Move = tuple[str, Quantity, Quantity]  # a name, and its quantity before and after
SHOWN_CANDIDATES = 6  # candidates of a round
SHOWN_ROWS = 15  # candidates of all rounds


def few_candidates(d: Diagnosis) -> int:
    """Return how many candidates of each round are shown where only the best are."""
    rounds = len({(candidate.round, candidate.within) for candidate in d.candidates})
    return max(1, min(SHOWN_CANDIDATES, SHOWN_ROWS // max(rounds, 1)))


def candidates_table(d: Diagnosis, caption: str, count: int, printed: int | None = None) -> Table:
    """Return the best candidates of each round, by gain, with the best form of each effect.

    ``count``: candidates of a round. ``printed``: number of rows on paper.
    """
    some: list[Candidate] = []
    nodes = dict.fromkeys((candidate.round, candidate.within) for candidate in d.candidates)
    for node in nodes:
        group = [
            candidate for candidate in d.candidates if (candidate.round, candidate.within) == node
        ]
        ranked = sorted(group, key=lambda c: (-c.gain, c.name))
        best = {candidate.name: candidate for candidate in reversed(ranked)}
        some += [candidate for candidate in ranked if best[candidate.name] is candidate][:count]
    shown = table(
        caption,
        (Column("round", PURE, left=True), [Number(c.round, digits=0) for c in some]),
        (Column("candidate"), [c.name for c in some]),
        (Column("added to"), [" + ".join(c.within) or "declared model" for c in some]),
        (Column("gain", PURE), [formatted(c.gain, ".1f") for c in some]),
        (Column("log odds", PURE), [formatted(c.weight, ".1f") for c in some]),
        (Column("parameters"), [candidate_parameters(c) for c in some]),
        (Column("remarks"), [candidate_remarks(c) for c in some]),
    )
    return replace(shown, printed=printed)


def candidate_parameters(c: Candidate) -> str:
    """Return the first parameters of a candidate with their values."""
    values = [
        f"{name} {with_sigma(quantity, name=name)}" for name, quantity in c.parameters.items()
    ]
    return ", ".join([*values[:3], *(["..."] if len(values) > 3 else [])])


def candidate_remarks(c: Candidate) -> str:
    """Return whether a candidate was fitted, and which others have a similar signature."""
    remarks = [] if c.fitted else ["linearised"]
    # another form of it is no alternative
    others = [name for name in c.collinear_with if name != c.name]
    return "; ".join(remarks + ([f"like {', '.join(others[:3])}"] if others else []))


def errors_table(d: Diagnosis, caption: str, units: Mapping[str, str] = CHANNEL_UNITS) -> Table:
    """Return a table with the error of each channel before and after, the residual of the fit where
    it is not the noise, and the noise; angles and their rates in degrees.
    """
    names = list(d.error_before.rmse)
    shown = {name: shown_in(units.get(name, ""), name) for name in names}
    levels = [residual_levels(d)] if is_coloured(d) else []

    def cells(values: Mapping[str, float]) -> list[Cell]:
        return [level_cell(shown[name].factor * values.get(name, math.nan)) for name in names]

    whole = table(
        caption,
        (Column("channel", printed="error"), names),
        (Column("before", BY_ROW), cells(d.error_before.rmse)),
        (Column("after", BY_ROW), cells(d.error_after.rmse)),
        *(
            (Column(heading, BY_ROW), cells(values))
            for heading, values in zip(noise_headings(d), (*levels, d.noise_floor), strict=True)
        ),
        units=[shown[name].unit for name in names],
    )
    return shown_table(d, whole)


def derivatives_table(d: Diagnosis, caption: str) -> Table:
    """Return the derivatives before and after, their run-to-run scatter where any is known, and the
    move in sigmas of both (marked beyond two).
    """
    pairs = [(name, old, d.after[name]) for name, old in d.before.items() if name in d.after]
    return shown_table(d, _moves(caption, "derivative", pairs, d.scatter))


def derived_table(d: Diagnosis, caption: str) -> Table:
    """Return a table of the quantities that follow from the derivatives; a frequency in rad/s and
    once more in Hz.
    """
    before, after = derived_of(d)
    pairs: list[Move] = []
    for name in (name for name in before if name in after):
        old, new, words = before[name], after[name], name.replace("_", " ")
        pairs.append((words, old, new))
        if is_frequency(name, old.unit):
            pairs.append((words, _hertz(old), _hertz(new)))
    return shown_table(d, _moves(caption, "derived", pairs, {}))


def _moves(
    caption: str, heading: str, pairs: Sequence[Move], scatter: Mapping[str, float]
) -> Table:
    return table(
        caption,
        (Column("name", printed=heading), [name for name, _, _ in pairs]),
        (
            Column("before", BY_ROW, together=True),
            [brief_estimate(old.value, old.std) for _, old, _ in pairs],
        ),
        (
            Column("after", BY_ROW, together=True),
            [brief_estimate(new.value, new.std) for _, _, new in pairs],
        ),
        (
            Column("run-to-run", BY_ROW),
            [formatted(scatter.get(name), ".2g") for name, _, _ in pairs],
        )
        if scatter
        else None,
        (Column("moved by", PURE), [move_cell(moved(old, new)) for _, old, new in pairs]),
        units=[old.unit for _, old, _ in pairs],
    )


def move_cell(sigmas: float) -> Cell:
    """Return a move in sigmas, marked beyond two; a dash if there is none."""
    if abs(sigmas) < 0.05:
        return MISSING
    mark = " *" if abs(sigmas) > MOVED_SIGMAS else "  "
    return Number(sigmas, unit=SIGMAS, shown=f"{sigmas:+.1f} sigma{mark}")


def member_tables(d: Diagnosis, caption: str) -> list[Table]:
    """Return, for each effect with alternatives, a table of the derivatives under each of them.

    A star marks a value that is more than two of both sigmas from that under the first.
    """
    if nothing_stands(d):
        return []
    out = []
    for claim in d.effects:
        members = claim.derivatives_under
        if len(members) < 2:
            continue
        first = next(iter(members.values()))
        names = [name for name in d.after if any(name in each for each in members.values())]
        columns = [
            (
                Column(member, BY_ROW, together=True),
                [_member(each.get(name), first.get(name)) for name in names],
            )
            for member, each in members.items()
        ]
        units = [d.after[name].unit for name in names]
        out.append(
            table(caption, (Column("name", printed="derivative"), names), *columns, units=units)
        )
    return [each for each in out if each.rows]


def _member(quantity: Quantity | None, first: Quantity | None) -> Cell:
    if quantity is None:
        return MISSING
    apart = first is not None and abs(quantity.value - first.value) > MOVED_SIGMAS * math.hypot(
        quantity.std, first.std
    )
    return brief_estimate(quantity.value, quantity.std, "*" if apart else "")


def derived_of(d: Diagnosis) -> tuple[dict[str, Quantity], dict[str, Quantity]]:
    """Return derived quantities before and after, including a delay of the model."""
    pairs = ((d.derived_before, d.before), (d.derived_after, d.after))
    before, after = (
        {**derived, **({"delay": own["delay"]} if "delay" in own else {})} for derived, own in pairs
    )
    return before, after


def _hertz(q: Quantity) -> Quantity:
    return Quantity(q.value / (2.0 * math.pi), q.std / (2.0 * math.pi), "Hz")


def sigma_note(d: Diagnosis) -> str:
    """Return a note if sigmas are widened by scatter; empty without an accepted effect."""
    return SIGMA_NOTE if d.inflation and not nothing_stands(d) else ""


def simulation_note(d: Diagnosis) -> str:
    """Return a note on simulation errors if turbulence is claimed, which no simulation follows."""
    random = any(claim.claimed and claim.one_step_gains for claim in d.effects)
    return SIMULATION_NOTE if random else ""


def moved_title(d: Diagnosis) -> str:
    """Return the heading of the table of derivatives."""
    if nothing_stands(d):
        return (
            "derivatives of the declared model: something is missing in it, they carry what it "
            "costs"
        )
    if declared_alone(d):
        return "derivatives of the declared model"
    any_moved = any(
        abs(moved(d.before[name], d.after[name])) > MOVED_SIGMAS
        for name in d.before
        if name in d.after
    )
    return (
        "derivatives (* moved by more than two of their joint sigmas, the root of the sum of both "
        "squared)"
        if any_moved
        else "derivatives"
    )


def moved(old: Quantity, new: Quantity) -> float:
    """Return the change in standard deviations of both together; zero if neither is known."""
    spread = math.hypot(old.std, new.std)
    return (new.value - old.value) / spread if spread > 0 and math.isfinite(spread) else 0.0


def short(value: float) -> str:
    """Three digits, zeros among them, no exponent below ten millions; a dash if there is no
    number.
    """
    if not math.isfinite(value):
        return "-"
    if abs(value) < 999.5:
        return f"{value:#.3g}".rstrip(".") if value else "0"
    return f"{value:.0f}" if value < 1e7 else f"{value:.2g}"


def level_cell(value: float) -> Cell:
    """Return a root mean square with three digits; a dash if there is no number."""
    return Number(value, shown=short(value)) if math.isfinite(value) else MISSING


Levels = tuple[ModeLevel, ...]


def levels_of(tracing: Tracing) -> tuple[Levels, Levels]:
    """Return levels of the declared model and of the one with the effects; empty without modes."""
    d = tracing.diagnosis
    before, after = (
        mode_levels(some, tracing.flown) if some is not None else ()
        for some in (d.modes_before, d.modes_after)
    )
    return before, after


def levels_title(tracing: Tracing) -> str:
    """Return the standard, class and category."""
    return levels_heading(tracing.flown)


def levels_table(tracing: Tracing, caption: str) -> Table:
    """Mode, level before and after, and the limit that the last of these models misses."""
    before, after = levels_of(tracing)
    old, new = ({level.mode: level for level in levels} for levels in (before, after))
    last = old if nothing_stands(tracing.diagnosis) else new
    modes = list({**old, **new})

    def levels(some: Mapping[str, ModeLevel]) -> list[Cell]:
        return [level_text(some[mode]) if mode in some else MISSING for mode in modes]

    whole = table(
        caption,
        (Column("mode"), modes),
        (Column("before"), levels(old)),
        (Column("after"), levels(new)),
        (Column("remarks"), [_missed(last.get(mode)) for mode in modes]),
    )
    return shown_table(tracing.diagnosis, whole)


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


def _missed(level: ModeLevel | None) -> str:
    return limit_text(level) if level is not None else ""


FREE = "the fits of a diagnosis leave a bias of each channel free"


def kinematics_lines(
    kinematics: Kinematics, claims: Sequence[Claim], wording: Wording
) -> list[str]:
    """Return all of it in sentences, one a line."""
    if kinematics.result is None:
        return [kinematics.why]
    lines = [each.sentence for each in agreements(kinematics, claims)]
    lines += [
        f"kinematics alone give {finding_sentence(finding, wording)}; "
        f"{FREE if finding.kind == BIAS else 'the diagnosis does not name it'}"
        for finding in unnamed(kinematics, claims)
    ]
    lines = lines or ["kinematics alone find no sensor fault"]
    # The declared equations say as much themselves.
    return [
        *lines,
        kinematics.source,
        *(f"kinematics: {note}" for note in kinematics.result.notes if note != LEVEL),
    ]


def finding_sentence(finding: SensorFinding, wording: Wording) -> str:
    """One finding: name, value and sigma, and what that is in the words of its effect and group."""
    quantity = Quantity(finding.value, finding.std, finding.unit)
    if wording.traits(finding.name).sentences:
        words = group_sentence(
            Claim(finding.name, {_parameter(finding): quantity}, finding.group), wording
        )
        return f"{finding.name} {with_sigma(quantity)}, {words}"
    # What is no effect of the library, a bias or the place of all accelerometers together, has the
    # words of a check.
    from scenarios.compatibility.report import fault_text, fit_as_well

    group = f" ({fit_as_well(finding.group)})" if finding.group else ""
    return f"{finding.name}, {fault_text(finding)}{group}"


def _parameter(finding: SensorFinding) -> str:
    """Return the effect's parameter that is the size of a finding."""
    return "arm" if finding.kind in ARMS else PARAMETERS.get(finding.kind, finding.kind)


def kinematics_content(
    kinematics: Kinematics, claims: Sequence[Claim], wording: Wording
) -> dict[str, Any]:
    """Return the entry ``compatibility`` of a study; numbers that are not finite are left out."""
    lines = kinematics_lines(kinematics, claims, wording)
    if kinematics.result is None:
        return {"records": list(kinematics.records), "checked": False, "sentences": lines}
    findings = [
        finding
        for finding in kinematics.result.findings
        if finding.stands and _finite(finding.value, finding.std, finding.gain)
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
                "effect": each.effect,
                "says": each.says,
                "sentence": each.sentence,
                **({"found": _number(each.found)} if each.found else {}),
            }
            for each in agreements(kinematics, claims)
        ],
        "cannot_tell": list(kinematics.result.cannot_tell),
        "notes": list(kinematics.result.notes),
        "sentences": lines,
    }


def _number(quantity: Quantity) -> dict[str, Any]:
    return {"value": quantity.value, "std": max(quantity.std, 1e-300), "unit": quantity.unit}
