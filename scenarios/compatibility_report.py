"""A check of data compatibility in the terminal, on its page and in its folder."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from ident.compatibility.kinematics import BOOM, PACKAGE, VANES
from ident.compatibility.six_degrees.kinematics import CHANNELS
from ident.compatibility.trials import (
    CheckResult,
    Compatibility,
    FaultQuantity,
    SensorEstimate,
    SensorFinding,
)
from scenarios.compatibility import (
    CompatibilityCheck,
    equivalent_constant,
    lacks_airspeed,
    noise_levels,
)
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json
from scenarios.plots import draw_into
from scenarios.plots.display import MEASURED_DATA, SIMULATED_DATA
from scenarios.preparation.recording import record_content, record_lines, record_table
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    SIGMAS,
    Block,
    Bullets,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Table,
    as_sentence,
    formatted,
    now,
    reproduction,
    section,
    table,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import figures, write_page
from scenarios.report.quantities import console, number_text, shown_in, spaced
from scenarios.report.summary import BELOW, Summary, print_paragraph, print_summary
from scenarios.report.terminal import fixed_table, levels_of_noise, show_blocks
from sim.record import extent

if TYPE_CHECKING:
    from scenarios.plots.drawing import Named


# ---- Figures of a check: one for each integrated record


def check_figures(result: Compatibility, simulated: bool) -> Iterator[Named]:
    """Yield the figures of a check: the stem of each file, and what draws it."""
    from scenarios.plots.signals import figure_reconstruction

    data = SIMULATED_DATA if simulated else MEASURED_DATA
    for number, item in enumerate(result.reconstructions, start=1):
        stem = "reconstruction" if number == 1 else f"reconstruction_{number}"
        yield (
            stem,
            partial(figure_reconstruction, item, f"{item.record}: {data} and reconstruction", data),
        )


# ---- A check in the terminal

WORDS = {
    "delay": "{} is late by {} s",
    "lag": "{} lags with {} s",
    "scale": "{} reads {} times the true value",
    "drift": "{} drifts by {}",
    "bias": "{} reads {} too much",
}
# Of a positive and of a negative arm.
PLACES = {
    "arm": ("ahead of", "behind"),
    "arm-right": ("to the right of", "to the left of"),
    "arm-below": ("below", "above"),
}


def print_check(
    check: CompatibilityCheck, out: Console | None = None, details: str = BELOW
) -> None:
    """Print a check: summary, estimates, differences between records, findings, limits."""
    out = out or console()
    result = check.result
    print_summary(out, check_summary(check, details))
    for record in check.records:
        print_paragraph(out, f"{record.name}: {extent(record)}", indent=0)
    for line in (*(f"warning: {doubt}" for doubt in check.look.doubts), *record_lines(check.look)):
        print_paragraph(out, line, indent=0)
    for output, joined in result.relations.items():
        print_paragraph(out, f"relation of {output}: {', '.join(joined)}", indent=0)
    if result.joint.estimates:
        show_blocks(out, _estimates(check))
        print_paragraph(
            out, f"noise (1 sigma; of integrated channels: that of their integral): {_noise(check)}"
        )
    for line in finding_lines(check):
        print_paragraph(out, line, indent=0)
    if result.unobservable:
        print_paragraph(out, "these channels cannot show:", indent=0)
        for line in result.unobservable:
            print_paragraph(out, line)
    for line in (*check.notes, *result.notes):
        print_paragraph(out, f"note: {line}", indent=0)


def check_summary(check: CompatibilityCheck, details: str = BELOW) -> Summary:
    """Return the summary: records, relations, accepted faults with sizes, remaining noise."""
    result, lines = check.result, finding_lines(check)
    samples = sum(len(record) for record in check.records)
    named_faults: set[str] = set()
    standing: list[str] = []
    for finding in result.findings:
        if finding.supported and finding.name not in named_faults:
            named_faults |= {finding.name, *finding.group}
            standing.append(" or ".join((finding.name, *finding.group)))
    sentences = [
        line.removeprefix("fault found: ") for line in lines if line.startswith("fault found")
    ]
    named = f"{check.records[0].name}{f' and {len(check.records) - 1} more' if len(check.records) > 1 else ''}"  # noqa: E501
    checked = (
        f"kinematics of {', '.join(result.relations)}"
        if result.relations
        else "no airspeed is known"
        if lacks_airspeed(result)
        else "kinematics relate none of these channels"
    )
    return Summary(
        f"{named}, {samples} samples; {checked}",
        f"sensor fault found: {', '.join(standing)}"
        if standing
        else next((line for line in lines if line.startswith(("no sensor", "nothing"))), lines[0]),
        "; ".join(sentences),
        f"noise {_noise(check)}" if result.joint.noise_std else "",
        details,
    )


def _noise(check: CompatibilityCheck) -> str:
    return ", ".join(
        _level(name, std, unit_of(check, name)) for name, std in noise_levels(check).items()
    )


def finding_lines(check: CompatibilityCheck) -> list[str]:
    """Return the accepted findings in sentences, and where the two methods disagree."""
    result, lines = check.result, []
    named: set[str] = set()
    for finding in result.findings:
        if finding.supported and finding.name not in named:
            named |= {finding.name, *finding.group}
            other = equivalent_constant(check, finding)
            lines.append(f"fault found: {sentence(finding)}{f'; {other}' if other else ''}")
            lines += [said_of] if (said_of := odds(finding, result.findings)) else []
        elif not finding.replicates:
            lines.append(f"does not replicate: {finding.name}, the records by themselves disagree")
    if len(result.single) > 1:
        for single in result.single:
            drifts = [f for f in single.findings if f.supported and f.kind == "drift"]
            lines += [
                f"fault found in {single.records[0]} alone: {sentence(f)}" for f in drifts[:1]
            ]
            lines += [
                f"fault found in {single.records[0]}: {sentence(f)}"
                for f in single.findings
                if f.supported and f.kind == "bias"
            ]
    if result.joint.estimates and not any(line.startswith("fault found") for line in lines):
        lines.append("no sensor fault found: the channels agree with each other within their noise")
    if not result.relations:
        lines.append(
            "nothing is checked: no airspeed is known"
            + ("" if check.vehicle is not None else "; add --vehicle V.toml")
            if lacks_airspeed(result)
            else "nothing is checked: check needs channels that kinematics relate: alpha, q and nz "
            "(or az); or q and theta; or p and phi (docs/compatibility.md)"
        )
    for item in result.joint.estimates:
        if item.determined and not item.agrees:
            lines.append(
                f"the two methods disagree on {item.name} by {abs(item.difference):.1f} sigmas: "
                "trust neither"
            )
    return lines


def odds(finding: SensorFinding, findings: Sequence[SensorFinding]) -> str:
    """Return the probabilities and sizes of a finding and of the faults that fit equally well;
    empty unless one of them is the position of a sensor, for which the usual positions count.
    """
    shown = [f"{share} that {fault_text(item)}" for item, share in shares(finding, findings)]
    if not shown:
        return ""
    prior = "vanes usually sit metres from the centre of gravity, accelerometers within a metre"
    return f"the usual places of sensors decide between these causes ({prior}): {'; '.join(shown)}"


def shares(
    finding: SensorFinding, findings: Sequence[SensorFinding]
) -> list[tuple[SensorFinding, str]]:
    """Return a finding and the faults that fit equally well with their probabilities, the likeliest
    first; empty unless one of them is the position of a sensor.
    """
    by_name = {item.name: item for item in findings} | {finding.name: finding}
    known = [
        (by_name[name], share) for name, share in finding.probabilities.items() if name in by_name
    ]
    if len(known) < 2 or not any(item.kind in PLACES for item, _ in known):
        return []
    return [(item, _share(share)) for item, share in sorted(known, key=lambda pair: -pair[1])]


def _share(share: float) -> str:
    return "< 0.1 %" if share < 1e-3 else "> 99.9 %" if share > 0.999 else f"{100.0 * share:.1f} %"


def sentence(finding: SensorFinding) -> str:
    """Return one finding with its alternatives."""
    other = f"; {fit_as_well(finding.group)}" if finding.group else ""
    gain = f"raises the log likelihood by {finding.gain:.1f}"
    return f"{finding.name}, {fault_text(finding)} ({gain}{other})"


def fit_as_well(group: Sequence[str]) -> str:
    """Return a phrase: other faults fit the data as well as the named one."""
    return f"{' or '.join(group)} fits these data equally well"


def fault_text(finding: SensorFinding) -> str:
    """Return a description of the sensor fault with its size."""
    factor, shown = shown_in(finding.unit)
    place = PLACES.get(finding.kind)
    size = abs(finding.value) if place else finding.value
    value = (
        f"{number_text(factor * size, factor * finding.std)} +- "
        f"{number_text(factor * finding.std, factor * finding.std)}"
    )
    if place:
        side = place[finding.value < 0.0]
        return f"{_sensor(finding.channel)} {value} m {side} the centre of gravity"
    if finding.channel == "wind":
        return f"the air rises by {value} {shown}"
    unit = f" {shown}" if finding.kind in ("drift", "bias") else ""
    return WORDS[finding.kind].format(finding.channel, value + unit)


def _sensor(channel: str) -> str:
    if channel == PACKAGE:
        return "the accelerometers are"
    if channel == BOOM:
        return "the vanes on their boom are"
    if channel in ("alpha", "nz"):
        return "the vane is" if channel == "alpha" else "the accelerometer is"
    return f"the {'vane' if channel in VANES else 'accelerometer'} of {channel} is"


METHODS_NOTE = (
    "each fault is estimated alone, by a smoother and by output error. Difference: between the two "
    "estimates, in sigmas; above 3, trust neither. Gain: increase of the log likelihood by this "
    "fault; about 0.5 by chance"
)

IN_PLACE_NOTE = (
    'rows marked "as well" or "instead" replace a found fault, which they resemble ("instead" '
    "fits less well); all other rows stand beside what is found"
)


def estimates_table(caption: str, result: CheckResult) -> Table:
    """Return every fault by both methods."""
    rows = [*result.biases, *result.estimates]
    remarks = {finding.name: _remark(finding) for finding in result.findings}
    return table(
        caption,
        (Column("fault"), [row.name for row in rows]),
        (Column("smoother", BY_ROW), [_cell(row, row.smoother) for row in rows]),
        (Column("output error", BY_ROW), [_cell(row, row.output_error) for row in rows]),
        (
            Column("difference", SIGMAS),
            [formatted(row.difference if row.determined else None, "+.1f") for row in rows],
        ),
        (
            Column("gain", PURE),
            [
                formatted(row.gain if row.determined and row.kind != "bias" else None, ".1f")
                for row in rows
            ],
        ),
        (
            Column("remark", printed=" "),
            [
                remarks.get(row.name, "") or ("" if row.determined else "not observable")
                for row in rows
            ],
        ),
        units=[shown_in(row.unit).unit for row in rows],
    )


def _remark(finding: SensorFinding) -> str:
    """Return whether a fault is found, and whether it was tried in place of a found one."""
    if not finding.instead_of:
        return "found" if finding.supported else ""
    return "as well" if finding.supported else "instead"


def by_record_table(single: Sequence[CheckResult], joint: CheckResult) -> Table:
    """Return the smoother's value of every fault in each record."""
    found = [{item.name: item for item in result.estimates} for result in single]
    return table(
        "each record by itself, by the smoother",
        (Column("fault"), [item.name for item in joint.estimates]),
        *(
            (
                Column(result.records[0], BY_ROW, together=True),
                [
                    _cell(items[each.name], items[each.name].smoother)
                    if each.name in items
                    else MISSING
                    for each in joint.estimates
                ],
            )
            for result, items in zip(single, found, strict=True)
        ),
        units=[shown_in(item.unit).unit for item in joint.estimates],
    )


