"""The application: commands in groups, help with examples, numbers as typed, exit codes."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import signal
import sys
import threading
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from scenarios.cli.record_commands import (
    check,
    diagnose,
    identify,
    maneuvers,
    map_,
    response,
    survey,
    watch,
)
from scenarios.cli.study_commands import (
    campaign,
    compare,
    design,
    effects,
    export,
    lab,
    list_,
    models,
    predict,
    report,
    run,
    simulate,
    structure,
    vehicles,
)
from scenarios.commands.failures import Stopped, each_validated
from scenarios.files.sources import escaped_streams, versions
from sim.errors import DeclarationError

# ---- Signals that end the process from outside

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def ending_signals() -> Iterator[list[int]]:
    """Raise KeyboardInterrupt on SIGTERM and SIGHUP while the body runs; the list holds the numbers
    of the signals received.

    A signal that the process was started to ignore, as ``nohup`` does, stays ignored. A fork ends
    at once, as it would without this.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    first = os.getpid()

    def end(number: int, frame: FrameType | None) -> None:
        if os.getpid() != first:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        came.append(number)
        raise KeyboardInterrupt

    former = {number: signal.getsignal(number) for number in ENDING}
    taken = [number for number, handler in former.items() if handler is signal.SIG_DFL]
    for number in taken:
        signal.signal(number, end)
    try:
        yield came
    finally:
        for number in taken:
            signal.signal(number, former[number])


# ---- Examples of every command

# What is typed, and what it does. The order is that in which they run: later ones take files that
# earlier ones wrote.
EXAMPLES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "list": (
        ("flightid list", "what there is to run"),
        ("flightid list rigid > mine.toml", "the file of a scenario, to copy and edit"),
    ),
    "run": (
        (
            "flightid run rigid --out study",
            "simulate, identify, compare with the truth, into a folder",
        ),
        (
            "flightid run mine.toml --seed 3 --set flight.rate=50 --out edited",
            "an edited copy, with another seed and sampling",
        ),
    ),
    "compare": (("flightid compare study edited", "studies side by side, from their folders"),),
    "simulate": (
        (
            "flightid simulate rigid --seed 3 --out rigid.csv",
            "a record as a flight test would hand it over",
        ),
        (
            "flightid simulate trace-vane --out flight.csv",
            "two records with something hidden in them, and a vehicle file",
        ),
    ),
    "campaign": (
        ("flightid campaign rigid --runs 100", "bias, scatter and coverage over a hundred seeds"),
        (
            "flightid campaign ballistic --runs 20 --out campaign",
            "the same into a folder, with figures and every run",
        ),
    ),
    "map": (
        (
            "flightid map flight.csv",
            "the content of a recorder's file, and drafts of its channel map and vehicle file",
        ),
        ("flightid map flight.csv --out draft", "the drafts as files, to check and complete"),
    ),
    "maneuvers": (
        (
            "flightid maneuvers flight.csv",
            "steps, doublets, sweeps, turns and the like in a long record",
        ),
        (
            "flightid maneuvers flight.csv --out found",
            "with the flight in a figure and maneuvers.toml for --maneuver",
        ),
    ),
    "response": (
        (
            "flightid response flight.csv --input elevator --output q --out bode",
            "the response of the pitch rate to the elevator",
        ),
        (
            "flightid response flight.csv --input elevator --output q --output alpha --band 0.2 2",
            "two outputs, in a band in Hz",
        ),
    ),
    "identify": (
        (
            "flightid identify flight.csv --model rigid --vehicle flight_vehicle.toml --out fit",
            "parameters of a model from a record",
        ),
        (
            "flightid identify flight.csv --model rigid --vehicle flight_vehicle.toml --validate "
            "flight_validate.csv --from 1 --to 9",
            "from a part of it, and what that predicts of another",
        ),
        (
            "flightid identify flight.csv --model rigid --vehicle flight_vehicle.toml --json > "
            "fit.json",
            "for a program that reads on",
        ),
    ),
    "diagnose": (
        (
            "flightid diagnose flight.csv --model rigid --vehicle flight_vehicle.toml --validate "
            "flight_validate.csv --out cause",
            "what the model lacks, and the error before and after on another record",
        ),
    ),
    "design": (
        (
            "flightid design --model rigid --vehicle flight_vehicle.toml --out plan",
            "the maneuver that determines the derivatives best",
        ),
        (
            "flightid design --model rigid --vehicle flight_vehicle.toml --tell "
            "vane-offset,sensor-lag:alpha --size 'arm=2 m'",
            "the one that tells a vane ahead of the centre of gravity from a slow one",
        ),
    ),
    "predict": (
        (
            "flightid predict fit flight_validate.csv",
            "the model of a study on a record that it has not seen",
        ),
        (
            "flightid predict cause flight_validate.csv --out prediction",
            "with the effects that were claimed, into a folder",
        ),
    ),
    "structure": (
        ("flightid simulate trace-aircraft --out coupled.csv", "a flight, a second one, a vehicle"),
        (
            "flightid structure coupled.csv coupled_validate.csv "
            "--vehicle coupled_vehicle.toml --out terms",
            "the terms that two maneuvers support, and a vehicle file of them",
        ),
    ),
    "export": (
        ("flightid export fit --to python", "the model of a study as a module that needs NumPy"),
        (
            "flightid export fit --to fmu --out aircraft.fmu",
            "for Simulink, OpenModelica and others",
        ),
        (
            "flightid export coupled_vehicle.toml --to jsbsim",
            "the aircraft of a vehicle file of model aircraft",
        ),
    ),
    "report": (
        ("flightid report study edited", "the pages of study folders again, with nothing computed"),
    ),
    "check": (
        (
            "flightid check flight.csv --vehicle flight_vehicle.toml",
            "what the kinematics alone say of the sensors",
        ),
    ),
    "survey": (
        ("flightid survey --example > flights.toml", "the file of a survey, to copy and edit"),
        (
            "flightid survey flights.toml --out morning",
            "each flight diagnosed and kept, then what recurs; again after each new flight",
        ),
    ),
    "watch": (
        (
            "flightid simulate x29-simulation --out stream.csv",
            "a record of the closed loop, which stands for a stream",
        ),
        ("flightid watch stream.csv --model loes --until-end --no-refine", "identified row by row"),
    ),
    "models": (
        ("flightid models", "the models that there are"),
        (
            "flightid models --example > my_model.py",
            "the file of a model of one's own, to copy and edit",
        ),
        ("flightid models my_model.py", "what it declares, checked"),
    ),
    "vehicles": (
        ("flightid vehicles bomber_rigid", "every number with unit and origin"),
        ("flightid vehicles bomber_ac2 --diff bomber_ac1", "what differs from another vehicle"),
    ),
    "lab": (
        ("flightid lab", "the labs that there are"),
        ("flightid lab 1 --key", "the instructor's key of one"),
    ),
    "effects": (("flightid effects vane-offset", "one effect, explained"),),
}


