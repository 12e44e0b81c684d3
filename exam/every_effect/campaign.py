"""The campaign of every effect: all flights together in tables, files and on a page; and one of its
flights again.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from exam.every_effect.flight import Flown, write_hidden
from exam.every_effect.work import EveryEffect, HiddenEffectFlight, scored_flight_of
from exam.options import exam_reproduction
from exam.repeated import FlownCampaign
from exam.scores.rates import NOTHING, Scores, false_share, right_share
from exam.scores.report import (
    score_cells,
    scores_blocks,
    scores_sections,
    write_campaign_folder,
)
from exam.scores.scored_flight import ScoredFlight
from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.diagnosis.files import write_diagnosis
from scenarios.diagnosis.text import diagnosis_text
from scenarios.files.writing import study_folder, write_json
from scenarios.report.document import Page, Prose, as_sentence, now, section
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.summary import WIDTH
from scenarios.tasks.work import Task, seed_of

# ---- The campaign of every effect

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
    """Return the flights with the effects for which they were flown."""
    return Scores(
        [each.marked for each in flights], [each.effect for each in flights], by_kind=True
    )


def every_effect_text(done: FlownCampaign, width: int = WIDTH) -> str:
    """Return the tables for the terminal."""
    blocks = [
        [f"{NAME}: {done.ended} flights, {done.words}"],
        *scores_blocks(scores_of(done.found), width),
    ]
    return "\n\n".join("\n".join(block) for block in blocks) + "\n"


def cells_of(flight: HiddenEffectFlight) -> dict[str, Any]:
    """Return one row of ``COLUMNS`` for a flight; None for a cell without a value."""
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
    done: FlownCampaign,
    runs: int,
    effects: Sequence[str] | None,
    out: str | Path,
    figures: Formats = USUAL,
) -> Path:
    """Write ``flights.csv`` with a row for each flight, figures, the page, and ``campaign.json``
    (last) into a folder; return the folder.

    ``runs`` : number of flights of each of the ``effects``, None for all of the library.
    """
    scores = scores_of(done.found)
    content = {
        "schema": SCHEMA,
        "scenario": NAME,
        **done.content,
        "runs": runs,
        "flights": done.ended,
        **({"effects": list(effects)} if effects else {}),
    }
    rows = [tuple(cells_of(flight).values()) for flight in done.found]
    paged = partial(every_effect_page, done, scores, runs, effects)
    return write_campaign_folder(out, NAME, scores, COLUMNS, rows, content, paged, figures)


# ---- The page of the campaign of every effect

EXPLAINED = (
    "In each flight one effect of the library, or nothing, is hidden with values drawn from the "
    "flight's seed; the loop is given two records and a "
    "vehicle file with starting values up to 30 % off, and no truth. The size is the change of the "
    "fitted outputs in noise sigmas that no other "
    "values of the declared parameters explain; it is drawn between 8 and 80, even in the "
    "logarithm."
)


def every_effect_page(
    done: FlownCampaign,
    scores: Scores,
    runs: int,
    effects: Sequence[str] | None,
    drawn: Sequence[Drawn] = (),
) -> Page:
    """Return the page of all flights, ``runs`` of each of the ``effects``, with the figures
    ``drawn``.
    """
    right = right_share([each for each in scores.flights if each.hidden])
    clean = false_share([each for each in scores.flights if not each.hidden])
    told = (
        f"{right.count} of {right.of} hidden effects are named"
        if right.of
        else "nothing was hidden"
    )
    false = (
        f"{clean.count} of {clean.of} flights with nothing in them get a name"
        if clean.of
        else f"no flight has {NOTHING} in it"
    )
    options = ("--effects", ",".join(effects)) if effects else ()
    command = ("every-effect", "--runs", str(runs), "--seed", str(done.root), *options)
    one = "python -m exam every-effect " + " ".join(
        (*options, "--seed", str(done.root), "--only", "NUMBER", "--out", "DIR")
    )
    return Page(
        title=f"Every effect: {done.ended} flights",
        kind="Campaign of the tracing loop",
        verdict="false names" if clean.count else "no false name" if clean.of else "",
        tone="fair" if clean.count else "good" if clean.of else "plain",
        sentence=as_sentence(told),
        summary=(as_sentence(false),),
        warnings=(as_sentence(done.failed),) if done.failed else (),
        sections=(
            *scores_sections(scores, drawn),
            *section(
                "How it was made",
                Prose(EXPLAINED),
                Prose("One flight again, by its number in flights.csv:"),
                Prose(one, "code"),
            ),
        ),
        reproduction=exam_reproduction(command, as_sentence(done.words)),
        created=now(),
    )


# ---- One flight of the campaign again


@dataclass(frozen=True, eq=False)
class OneFlight:
    """A flight with its ``task``, its diagnosis and its score."""

    task: Task
    flown: Flown
    tracing: Tracing
    marked: ScoredFlight


def fly_one(
    work: EveryEffect,
    number: int,
    root: int,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> OneFlight:
    """Fly flight ``number`` of the campaign with the root seed ``root``; it equals that of the
    campaign bit for bit.

    Raises
    ------
    FlightidError : it cannot be flown, or its files are refused.
    """
    task = Task(number, seed_of(root, number))
    progress("flying", 0.0)
    flown = work.fly(task)
    with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
        tracing = diagnose_files(write_hidden(flown, Path(folder)), progress)
    return OneFlight(task, flown, tracing, scored_flight_of(flown, tracing))


def one_text(one: OneFlight, width: int = WIDTH) -> str:
    """Return the text of `flightid diagnose` and the truth."""
    return f"{diagnosis_text(one.tracing, width).rstrip()}\n\n{truth_sentence(one)}\n"


def truth_sentence(one: OneFlight) -> str:
    """Return a sentence on the hidden effect and the score of the diagnosis."""
    values = ", ".join(f"{local} {value:.5g}" for local, value in one.flown.values.items())
    hidden = (
        f"{one.flown.name} ({values}; SI), {one.flown.size:.0f} sigmas"
        if one.flown.name
        else "nothing"
    )
    return (
        f"flight {one.task.number}: hidden was {hidden}; the loop says {one.marked.standing.value}"
    )


def write_one(one: OneFlight, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write the diagnosis, the files of the loop, and ``truth.json`` (last); return the folder."""
    write_diagnosis(one.tracing, folder, figures=figures)
    with study_folder(folder, "truth.json") as scratch:
        write_hidden(one.flown, scratch)
        write_json(scratch / "truth.json", truth_content(one))
    return Path(folder)


def truth_content(one: OneFlight) -> dict[str, Any]:
    """Content of ``truth.json``."""
    flown, true = one.flown, one.flown.carrier.train.model.parameters
    return {
        "schema": "flightid/truth/1",
        "number": one.task.number,
        "seed": one.task.seed,
        "parameters": {
            name: {"value": true[name].value, "unit": true[name].unit}
            for name in flown.carrier.free
        },
        "effects": [flown.name] if flown.name else [],
        "hidden": {flown.name: dict(flown.values)} if flown.name else {},
        "size_sigmas": flown.size,
        "noise_std": dict(flown.carrier.noise),
        "standing": one.marked.standing.value,
    }