def _estimates(check: CompatibilityCheck) -> list[Block]:
    """Return every fault from all records together, and from each record if there are several."""
    result, several = check.result, len(check.records) > 1
    if not result.joint.estimates:
        return []
    caption = "all records, one fault at a time" if several else "one fault at a time"
    any_found = any(finding.supported for finding in result.joint.findings)
    notes = (METHODS_NOTE, IN_PLACE_NOTE) if any_found else (METHODS_NOTE,)
    blocks: list[Block] = [
        Bullets(tuple(map(as_sentence, notes))),
        estimates_table(caption, result.joint),
    ]
    return [*blocks, by_record_table(result.single, result.joint)] if several else blocks


def unit_of(check: CompatibilityCheck, name: str) -> str:
    """Return the unit of a channel."""
    # nz made from az has no channel
    return next((record[name].unit for record in check.records if name in record.output_names), "g")


def _cell(row: SensorEstimate, quantity: FaultQuantity) -> Cell:
    factor, _ = shown_in(row.unit)
    return Number(factor * quantity.value, factor * quantity.std) if row.determined else MISSING


def _level(name: str, std: float | None, unit: str) -> str:
    if std is None:
        return f"{name} not measurable from these records"
    factor, shown = shown_in(unit, name)
    return f"{name} {factor * std:.3g}{spaced(shown)}"


