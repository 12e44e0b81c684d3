"""The command line: what each command takes; the work is done in `scenarios.commands`, imported when it is run."""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path
from typing import Annotated

import typer

from scenarios.commands.arguments import each_validated
from scenarios.preparation.plan import plan_of
from scenarios.preparation.request import Request

# Threads of the linear algebra that NumPy may have been built with: matrices here are small, and more than one only waits for another.
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")

app = typer.Typer(
    name="flightid",
    help="Simulate a flight vehicle, identify it from its record, and trace what the model lacks.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Write the study into this folder.")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, metavar="N", help="Seed of the random numbers; the scenario's own when left out.")]
Changes = Annotated[list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change an entry of the scenario, e.g. flight.rate=50.")]
From = Annotated[
    list[float] | None, typer.Option("--from", metavar="T", help="Use the record from this time on, s; with --to again for each maneuver.")
]
To = Annotated[list[float] | None, typer.Option("--to", metavar="T", help="Use the record up to this time, s.")]
Held = Annotated[str | None, typer.Option("--hold", metavar="HOLD", help="Inputs between samples: previous or linear; else as the data say.")]
Rate = Annotated[float | None, typer.Option("--rate", metavar="HZ", help="Resample all channels to this rate behind one filter.")]
Lowpass = Annotated[float | None, typer.Option("--lowpass", metavar="HZ", help="One zero-phase low-pass for all channels, inputs included.")]
Trust = Annotated[bool, typer.Option("--trust-record", help="Take the raw columns as they are: warn of what they show, refuse and mask nothing.")]
Model = Annotated[
    str, typer.Option("--model", metavar="M", help="ballistic, rigid, flexible, loes, lateral, longitudinal, or FILE.py with a model of your own.")
]
Records = Annotated[list[Path], typer.Argument(metavar="RECORD...", help="CSV, Parquet or MAT files of one vehicle.")]
VehicleBeside = Annotated[
    Path | None,
    typer.Option(
        "--vehicle",
        metavar="V.toml",
        help="Constants and starting values; else vehicle.toml beside the first record, if any.",
    ),
]
Scenario = Annotated[str | None, typer.Argument(metavar="NAME", help="A scenario; none beside --model.")]
OwnModel = Annotated[str | None, typer.Option("--model", metavar="FILE.py", help="A model of your own flies instead of a scenario; its file is run.")]
TrueValues = Annotated[Path | None, typer.Option("--vehicle", metavar="V.toml", help="With --model: true values; else those of its file.")]
Inputs = Annotated[
    list[str] | None,
    typer.Option("--input", metavar="NAME=KIND,KEY=VALUE,...", help="With --model, again for each maneuver; else a doublet on each input."),
]
Noise = Annotated[
    list[str] | None, typer.Option("--noise", metavar="OUTPUT=SIZE", help="With --model: standard deviation; else 1 % of its largest move.")
]
Duration = Annotated[float | None, typer.Option("--duration", metavar="S", help="With --model: length of the record, s.")]
SampleRate = Annotated[float | None, typer.Option("--rate", metavar="HZ", help="With --model: samples a second.")]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures into the study folder.")]
Class = Annotated[str | None, typer.Option("--class", metavar="I..IV", help="Class of the aircraft, for levels of flying qualities; II-C: carrier.")]
Category = Annotated[str | None, typer.Option("--category", metavar="A|B|C", help="Category of the flight phase: A rapid, B gradual, C terminal.")]
Channels = Annotated[Path | None, typer.Option("--channels", metavar="MAP", help="TOML file that maps columns to channels.")]


@app.callback()
def options(debug: Annotated[bool, typer.Option("--debug", help="Show a traceback when something fails.")] = False) -> None:
    """Simulate a flight vehicle, identify it from its record, and trace what the model lacks."""


@app.command("list")
def list_(name: Annotated[str | None, typer.Argument(metavar="NAME", help="Print this scenario's file, to copy and edit.")] = None) -> None:
    """Scenarios, one line each; with a name, that scenario's file."""
    from scenarios.commands.libraries import list_scenarios, show_scenario

    if name is None:
        list_scenarios()
    else:
        show_scenario(name)


@app.command()
def run(
    names: Annotated[list[str], typer.Argument(metavar="NAME...", help="Scenarios of the catalogue, or paths of scenario files.")],
    seed: Seed = None,
    out: Out = None,
    changes: Changes = None,
    figures: Figures = True,
    compare: Annotated[bool, typer.Option("--compare", help="Then put the studies side by side, as compare does.")] = False,
) -> None:
    """Simulate, identify and compare: true, estimated, published."""
    from scenarios.commands.run import run_and_compare, run_scenarios

    (run_and_compare if compare else run_scenarios)(names, seed, out, changes or [], figures)


@app.command()
def compare(
    studies: Annotated[list[str], typer.Argument(metavar="STUDY...", help="Study folders; FOLDER:METHOD is a further method of one.")],
    every: Annotated[bool, typer.Option("--methods", help="All methods of each study, not its main one alone.")] = False,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Write tables and figures into this folder.")] = None,
    figures: Figures = True,
) -> None:
    """Studies side by side: estimates, errors, published values and responses, from their folders alone."""
    from scenarios.commands.compare import compare_studies

    compare_studies(studies, out, every, figures)


@app.command()
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
        list[str] | None, typer.Option("--hide", metavar="EFFECT.KEY=VALUE", help="With --model: an effect that acts and is not told.")
    ] = None,
    duration: Duration = None,
    rate: SampleRate = None,
) -> None:
    """The record of a scenario alone, or of a flight of a model of your own."""
    from scenarios.commands.arguments import scenario_or_own
    from scenarios.commands.run import simulate as simulate_what

    what = scenario_or_own(name, model, vehicle, inputs, noise, hidden, duration, rate)
    simulate_what(what, out, seed, changes or [])


