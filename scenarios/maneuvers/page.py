"""The page of a search: the table, the whole flight in a figure, how the maneuvers are used."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from scenarios.maneuvers.finding import LEAD, TAIL, Maneuvers
from scenarios.maneuvers.text import maneuvers_summary, table_columns
from scenarios.pages.folder import figures
from scenarios.pages.model import Bullets, Page, Prose, section
from scenarios.pages.printed import printed_blocks
from scenarios.pages.reproduction import now, reproduction
from scenarios.pages.wording import sentence
from scenarios.plots.page.named import Drawn
from scenarios.preparation.maneuver_file import FILE
from scenarios.terminal.tables import print_table


def maneuvers_page(found: Maneuvers, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a search with the figures ``drawn``."""
    name, summary = found.identity.name, maneuvers_summary(found)
    moves = sum(each.found.kind != "trim" for each in found.maneuvers)
    table = printed_blocks(partial(print_table, title="Maneuvers and trim points", columns=table_columns(found)))
    used = (
        f"The file {FILE} holds the part of the record to use for each: {LEAD:g} s before the input to {TAIL:g} s after it, or half way to "
        "its neighbour.",
        f"flightid identify {name} --maneuver N uses one of them, by number or name; diagnose and survey do so as well.",
        "A t value is a derivative over its standard deviation, by equation error on this maneuver alone; below about 5 it hardly determines it.",
    )
    return Page(
        title=f"{name}: maneuvers",
        kind="Maneuvers in a long record",
        verdict=f"{moves} maneuver{'s' if moves != 1 else ''}",
        tone="plain",
        sentence=sentence(summary.outcome),
        summary=(sentence(summary.result),),
        warnings=tuple(map(sentence, found.cautions)),
        sections=(
            *section("The whole flight", *figures(drawn)),
            *section("Maneuvers", *table, Prose("Angles in degrees; times of the inputs.", "note")),
            *section("How they are used", Bullets(used)),
        ),
        reproduction=reproduction(["flightid", "maneuvers", name], "", [("searched", name, found.identity.sha256)]),
        created=now(),
    )
