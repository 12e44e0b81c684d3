"""`flightid simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import Changes, Duration, Inputs, Noise, OwnModel, Quiet, SampleRate, Scenario, Seed, TrueValues


def simulate(
    out: Annotated[Path, typer.Option("--out", metavar="RECORD.csv", help="The file to write.")],
    name: Scenario = None,
    seed: Seed = None,
    changes: Changes = None,
    model: OwnModel = None,
    vehicle: TrueValues = None,
    inputs: Inputs = None,
    noise: Noise = None,
    hidden: Annotated[
        list[str] | None, typer.Option("--hide", metavar="EFFECT.KEY=VALUE", help="With --model: an effect that acts and is not told.")
    ] = None,
    duration: Duration = None,
    rate: SampleRate = None,
    quiet: Quiet = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the names of the files as JSON, and nothing else.")] = False,
) -> None:
    """The record of a scenario alone, or of a flight of a model of your own."""
    from scenarios.cli.telling import telling
    from scenarios.commands.arguments import scenario_or_own
    from scenarios.commands.run import files_text
    from scenarios.commands.run import simulate as simulate_what

    what = scenario_or_own(name, model, vehicle, inputs, noise, hidden, duration, rate)
    with telling(None, (), quiet=quiet or as_json, as_json=False):
        files = simulate_what(what, out, seed, changes or [])
    if as_json:
        print(files_text(files))
