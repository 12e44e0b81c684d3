"""Options of the commands on simulated studies, libraries, labs and models of studies."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli import options
from scenarios.cli.options import (
    METHOD_WORDS,
    AsJson,
    Changes,
    Channels,
    ClockRate,
    Cluster,
    Columns,
    Duration,
    Figures,
    From,
    Inputs,
    Jobs,
    ManeuverFile,
    Maneuvers,
    Model,
    NoFigures,
    Noise,
    Out,
    Output,
    OwnModel,
    Preparation,
    Quiet,
    Records,
    Resume,
    SampleRate,
    Scenario,
    Seed,
    StudyModel,
    TimeLimit,
    To,
    TrueValues,
    Trust,
    VehicleOption,
    fixed_words,
    flag,
    scenarios,
    valued,
    with_groups,
)
from scenarios.preparation.plan import Request, plan_of, with_maneuvers
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
        bool, flag("--compare", "Then put the studies side by side, as compare does.")
    ] = False,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Simulate, identify and compare: true, estimated, published."""
    from scenarios.cli.options import output_options
    from scenarios.commands.studies import documents_of, run_and_compare, run_scenarios

    command = run_and_compare if compare else run_scenarios
    with output_options(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=documents_of(names, compare),
    ) as target:
        command(names, seed, target.out, changes or [], target.figures, progress=target.progress)


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
    from scenarios.cli.options import output_options
    from scenarios.commands.failures import scenario_or_own
    from scenarios.commands.studies import files_text
    from scenarios.commands.studies import simulate as write_records

    flight = scenario_or_own(name, model, vehicle, inputs, noise, hidden, duration, rate)
    with output_options(None, (), quiet=quiet or as_json, as_json=False):
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
    from scenarios.cli.options import output_options
    from scenarios.commands.failures import scenario_or_own
    from scenarios.commands.studies import own_campaign, refuse_method, run_campaign
    from scenarios.tasks.study import Execution

    flight = scenario_or_own(name, model, vehicle, inputs, noise, None, duration, rate)
    if runs is None:
        raise DeclarationError(
            "no number of runs is given", where="--runs", remedy="give two or more"
        )
    formats, documents = formats_of(figures, no_figures), ["campaign.json"]
    with output_options(out, formats, quiet=quiet, as_json=as_json, documents=documents) as target:
        run = partial(
            run_campaign if isinstance(flight, str) else own_campaign,
            runs=runs,
            seed=seed,
            execution=Execution(jobs, target.out, resume, cluster, time_limit),
            changes=changes or [],
            figures=target.figures,
            levels=noise_levels,
            progress=target.progress,
        )
        if isinstance(flight, str):
            run(flight, method=method)
        else:
            refuse_method(method)
            run(flight)


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
    from scenarios.cli.options import output_options
    from scenarios.commands.studies import compare_studies

    with output_options(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=["compared.json"],
    ) as target:
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


def design(
    model: Model,
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
    with output_options(
        out,
        formats_of(figures, no_figures),
        quiet=quiet,
        as_json=as_json,
        documents=["design.json"],
    ) as target:
        design_maneuver(request, target.out, target.figures, progress=target.progress)


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
    from scenarios.commands.studies import rebuild_pages

    if paper is not None and not pdf:
        raise DeclarationError("there is no PDF", where="--paper", remedy="add --pdf")
    rebuild_pages(folders, tables=tables, pdf=pdf, paper=(paper or "a4").lower())


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
        bool, flag("--example", "Print the file of a model of one's own, to copy and edit.")
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
        valued("--diff", "OTHER", "What differs from another vehicle.", complete=options.vehicles),
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
    from scenarios.commands.libraries import copy_lab, list_labs, open_lab, show_key

    if number is None:
        list_labs()
    elif key:
        show_key(number)
    elif copy is not None and not edit:
        copy_lab(number, copy)
    else:
        raise SystemExit(open_lab(number, edit, port, browser, copy))


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
    from scenarios.commands.records import find_structure
    from scenarios.structure import StructureOptions

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
        find_structure(request, options, target.out, target.figures)


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
    from scenarios.commands.failures import one_segment
    from scenarios.commands.records import predict_with_study
    from scenarios.prediction import PredictionRequest

    plan = plan_of(start, stop, rate=rate, trusted=trust, columns=columns)
    plan = one_segment(with_maneuvers(plan, [record], maneuver, maneuvers))
    request = PredictionRequest(study, record, channels, plan, model, effects, tolerances)
    with output.writing("prediction.json") as target:
        predict_with_study(request, target.out, target.figures)


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
    from scenarios.commands.records import export_model

    export_model(study, to, out, model)
