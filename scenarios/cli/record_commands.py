"""Commands that examine measured records: map, maneuvers, response, check, structure."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import (
    METHOD_WORDS,
    Channels,
    ClockRate,
    Columns,
    Output,
    Preparation,
    Records,
    Trust,
    VehicleOption,
    fixed_words,
    flag,
    valued,
    with_groups,
)
from scenarios.preparation.plan import Request, plan_of

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
    from scenarios.preparation.draft_text import draft_map

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
    from scenarios.files.declarations import read_channel_map
    from scenarios.maneuvers import maneuvers_of, print_maneuvers, write_maneuvers

    plan = plan_of(rate=rate, columns=columns)
    with output.writing("maneuvers.json") as target:
        choices = read_channel_map(channels, surfaces=True) if channels is not None else None
        found = maneuvers_of(record, choices, plan)
        target.finish(found, write_maneuvers, partial(print_maneuvers, found))


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
    from scenarios.responses.analysis import ResponseOptions, responses_of
    from scenarios.responses.fitting import FitOptions, ModelOptions
    from scenarios.responses.qualities import LevelOptions, pilot_demand
    from scenarios.responses.reading import Names
    from scenarios.responses.report import print_responses, write_responses

    plan = preparation.plan(records)
    with output.writing("responses.json") as target:
        found = responses_of(
            Request(tuple(records), channels=preparation.channels, plan=plan),
            Names(tuple(inputs or ()), tuple(outputs or ()), tuple(references or ())),
            ResponseOptions(band, tuple(window or ()), tapers, coherence),
            FitOptions(tuple(fit or ()), tuple(fix or ()), shared_poles),
            bandwidth,
            margins,
            LevelOptions(levels, airspeed),
            pilot_demand(pilot, pilot_delay),
            ModelOptions(model, vehicle),
        )
        target.finish(found, write_responses, partial(print_responses, found))


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
    from scenarios.compatibility import check_files
    from scenarios.compatibility_report import print_check, write_check

    plan = preparation.plan(records, trusted=trust)
    with output.writing("compatibility.json") as target:
        found = check_files(
            Request(tuple(records), vehicle=vehicle, channels=preparation.channels, plan=plan)
        )
        target.finish(found, write_check, partial(print_check, found))


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
            complete=fixed_words(*METHOD_WORDS),
        ),
    ] = "stepwise",
    degree: Annotated[int, valued("--degree", "N", "Degree of the products of signals.")] = 2,
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
    bandwidth: Annotated[float, valued("--bandwidth", "HZ", "For angular accelerations.")] = 3.0,
    output: Output,
) -> None:
    """Terms of the aerodynamic coefficients that the records support, and a vehicle file of them.

    Stepwise regression or orthogonal functions. Collinear terms are named with the maneuver that
    would separate them.
    """
    from scenarios.report.summary import terminal_width
    from scenarios.structure import StructureOptions, structure_of_files
    from scenarios.structure_report import structure_text, write_structure

    plan = preparation.plan(records)
    request = Request(
        tuple(records),
        vehicle=vehicle,
        validate=tuple(validate or ()),
        channels=preparation.channels,
        plan=plan,
    )
    options = StructureOptions(method, bandwidth, degree, splines, terms, baseline, hierarchical)
    with output.writing("structure.json") as target:
        found = structure_of_files(request, options)

        def show(details: str) -> None:
            print(structure_text(found, terminal_width(), details), end="")
            if target.out is not None:
                names = " ".join(map(str, records))
                channels = f"--channels {request.channels} " if request.channels else ""
                print(
                    f"refine: flightid identify {names} --model aircraft --vehicle "
                    f"{target.out / 'vehicle.toml'} {channels}--out FIT"
                )

        target.finish(found, write_structure, show)
