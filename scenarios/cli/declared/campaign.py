"""`flightid campaign`."""

from __future__ import annotations

from typing import Annotated

import typer

from scenarios.cli.completion import campaigns
from scenarios.cli.options import (
    AsJson,
    Changes,
    Cluster,
    Duration,
    Figures,
    Inputs,
    Jobs,
    NoFigures,
    Noise,
    Out,
    OwnModel,
    Quiet,
    Resume,
    SampleRate,
    Seed,
    TimeLimit,
    TrueValues,
)
from scenarios.plots.formats import formats_of
from scenarios.trials.names import LOOP


def campaign(
    runs: Annotated[int, typer.Option("--runs", min=2, metavar="N", help="Number of runs, each with a seed of its own.")],
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", autocompletion=campaigns, help="A scenario, or a campaign of the loop itself: " + ", ".join(LOOP) + "."),
    ] = None,
    seed: Seed = None,
    out: Out = None,
    changes: Changes = None,
    model: OwnModel = None,
    vehicle: TrueValues = None,
    inputs: Inputs = None,
    noise: Noise = None,
    duration: Duration = None,
    rate: SampleRate = None,
    method: Annotated[str | None, typer.Option("--method", metavar="NAME", help="One of the scenario's further methods; else its main one.")] = None,
    jobs: Jobs = None,
    resume: Resume = False,
    cluster: Cluster = None,
    time_limit: TimeLimit = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Monte Carlo: bias, scatter against reported sigma, coverage."""
    from scenarios.cli.telling import telling
    from scenarios.commands.arguments import scenario_or_own
    from scenarios.commands.campaign import own_campaign, refuse_method, run_campaign
    from scenarios.tasks.manner import Manner

    what = scenario_or_own(name, model, vehicle, inputs, noise, None, duration, rate)
    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=["campaign.json"]) as told:
        manner = Manner(jobs, told.out, resume, cluster, time_limit)
        if isinstance(what, str):
            run_campaign(what, runs, seed, manner, changes or [], method, told.figures, progress=told.progress)
        else:
            refuse_method(method)
            own_campaign(what, runs, seed, manner, changes or [], told.figures, progress=told.progress)
