"""Commands on models of measured flights: identify, diagnose, predict, export, survey, watch."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from scenarios.cli import options
from scenarios.cli.options import (
    METHOD_NAMES,
    AsJson,
    Category,
    Channels,
    Class,
    ClockRate,
    Cluster,
    Columns,
    Figures,
    From,
    Held,
    ManeuverFile,
    Maneuvers,
    Model,
    NoFigures,
    Out,
    Output,
    Preparation,
    Quiet,
    Records,
    StudyModel,
    To,
    Trust,
    VehicleOption,
    fixed_words,
    flag,
    methods,
    valued,
    with_groups,
)
from scenarios.preparation.plan import Request, plan_of, with_maneuvers
from sim.errors import DeclarationError

# Shares of the work, in the progress bar, that are done when the writing of a study begins.
WRITING_SURVEY_SHARE, WRITING_DIAGNOSIS_SHARE = 0.98, 0.97

# ---- flightid identify


@with_groups
def identify(
    records: Records,
    model: Model,
    *,
    vehicle: VehicleOption = None,
    preparation: Preparation,
    trust: Trust = False,
    method: Annotated[
        str, valued("--method", "METHOD", f"{', '.join(METHOD_NAMES)}.", complete=methods)
    ] = "output-error",
    validate: Annotated[
        list[Path] | None,
        valued(
            "--validate",
            "RECORD...",
            "Predict these records with the parameters estimated from the others.",
        ),
    ] = None,
    profile: Annotated[
        list[str] | None,
        valued(
            "--profile",
            "NAME...",
            "Profile-likelihood intervals of these parameters; all for every parameter.",
        ),
    ] = None,
    band: Annotated[
        tuple[float, float] | None,
        valued("--band", "LOW HIGH", "Hz, for frequency-domain; else from the inputs' power."),
    ] = None,
    engine: Annotated[
        str | None,
        valued("--engine", "ENGINE", "Extended Kalman filter by filterpy or batched; same result."),
    ] = None,
    aircraft_class: Class = None,
    category: Category = None,
    matrices: Annotated[
        Path | None,
        valued(
            "--state-space", "FILE", "Write A, B, C, D about trim with names: .json, .mat or .npz."
        ),
    ] = None,
    output: Output,
) -> None:
    """Parameters of a model from measured records."""
    from scenarios.identification.assessment import Options
    from scenarios.identification.files import (
        refuse_place,
        state_space_of,
        write_identification,
        write_state_space,
    )
    from scenarios.identification.identify import identify_files
    from scenarios.identification.report import print_identification

    plan = preparation.plan(records, trusted=trust)
    request = Request(
        tuple(records),
        model,
        vehicle,
        tuple(validate or ()),
        channels=preparation.channels,
        plan=plan,
        aircraft_class=aircraft_class,
        flight_phase=category,
    )
    with output.writing("comparison.json") as target:
        if matrices is not None:
            refuse_place(matrices, _files_of(request, target.out))
        identified = identify_files(request, method, Options(_profiled(profile), band, engine))
        state_space = state_space_of(identified.found) if matrices is not None else None

        def show(details: str) -> None:
            print_identification(identified.found, identified.flown, details=details)
            if matrices is not None and state_space is not None:
                write_state_space(state_space, matrices)
                print(f"matrices written to {matrices}")

        target.finish(identified, write_identification, show)


def _profiled(names: list[str] | None) -> tuple[str, ...] | None:
    """Return the parameters to profile; empty for all, None for none."""
    if names is None:
        return None
    return () if "all" in names else tuple(dict.fromkeys(names))


def _files_of(request: Request, out: Path | None) -> list[Path]:
    """Return the files that an identification reads, and the main ones that it writes."""
    from scenarios.files.measured.columns import path_of

    paths = [path_of(each) for each in (*request.records, *request.validate)]
    written = [] if out is None else [out / "comparison.json", out / "record.csv"]
    return [*(path for path in paths if path is not None), *written]


# ---- flightid diagnose


@with_groups
def diagnose(
    records: Records,
    model: Model,
    *,
    vehicle: VehicleOption = None,
    validate: Annotated[
        list[Path] | None,
        valued(
            "--validate",
            "RECORD...",
            "Predict these records; else the last of several, or the last part of one.",
        ),
    ] = None,
    effects: Annotated[
        Path | None, valued("--effects", "FILE", "Python file with effects of your own; it is run.")
    ] = None,
    preparation: Preparation,
    trust: Trust = False,
    effort: Annotated[
        str,
        valued(
            "--effort",
            "E",
            "How far the search looks: normal, thorough.",
            complete=fixed_words("normal", "thorough"),
        ),
    ] = "normal",
    aircraft_class: Class = None,
    category: Category = None,
    output: Output,
) -> None:
    """Trace what the model lacks: fit, find the residual's cause, add it, refit, compare before and
    after.
    """
    from scenarios.report.summary import details_in, terminal_width
    from scenarios.report.terminal import progress_bar

    plan = preparation.plan(records, trusted=trust)
    request = Request(
        tuple(records),
        model,
        vehicle,
        tuple(validate or ()),
        effects,
        preparation.channels,
        plan,
        effort,
        aircraft_class,
        category,
    )
    with output.writing("diagnosis.json") as target:
        with progress_bar(target.progress, counted=False) as show_progress:
            from scenarios.diagnosis.diagnose import diagnose_files

            tracing = diagnose_files(request, show_progress)
            if target.out is not None:
                from scenarios.diagnosis.files import write_diagnosis

                show_progress("writing the study", WRITING_DIAGNOSIS_SHARE)
                write_diagnosis(tracing, target.out, figures=target.figures)
        from scenarios.diagnosis.text import diagnosis_text

        print(diagnosis_text(tracing, terminal_width(), details_in(target.out)))
        target.print_place()


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
    model: StudyModel = None,
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
    """Prediction of another record by the model of a study, with fixed parameters."""
    from scenarios.prediction import (
        PredictionRequest,
        predict_record,
        prediction_text,
        write_prediction,
    )
    from scenarios.report.summary import terminal_width

    plan = plan_of(start, stop, rate=rate, trusted=trust, columns=columns)
    plan = with_maneuvers(plan, [record], maneuver, maneuvers)
    if len(plan.segments) > 1:
        raise DeclarationError(
            "a prediction is of one part of a record",
            where="--from, --to, --maneuver",
            remedy="give each of them once",
        )
    request = PredictionRequest(study, record, channels, plan, model, effects, tolerances)
    with output.writing("prediction.json") as target:
        found = predict_record(request)

        def show(details: str) -> None:
            print(prediction_text(found, terminal_width()), end="")

        target.finish(found, write_prediction, show)


# ---- flightid export


def export(
    study: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY",
            help="Folder of identify, diagnose or structure, or a vehicle file of model aircraft.",
        ),
    ],
    to: Annotated[
        str, valued("--to", "TARGET", options.TO_HELP, complete=fixed_words(*options.TARGETS))
    ],
    out: Annotated[
        Path | None,
        valued("--out", "FILE", "The file; else one named after the vehicle, in this folder."),
    ] = None,
    model: StudyModel = None,
) -> None:
    """The model of a study for another program: Python module, FMU, JSBSim or DAVE-ML file.

    Units are SI and radians. The file has the estimated values and the initial states of the first
    record. jsbsim and dave-ml take only the model aircraft, python and fmu take any model.
    """
    from scenarios.export.targets import written_model

    path, exported, description = written_model(study, to, out, model)
    print(f"{path}: {exported.model} model of {exported.name}, {description}")
    for remark in exported.remarks:
        print(f"note: {remark}")


# ---- Example of a survey file

# The example names the two records and the vehicle file that
# `flightid simulate trace-vane --out flight.csv` writes, so it can be run without changes.
EXAMPLE = """\
title = "two flights of a bomber"
model = "rigid"                    # as --model
vehicle = "flight_vehicle.toml"    # common to all flights; paths are relative to this file
# channels = "map.toml"            # likewise columns, from, to, maneuver, maneuvers, hold, rate, lowpass, effort, effects
# records = "flights/*.csv"        # each file is a flight without further entries

