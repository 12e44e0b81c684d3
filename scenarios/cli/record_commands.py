"""Options of the commands on measured records."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
    Held,
    Model,
    NoFigures,
    Out,
    Output,
    Preparation,
    Quiet,
    Records,
    Trust,
    VehicleOption,
    fixed_words,
    flag,
    methods,
    valued,
    with_groups,
)
from scenarios.preparation.plan import Request, plan_of
from scenarios.report.figure_formats import formats_of
from sim.errors import DeclarationError

# ---- flightid map


def map_(
    record: Annotated[
        Path, typer.Argument(metavar="FILE", help="A recorder's file, in any format.")
    ],
    rate: ClockRate = None,
    columns: Columns = None,
    topics: Annotated[bool, flag("--topics", "Show every topic of a log.")] = False,
    out: Annotated[
        Path | None,
        valued("--out", "DIR", "Write channels.toml and vehicle.toml into this folder."),
    ] = None,
) -> None:
    """Content of a recorder's file, with drafts of the channel map and of the vehicle file."""
    from scenarios.commands.records import draft_map

    draft_map(record, out, rate, columns, topics)


# ---- flightid maneuvers


@with_groups
def maneuvers(
    record: Annotated[
        Path, typer.Argument(metavar="RECORD", help="A recorded flight of any length.")
    ],
    *,
    channels: Channels = None,
    columns: Columns = None,
    rate: ClockRate = None,
    output: Output,
) -> None:
    """The maneuvers in a long record: steps, doublets, 3-2-1-1, sweeps, multisines, pull-ups,
    turns, trim points.
    """
    from scenarios.commands.records import search_record

    plan = plan_of(rate=rate, columns=columns)
    with output.writing("maneuvers.json") as target:
        search_record(record, channels, plan, target.out, target.figures)


# ---- flightid response

Inputs = Annotated[
    list[str] | None,
    valued("--input", "A", "A column or channel; again for inputs that move together."),
]
Outputs = Annotated[
    list[str] | None, valued("--output", "B", "A column or channel; again for each.")
]
References = Annotated[
    list[str] | None,
    valued(
        "--reference",
        "R",
        "With feedback: an excitation that is independent of the noise; one for each input.",
    ),
]
Windows = Annotated[
    list[float] | None, valued("--window", "S", "Length of a window, s; again for each; else four.")
]
Tapers = Annotated[int, valued("--tapers", "N", "N sine tapers instead of windows.", min=0)]
Band = Annotated[
    tuple[float, float] | None, valued("--band", "LOW HIGH", "Hz; else from the inputs' power.")
]
Fit = Annotated[
    list[str] | None,
    valued(
        "--fit",
        "[OUTPUT=]FORM",
        "Fit pitch, roll, dutch-roll, roll-and-dutch-roll, or orders such as 1/2.",
    ),
]
Fix = Annotated[
    list[str] | None, valued("--fix", "NAME=VALUE", "Hold a parameter of the form; again for each.")
]
Shared = Annotated[bool, flag("--shared-poles", "One denominator for all responses.")]
Bandwidth = Annotated[
    str | None,
    valued(
        "--bandwidth",
        "KIND",
        "Bandwidth and phase delay of outputs that are a rate or an attitude.",
        complete=fixed_words("rate", "attitude"),
    ),
]
Margins = Annotated[
    str | None,
    valued(
        "--margins",
        "SIGN",
        "Stability margins of a loop whose output returns into the input with this sign.",
        complete=fixed_words("minus", "plus"),
    ),
]
Levels = Annotated[
    str | None,
    valued(
        "--levels",
        "CLASS-CATEGORY",
        "Levels of fitted forms: class I, II-C, II-L, III, IV and flight phase A, B, C, as in "
        "IV-A.",
    ),
]
Airspeed = Annotated[
    float | None, valued("--airspeed", "V", "m/s; n/alpha and CAP of a fitted pitch rate.")
]
PilotBandwidth = Annotated[
    float | None,
    valued(
        "--pilot",
        "RAD/S",
        "With --bandwidth: Neal and Smith's pilot at this closed-loop bandwidth, rad/s.",
    ),
]
FittedModel = Annotated[
    str | None,
    valued(
        "--model",
        "M",
        "Fit this linear model to all responses at once: built in, or your own file.",
        complete=fixed_words("rigid", "lateral", "longitudinal", "loes"),
    ),
]
ModelVehicle = Annotated[
    Path | None, valued("--vehicle", "V.toml", "Constants and starting values of --model.")
]
PilotDelay = Annotated[float | None, valued("--pilot-delay", "S", "Delay of that pilot, s: 0.25.")]
Coherence = Annotated[float, valued("--coherence", "C", "Least coherence of the usable band.")]


