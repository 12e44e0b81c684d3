"""`flightid campaign`."""

from __future__ import annotations

from typing import Annotated

import typer

from scenarios.cli.options import Changes, Duration, Figures, Inputs, NoFigures, Noise, Out, OwnModel, SampleRate, Scenario, Seed, TrueValues
from scenarios.plots.formats import formats_of


def campaign(
    runs: Annotated[int, typer.Option("--runs", min=2, metavar="N", help="Number of runs, each with a seed of its own.")],
    name: Scenario = None,
    seed: Seed = None,
    out: Out = None,
    changes: Changes = None,
    model: OwnModel = None,
    vehicle: TrueValues = None,
    inputs: Inputs = None,
    noise: Noise = None,
    duration: Duration = None,
    rate: SampleRate = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    method: Annotated[str | None, typer.Option("--method", metavar="NAME", help="One of the scenario's further methods; else its main one.")] = None,
) -> None:
    """Monte Carlo: bias, scatter against reported sigma, coverage."""
    from scenarios.commands.arguments import scenario_or_own
    from scenarios.commands.campaign import own_campaign, refuse_method, run_campaign

    what = scenario_or_own(name, model, vehicle, inputs, noise, None, duration, rate)
    if isinstance(what, str):
        run_campaign(what, runs, seed, out, changes or [], method, formats_of(figures, no_figures))
    else:
        refuse_method(method)
        own_campaign(what, runs, seed, out, changes or [], formats_of(figures, no_figures))
