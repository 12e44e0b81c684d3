"""`flightid predict`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import AsJson, Channels, ClockRate, Columns, Figures, From, ManeuverFile, Maneuvers, NoFigures, Out, Quiet, To, Trust
from scenarios.plots.formats import formats_of
from scenarios.preparation.maneuver_file import with_maneuvers
from scenarios.preparation.plan import plan_of


def predict(
    study: Annotated[Path, typer.Argument(metavar="STUDY", help="Folder that identify, diagnose or a run of trace-* wrote.")],
    record: Annotated[Path, typer.Argument(metavar="RECORD", help="Record of the same vehicle, from any recorder.")],
    channels: Channels = None,
    columns: Columns = None,
    start: From = None,
    stop: To = None,
    maneuver: Maneuvers = None,
    maneuvers: ManeuverFile = None,
    rate: ClockRate = None,
    trust: Trust = False,
    model: Annotated[Path | None, typer.Option("--model", metavar="FILE.py", help="The study's own model, which is run.")] = None,
    effects: Annotated[Path | None, typer.Option("--effects", metavar="FILE", help="The study's own effects, which are run.")] = None,
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """The model of a study on another record: initial states and biases alone are fitted."""
    from scenarios.cli.telling import telling
    from scenarios.commands.arguments import one_segment
    from scenarios.commands.predict import predict_with_study
    from scenarios.prediction.predict import Asked

    plan = plan_of(start, stop, rate=rate, trusted=trust, columns=columns)
    plan = one_segment(with_maneuvers(plan, [record], maneuver, maneuvers))
    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=["prediction.json"]) as told:
        predict_with_study(Asked(study, record, channels, plan, model, effects), told.out, told.figures)