@app.command()
def identify(
    records: Records,
    model: Model,
    vehicle: VehicleBeside = None,
    channels: Channels = None,
    start: From = None,
    stop: To = None,
    hold: Held = None,
    rate: Rate = None,
    lowpass: Lowpass = None,
    trust: Trust = False,
    method: Annotated[
        str, typer.Option("--method", metavar="METHOD", help="output-error, filter-error, frequency-domain, equation-error, ekf, ukf.")
    ] = "output-error",
    validate: Annotated[
        list[Path] | None, typer.Option("--validate", metavar="RECORD...", help="Predict these records with what was estimated from the others.")
    ] = None,
    profile: Annotated[
        list[str] | None, typer.Option("--profile", metavar="NAME...", help="Profile-likelihood intervals of these parameters; all: of every one.")
    ] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option("--band", metavar="LOW HIGH", help="Hz, for frequency-domain; else from the inputs' power.")
    ] = None,
    engine: Annotated[
        str | None, typer.Option("--engine", metavar="ENGINE", help="Who runs the filters of loes by ekf: batched (usual) or filterpy, one by one.")
    ] = None,
    aircraft_class: Class = None,
    category: Category = None,
    matrices: Annotated[
        Path | None, typer.Option("--state-space", metavar="FILE", help="Write A, B, C, D about trim with names: .json, .mat or .npz.")
    ] = None,
    out: Out = None,
    figures: Figures = True,
) -> None:
    """Parameters of a model from measured records."""
    from scenarios.commands.identify import identify_records, options_of

    plan = plan_of(start, stop, hold, rate, lowpass, trusted=trust)
    request = Request(
        tuple(records), model, vehicle, tuple(validate or ()), channels=channels, plan=plan, aircraft_class=aircraft_class, flight_phase=category
    )
    identify_records(request, method, out, figures, options_of(profile, band, engine), matrices)


@app.command()
def diagnose(
    records: Records,
    model: Model,
    vehicle: VehicleBeside = None,
    validate: Annotated[
        list[Path] | None,
        typer.Option("--validate", metavar="RECORD...", help="Predict these records; else the last of several, or the last part of one."),
    ] = None,
    effects: Annotated[Path | None, typer.Option("--effects", metavar="FILE", help="Python file with effects of your own; it is run.")] = None,
    channels: Channels = None,
    start: From = None,
    stop: To = None,
    hold: Held = None,
    rate: Rate = None,
    lowpass: Lowpass = None,
    trust: Trust = False,
    effort: Annotated[str, typer.Option("--effort", metavar="E", help="How far the search looks: normal, thorough.")] = "normal",
    aircraft_class: Class = None,
    category: Category = None,
    out: Out = None,
    figures: Figures = True,
) -> None:
    """Trace what the model lacks: fit, find the residual's cause, add it, refit, compare before and after."""
    from scenarios.commands.diagnose import diagnose_records

    plan = plan_of(start, stop, hold, rate, lowpass, trusted=trust)
    request = Request(tuple(records), model, vehicle, tuple(validate or ()), effects, channels, plan, effort, aircraft_class, category)
    diagnose_records(request, out, figures)


@app.command()
def check(
    records: Records,
    vehicle: VehicleBeside = None,
    channels: Channels = None,
    start: From = None,
    stop: To = None,
    hold: Held = None,
    rate: Rate = None,
    lowpass: Lowpass = None,
    trust: Trust = False,
    out: Out = None,
    figures: Figures = True,
) -> None:
    """Data compatibility: what the kinematics alone say of the sensors."""
    from scenarios.commands.check import check_records

    plan = plan_of(start, stop, hold, rate, lowpass, trusted=trust)
    check_records(Request(tuple(records), vehicle=vehicle, channels=channels, plan=plan), out, figures)


