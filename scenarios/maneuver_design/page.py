"""The page of a design: which maneuver to fly, what it would tell, and how far it goes."""

from __future__ import annotations

import shlex
from collections.abc import Sequence

from scenarios.maneuver_design.design import Design
from scenarios.maneuver_design.text import LEAST, comparison, contest_table, notes_of, response_table, sigma_table, verdict_of
from scenarios.pages.folder import figures
from scenarios.pages.model import Bullets, Page, Prose, as_sentence, capital, now, reproduction, section
from scenarios.pages.tables import rows_table
from scenarios.plots.formats import Drawn

RULE = (
    "A maneuver decides where the loop would find the effect that acts and prefer it to the other by more than the three units of twice the log "
    "likelihood below which it calls two names ambiguous"
)


def design_page(design: Design, drawn: Sequence[Drawn] = ()) -> Page:
    """The page of a design with the figures ``drawn``."""
    setting, told = design.setting, bool(design.acting)
    word, _, rest = verdict_of(design).partition(": ")
    inputs = [(use, file.name, file.sha256) for use, file in (("vehicle", setting.vehicle.identity), ("model", setting.vehicle.own_file)) if file]
    names, rows = sigma_table(design)
    return Page(
        title=f"{setting.vehicle.name}: maneuver design",
        kind=f"{setting.model.name} model, {setting.room.time[-1]:g} s at {setting.rate:g} Hz",
        verdict=capital(word.lower()),
        tone="open" if told and design.best.chance < LEAST else "good",
        sentence=as_sentence(rest),
        summary=(),
        warnings=(),
        sections=(
            *section("Maneuvers", rows_table("Equal amplitude and time, within the limits, the best first", *comparison(design))),
            *(
                section("Who is told from whom", rows_table(f"The {design.best.kind}", *contest_table(design)), Prose(f"{RULE}.", "note"))
                if told
                else ()
            ),
            *section("Expected frequency responses", rows_table("Of one flight", *response_table(design)) if design.best.responses else None),
            *section("Expected standard deviations", rows_table("Cramer-Rao bounds", names, rows)),
            *section("Figures", *figures(drawn)),
            *section("What it rests on", Bullets(tuple(map(as_sentence, map(capital, notes_of(design)))))),
        ),
        reproduction=reproduction(shlex.split(design.asked.command()), "", inputs),
        created=now(),
    )
