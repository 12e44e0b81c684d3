"""The application: its commands in the order and the groups in which the help lists them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

import typer

from scenarios.cli.declared.campaign import campaign
from scenarios.cli.declared.check import check
from scenarios.cli.declared.compare import compare
from scenarios.cli.declared.design import design
from scenarios.cli.declared.diagnose import diagnose
from scenarios.cli.declared.identify import identify
from scenarios.cli.declared.lab import lab
from scenarios.cli.declared.libraries import effects, list_, models, vehicles
from scenarios.cli.declared.maneuvers import maneuvers
from scenarios.cli.declared.map import map_
from scenarios.cli.declared.predict import predict
from scenarios.cli.declared.report import report
from scenarios.cli.declared.response import response
from scenarios.cli.declared.run import run
from scenarios.cli.declared.simulate import simulate
from scenarios.cli.declared.survey import survey
from scenarios.cli.declared.watch import watch
from scenarios.cli.helping import GroupedCommands, WithExamples

# The commands by group: a further one is a file in `declared` and its name here.
COMMANDS: Mapping[str, tuple[Callable[..., Any], ...]] = {
    "Studies": (run, compare, simulate, campaign, design, report),
    "Measured data": (map_, maneuvers, response, identify, diagnose, predict, check, survey, watch),
    "Libraries": (list_, models, vehicles, effects),
    "Teaching": (lab,),
}


def _version(wanted: bool) -> None:
    if wanted:
        from scenarios.cli.version import show_version

        show_version()
        raise typer.Exit


def options(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_version, help="Show the version, and those of Python, NumPy and SciPy.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show a traceback when something fails.")] = False,
) -> None:
    """Simulate a flight vehicle, identify it from its record, and trace what the model lacks."""


def _application() -> typer.Typer:
    app = typer.Typer(
        name="flightid",
        help="Simulate a flight vehicle, identify it from its record, and trace what the model lacks.",
        cls=GroupedCommands,
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(options)
    for group, functions in COMMANDS.items():
        for function in functions:
            app.command(function.__name__.rstrip("_"), cls=WithExamples, rich_help_panel=group)(function)
    return app


app = _application()
