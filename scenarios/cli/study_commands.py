"""Commands of simulated studies, libraries and labs: their options."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli import options
from scenarios.cli.options import (
    AsJson,
    Changes,
    Cluster,
    Duration,
    Figures,
    Inputs,
    Jobs,
    Model,
    NoFigures,
    Noise,
    Out,
    OwnModel,
    Quiet,
    Resume,
    SampleRate,
    Scenario,
    Seed,
    TimeLimit,
    TrueValues,
    scenarios,
)
from scenarios.report.figure_formats import formats_of
from sim.errors import DeclarationError

# ---- flightid run


def run(
    names: Annotated[
        list[str],
        typer.Argument(
            metavar="NAME...",
            autocompletion=scenarios,
            help="Scenarios of the catalogue, or paths of scenario files.",
        ),
    ],
    seed: Seed = None,
    out: Out = None,
    changes: Changes = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    compare: Annotated[
        bool, typer.Option("--compare", help="Then put the studies side by side, as compare does.")
    ] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Simulate, identify and compare: true, estimated, published."""
    from scenarios.cli.options import output_options
    from scenarios.commands.studies import documents_of, run_and_compare, run_scenarios

    work = run_and_compare if compare else run_scenarios
    with output_options(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=documents_of(names, compare),
    ) as told:
        work(names, seed, told.out, changes or [], told.figures, progress=told.progress)


# ---- flightid simulate


def simulate(
    out: Annotated[Path, typer.Option("--out", metavar="RECORD.csv", help="The file to write.")],
    name: Scenario = None,
    seed: Seed = None,
    changes: Changes = None,
    model: OwnModel = None,
    vehicle: TrueValues = None,
    inputs: Inputs = None,
    noise: Noise = None,
    hidden: Annotated[
        list[str] | None,
        typer.Option(
            "--hide",
            metavar="EFFECT.KEY=VALUE",
            help="With --model: an effect that acts and is not told.",
        ),
    ] = None,
    duration: Duration = None,
    rate: SampleRate = None,
    quiet: Quiet = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the names of the files as JSON, and nothing else.")
    ] = False,
) -> None:
    """The record of a scenario alone, or of a flight of a model of your own."""
    from scenarios.cli.options import output_options
    from scenarios.commands.failures import scenario_or_own
    from scenarios.commands.studies import files_text
    from scenarios.commands.studies import simulate as simulate_what

    what = scenario_or_own(name, model, vehicle, inputs, noise, hidden, duration, rate)
    with output_options(None, (), quiet=quiet or as_json, as_json=False):
        files = simulate_what(what, out, seed, changes or [])
    if as_json:
        print(files_text(files))


# ---- flightid campaign


