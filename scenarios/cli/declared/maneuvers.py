"""`flightid maneuvers`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import AsJson, Channels, ClockRate, Columns, Figures, NoFigures, Out, Quiet
from scenarios.plots.formats import formats_of
from scenarios.preparation.plan import plan_of


def maneuvers(
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="A recorded flight of any length.")],
    channels: Channels = None,
    columns: Columns = None,
    rate: ClockRate = None,
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """The maneuvers in a long record: steps, doublets, 3-2-1-1, sweeps, multisines, pull-ups, turns, trim points."""
    from scenarios.cli.telling import telling
    from scenarios.commands.maneuvers import search_record

    plan = plan_of(rate=rate, columns=columns)
    with telling(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=["maneuvers.json"],
    ) as told:
        search_record(record, channels, plan, told.out, told.figures)
