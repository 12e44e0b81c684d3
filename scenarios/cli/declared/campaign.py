"""`flightid campaign`."""

from __future__ import annotations

from typing import Annotated

import typer

from scenarios.cli.completion import campaigns
from scenarios.cli.completion import effects as completed_effects
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
from sim.errors import DeclarationError


def campaign(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", autocompletion=campaigns, help="A scenario, or a campaign of the loop itself: " + ", ".join(LOOP) + "."),
    ] = None,
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
    effects: Annotated[
        str | None,
        typer.Option("--effects", metavar="EFFECT,...", autocompletion=completed_effects, help="Of every-effect: these alone."),
    ] = None,
    only: Annotated[int | None, typer.Option("--only", min=0, metavar="NUMBER", help="Of every-effect: one flight again.")] = None,
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
    from scenarios.commands.campaign import own_campaign, refuse_effects, refuse_method, run_campaign
    from scenarios.tasks.manner import Manner

    named = None if effects is None else [each.strip() for each in effects.split(",") if each.strip()]
    what = scenario_or_own(name, model, vehicle, inputs, noise, None, duration, rate)
    refuse_effects(name, named, only)
    if runs is None and only is None:
        raise DeclarationError("no number of runs is given", where="--runs", remedy="give two or more")
    document = "campaign.json" if only is None else "truth.json"
    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=[document]) as told:
        manner = Manner(jobs, told.out, resume, cluster, time_limit)
        if only is not None:
            from scenarios.commands.simulated.loop import one_of_every_effect

            one_of_every_effect(only, seed, named, manner, changes or [], told.figures, told.progress)
            return
        assert runs is not None
        if isinstance(what, str):
            run_campaign(what, runs, seed, manner, changes or [], method, told.figures, levels=noise_levels, progress=told.progress, effects=named)
        else:
            refuse_method(method)
            own_campaign(what, runs, seed, manner, changes or [], told.figures, levels=noise_levels, progress=told.progress)