@app.command()
def watch(
    record: Annotated[str, typer.Argument(metavar="RECORD|-", help="A CSV file that grows, or - for standard input.")],
    model: Annotated[str, typer.Option("--model", metavar="M", help="loes.")],
    vehicle: Annotated[Path | None, typer.Option("--vehicle", metavar="V.toml", help="Constants and starting values.")] = None,
    reference: Annotated[
        Path | None, typer.Option("--reference", metavar="STUDY", help="A study to compare with; without --vehicle the filter starts from it.")
    ] = None,
    channels: Channels = None,
    out: Out = None,
    idle: Annotated[
        float | None, typer.Option("--idle", min=0.0, metavar="S", help="End after so many seconds without a row; a file: 5, a pipe: never.")
    ] = None,
    until_end: Annotated[bool, typer.Option("--until-end", help="Do not wait for the file to grow.")] = False,
    refine: Annotated[bool, typer.Option(help="Refine the estimate over all rows when the stream has ended.")] = True,
) -> None:
    """Identification of a stream: rows as they arrive, estimates against a reference."""
    from scenarios.commands.watch import watch_stream

    watch_stream(record, model, vehicle, reference, channels, out, idle, until_end, refine)


@app.command()
def campaign(
    runs: Annotated[int, typer.Option("--runs", min=2, metavar="N", help="Number of runs, each with a seed of its own.")],
    name: Scenario = None,
    seed: Seed = None,
    out: Out = None,
    changes: Changes = None,
    model: OwnModel = None,
    vehicle: TrueValues = None,
    inputs: Inputs = None,
    noise: Noise = None,
    duration: Duration = None,
    rate: SampleRate = None,
    method: Annotated[str | None, typer.Option("--method", metavar="NAME", help="One of the scenario's further methods; else its main one.")] = None,
) -> None:
    """Monte Carlo: bias, scatter against reported sigma, coverage."""
    from scenarios.commands.arguments import scenario_or_own
    from scenarios.commands.campaign import own_campaign, refuse_method, run_campaign

    what = scenario_or_own(name, model, vehicle, inputs, noise, None, duration, rate)
    if isinstance(what, str):
        run_campaign(what, runs, seed, out, changes or [], method)
    else:
        refuse_method(method)
        own_campaign(what, runs, seed, out, changes or [])


@app.command()
def effects(name: Annotated[str | None, typer.Argument(metavar="NAME", help="One effect, explained.")] = None) -> None:
    """The library of effects."""
    from scenarios.commands.libraries import show_effects

    show_effects(name)


@app.command()
def models(
    name: Annotated[str | None, typer.Argument(metavar="NAME|FILE", help="One model, or a file with one of your own, which is run.")] = None,
    example: Annotated[bool, typer.Option("--example", help="Print the file of a model of one's own, to copy and edit.")] = False,
) -> None:
    """The models: states, inputs, outputs, parameters, and the effects that may act on them."""
    from scenarios.commands.models import show_example, show_models

    if example:
        show_example(name)
    else:
        show_models(name)


@app.command()
def vehicles(
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="One vehicle, number by number.")] = None,
    other: Annotated[str | None, typer.Option("--diff", metavar="OTHER", help="What differs from another vehicle.")] = None,
) -> None:
    """The library of vehicles, every number with unit and origin."""
    from scenarios.commands.libraries import show_vehicles

    show_vehicles(name, other)


@app.command()
def lab(
    number: Annotated[int | None, typer.Argument(metavar="N", help="Number of the lab; all are listed when left out.")] = None,
    edit: Annotated[bool, typer.Option("--edit", help="Open a copy of your own in the editor, not as a page.")] = False,
    copy: Annotated[Path | None, typer.Option("--copy", metavar="DIR", help="Write a copy of your own into this folder.")] = None,
    key: Annotated[bool, typer.Option("--key", help="Print the instructor's key.")] = False,
    port: Annotated[int | None, typer.Option("--port", min=1, max=65535, metavar="P", help="Port on this machine; else a free one.")] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open it in a browser.")] = True,
) -> None:
    """A teaching notebook, opened in a browser."""
    from scenarios.commands.lab import copy_lab, list_labs, open_lab, show_key

    if number is None:
        list_labs()
    elif key:
        show_key(number)
    elif copy is not None and not edit:
        copy_lab(number, copy)
    else:
        raise SystemExit(open_lab(number, edit, port, browser, copy))


def main(arguments: list[str] | None = None) -> None:
    """Entry point: exit code 0 done, 2 bad usage or input (one line on stderr), 1 anything else."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")  # read when NumPy is loaded, by the command itself
    given = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    debug = "--debug" in given
    try:
        code = app(args=each_validated([text for text in given if text != "--debug"]), standalone_mode=False)
    except BaseException as error:
        if debug and not isinstance(error, SystemExit):
            raise
        from scenarios.commands.failures import report

        raise SystemExit(report(error)) from None
    if arguments is None:
        gc.freeze()  # the process ends: nothing is worth the tenth of a second that a last search for garbage takes
    raise SystemExit(code if isinstance(code, int) else 0)
