"""`flightid run`."""

from __future__ import annotations

from typing import Annotated

import typer

from scenarios.cli.options import Changes, Figures, NoFigures, Out, Seed
from scenarios.plots.formats import formats_of


def run(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Scenarios of the catalogue, or paths of scenario files.")],
    seed: Seed = None,
    out: Out = None,
    changes: Changes = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    compare: Annotated[bool, typer.Option("--compare", help="Then put the studies side by side, as compare does.")] = False,
) -> None:
    """Simulate, identify and compare: true, estimated, published."""
    from scenarios.commands.run import run_and_compare, run_scenarios

    (run_and_compare if compare else run_scenarios)(names, seed, out, changes or [], formats_of(figures, no_figures))