def examples_text(command: str) -> str:
    """The examples of a command as its help ends with them; empty if there are none."""
    lines = [
        line
        for typed, does in EXAMPLES.get(command, ())
        for line in (f"  {typed}", f"      {does}")
    ]
    return "\n".join(["Examples:", *lines]) if lines else ""


# ---- Pages of help: commands by group, examples as they are typed

LARGEST_UNCUT_WIDTH = 1000  # characters: a line too long for the terminal is folded, not cut


class GroupedCommands(TyperGroup):
    """Lists the commands under the headings of their groups (the command-line library asks for a
    class here).
    """

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write one section a group, in the order in which the commands were declared."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            panel = getattr(command, "rich_help_panel", None)
            groups.setdefault(panel if isinstance(panel, str) else "Commands", []).append(
                (name, command.get_short_help_str(LARGEST_UNCUT_WIDTH))
            )
        for group, rows in groups.items():
            with formatter.section(group):
                formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; Ctrl-C leaves with what it says is kept."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stopped:
            raise Stopped(str(stopped)) from None


class WithExamples(TyperCommand):
    """A command whose help ends with examples, each on a line of its own however long it is."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples as they stand."""
        text = examples_text(self.name or "")
        if text:
            formatter.write_paragraph()
            formatter.write(f"{text}\n")


# ---- flightid --version: this version, and those of what it computes with

NAMED = {"flightid": "flightid", "python": "Python", "numpy": "NumPy", "scipy": "SciPy"}


def show_version() -> None:
    """One line; a package that is not installed under its name is left out of it."""
    found = versions()
    print(", ".join(f"{word} {found[name]}" for name, word in NAMED.items() if name in found))


# ---- The application: its commands in the order and the groups in which the help lists them

# The commands by group: a further one is a file in `declared` and its name here.
COMMANDS: Mapping[str, tuple[Callable[..., Any], ...]] = {
    "Studies": (run, compare, simulate, campaign, design, report),
    "Measured data": (
        map_,
        maneuvers,
        response,
        structure,
        identify,
        diagnose,
        predict,
        export,
        check,
        survey,
        watch,
    ),
    "Libraries": (list_, models, vehicles, effects),
    "Teaching": (lab,),
}


