"""The campaign of every effect: its flights, all of them together, and what is written of them."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from scenarios.files.folders import study_folder
from scenarios.files.versions import versions
from scenarios.files.writing import write_json, write_text
from scenarios.pages.folder import write_page
from scenarios.pages.model import Page
from scenarios.terminal.paragraphs import WIDTH
from scenarios.terminal.tables import columns_of, table_lines
from scenarios.trials.every_effect.work import PlantedFlight
from scenarios.trials.marks.tables import RATES, rate_rows
from scenarios.trials.repeated import Flown

NAME = "every-effect"
SCHEMA = "flightid/campaign/1"
COLUMNS = (
    *("number", "seed", "effect", "planted", "vehicle", "model", "size_sigmas", "values", "verdict", "outcome", "right", "name", "false"),
    *("probability", "error_sigmas", "errors", "held_out_before", "held_out_after"),
)


def every_effect_text(done: Flown, width: int = WIDTH) -> str:
    """The tables of the terminal."""
    flights: Sequence[PlantedFlight] = done.found
    marked, labels = [each.marked for each in flights], [each.effect for each in flights]
    title = "rates of each verdict; right: what was planted is named, or among the names of an ambiguous verdict, and nothing else is"
    lines = [f"{NAME}: {done.ended} flights, {done.words}", *table_lines(columns_of(RATES, rate_rows(marked, labels)), title=title, width=width)]
    return "\n".join(lines) + "\n"


def cells_of(flight: PlantedFlight) -> dict[str, Any]:
    """A flight as one row of ``COLUMNS``; None where there is no such thing."""
    m = flight.marked
    errors, first = [*m.errors.values()], next((each for each in m.stated if each.first), None)
    return {
        **{"number": flight.number, "seed": flight.seed, "effect": flight.effect, "planted": flight.planted, "vehicle": flight.vehicle},
        **{"model": flight.model, "size_sigmas": flight.size, "values": json.dumps(dict(flight.values))},
        **{"verdict": m.verdict, "outcome": m.outcome.value, "right": m.right, "name": " + ".join(m.given), "false": " + ".join(m.false)},
        **{"probability": first.probability if first else None, "error_sigmas": max(errors, key=abs) if errors else None},
        **{"errors": json.dumps(dict(m.errors)), "held_out_before": m.held_out_before, "held_out_after": m.held_out_after},
    }


def write_every_effect(done: Flown, runs: int, effects: Sequence[str] | None, out: str | Path, page: Page) -> Path:
    """Write ``flights.csv``, one row a flight, the ``page``, and ``campaign.json`` (last) into a folder; returns it. ``runs`` : of each effect."""
    flights: Sequence[PlantedFlight] = done.found
    marked, labels = [each.marked for each in flights], [each.effect for each in flights]
    with study_folder(out, "campaign.json") as scratch:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(cells_of(flight) for flight in flights)
        write_text(scratch / "flights.csv", text.getvalue())
        rates = [dict(zip(RATES, row, strict=True)) for row in rate_rows(marked, labels)]
        content = {
            "schema": SCHEMA,
            "scenario": NAME,
            **done.content,
            "runs": runs,
            "flights": done.ended,
            "effects": effects,
        }
        write_page(scratch, page)
        write_json(scratch / "campaign.json", {**content, "rates": rates, "versions": versions()})
    return Path(out)