# ---- The page of a check


def check_page(check: CompatibilityCheck, drawn: Sequence[Drawn] = ()) -> Page:
    """Return the page of a check with the figures ``drawn``."""
    result, names = check.result, ", ".join(dict.fromkeys(record.name for record in check.records))
    lines = finding_lines(check)
    faults = [finding.name for finding in result.findings if finding.supported]
    checked = bool(result.relations)
    inputs = [("checked", file.name, file.sha256) for file in check.files]
    inputs += (
        [("vehicle", check.vehicle.name, check.vehicle.sha256)] if check.vehicle is not None else []
    )
    given = ["--vehicle", check.vehicle.name] if check.vehicle is not None else []
    return Page(
        title=f"{names}: data compatibility",
        kind="Sensor errors that kinematics alone reveal",
        verdict=("a fault stands" if faults else "compatible") if checked else "not checked",
        tone=("fair" if faults else "good") if checked else "open",
        sentence=as_sentence(lines[0]) if lines else "",
        summary=tuple(map(as_sentence, lines[1:4])),
        warnings=tuple(map(as_sentence, check.look.doubts)),
        sections=(
            *section("Figures", *figures(drawn)),
            *section("Sensor faults", Bullets(tuple(map(as_sentence, lines)))),
            *section("Every fault by both methods", *_page_estimates(check)),
            *section(
                "What these channels cannot show", Bullets(tuple(map(_limit, result.unobservable)))
            ),
            *section("The record as it was recorded", record_table(check.look)),
            *section("How it was made", *_made(check)),
        ),
        reproduction=reproduction(
            ["flightid", "check", *(file.name for file in check.files), *given], "", inputs
        ),
        created=now(),
    )


