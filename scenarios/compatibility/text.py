"""A check in the terminal: a table of every sensor fault by both methods, then what stands and what cannot be told."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console

from ident.compatibility.kinematics import BOOM, PACKAGE, VANES
from ident.compatibility.trials import CheckResult, SensorEstimate, SensorFinding
from scenarios.compatibility.check import Check, equivalent_constant, noise_levels
from scenarios.preparation.record_words import record_lines
from scenarios.terminal.display_units import shown_in, spaced, unit_cell
from scenarios.terminal.numbers import console, number
from scenarios.terminal.paragraphs import print_paragraph
from scenarios.terminal.summary import BELOW, Summary, print_summary
from scenarios.terminal.tables import Column, print_table

WORDS = {"delay": "{} is late by {} s", "lag": "{} lags with {} s", "scale": "{} reads {} times the true value", "drift": "{} drifts by {}"} | {
    "bias": "{} reads {} too much"
}
PLACES = {"arm": "ahead of", "arm-right": "to the right of", "arm-below": "below"}


def print_check(check: Check, out: Console | None = None, details: str = BELOW) -> None:
    """Print a check: a summary, the estimates of all records together, those of the others where they differ, findings, limits."""
    out = out or console()
    result = check.result
    print_summary(out, check_summary(check, details))
    for record in check.records:
        print_paragraph(out, f"{record.name}: {len(record)} samples, {record.time[0]:g} to {record.time[-1]:g} s", indent=0)
    for line in (*(f"warning: {doubt}" for doubt in check.look.doubts), *record_lines(check.look)):
        print_paragraph(out, line, indent=0)
    for output, joined in result.relations.items():
        print_paragraph(out, f"relation of {output}: {', '.join(joined)}", indent=0)
    if result.joint.estimates:
        print_estimates(out, "all records, one fault at a time" if len(check.records) > 1 else "one fault at a time", result.joint)
        if len(check.records) > 1:
            print_by_record(out, result.single, result.joint)
        print_paragraph(out, f"noise (1 sigma; of what is integrated, as its integral shows it): {_noise(check)}")
    for line in finding_lines(check):
        print_paragraph(out, line, indent=0)
    if result.cannot_tell:
        print_paragraph(out, "these channels cannot tell:", indent=0)
        for line in result.cannot_tell:
            print_paragraph(out, line)
    for line in (*check.notes, *result.notes):
        print_paragraph(out, f"note: {line}", indent=0)


def check_summary(check: Check, details: str = BELOW) -> Summary:
    """Records and relations, what stands, by how much, and the noise that is left."""
    result, lines = check.result, finding_lines(check)
    samples = sum(len(record) for record in check.records)
    said: set[str] = set()
    standing: list[str] = []
    for finding in result.findings:
        if finding.stands and finding.name not in said:
            said |= {finding.name, *finding.group}
            standing.append(" or ".join((finding.name, *finding.group)))
    told = [line.removeprefix("stands: ") for line in lines if line.startswith("stands")]
    named = f"{check.records[0].name}{f' and {len(check.records) - 1} more' if len(check.records) > 1 else ''}"
    checked = f"kinematics of {', '.join(result.relations)}" if result.relations else "the channels close no relation"
    return Summary(
        f"{named}, {samples} samples; {checked}",
        f"stands: {', '.join(standing)}" if standing else next((line for line in lines if line.startswith(("no sensor", "nothing"))), lines[0]),
        "; ".join(told),
        f"noise {_noise(check)}" if result.joint.noise_std else "",
        details,
    )


def _noise(check: Check) -> str:
    return ", ".join(_level(name, std, unit_of(check, name)) for name, std in noise_levels(check).items())


def finding_lines(check: Check) -> list[str]:
    """What stands, in sentences; and where the two methods disagree."""
    result, lines = check.result, []
    said: set[str] = set()
    for finding in result.findings:
        if finding.stands and finding.name not in said:
            said |= {finding.name, *finding.group}
            other = equivalent_constant(check, finding)
            lines.append(f"stands: {sentence(finding)}{f'; {other}' if other else ''}")
            lines += [said_of] if (said_of := odds(finding, result.findings)) else []
        elif not finding.replicates:
            lines.append(f"does not replicate: {finding.name}, the records by themselves disagree")
    if len(result.single) > 1:
        for single in result.single:
            drifts = [f for f in single.findings if f.stands and f.kind == "drift"]
            lines += [f"stands in {single.records[0]} alone: {sentence(f)}" for f in drifts[:1]]
            lines += [f"stands in {single.records[0]}: {sentence(f)}" for f in single.findings if f.stands and f.kind == "bias"]
    if result.joint.estimates and not any(line.startswith("stands") for line in lines):
        lines.append("no sensor fault stands: the channels agree with each other within their noise")
    if not result.relations:
        lines.append("nothing is checked: these channels close no relation of the kinematics")
    for item in result.joint.estimates:
        if item.told and not item.agrees:
            lines.append(f"the two methods disagree on {item.name} by {abs(item.difference):.1f} sigmas: trust neither")
    return lines


def odds(finding: SensorFinding, findings: Sequence[SensorFinding]) -> str:
    """Probabilities and sizes of a finding and of what would do as well, where one is an arm: how far sensors usually are off then counts."""
    by_name = {item.name: item for item in findings} | {finding.name: finding}
    known = [(by_name[name], share) for name, share in finding.probabilities.items() if name in by_name]
    if len(known) < 2 or not any(item.kind in PLACES for item, _ in known):
        return ""
    shown = [f"{_share(share)} that {what_it_is(item)}" for item, share in sorted(known, key=lambda pair: -pair[1])]
    prior = "a vane is metres ahead, an accelerometer within half a chord or a metre of the centre of gravity"
    return f"probabilities, as {prior}: {'; '.join(shown)}"


def _share(share: float) -> str:
    return "< 0.1 %" if share < 1e-3 else "> 99.9 %" if share > 0.999 else f"{100.0 * share:.1f} %"


def sentence(finding: SensorFinding) -> str:
    """One finding with its alternatives."""
    other = f"; {' or '.join(finding.group)} would do as well" if finding.group else ""
    return f"{finding.name}, {what_it_is(finding)} (gain {finding.gain:.1f}{other})"


def what_it_is(finding: SensorFinding) -> str:
    """What is wrong with the sensor, and by how much."""
    factor, shown = shown_in(finding.unit)
    value = f"{number(factor * finding.value, factor * finding.std)} +- {number(factor * finding.std, factor * finding.std)}"
    if finding.kind in PLACES:
        return f"{_sensor(finding.channel)} {value} m {PLACES[finding.kind]} the centre of gravity"
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


def print_estimates(out: Console, title: str, result: CheckResult) -> None:
    """Every fault by both methods."""
    rows = [*result.biases, *result.estimates]
    standing = {finding.name for finding in result.findings if finding.stands}
    print_table(
        out,
        title,
        [
            Column("fault", [row.name for row in rows], left=True),
            Column("unit", [unit_cell(shown_in(row.unit).unit) for row in rows], left=True),
            Column("smoother", [_value(row, row.smoother.value, row.smoother.std) for row in rows]),
            Column("+- sigma", [_value(row, row.smoother.std, row.smoother.std) for row in rows], beside=True),
            Column("output error", [_value(row, row.output_error.value, row.output_error.std) for row in rows]),
            Column("+- sigma", [_value(row, row.output_error.std, row.output_error.std) for row in rows], beside=True),
            Column("apart, sigmas", [f"{row.difference:+.1f}" if row.told else "-" for row in rows]),
            Column("gain", [f"{row.gain:.1f}" if row.told and row.kind != "bias" else "-" for row in rows]),
            Column("", ["stands" if row.name in standing else "" if row.told else "cannot tell" for row in rows], left=True),
        ],
    )


def print_by_record(out: Console, single: Sequence[CheckResult], joint: CheckResult) -> None:
    """The smoother's value of every fault in each record by itself."""
    names = [item.name for item in joint.estimates]
    by_name = [{item.name: item for item in result.estimates} for result in single]
    columns = [Column("each record by itself", names, left=True)]
    for result, table in zip(single, by_name, strict=True):
        cells = []
        for name in names:
            item = table.get(name)
            told = item is not None and item.told
            cells.append(
                f"{_value(item, item.smoother.value, item.smoother.std)} +- {_value(item, item.smoother.std, item.smoother.std)}"
                if item and told
                else "-"
            )
        columns.append(Column(result.records[0], cells))
    print_table(out, "", columns)


def unit_of(check: Check, name: str) -> str:
    """The unit of a channel."""
    return next((record[name].unit for record in check.records if name in record.output_names), "g")  # nz made from az has no channel


def _value(row: SensorEstimate, value: float, std: float) -> str:
    factor, _ = shown_in(row.unit)
    return number(factor * value, factor * std) if row.told else "-"


def _level(name: str, std: float | None, unit: str) -> str:
    if std is None:
        return f"{name} not measurable from these records"
    factor, shown = shown_in(unit, name)
    return f"{name} {factor * std:.3g}{spaced(shown)}"
