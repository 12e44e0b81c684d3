"""`flightid compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import AsJson, Figures, NoFigures, Quiet
from scenarios.plots.formats import formats_of


def compare(
    studies: Annotated[list[str], typer.Argument(metavar="STUDY...", help="Study folders; FOLDER:METHOD is a further method of one.")],
    every: Annotated[bool, typer.Option("--methods", help="All methods of each study, not its main one alone.")] = False,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Write tables and figures into this folder.")] = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Studies side by side: estimates, errors, published values and responses, from their folders alone."""
    from scenarios.cli.telling import telling
    from scenarios.commands.compare import compare_studies

    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=["compared.json"]) as told:
        compare_studies(studies, told.out, every, told.figures)
