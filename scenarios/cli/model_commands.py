"""Commands on model structure and on models that leave the tool: their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import (
    AsJson,
    Channels,
    Columns,
    Figures,
    From,
    Held,
    Lowpass,
    ManeuverFile,
    Maneuvers,
    NoFigures,
    Out,
    Quiet,
    Rate,
    Records,
    To,
    VehicleOption,
    of,
)
from scenarios.preparation.maneuver_file import with_maneuvers
from scenarios.preparation.plan import Request, plan_of
from scenarios.report.figure_formats import formats_of

METHOD_WORDS = ("stepwise", "orthogonal")
TARGETS = ("python", "fmu", "jsbsim")

# ---- flightid structure


def structure(
    records: Records,
    vehicle: VehicleOption = None,
    channels: Channels = None,
    columns: Columns = None,
    start: From = None,
    stop: To = None,
    maneuver: Maneuvers = None,
    maneuvers: ManeuverFile = None,
    hold: Held = None,
    rate: Rate = None,
    lowpass: Lowpass = None,
    method: Annotated[
        str,
        typer.Option(
            "--method",
            metavar="METHOD",
            autocompletion=of(*METHOD_WORDS),
            help="stepwise regression, or orthogonal functions.",
        ),
    ] = "stepwise",
    degree: Annotated[
        int, typer.Option("--degree", metavar="N", help="Of the products of signals offered.")
    ] = 2,
    splines: Annotated[
        int,
        typer.Option(
            "--splines",
            metavar="N",
            help="Offer splines with N knots in alpha.",
        ),
    ] = 0,
    terms: Annotated[
        Path | None,
        typer.Option("--terms", metavar="FILE", help="The terms offered, by coefficient."),
    ] = None,
    baseline: Annotated[
        bool,
        typer.Option("--baseline", help="Find increments to the terms of the vehicle file."),
    ] = False,
    bandwidth: Annotated[
        float, typer.Option("--bandwidth", metavar="HZ", help="Of the angular accelerations.")
    ] = 3.0,
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Which terms of the aerodynamic coefficients the records support; a vehicle file of them.

    Stepwise regression or orthogonal functions; collinear terms are told with the maneuver that
    would separate them.
    """
    from scenarios.cli.options import output_options
    from scenarios.commands.structure import find_structure
    from scenarios.structure.study import StructureOptions

    plan = plan_of(start, stop, hold, rate, lowpass, columns=columns)
    plan = with_maneuvers(plan, records, maneuver, maneuvers)
    request = Request(tuple(records), vehicle=vehicle, channels=channels, plan=plan)
    options = StructureOptions(method, bandwidth, degree, splines, terms, baseline)
    with output_options(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=["structure.json"],
    ) as told:
        find_structure(request, options, told.out, told.figures)


# ---- flightid export


def export(
    study: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY",
            help="Folder that identify or diagnose wrote, or a vehicle file of model aircraft.",
        ),
    ],
    to: Annotated[
        str,
        typer.Option(
            "--to",
            metavar="TARGET",
            autocompletion=of(*TARGETS),
            help=f"{', '.join(TARGETS)}.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            help="The file; else one named after the vehicle, in this folder.",
        ),
    ] = None,
    model: Annotated[
        Path | None,
        typer.Option("--model", metavar="FILE.py", help="The study's own model, which is run."),
    ] = None,
) -> None:
    """The model of a study for another program: a Python module, an FMU, a JSBSim file.

    SI and radians, with the values found and the starting states of the first record.
    """
    from scenarios.commands.structure import export_model

    export_model(study, to, out, model)
