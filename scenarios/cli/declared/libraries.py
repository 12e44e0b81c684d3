"""`flightid list`, `effects`, `models` and `vehicles`: what there is."""

from __future__ import annotations

from typing import Annotated

import typer

from scenarios.cli import completion


def list_(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", autocompletion=completion.scenarios, help="Print this scenario's file, to copy and edit.")
    ] = None,
) -> None:
    """Scenarios, one line each; with a name, that scenario's file."""
    from scenarios.commands.libraries import list_scenarios, show_scenario

    if name is None:
        list_scenarios()
    else:
        show_scenario(name)


def effects(
    name: Annotated[str | None, typer.Argument(metavar="NAME", autocompletion=completion.effects, help="One effect, explained.")] = None,
) -> None:
    """The library of effects."""
    from scenarios.commands.libraries import show_effects

    show_effects(name)


def models(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME|FILE", autocompletion=completion.models, help="One model, or a file with one of your own, which is run."),
    ] = None,
    example: Annotated[bool, typer.Option("--example", help="Print the file of a model of one's own, to copy and edit.")] = False,
) -> None:
    """The models: states, inputs, outputs, parameters, and the effects that may act on them."""
    from scenarios.commands.models import show_example, show_models

    if example:
        show_example(name)
    else:
        show_models(name)


def vehicles(
    name: Annotated[str | None, typer.Argument(metavar="NAME", autocompletion=completion.vehicles, help="One vehicle, number by number.")] = None,
    other: Annotated[
        str | None, typer.Option("--diff", metavar="OTHER", autocompletion=completion.vehicles, help="What differs from another vehicle.")
    ] = None,
) -> None:
    """The library of vehicles, every number with unit and origin."""
    from scenarios.commands.libraries import show_vehicles

    show_vehicles(name, other)
