"""Commands on simulated studies, maneuver design, pages, libraries and labs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    Output,
    OwnModel,
    Quiet,
    Resume,
    SampleRate,
    Scenario,
    Seed,
    TimeLimit,
    TrueValues,
    flag,
    scenarios,
    valued,
    with_groups,
)
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.trials.own_flight import OwnFlight

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
        bool, flag("--compare", "Then put the studies side by side, as compare does.")
    ] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Simulate, identify and compare: true, estimated, published."""
    from scenarios.cli.studies import documents_of, run_and_compare, run_scenarios

    command = run_and_compare if compare else run_scenarios
    output = Output(out, figures, no_figures, quiet, as_json)
    with output.writing(*documents_of(names, compare)) as target:
        command(names, seed, target.out, changes or [], target.figures, progress=target.progress)


def scenario_or_own(
    name: str | None,
    model: str | None,
    vehicle: Path | None,
    inputs: Sequence[str] | None,
    noise: Sequence[str] | None,
    hidden: Sequence[str] | None,
    duration: float | None,
    rate: float | None,
) -> str | OwnFlight:
    """Return the flight to simulate: the name of a scenario, or a flight of a user's model.

    Parameters
    ----------
    name : name of a scenario.
    model : file of a user's model; the other parameters describe its flight.

    Raises
    ------
    DeclarationError : name and model are both given or both missing, or an option is given that
        only ``--model`` takes.
    """
    if model is None:
        given = {
            "--vehicle": vehicle,
            "--input": inputs,
            "--noise": noise,
            "--hide": hidden,
            "--duration": duration,
            "--rate": rate,
        }
        if name is None:
            raise DeclarationError(
                "nothing is named",
                where="flightid",
                remedy="name a scenario (flightid list), or --model FILE.py",
            )
        for option, value in given.items():
            if value is not None:
                remedy = "change an entry of a scenario with --set, for example flight.rate=50"
                raise DeclarationError(
                    "this goes with --model FILE.py", where=option, remedy=remedy
                )
        return name
    if name is not None:
        raise DeclarationError(
            f"a scenario is named as well, {name!r}",
            where="--model",
            remedy="leave one of the two out",
        )
    from scenarios.trials.own_flight import OwnFlight

    return OwnFlight(
        model, vehicle, tuple(inputs or ()), tuple(noise or ()), tuple(hidden or ()), duration, rate
    )


# ---- flightid simulate


def simulate(
    out: Annotated[Path, valued("--out", "RECORD.csv", "The file to write.")],
    name: Scenario = None,
    seed: Seed = None,
    changes: Changes = None,
    model: OwnModel = None,
    vehicle: TrueValues = None,
    inputs: Inputs = None,
    noise: Noise = None,
    hidden: Annotated[
        list[str] | None,
        valued("--hide", "EFFECT.KEY=VALUE", "With --model: an effect that no file names."),
    ] = None,
    duration: Duration = None,
    rate: SampleRate = None,
    quiet: Quiet = False,
    as_json: Annotated[
        bool, flag("--json", "Print the names of the files as JSON, and nothing else.")
    ] = False,
) -> None:
    """The record of a scenario alone, or of a flight of a model of your own."""
    from scenarios.cli.studies import files_text
    from scenarios.cli.studies import simulate as write_records

    flight = scenario_or_own(name, model, vehicle, inputs, noise, hidden, duration, rate)
    with Output(no_figures=True, quiet=quiet or as_json).writing():
        files = write_records(flight, out, seed, changes or [])
    if as_json:
        print(files_text(files))


# ---- flightid campaign


