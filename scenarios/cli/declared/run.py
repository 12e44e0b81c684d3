"""`flightid run`."""

from __future__ import annotations

from typing import Annotated

import typer

from scenarios.cli.completion import scenarios
from scenarios.cli.options import AsJson, Changes, Figures, NoFigures, Out, Quiet, Seed
from scenarios.plots.formats import formats_of


def run(
    names: Annotated[
        list[str], typer.Argument(metavar="NAME...", autocompletion=scenarios, help="Scenarios of the catalogue, or paths of scenario files.")
    ],
    seed: Seed = None,
    out: Out = None,
    changes: Changes = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    compare: Annotated[bool, typer.Option("--compare", help="Then put the studies side by side, as compare does.")] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Simulate, identify and compare: true, estimated, published."""
    from scenarios.cli.telling import telling
    from scenarios.commands.run import documents_of, run_and_compare, run_scenarios

    work = run_and_compare if compare else run_scenarios
    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=documents_of(names, compare)) as told:
        work(names, seed, told.out, changes or [], told.figures, progress=told.progress)