def campaign(
    name: Scenario = None,
    runs: Annotated[
        int | None,
        typer.Option(
            "--runs", min=2, metavar="N", help="Number of runs, each with a seed of its own."
        ),
    ] = None,
    seed: Seed = None,
    out: Out = None,
    changes: Changes = None,
    model: OwnModel = None,
    vehicle: TrueValues = None,
    inputs: Inputs = None,
    noise: Noise = None,
    duration: Duration = None,
    rate: SampleRate = None,
    method: Annotated[
        str | None,
        typer.Option(
            "--method",
            metavar="NAME",
            help="One of the scenario's further methods; else its main one.",
        ),
    ] = None,
    noise_levels: Annotated[
        bool,
        typer.Option(
            "--noise-levels",
            help=(
                "Also find the noise levels by likelihood, which is done anyway where a sigma is "
                "wrong."
            ),
        ),
    ] = False,
    jobs: Jobs = None,
    resume: Resume = False,
    cluster: Cluster = None,
    time_limit: TimeLimit = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Monte Carlo: bias, scatter against reported sigma, coverage."""
    from scenarios.cli.options import output_options
    from scenarios.commands.failures import scenario_or_own
    from scenarios.commands.studies import own_campaign, refuse_method, run_campaign
    from scenarios.tasks.study import Execution

    what = scenario_or_own(name, model, vehicle, inputs, noise, None, duration, rate)
    if runs is None:
        raise DeclarationError(
            "no number of runs is given", where="--runs", remedy="give two or more"
        )
    formats, documents = formats_of(figures, no_figures), ["campaign.json"]
    with output_options(out, formats, quiet=quiet, as_json=as_json, documents=documents) as told:
        run = partial(
            run_campaign if isinstance(what, str) else own_campaign,
            runs=runs,
            seed=seed,
            manner=Execution(jobs, told.out, resume, cluster, time_limit),
            changes=changes or [],
            figures=told.figures,
            levels=noise_levels,
            progress=told.progress,
        )
        if isinstance(what, str):
            run(what, method=method)
        else:
            refuse_method(method)
            run(what)


# ---- flightid compare


def compare(
    studies: Annotated[
        list[str],
        typer.Argument(
            metavar="STUDY...", help="Study folders; FOLDER:METHOD is a further method of one."
        ),
    ],
    every: Annotated[
        bool, typer.Option("--methods", help="All methods of each study, not its main one alone.")
    ] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="DIR", help="Write tables and figures into this folder."),
    ] = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Studies side by side: estimates, errors, published values and responses, from their folders
    alone.
    """
    from scenarios.cli.options import output_options
    from scenarios.commands.studies import compare_studies

    with output_options(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=["compared.json"],
    ) as told:
        compare_studies(studies, told.out, every, told.figures)


# ---- flightid design


def design(
    model: Model,
    vehicle: Annotated[
        Path | None,
        typer.Option(
            "--vehicle",
            metavar="V.toml",
            help="Constants and derivatives as far as they are known.",
        ),
    ] = None,
    limits: Annotated[
        Path | None,
        typer.Option(
            "--limits",
            metavar="L.toml",
            help=(
                "nz_max, alpha_max, elevator_amplitude, elevator_rate and the like; else usual "
                "ones."
            ),
        ),
    ] = None,
    tell: Annotated[
        str,
        typer.Option("--tell", metavar="EFFECT,EFFECT", help="Effects that are to be told apart."),
    ] = "",
    size: Annotated[
        str,
        typer.Option(
            "--size",
            metavar="KEY=VALUE,...",
            help="Of the first effect; typical, or found: what one 3-2-1-1 just shows.",
        ),
    ] = "typical",
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--value", metavar="NAME=VALUE,...", help="Derivatives known better than in the file."
        ),
    ] = None,
    noise: Annotated[
        list[str] | None,
        typer.Option(
            "--noise", metavar="OUTPUT=SIZE,...", help="Measured outputs, standard deviations."
        ),
    ] = None,
    amplitude: Annotated[
        list[str] | None,
        typer.Option(
            "--amplitude", metavar="INPUT=SIZE,...", help="Largest deflections from trim."
        ),
    ] = None,
    duration: Annotated[
        float | None, typer.Option("--duration", metavar="S", help="Length of the record, s.")
    ] = None,
    rate: Annotated[
        float | None, typer.Option("--rate", metavar="HZ", help="Samples a second.")
    ] = None,
    band: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--band",
            metavar="LOW HIGH",
            help=(
                "Hz: a sweep and multisines for frequency responses, with the coherence to expect."
            ),
        ),
    ] = None,
    computer: Annotated[
        bool,
        typer.Option(
            "--computer",
            help="A flight computer moves the controls: multisines, quick steps, wide bands.",
        ),
    ] = False,
    out: Out = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Before flying: which maneuver determines the derivatives best, or tells effects apart."""
    from scenarios.cli.options import output_options
    from scenarios.commands.studies import design_maneuver
    from scenarios.maneuver_design.setting import DesignRequest

    names = tuple(name.strip() for name in tell.split(",") if name.strip())
    asked = DesignRequest(
        model,
        vehicle,
        limits,
        names,
        size,
        tuple(values or ()),
        tuple(noise or ()),
        tuple(amplitude or ()),
        duration,
        rate,
        band,
        computer,
    )
    with output_options(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=["design.json"],
    ) as told:
        design_maneuver(asked, told.out, told.figures, progress=told.progress)


# ---- flightid report


def report(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Folders that --out was given.")
    ],
    tables: Annotated[
        bool,
        typer.Option("--tables", help="Write its tables as Markdown, LaTeX and XLSX as well."),
    ] = False,
    pdf: Annotated[
        bool, typer.Option("--pdf", help="Print it as report.pdf as well, by Chromium or Chrome.")
    ] = False,
) -> None:
    """The page of a study again, from its folder, without computing anything; its tables, a PDF."""
    from scenarios.commands.studies import rebuild_pages

    rebuild_pages(folders, tables=tables, pdf=pdf)


# ---- flightid list, effects, models and vehicles: what there is


def list_(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME",
            autocompletion=options.scenarios,
            help="Print this scenario's file, to copy and edit.",
        ),
    ] = None,
) -> None:
    """Scenarios, one line each; with a name, that scenario's file."""
    from scenarios.commands.libraries import list_scenarios, show_scenario

    if name is None:
        list_scenarios()
    else:
        show_scenario(name)


def effects(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", autocompletion=options.effects, help="One effect, explained."
        ),
    ] = None,
) -> None:
    """The library of effects."""
    from scenarios.commands.libraries import show_effects

    show_effects(name)


def models(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME|FILE",
            autocompletion=options.models,
            help="One model, or a file with one of your own, which is run.",
        ),
    ] = None,
    example: Annotated[
        bool,
        typer.Option("--example", help="Print the file of a model of one's own, to copy and edit."),
    ] = False,
) -> None:
    """The models: states, inputs, outputs, parameters, and the effects that may act on them."""
    from scenarios.commands.libraries import show_example, show_models

    if example:
        show_example(name)
    else:
        show_models(name)


def vehicles(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", autocompletion=options.vehicles, help="One vehicle, number by number."
        ),
    ] = None,
    other: Annotated[
        str | None,
        typer.Option(
            "--diff",
            metavar="OTHER",
            autocompletion=options.vehicles,
            help="What differs from another vehicle.",
        ),
    ] = None,
) -> None:
    """The library of vehicles, every number with unit and origin."""
    from scenarios.commands.libraries import show_vehicles

    show_vehicles(name, other)


# ---- flightid lab


def lab(
    number: Annotated[
        int | None,
        typer.Argument(metavar="N", help="Number of the lab; all are listed when left out."),
    ] = None,
    edit: Annotated[
        bool, typer.Option("--edit", help="Open a copy of your own in the editor, not as a page.")
    ] = False,
    copy: Annotated[
        Path | None,
        typer.Option("--copy", metavar="DIR", help="Write a copy of your own into this folder."),
    ] = None,
    key: Annotated[bool, typer.Option("--key", help="Print the instructor's key.")] = False,
    port: Annotated[
        int | None,
        typer.Option(
            "--port", min=1, max=65535, metavar="P", help="Port on this machine; else a free one."
        ),
    ] = None,
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open it in a browser.")
    ] = True,
) -> None:
    """A teaching notebook, opened in a browser."""
    from scenarios.commands.libraries import copy_lab, list_labs, open_lab, show_key

    if number is None:
        list_labs()
    elif key:
        show_key(number)
    elif copy is not None and not edit:
        copy_lab(number, copy)
    else:
        raise SystemExit(open_lab(number, edit, port, browser, copy))
