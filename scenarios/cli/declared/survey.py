"""`flightid survey`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import AsJson, Cluster, Figures, NoFigures, Out, Quiet
from scenarios.plots.formats import formats_of
from sim.errors import DeclarationError


def survey(
    flights: Annotated[
        Path | None, typer.Argument(metavar="FLIGHTS.toml", help="Model, vehicle, and the records with what they were flown at.")
    ] = None,
    example: Annotated[bool, typer.Option("--example", help="Print such a file, to copy and edit.")] = False,
    out: Out = None,
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, metavar="N", help="Processes; all cores when left out.")] = None,
    cluster: Cluster = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Many flights of one aircraft: each diagnosed, then what recurs; a folder that grows."""
    if example:
        from scenarios.survey.example import EXAMPLE

        print(EXAMPLE, end="")
        return
    if flights is None:
        raise DeclarationError("no file is named", where="FLIGHTS.toml", remedy="flightid survey --example prints one to edit")
    from scenarios.cli.telling import telling
    from scenarios.commands.fleets.survey import survey_records

    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=["survey.json"]) as told:
        survey_records(flights, told.out, jobs, told.figures, progress=told.progress, cluster=cluster)