[[flights]]
record = "flight.csv"              # or records = ["a.csv", "b.csv"]: several maneuvers of one flight
name = "F001"                      # else the file's name
date = 2026-03-02
tail = "A-1"
condition = {altitude = "1500 m"}  # quantities over which derivatives are compared

[[flights]]
record = "flight_validate.csv"
name = "F002"
date = 2026-03-03
tail = "A-1"
vehicle = {mass = "2.9e5 kg"}      # replaces the value in the vehicle file
condition = {altitude = "1500 m"}
"""  # noqa: E501


# ---- flightid survey


def survey(
    flights: Annotated[
        Path | None,
        typer.Argument(
            metavar="FLIGHTS.toml",
            help="Model, vehicle, and the records with their flight conditions.",
        ),
    ] = None,
    example: Annotated[bool, flag("--example", "Print such a file, to copy and edit.")] = False,
    out: Out = None,
    jobs: Annotated[
        int | None, valued("--jobs", "N", "Processes; all cores when left out.", min=1)
    ] = None,
    cluster: Cluster = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Many flights of one aircraft: a diagnosis of each, and effects that recur; a folder that
    grows.
    """
    if example:
        print(EXAMPLE, end="")
        return
    if flights is None:
        raise DeclarationError(
            "no file is named",
            where="FLIGHTS.toml",
            remedy="flightid survey --example prints one to edit",
        )
    from scenarios.report.summary import details_in, terminal_width
    from scenarios.report.terminal import progress_bar
    from scenarios.survey.report import survey_text
    from scenarios.survey.survey import survey_flights
    from scenarios.tasks.processes import available_cores

    output = Output(out, figures, no_figures, quiet, as_json)
    with (
        output.writing("survey.json") as target,
        TemporaryDirectory(prefix="flightid-") as temporary,
    ):
        with progress_bar(target.progress) as show_progress:
            try:
                found = survey_flights(
                    flights,
                    target.out or Path(temporary) / "survey",
                    jobs or available_cores(),
                    target.figures if target.out is not None else (),
                    show_progress,
                    cluster,
                )
            except KeyboardInterrupt as interrupt:
                if target.out is not None:
                    raise
                raise KeyboardInterrupt("nothing is kept without --out") from interrupt
            if target.out is not None:
                from scenarios.survey.files import write_survey

                show_progress("writing the survey", WRITING_SURVEY_SHARE)
                write_survey(found, target.out, figures=target.figures)
        print(survey_text(found, terminal_width(), details_in(target.out)), end="")
        target.print_place()


