"""`flightid response`."""

from __future__ import annotations

from typing import Annotated

import typer

from scenarios.cli.completion import of
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
)
from scenarios.plots.formats import formats_of
from scenarios.preparation.maneuver_file import with_maneuvers
from scenarios.preparation.plan import plan_of
from scenarios.preparation.request import Request

Inputs = Annotated[
    list[str] | None,
    typer.Option("--input", metavar="A", help="A column or channel; again for inputs that move together."),
]
Outputs = Annotated[
    list[str] | None,
    typer.Option("--output", metavar="B", help="A column or channel; again for each."),
]
References = Annotated[
    list[str] | None,
    typer.Option(
        "--reference",
        metavar="R",
        help="With feedback: an excitation that the noise does not reach; one for each input.",
    ),
]
Windows = Annotated[
    list[float] | None,
    typer.Option("--window", metavar="S", help="Length of a window, s; again for each. Else four."),
]
Tapers = Annotated[int, typer.Option("--tapers", min=0, metavar="N", help="N sine tapers instead of windows.")]
Band = Annotated[
    tuple[float, float] | None,
    typer.Option("--band", metavar="LOW HIGH", help="Hz; else from the inputs' power."),
]
Fit = Annotated[
    list[str] | None,
    typer.Option(
        "--fit",
        metavar="[OUTPUT=]FORM",
        help="Fit pitch, roll, dutch-roll, roll-and-dutch-roll, or orders such as 1/2.",
    ),
]
Fix = Annotated[
    list[str] | None,
    typer.Option("--fix", metavar="NAME=VALUE", help="Hold a parameter of the form; again for each."),
]
Shared = Annotated[bool, typer.Option("--shared-poles", help="One denominator for all responses.")]
Bandwidth = Annotated[
    str | None,
    typer.Option(
        "--bandwidth",
        metavar="KIND",
        autocompletion=of("rate", "attitude"),
        help="Bandwidth and phase delay of outputs that are a rate or an attitude.",
    ),
]
Margins = Annotated[
    str | None,
    typer.Option(
        "--margins",
        metavar="SIGN",
        autocompletion=of("minus", "plus"),
        help="Stability margins of a loop whose output returns into the input with this sign.",
    ),
]
Levels = Annotated[
    str | None,
    typer.Option(
        "--levels",
        metavar="CLASS-CATEGORY",
        help="Levels of fitted forms: class I, II-C, II-L, III, IV and flight phase A, B, C, as in IV-A.",
    ),
]
Airspeed = Annotated[float | None, typer.Option("--airspeed", metavar="V", help="m/s; n/alpha and CAP of a fitted pitch rate.")]
Coherence = Annotated[float, typer.Option("--coherence", metavar="C", help="Least coherence of the usable band.")]


def response(
    records: Records,
    inputs: Inputs = None,
    outputs: Outputs = None,
    references: References = None,
    channels: Channels = None,
    columns: Columns = None,
    start: From = None,
    stop: To = None,
    maneuver: Maneuvers = None,
    maneuvers: ManeuverFile = None,
    hold: Held = None,
    rate: Rate = None,
    lowpass: Lowpass = None,
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
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Frequency responses of any record: magnitude, phase, coherence and their errors."""
    from scenarios.cli.telling import telling
    from scenarios.commands.response import respond

    plan = plan_of(start, stop, hold, rate, lowpass, columns=columns)
    plan = with_maneuvers(plan, records, maneuver, maneuvers)
    request = Request(tuple(records), channels=channels, plan=plan)
    with telling(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=["responses.json"],
    ) as told:
        respond(
            request,
            (tuple(inputs or ()), tuple(outputs or ()), tuple(references or ())),
            (band, tuple(window or ()), tapers, coherence),
            (tuple(fit or ()), tuple(fix or ()), shared_poles),
            bandwidth,
            margins,
            (levels, airspeed),
            told.out,
            told.figures,
        )