def campaign(
    name: Scenario = None,
    runs: Annotated[
        int | None, valued("--runs", "N", "Number of runs, each with a seed of its own.", min=2)
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
        valued("--method", "NAME", "One of the scenario's further methods; else its main one."),
    ] = None,
    noise_levels: Annotated[
        bool, flag("--noise-levels", "Estimate noise levels even if no sigma is wrong.")
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
    from scenarios.cli.studies import run_campaign
    from scenarios.tasks.study import Execution

    flight = scenario_or_own(name, model, vehicle, inputs, noise, None, duration, rate)
    if runs is None:
        raise DeclarationError(
            "no number of runs is given", where="--runs", remedy="give two or more"
        )
    output = Output(out, figures, no_figures, quiet, as_json)
    with output.writing("campaign.json") as target:
        run_campaign(
            flight,
            runs,
            seed,
            Execution(jobs, target.out, resume, cluster, time_limit),
            changes or [],
            method,
            target.figures,
            levels=noise_levels,
            progress=target.progress,
        )


# ---- flightid compare


def compare(
    studies: Annotated[
        list[str],
        typer.Argument(
            metavar="STUDY...", help="Study folders; FOLDER:METHOD is a further method of one."
        ),
    ],
    every: Annotated[
        bool, flag("--methods", "All methods of each study, not its main one alone.")
    ] = False,
    out: Annotated[
        Path | None, valued("--out", "DIR", "Write tables and figures into this folder.")
    ] = None,
    figures: Figures = None,
    no_figures: NoFigures = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Studies side by side: estimates, errors, published values and responses, from their folders
    alone.
    """
    from scenarios.cli.studies import compare_studies

    output = Output(out, figures, no_figures, quiet, as_json)
    with output.writing("compared.json") as target:
        compare_studies(studies, target.out, every, target.figures)


# ---- flightid design


DesignVehicle = Annotated[
    Path | None,
    valued("--vehicle", "V.toml", "Constants and derivatives as far as they are known."),
]
DesignLimits = Annotated[
    Path | None,
    valued(
        "--limits",
        "L.toml",
        "nz_max, alpha_max, elevator_amplitude, elevator_rate and the like; else usual ones.",
    ),
]
DesignTell = Annotated[str, valued("--tell", "EFFECT,EFFECT", "Effects that are to be told apart.")]
DesignSize = Annotated[
    str,
    valued(
        "--size",
        "KEY=VALUE,...",
        "Size of the first effect: values, typical, or found (what one 3-2-1-1 just shows).",
    ),
]
DesignValues = Annotated[
    list[str] | None,
    valued("--value", "NAME=VALUE,...", "Derivatives known better than in the file."),
]
DesignNoise = Annotated[
    list[str] | None, valued("--noise", "OUTPUT=SIZE,...", "Measured outputs, standard deviations.")
]
DesignAmplitude = Annotated[
    list[str] | None, valued("--amplitude", "INPUT=SIZE,...", "Largest deflections from trim.")
]
DesignDuration = Annotated[float | None, valued("--duration", "S", "Length of the record, s.")]
DesignRate = Annotated[float | None, valued("--rate", "HZ", "Samples a second.")]
DesignBand = Annotated[
    tuple[float, float] | None,
    valued(
        "--band",
        "LOW HIGH",
        "Hz: a sweep and multisines for frequency responses, with the coherence to expect.",
    ),
]
DesignComputer = Annotated[
    bool,
    flag(
        "--computer", "A flight computer moves the controls: multisines, quick steps, wide bands."
    ),
]


@with_groups
def design(
    model: Model,
    *,
    vehicle: DesignVehicle = None,
    limits: DesignLimits = None,
    tell: DesignTell = "",
    size: DesignSize = "typical",
    values: DesignValues = None,
    noise: DesignNoise = None,
    amplitude: DesignAmplitude = None,
    duration: DesignDuration = None,
    rate: DesignRate = None,
    band: DesignBand = None,
    computer: DesignComputer = False,
    output: Output,
) -> None:
    """Before flying: which maneuver determines the derivatives best, or tells effects apart."""
    from scenarios.maneuver_design.design import design as design_maneuver
    from scenarios.maneuver_design.report import design_text, write_design
    from scenarios.maneuver_design.setting import DesignRequest
    from scenarios.report.summary import details_in, terminal_width
    from scenarios.report.terminal import progress_bar

    names = tuple(name.strip() for name in tell.split(",") if name.strip())
    request = DesignRequest(
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
    with output.writing("design.json") as target:
        with progress_bar(target.progress) as show_progress:
            result = design_maneuver(request, show_progress)
            if target.out is not None:
                write_design(result, target.out, figures=target.figures)
        print(design_text(result, terminal_width(), details_in(target.out)), end="")
        target.print_place()


# ---- flightid report


def report(
    folders: Annotated[
        list[Path], typer.Argument(metavar="DIR...", help="Study folders, as --out wrote them.")
    ],
    tables: Annotated[
        bool, flag("--tables", "Write its tables as Markdown, LaTeX and XLSX as well.")
    ] = False,
    pdf: Annotated[
        bool, flag("--pdf", "Print it as report.pdf as well, by Chromium or Chrome.")
    ] = False,
    paper: options.Paper = None,
) -> None:
    """The page of a study again, from its folder, without computing anything; its tables, a PDF."""
    from scenarios.report.folder import rebuilt, stored_page, write_pdf, write_tables

    if paper is not None and not pdf:
        raise DeclarationError("there is no PDF", where="--paper", remedy="add --pdf")
    for folder in folders:
        print(f"written to {rebuilt(folder)}")
        if tables:
            print(f"tables: {', '.join(map(str, write_tables(stored_page(folder), folder)))}")
        if pdf:
            print(f"PDF: {write_pdf(folder, (paper or 'a4').lower())}")


# ---- flightid list, effects, models and vehicles


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
    from scenarios.studies.catalogue import scenario_names, scenario_text, scenario_title

    if name is not None:
        print(scenario_text(name), end="")  # unchanged, for ``flightid list rigid > mine.toml``
        return
    names = scenario_names()
    width = max(map(len, names))
    for each in names:
        print(f"{each:{width}}  {scenario_title(each)}")


def effects(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", autocompletion=options.effects, help="One effect, explained."
        ),
    ] = None,
) -> None:
    """The library of effects."""
    from scenarios.cli.libraries import show_effects

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
        bool, flag("--example", "Print the file of a model of one's own, to copy and edit.")
    ] = False,
) -> None:
    """The models: states, inputs, outputs, parameters, and the effects that may act on them."""
    from scenarios.cli.libraries import show_example, show_models

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
        valued("--diff", "OTHER", "What differs from another vehicle.", complete=options.vehicles),
    ] = None,
) -> None:
    """The library of vehicles, every number with unit and origin."""
    from scenarios.cli.libraries import show_vehicles

    show_vehicles(name, other)


# ---- flightid lab


def lab(
    number: Annotated[
        int | None,
        typer.Argument(metavar="N", help="Number of the lab; all are listed when left out."),
    ] = None,
    edit: Annotated[
        bool, flag("--edit", "Open a copy of your own in the editor, not as a page.")
    ] = False,
    copy: Annotated[
        Path | None, valued("--copy", "DIR", "Write a copy of your own into this folder.")
    ] = None,
    key: Annotated[bool, flag("--key", "Print the instructor's key.")] = False,
    port: Annotated[
        int | None,
        valued("--port", "P", "Port on this machine; else a free one.", min=1, max=65535),
    ] = None,
    browser: Annotated[bool, flag("--browser/--no-browser", "Open it in a browser.")] = True,
) -> None:
    """A teaching notebook, opened in a browser."""
    from scenarios.cli.libraries import copy_lab, list_labs, open_lab, show_key

    if number is None:
        list_labs()
    elif key:
        show_key(number)
    elif copy is not None and not edit:
        copy_lab(number, copy)
    else:
        raise SystemExit(open_lab(number, edit, port, browser, copy))