# ---- flightid watch


def _refuse_mixed_watch(model: str | None, margins: str | None, signals: list[str]) -> None:
    """Raise DeclarationError unless either a model or a loop, with its signals, is named."""
    if model is None and margins is None:
        remedy = "name one, or the loop whose margins are wanted with --margins"
        raise DeclarationError("there is no model", where="--model", remedy=remedy)
    if model is not None and margins is not None:
        remedy = "leave one of them out"
        raise DeclarationError("a model and a loop", where="--model, --margins", remedy=remedy)
    if margins is None and signals:
        what = f"{signals[0]} is named without a loop"
        raise DeclarationError(what, where="--input, --output", remedy="add --margins minus")


WatchRecord = Annotated[
    str, typer.Argument(metavar="RECORD|-", help="A CSV file that grows, or - for standard input.")
]
WatchModel = Annotated[
    str | None,
    valued(
        "--model",
        "M",
        "loes, rigid, lateral, longitudinal, or your own model file.",
        complete=fixed_words("loes", "rigid", "lateral", "longitudinal"),
    ),
]
WatchVehicle = Annotated[
    Path | None, valued("--vehicle", "V.toml", "Constants and starting values.")
]
WatchMargins = Annotated[
    str | None,
    valued(
        "--margins",
        "SIGN",
        "Instead of a model: margins of the loop of --input, --output, --excitation.",
        complete=fixed_words("minus", "plus"),
    ),
]
WatchInputs = Annotated[
    list[str] | None, valued("--input", "A", "With --margins: the command after the sum.")
]
WatchOutputs = Annotated[
    list[str] | None, valued("--output", "B", "With --margins: the signal that returns.")
]
WatchExcitation = Annotated[
    str | None, valued("--excitation", "R", "With --margins: the signal added at the sum.")
]
WatchReference = Annotated[
    Path | None,
    valued(
        "--reference",
        "STUDY",
        "A study to compare with; without --vehicle the filter starts from it.",
    ),
]
WatchRate = Annotated[
    float | None, valued("--rate", "HZ", "Rows a second of a stream without a clock.")
]
WatchIdle = Annotated[
    float | None,
    valued(
        "--idle", "S", "End after so many seconds without a row; a file: 5, a pipe: never.", min=0.0
    ),
]
WatchUntilEnd = Annotated[bool, flag("--until-end", "Do not wait for the file to grow.")]
WatchRefine = Annotated[
    bool, typer.Option(help="Linearise again during the stream, and fit all rows again at its end.")
]
WatchPage = Annotated[
    bool, flag("--page", "Serve a page of the stream to the browser of this machine, until Ctrl-C.")
]
WatchPort = Annotated[
    int | None,
    valued("--port", "N", "The page's port; without it 8040 or a free one.", min=1, max=65535),
]
WatchBand = Annotated[
    tuple[float, float] | None,
    valued(
        "--band",
        "LOW HIGH",
        "Hz, of the regression in the frequency domain: 0.1 2; of margins: 0.2 10.",
    ),
]


def watch(
    record: WatchRecord,
    model: WatchModel = None,
    vehicle: WatchVehicle = None,
    margins: WatchMargins = None,
    inputs: WatchInputs = None,
    outputs: WatchOutputs = None,
    excitation: WatchExcitation = None,
    reference: WatchReference = None,
    channels: Channels = None,
    columns: Columns = None,
    rate: WatchRate = None,
    out: Out = None,
    idle: WatchIdle = None,
    until_end: WatchUntilEnd = False,
    refine: WatchRefine = True,
    page: WatchPage = False,
    port: WatchPort = None,
    band: WatchBand = None,
    hold: Held = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identification of a stream: rows as they arrive, estimates against a reference."""
    from scenarios.cli.watch import watch_loop, watch_stream
    from scenarios.watching.loop_margins import MAIN, loop_names

    plan = plan_of(rate=rate, columns=columns, hold=hold)
    signals = [*(inputs or ()), *(outputs or ())]
    if excitation:
        signals.append(excitation)
    _refuse_mixed_watch(model, margins, signals)
    output = Output(out, figures, no_figures, quiet, as_json)
    if margins is not None:
        names = loop_names(margins, inputs or (), outputs or (), excitation)
        with output.writing(MAIN) as target:
            stream = (target.out, idle, until_end, page, port, plan, band, target.figures)
            watch_loop(record, names, channels, *stream)
        return
    assert model is not None
    with output.writing("comparison.json") as target:
        stream_end = (target.out, idle, until_end, refine, page, port, plan, band, target.figures)
        watch_stream(record, model, vehicle, reference, channels, *stream_end)