def _version(wanted: bool) -> None:
    if wanted:
        show_version()
        raise typer.Exit


def options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            is_eager=True,
            callback=_version,
            help="Show the version, and those of Python, NumPy and SciPy.",
        ),
    ] = False,
    debug: Annotated[
        bool, typer.Option("--debug", help="Show a traceback when something fails.")
    ] = False,
) -> None:
    """Simulate a flight vehicle, identify it from its record, and trace what the model lacks."""


def _application() -> typer.Typer:
    app = typer.Typer(
        name="flightid",
        help=(
            "Simulate a flight vehicle, identify it from its record, and trace what the model "
            "lacks."
        ),
        cls=GroupedCommands,
        no_args_is_help=True,
        add_completion=True,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(options)
    for group, functions in COMMANDS.items():
        for function in functions:
            app.command(function.__name__.rstrip("_"), cls=WithExamples, rich_help_panel=group)(
                function
            )
    return app


app = _application()


# ---- Numbers as they are typed


def refuse_foreign_digits(given: Sequence[str]) -> None:
    """Raise DeclarationError if an option's number is typed as Python alone would read it: in
    digits of another script, or with underscores.
    """
    for at, word in enumerate(given):
        name, equals, text = word.partition("=")
        values = [text] if equals else given[at + 1 : at + 3]
        for value in values if name.startswith("--") else ():
            if value.startswith("-") and not value[1:2].isdecimal():
                break
            if _is_foreign(value) and name in _numeric_options(given[0]):
                raise DeclarationError(
                    f"{value!r} is no plain number",
                    where=name,
                    remedy="write it in digits from 0 to 9",
                )


def _is_foreign(text: str) -> bool:
    try:
        return not (text.isascii() and "_" not in text) and float(text) is not None
    except ValueError:
        return False


def _numeric_options(command: str) -> frozenset[str]:
    """The options of a command that take a number, by the annotations of its function."""

    functions = {
        function.__name__.rstrip("_"): function for group in COMMANDS.values() for function in group
    }
    if command not in functions:
        return frozenset()
    hints = typing.get_type_hints(functions[command], include_extras=True).values()
    options = [(hint, declared) for hint in hints for declared in getattr(hint, "__metadata__", ())]
    numeric = [declared for hint, declared in options if _holds_number(hint.__origin__)]
    # Within an annotation the library keeps the first name where a default would be.
    return frozenset(
        name
        for each in numeric
        for name in (each.default, *(each.param_decls or ()))
        if isinstance(name, str)
    )


def _holds_number(kind: object) -> bool:
    return kind in (int, float) or any(map(_holds_number, typing.get_args(kind)))


# ---- The entry point: what was typed, run, and every end of it as an exit code

# Threads of the linear algebra that NumPy may have been built with: matrices here are small, and
# more than one only waits for another.
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def run_typed(arguments: list[str] | None = None) -> None:
    """Run what was typed (None: in the shell) and end with its exit code, as ``scenarios.cli.main``
    says.
    """
    for name in _THREADS:
        os.environ.setdefault(name, "1")  # read when NumPy is loaded, by the command itself
    if isinstance(sys.stdout, io.TextIOWrapper):
        # a letter that the terminal does not have ends no study
        sys.stdout.reconfigure(errors="backslashreplace")
    given = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    debug = "--debug" in given
    with escaped_streams(), ending_signals() as came, warnings.catch_warnings():
        if not debug:
            # Libraries warn of numbers beyond the range of floats, and what came of them is refused
            # where it is written or printed.
            warnings.showwarning = lambda *_, **__: None
        code = _run([text for text in given if text != "--debug"], debug)
    if arguments is None:
        _let_go_of_output()
        # the process ends: nothing is worth the tenth of a second that a last search for garbage
        # takes
        gc.freeze()
    raise SystemExit(128 + came[0] if came else code)


def _run(given: list[str], debug: bool) -> int:
    try:
        refuse_foreign_digits(given)
        code = app(args=each_validated(given), prog_name="flightid", standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()
    except BaseException as error:
        if debug and not isinstance(error, SystemExit):
            raise
        from scenarios.commands.failures import report

        return report(error)
    return code if isinstance(code, int) else 0


def _let_go_of_output() -> None:
    """Let what a full or closed stdout still holds go nowhere: the interpreter would complain of it
    at its end, in lines of its own.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, sys.stdout.fileno())
            os.close(nowhere)