def _limit(line: str) -> str:
    # The name of a channel keeps its small letter.
    return f"{line}." if line.partition(":")[0] in CHANNELS else as_sentence(line)


def _page_estimates(check: CompatibilityCheck) -> list[Block]:
    noise = {
        name: (std, unit_of(check, name))
        for name, std in noise_levels(check).items()
        if std is not None
    }
    caption = "Noise, one sigma"
    blocks = _estimates(check)
    note = Prose("For a channel that the kinematics integrate: noise of its integral.", "note")
    return [*blocks, levels_of_noise(caption, noise), note] if blocks else []


def _made(check: CompatibilityCheck) -> list[Block]:
    settings = check.settings
    parts = tuple(f"{r.name}: {extent(r)}" for r in check.records)
    relations = tuple((name, ", ".join(joined)) for name, joined in check.result.relations.items())
    held = {"gravity": (settings.gravity, "m/s2"), "vane_arm": (settings.vane_arm, "m")}
    held |= {"airspeed": (settings.airspeed, "m/s")} if settings.airspeed is not None else {}
    notes = tuple(map(as_sentence, (*check.notes, *check.result.notes)))
    return [
        Bullets(parts),
        Table(
            "Channels of each kinematic relation",
            (Column("relation of"), Column("channels")),
            relations,
        ),
        Bullets(notes),
        fixed_table("Constants", held),
    ]


