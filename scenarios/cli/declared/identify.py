"""`flightid identify`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.completion import METHOD_NAMES, methods
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


def identify(
    records: Records,
    model: Model,
    vehicle: VehicleBeside = None,
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
    method: Annotated[str, typer.Option("--method", metavar="METHOD", autocompletion=methods, help=f"{', '.join(METHOD_NAMES)}.")] = "output-error",
    validate: Annotated[
        list[Path] | None, typer.Option("--validate", metavar="RECORD...", help="Predict these records with what was estimated from the others.")
    ] = None,
    profile: Annotated[
        list[str] | None, typer.Option("--profile", metavar="NAME...", help="Profile-likelihood intervals of these parameters; all: of every one.")
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option("--band", metavar="LOW HIGH", help="Hz, for frequency-domain; else from the inputs' power.")
    ] = None,
    engine: Annotated[
        str | None,
        typer.Option("--engine", metavar="ENGINE", help="Of the extended Kalman filter: filterpy or batched; same result."),
    ] = None,
    aircraft_class: Class = None,
    category: Category = None,
    matrices: Annotated[
        Path | None, typer.Option("--state-space", metavar="FILE", help="Write A, B, C, D about trim with names: .json, .mat or .npz.")
    ] = None,
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Parameters of a model from measured records."""
    from scenarios.cli.telling import telling
    from scenarios.commands.identify import identify_records, options_of

    plan = plan_of(start, stop, hold, rate, lowpass, trusted=trust, columns=columns)
    plan = with_maneuvers(plan, records, maneuver, maneuvers)
    request = Request(
        tuple(records), model, vehicle, tuple(validate or ()), channels=channels, plan=plan, aircraft_class=aircraft_class, flight_phase=category
    )
    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=["comparison.json"]) as told:
        identify_records(request, method, told.out, told.figures, options_of(profile, band, engine), matrices)
