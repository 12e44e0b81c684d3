"""`flightid campaign`."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

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
    Scenario,
    Seed,
    TimeLimit,
    TrueValues,
)
from scenarios.plots.formats import formats_of
from sim.errors import DeclarationError


def campaign(
    name: Scenario = None,
    runs: Annotated[int | None, typer.Option("--runs", min=2, metavar="N", help="Number of runs, each with a seed of its own.")] = None,
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
    noise_levels: Annotated[
        bool, typer.Option("--noise-levels", help="Also find the noise levels by likelihood, which is done anyway where a sigma is wrong.")
    ] = False,
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
    if runs is None:
        raise DeclarationError("no number of runs is given", where="--runs", remedy="give two or more")
    formats, documents = formats_of(figures, no_figures), ["campaign.json"]
    with telling(out, formats, quiet=quiet, as_json=as_json, documents=documents) as told:
        run = partial(
            run_campaign if isinstance(what, str) else own_campaign,
            runs=runs,
            seed=seed,
            manner=Manner(jobs, told.out, resume, cluster, time_limit),
            changes=changes or [],
            figures=told.figures,
            levels=noise_levels,
            progress=told.progress,
        )
        if isinstance(what, str):
            run(what, method=method)
        else:
            refuse_method(method)
            run(what)
