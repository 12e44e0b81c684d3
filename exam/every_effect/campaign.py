"""The campaign of every effect: its flights, all of them together, and what is written of them."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from exam.every_effect.page import every_effect_page
from exam.every_effect.work import HiddenEffectFlight
from exam.repeated import Flown
from exam.scores.content import score_cells, scores_content
from exam.scores.page import drawn_scores
from exam.scores.rates import Scores
from exam.scores.text import scores_blocks
from scenarios.files.sources import versions
from scenarios.files.writing import study_folder, write_json, write_text
from scenarios.report.figure_formats import USUAL, Formats
from scenarios.report.folder import write_page
from scenarios.report.summary import WIDTH

NAME = "every-effect"
SCHEMA = "flightid/campaign/1"
COLUMNS = (
    *(
        "number",
        "seed",
        "effect",
        "planted",
        "vehicle",
        "model",
        "size_sigmas",
        "values",
        "verdict",
        "outcome",
        "right",
        "name",
        "false",
    ),
    *("probability", "error_sigmas", "errors", "held_out_before", "held_out_after"),
)


def scores_of(flights: Sequence[HiddenEffectFlight]) -> Scores:
    """The flights with what each was flown for."""
    return Scores(
        [each.marked for each in flights], [each.effect for each in flights], by_kind=True
    )


def every_effect_text(done: Flown, width: int = WIDTH) -> str:
    """The tables of the terminal."""
    blocks = [
        [f"{NAME}: {done.ended} flights, {done.words}"],
        *scores_blocks(scores_of(done.found), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def cells_of(flight: HiddenEffectFlight) -> dict[str, Any]:
    """A flight as one row of ``COLUMNS``; None where there is no such thing."""
    cells = {
        **{
            "number": flight.number,
            "seed": flight.seed,
            "effect": flight.effect,
            "planted": flight.hidden,
            "vehicle": flight.vehicle,
        },
        **{
            "model": flight.model,
            "size_sigmas": flight.size,
            "values": json.dumps(dict(flight.values)),
            **score_cells(flight.marked),
        },
    }
    return {name: cells[name] for name in COLUMNS}


def write_every_effect(
    done: Flown, runs: int, effects: Sequence[str] | None, out: str | Path, figures: Formats = USUAL
) -> Path:
    """Write ``flights.csv``, one row a flight, figures, the page, and ``campaign.json`` (last) into
    a folder; returns it.

    ``runs`` : flights of each of the ``effects``, None for all of the library.
    """
    scores = scores_of(done.found)
    with study_folder(out, "campaign.json") as scratch:
        text = io.StringIO(newline="")
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(cells_of(flight) for flight in done.found)
        write_text(scratch / "flights.csv", text.getvalue())
        content = {
            "schema": SCHEMA,
            "scenario": NAME,
            **done.content,
            "runs": runs,
            "flights": done.ended,
            **({"effects": list(effects)} if effects else {}),
        }
        write_page(
            scratch,
            every_effect_page(
                done, scores, runs, effects, drawn_scores(scores, NAME, scratch, figures)
            ),
        )
        write_json(
            scratch / "campaign.json",
            {**content, "marks": scores_content(scores), "versions": versions()},
        )
    return Path(out)
