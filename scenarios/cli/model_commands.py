"""Commands on models of studies: structure, prediction, export; their options."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import (
    Channels,
    ClockRate,
    Columns,
    From,
    ManeuverFile,
    Maneuvers,
    Output,
    Preparation,
    Records,
    To,
    Trust,
    VehicleOption,
    flag,
    of,
    valued,
    with_groups,
)
from scenarios.preparation.plan import Request, plan_of, with_maneuvers

METHOD_WORDS = ("stepwise", "orthogonal")
TARGETS = ("python", "fmu", "jsbsim", "dave-ml")

# ---- flightid structure


@with_groups
def structure(
    records: Records,
    *,
    vehicle: VehicleOption = None,
    validate: Annotated[
        list[Path] | None,
        valued("--validate", "RECORD...", "Predict the coefficients of these records."),
    ] = None,
    preparation: Preparation,
    method: Annotated[
        str,
        valued(
            "--method",
            "METHOD",
            "stepwise regression, or orthogonal functions.",
            complete=of(*METHOD_WORDS),
        ),
    ] = "stepwise",
    degree: Annotated[int, valued("--degree", "N", "Of the products of signals offered.")] = 2,
    splines: Annotated[int, valued("--splines", "N", "Offer splines with N knots in alpha.")] = 0,
    terms: Annotated[
        Path | None, valued("--terms", "FILE", "The terms offered, by coefficient.")
    ] = None,
    baseline: Annotated[
        bool, flag("--baseline", "Find increments to the terms of the vehicle file.")
    ] = False,
    hierarchical: Annotated[
        bool, flag("--hierarchical", "Offer a product after the linear terms of its symmetry.")
    ] = False,
    bandwidth: Annotated[float, valued("--bandwidth", "HZ", "Of the angular accelerations.")] = 3.0,
    output: Output,
) -> None:
    """Which terms of the aerodynamic coefficients the records support; a vehicle file of them.

    Stepwise regression or orthogonal functions; collinear terms are told with the maneuver that
    would separate them.
    """
    from scenarios.commands.records import find_structure
    from scenarios.structure.study import StructureOptions

    plan = preparation.plan(records)
    request = Request(
        tuple(records),
        vehicle=vehicle,
        validate=tuple(validate or ()),
        channels=preparation.channels,
        plan=plan,
    )
    options = StructureOptions(method, bandwidth, degree, splines, terms, baseline, hierarchical)
    with output.of("structure.json") as told:
        find_structure(request, options, told.out, told.figures)


# ---- flightid predict


@with_groups
def predict(
    study: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY", help="Folder that identify, diagnose or a run of trace-* wrote."
        ),
    ],
    record: Annotated[
        Path,
        typer.Argument(metavar="RECORD", help="Record of the same vehicle, from any recorder."),
    ],
    *,
    channels: Channels = None,
    columns: Columns = None,
    start: From = None,
    stop: To = None,
    maneuver: Maneuvers = None,
    maneuvers: ManeuverFile = None,
    rate: ClockRate = None,
    trust: Trust = False,
    model: Annotated[
        Path | None, valued("--model", "FILE.py", "The study's own model, which is run.")
    ] = None,
    effects: Annotated[
        Path | None, valued("--effects", "FILE", "The study's own effects, which are run.")
    ] = None,
    tolerances: Annotated[
        str | None,
        valued(
            "--tolerances",
            "TEST,...",
            "Pass or fail in tests of simulator qualification, or in those of FILE.toml.",
        ),
    ] = None,
    output: Output,
) -> None:
    """The model of a study on another record: initial states and biases alone are fitted."""
    from scenarios.commands.failures import one_segment
    from scenarios.commands.records import predict_with_study
    from scenarios.prediction import PredictionRequest

    plan = plan_of(start, stop, rate=rate, trusted=trust, columns=columns)
    plan = one_segment(with_maneuvers(plan, [record], maneuver, maneuvers))
    with output.of("prediction.json") as told:
        predict_with_study(
            PredictionRequest(study, record, channels, plan, model, effects, tolerances),
            told.out,
            told.figures,
        )


# ---- flightid export


def export(
    study: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY",
            help="Folder that identify or diagnose wrote, or a vehicle file of model aircraft.",
        ),
    ],
    to: Annotated[str, valued("--to", "TARGET", f"{', '.join(TARGETS)}.", complete=of(*TARGETS))],
    out: Annotated[
        Path | None,
        valued("--out", "FILE", "The file; else one named after the vehicle, in this folder."),
    ] = None,
    model: Annotated[
        Path | None, valued("--model", "FILE.py", "The study's own model, which is run.")
    ] = None,
) -> None:
    """The model of a study for another program: a Python module, an FMU, a JSBSim
    file, a DAVE-ML file.

    SI and radians, with the values found and the starting states of the first record.
    """
    from scenarios.commands.records import export_model

    export_model(study, to, out, model)
