"""The folder of a design: the best maneuver to fly, all of them, what is expected, a figure, a page, and the JSON last."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from pathlib import Path

from scenarios.files.channel_names import TIME
from scenarios.files.writing import study_folder, write_json, write_record, write_text
from scenarios.maneuver_design.content import design_content
from scenarios.maneuver_design.design import Design, Maneuver
from scenarios.maneuver_design.figure import design_figures
from scenarios.maneuver_design.page import design_page
from scenarios.pages.folder import write_page
from scenarios.plots.formats import USUAL, Drawn, Formats
from sim.record import Record

MAIN = "design.json"
FLOWN = "maneuver"  # stem of the input to be flown
EXPECTED = "expected"


def write_design(design: Design, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write ``maneuver.csv`` (the best), ``maneuver_KIND.csv`` of each kind, ``expected.csv``, figures, the page, ``design.json``; the folder.

    The CSV have ``time`` and the inputs in SI, held between samples, as the JSON beside each says; of a model of totals the trim is in them.
    """
    with study_folder(folder, MAIN) as scratch:
        write_maneuver(scratch, design.best, FLOWN)
        for each in design.maneuvers:
            write_maneuver(scratch, each, f"{FLOWN}_{each.kind}")
        write_text(scratch / f"{EXPECTED}.csv", _expected(design))
        drawn: tuple[Drawn, ...] = ()
        if figures:
            from scenarios.plots.drawing import drawn_for_page

            drawn = drawn_for_page(design_figures(design), scratch, figures)
        write_page(scratch, design_page(design, drawn))
        write_json(scratch / MAIN, design_content(design))
    return Path(folder)


def input_of(maneuver: Maneuver) -> Record:
    """The maneuver alone, as a record without outputs."""
    return replace(maneuver.flight.planned.record, outputs=(), name=f"{maneuver.kind}, designed")


def write_maneuver(folder: Path, maneuver: Maneuver, stem: str = FLOWN) -> None:
    """Write the inputs of a maneuver as ``stem.csv`` and what they mean as ``stem.json``."""
    write_record(folder, input_of(maneuver), stem, simulated=True)


def _expected(design: Design) -> str:
    """Outputs that the model has in the best maneuver, beside its inputs; load factors of perturbations without the weight, as a fit has them."""
    flight = design.best.flight
    columns = {TIME: design.setting.room.time, **{channel.name: channel.values for channel in flight.planned.record.inputs}}
    columns |= dict(zip(flight.motion.system.output_names, flight.motion.fit.lines[0].y, strict=True))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([f"{value:.9g}" for value in row] for row in zip(*columns.values(), strict=True))
    return text.getvalue()
