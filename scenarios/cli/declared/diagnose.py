"""`flightid diagnose`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.completion import of
from scenarios.cli.options import (
    AsJson,
    Category,
    Channels,
    Class,
    Columns,
    Figures,
    From,
    Held,
    Lowpass,
    ManeuverFile,
    Maneuvers,
    Model,
    NoFigures,
    Out,
    Quiet,
    Rate,
    Records,
    To,
    Trust,
    VehicleBeside,
)
from scenarios.plots.formats import formats_of
from scenarios.preparation.maneuver_file import with_maneuvers
from scenarios.preparation.plan import plan_of
from scenarios.preparation.request import Request


def diagnose(
    records: Records,
    model: Model,
    vehicle: VehicleBeside = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option("--validate", metavar="RECORD...", help="Predict these records; else the last of several, or the last part of one."),
    ] = None,
    effects: Annotated[Path | None, typer.Option("--effects", metavar="FILE", help="Python file with effects of your own; it is run.")] = None,
    channels: Channels = None,
    columns: Columns = None,
    start: From = None,
    stop: To = None,
    maneuver: Maneuvers = None,
    maneuvers: ManeuverFile = None,
    hold: Held = None,
    rate: Rate = None,
    lowpass: Lowpass = None,
    trust: Trust = False,
    effort: Annotated[
        str, typer.Option("--effort", metavar="E", autocompletion=of("normal", "thorough"), help="How far the search looks: normal, thorough.")
    ] = "normal",
    aircraft_class: Class = None,
    category: Category = None,
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Trace what the model lacks: fit, find the residual's cause, add it, refit, compare before and after."""
    from scenarios.cli.telling import telling
    from scenarios.commands.diagnose import diagnose_records

    plan = plan_of(start, stop, hold, rate, lowpass, trusted=trust, columns=columns)
    plan = with_maneuvers(plan, records, maneuver, maneuvers)
    request = Request(tuple(records), model, vehicle, tuple(validate or ()), effects, channels, plan, effort, aircraft_class, category)
    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=["diagnosis.json"]) as told:
        diagnose_records(request, told.out, told.figures, progress=told.progress)
