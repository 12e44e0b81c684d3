"""`flightid design`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import AsJson, Figures, Model, NoFigures, Out, Quiet
from scenarios.plots.formats import formats_of


def design(
    model: Model,
    vehicle: Annotated[Path | None, typer.Option("--vehicle", metavar="V.toml", help="Constants and derivatives as far as they are known.")] = None,
    limits: Annotated[
        Path | None,
        typer.Option("--limits", metavar="L.toml", help="nz_max, alpha_max, elevator_amplitude, elevator_rate and the like; else usual ones."),
    ] = None,
    tell: Annotated[str, typer.Option("--tell", metavar="EFFECT,EFFECT", help="Effects that are to be told apart.")] = "",
    size: Annotated[
        str, typer.Option("--size", metavar="KEY=VALUE,...", help="Of the first effect; typical, or found: what one 3-2-1-1 just shows.")
    ] = "typical",
    values: Annotated[list[str] | None, typer.Option("--value", metavar="NAME=VALUE,...", help="Derivatives known better than in the file.")] = None,
    noise: Annotated[list[str] | None, typer.Option("--noise", metavar="OUTPUT=SIZE,...", help="Measured outputs, standard deviations.")] = None,
    amplitude: Annotated[list[str] | None, typer.Option("--amplitude", metavar="INPUT=SIZE,...", help="Largest deflections from trim.")] = None,
    duration: Annotated[float | None, typer.Option("--duration", metavar="S", help="Length of the record, s.")] = None,
    rate: Annotated[float | None, typer.Option("--rate", metavar="HZ", help="Samples a second.")] = None,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option("--band", metavar="LOW HIGH", help="Hz: a sweep and multisines for frequency responses, with the coherence to expect."),
    ] = None,
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Before flying: which maneuver determines the derivatives best, or tells effects apart."""
    from scenarios.cli.telling import telling
    from scenarios.commands.planning.design import design_maneuver
    from scenarios.maneuver_design.asked import Asked

    names = tuple(name.strip() for name in tell.split(",") if name.strip())
    asked = Asked(model, vehicle, limits, names, size, tuple(values or ()), tuple(noise or ()), tuple(amplitude or ()), duration, rate, band)
    with telling(out, formats_of(figures, no_figures), quiet=quiet, as_json=as_json, documents=["design.json"]) as told:
        design_maneuver(asked, told.out, told.figures, progress=told.progress)