# ---- The study folder of a check: figures, the page, and the JSON last

MAIN = "compatibility.json"
SCHEMA = "flightid/compatibility/1"


def write_check(check: CompatibilityCheck, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write a check into ``folder``, whole or not at all; returns the folder."""
    with study_folder(folder, MAIN) as scratch:
        drawn = draw_into(scratch, check_figures(check.result, check.simulated), figures)
        write_page(scratch, check_page(check, drawn))
        write_json(scratch / MAIN, check_content(check))
    return Path(folder)


def check_content(check: CompatibilityCheck) -> dict[str, Any]:
    """Return the content of ``compatibility.json``: SI, nz in g; scales as factors."""
    result = check.result
    constants = {"gravity": check.settings.gravity, "vane_arm": check.settings.vane_arm}
    return {
        "schema": SCHEMA,
        "channels": list(result.channels),
        "relations": {name: list(joined) for name, joined in result.relations.items()},
        "constants": constants
        | ({"airspeed": check.settings.airspeed} if check.settings.airspeed is not None else {}),
        "joint": _result(check, result.joint),
        "single": [_result(check, item) for item in result.single],
        "findings": [_finding(item) for item in result.findings if item.supported],
        "cannot_tell": list(result.unobservable),
        "warnings": [*check.look.doubts, *check.look.set_aside, *_equivalents(check)],
        "notes": [*check.notes, *result.notes],
        "record": record_content(check.look),
        "inputs": {
            "records": [item.name for item in check.files],
            "sha256": [item.sha256 for item in check.files],
            **(
                {"vehicle": {"name": check.vehicle.name, "sha256": check.vehicle.sha256}}
                if check.vehicle is not None
                else {}
            ),
        },
        "versions": versions(),
    }


def _equivalents(check: CompatibilityCheck) -> list[str]:
    """Return the numbers of the vehicle file that would explain a finding as well."""
    found = [
        (finding.name, equivalent_constant(check, finding))
        for finding in check.result.findings
        if finding.supported
    ]
    return [f"{name}: {sentence}" for name, sentence in found if sentence]


def _result(check: CompatibilityCheck, result: CheckResult) -> dict[str, Any]:
    return {
        "records": list(result.records),
        "estimates": {item.name: _estimate(item) for item in result.estimates},
        "biases": {item.name: _estimate(item) for item in result.biases},
        "tested": [_finding(item) for item in result.findings],
        "noise_std": {
            name: level for name, level in noise_levels(check, result).items() if level is not None
        },
    }


def _estimate(item: SensorEstimate) -> dict[str, Any]:
    return {
        "unit": item.unit,
        "output_error": _quantity(item.output_error),
        "smoother": _quantity(item.smoother),
        "difference_in_sigmas": item.difference,
        "agrees": item.agrees,
        "gain": item.gain,
        "p_value": item.p_value,
        "told": item.determined,
    }


def _finding(item: SensorFinding) -> dict[str, Any]:
    return {
        "name": item.name,
        "channel": item.channel,
        "kind": item.kind,
        "value": item.value,
        "std": item.std,
        "unit": item.unit,
        "gain": item.gain,
        "stands": item.supported,
        "group": list(item.group),
        "replicates": item.replicates,
        **({"probabilities": dict(item.probabilities)} if len(item.probabilities) > 1 else {}),
        **({"lost": item.lost} if item.lost is not None and math.isfinite(item.lost) else {}),
    }


def _quantity(item: FaultQuantity) -> dict[str, float]:
    return {"value": item.value, "std": item.std}
