"""The page of a check: what stands against the sensors, every fault by both methods, what cannot be told."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from ident.compatibility.six_degrees.kinematics import CHANNELS
from scenarios.compatibility.check import Check, noise_levels
from scenarios.compatibility.text import finding_lines, print_by_record, print_estimates, unit_of
from scenarios.pages.folder import figures
from scenarios.pages.model import Block, Bullets, Column, Page, Prose, Table, section
from scenarios.pages.printed import printed_blocks
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.tables import fixed_table, levels_of_noise
from scenarios.pages.wording import sentence
from scenarios.plots.page.named import Drawn
from scenarios.preparation.record_words import record_table


def check_page(check: Check, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a check with the figures ``drawn``."""
    result, names = check.result, ", ".join(dict.fromkeys(record.name for record in check.records))
    lines = finding_lines(check)
    faults = [finding.name for finding in result.findings if finding.stands]
    checked = bool(result.relations)
    inputs = [("checked", file.name, file.sha256) for file in check.files]
    inputs += [("vehicle", check.vehicle.name, check.vehicle.sha256)] if check.vehicle is not None else []
    given = ["--vehicle", check.vehicle.name] if check.vehicle is not None else []
    return Page(
        title=f"{names}: data compatibility",
        kind="What the kinematics alone say of the sensors",
        verdict=("a fault stands" if faults else "compatible") if checked else "not checked",
        tone=("fair" if faults else "good") if checked else "open",
        sentence=sentence(lines[0]) if lines else "",
        summary=tuple(map(sentence, lines[1:4])),
        warnings=tuple(map(sentence, check.look.doubts)),
        sections=(
            *section("What stands", Bullets(tuple(map(sentence, lines)))),
            *section("Every fault by both methods", *_estimates(check)),
            *section("What these channels cannot tell", Bullets(tuple(map(_limit, result.cannot_tell)))),
            *section("Figures", *figures(drawn)),
            *section("The record as it was recorded", record_table(check.look)),
            *section("How it was made", *_made(check)),
        ),
        reproduction=reproduction(["flightid", "check", *(file.name for file in check.files), *given], "", inputs),
        created=now(),
    )


def _limit(line: str) -> str:
    # The name of a channel keeps its small letter.
    return f"{line}." if line.partition(":")[0] in CHANNELS else sentence(line)


def _estimates(check: Check) -> list[Block]:
    result = check.result
    if not result.joint.estimates:
        return []
    several = len(check.records) > 1
    title = "All records, one fault at a time" if several else "One fault at a time"
    blocks = printed_blocks(partial(print_estimates, title=title, result=result.joint))
    if several:
        units = {item.name: item.unit for item in result.joint.estimates}
        blocks += printed_blocks(partial(print_by_record, single=result.single, joint=result.joint), units)
    noise = {name: (std, unit_of(check, name)) for name, std in noise_levels(check).items() if std is not None}
    caption = "Noise, one sigma; of what is integrated as its integral shows it"
    return [*blocks, Prose("Gain of the log likelihood by this fault alone.", "note"), levels_of_noise(caption, noise)]


def _made(check: Check) -> list[Block]:
    settings = check.settings
    parts = tuple(f"{r.name}: {len(r)} samples, {r.time[0]:g} to {r.time[-1]:g} s" for r in check.records)
    relations = tuple((name, ", ".join(joined)) for name, joined in check.result.relations.items())
    held = {"gravity": (settings.gravity, "m/s2"), "vane_arm": (settings.vane_arm, "m")}
    held |= {"airspeed": (settings.airspeed, "m/s")} if settings.airspeed is not None else {}
    notes = tuple(map(sentence, (*check.notes, *check.result.notes)))
    return [
        Bullets(parts),
        Table("Which channels each relation joins", (Column("relation of"), Column("channels")), relations),
        Bullets(notes),
        fixed_table("Constants", held),
    ]