@with_groups
def response(
    records: Records,
    *,
    inputs: Inputs = None,
    outputs: Outputs = None,
    references: References = None,
    preparation: Preparation,
    band: Band = None,
    window: Windows = None,
    tapers: Tapers = 0,
    coherence: Coherence = 0.6,
    fit: Fit = None,
    fix: Fix = None,
    shared_poles: Shared = False,
    bandwidth: Bandwidth = None,
    margins: Margins = None,
    levels: Levels = None,
    airspeed: Airspeed = None,
    pilot: PilotBandwidth = None,
    pilot_delay: PilotDelay = None,
    model: FittedModel = None,
    vehicle: ModelVehicle = None,
    output: Output,
) -> None:
    """Frequency responses of any record: magnitude, phase, coherence and their errors."""
    from scenarios.commands.records import respond

    plan = preparation.plan(records)
    request = Request(tuple(records), channels=preparation.channels, plan=plan)
    with output.writing("responses.json") as target:
        respond(
            request,
            (tuple(inputs or ()), tuple(outputs or ()), tuple(references or ())),
            (band, tuple(window or ()), tapers, coherence),
            (tuple(fit or ()), tuple(fix or ()), shared_poles),
            bandwidth,
            margins,
            (levels, airspeed),
            target.out,
            target.figures,
            (pilot, pilot_delay),
            (model, vehicle),
        )


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
    from scenarios.commands.records import identify_records, options_of

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
        identify_records(
            request, method, target.out, target.figures, options_of(profile, band, engine), matrices
        )


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
    from scenarios.commands.records import diagnose_records

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
        diagnose_records(request, target.out, target.figures, progress=target.progress)


# ---- flightid check


@with_groups
def check(
    records: Records,
    *,
    vehicle: VehicleOption = None,
    preparation: Preparation,
    trust: Trust = False,
    output: Output,
) -> None:
    """Data compatibility: sensor errors that kinematics alone reveal."""
    from scenarios.commands.records import check_records

    plan = preparation.plan(records, trusted=trust)
    with output.writing("compatibility.json") as target:
        check_records(
            Request(tuple(records), vehicle=vehicle, channels=preparation.channels, plan=plan),
            target.out,
            target.figures,
        )


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
    from scenarios.cli.options import output_options
    from scenarios.commands.records import survey_records

    with output_options(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=["survey.json"],
    ) as target:
        survey_records(
            flights, target.out, jobs, target.figures, progress=target.progress, cluster=cluster
        )


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
    bool,
    typer.Option(help="Linearise again during the stream, and fit all rows again at its end."),
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
    from scenarios.cli.options import output_options
    from scenarios.commands.watch import watch_loop, watch_stream
    from scenarios.watching.loop_margins import MAIN, loop_names

    formats = formats_of(figures, no_figures)
    plan = plan_of(rate=rate, columns=columns, hold=hold)
    signals = [*(inputs or ()), *(outputs or ())]
    if excitation:
        signals.append(excitation)
    _refuse_mixed_watch(model, margins, signals)
    if margins is not None:
        names = loop_names(margins, inputs or (), outputs or (), excitation)
        with output_options(out, formats, quiet=quiet, as_json=as_json, documents=[MAIN]) as target:
            stream = (target.out, idle, until_end, page, port, plan, band, target.figures)
            watch_loop(record, names, channels, *stream)
        return
    assert model is not None
    with output_options(
        out, formats, quiet=quiet, as_json=as_json, documents=["comparison.json"]
    ) as target:
        stream_end = (target.out, idle, until_end, refine, page, port, plan, band, target.figures)
        watch_stream(record, model, vehicle, reference, channels, *stream_end)
