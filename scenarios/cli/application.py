"""The command-line application: groups of commands, help with examples, check of numbers, exit
codes.
"""

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

# ---- Signals that end the process

ENDING = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def ending_signals() -> Iterator[list[int]]:
    """Raise KeyboardInterrupt on SIGTERM and SIGHUP while the body runs.

    The context yields a list, to which the numbers of received signals are added. A signal that
    the process ignores from its start, as with ``nohup``, remains ignored. A forked process ends at
    once.
    """
    received: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    own_process = os.getpid()

    def handle(number: int, frame: FrameType | None) -> None:
        if os.getpid() != own_process:
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        received.append(number)
        raise KeyboardInterrupt

    previous = {number: signal.getsignal(number) for number in ENDING}
    handled = [number for number, handler in previous.items() if handler is signal.SIG_DFL]
    for number in handled:
        signal.signal(number, handle)
    try:
        yield received
    finally:
        for number in handled:
            signal.signal(number, previous[number])


# ---- Examples of every command

# Command -> pairs of a command line and its explanation. They can be run in this order: later
# examples read files that earlier ones write.
EXAMPLES: Mapping[str, tuple[tuple[str, str], ...]] = {
    "list": (
        ("flightid list", "the scenarios that can be run"),
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
            "a record as a flight test would give it",
        ),
        (
            "flightid simulate trace-vane --out flight.csv",
            "two records with a hidden effect, and a vehicle file",
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
            "the same with a figure of the flight, and maneuvers.toml for --maneuver",
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
            "from a part of the record, and a prediction of another record",
        ),
        (
            "flightid identify flight.csv --model rigid --vehicle flight_vehicle.toml --json > "
            "fit.json",
            "the JSON document, for another program",
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
            "the maneuver that distinguishes a vane ahead of the c.g. from a slow vane",
        ),
    ),
    "predict": (
        (
            "flightid predict fit flight_validate.csv",
            "a record that the study did not use, predicted by its model",
        ),
        (
            "flightid predict cause flight_validate.csv --out prediction",
            "the same with the claimed effects, into a folder",
        ),
    ),
    "structure": (
        (
            "flightid simulate trace-aircraft --out coupled.csv",
            "records of two flights, and a vehicle file",
        ),
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
    "report": (("flightid report study edited", "the pages of study folders, written again"),),
    "check": (
        (
            "flightid check flight.csv --vehicle flight_vehicle.toml",
            "sensor errors that kinematics alone reveal",
        ),
    ),
    "survey": (
        ("flightid survey --example > flights.toml", "the file of a survey, to copy and edit"),
        (
            "flightid survey flights.toml --out morning",
            "a diagnosis of each flight and the effects that recur; again after each new flight",
        ),
    ),
    "watch": (
        (
            "flightid simulate x29-simulation --out stream.csv",
            "a record of the closed loop, used as a stream",
        ),
        ("flightid watch stream.csv --model loes --until-end --no-refine", "identified row by row"),
    ),
    "models": (
        ("flightid models", "the names of the models"),
        (
            "flightid models --example > my_model.py",
            "the file of a model of one's own, to copy and edit",
        ),
        ("flightid models my_model.py", "the content of that file, and checks of the model"),
    ),
    "vehicles": (
        ("flightid vehicles bomber_rigid", "every number with unit and origin"),
        ("flightid vehicles bomber_ac2 --diff bomber_ac1", "what differs from another vehicle"),
    ),
    "lab": (
        ("flightid lab", "the titles of the labs"),
        ("flightid lab 1 --key", "the instructor's key of lab 1"),
    ),
    "effects": (("flightid effects vane-offset", "one effect, explained"),),
}


def examples_text(command: str) -> str:
    """Return the examples at the end of a command's help; empty if there are none."""
    lines = []
    for command_line, explanation in EXAMPLES.get(command, ()):
        lines += [f"  {command_line}", f"      {explanation}"]
    return "\n".join(["Examples:", *lines]) if lines else ""


# ---- Help: commands by group, with examples

LONGEST_SHORT_HELP = 1000  # characters; so large that the library folds lines and does not cut them


class GroupedCommands(TyperGroup):
    """Group of commands that lists them under the headings of their groups.

    The command-line library requires a class here.
    """

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section for each group, with commands in the order of their declaration."""
        sections: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            panel = getattr(command, "rich_help_panel", None)
            heading = panel if isinstance(panel, str) else "Commands"
            row = (name, command.get_short_help_str(LONGEST_SHORT_HELP))
            sections.setdefault(heading, []).append(row)
        for heading, rows in sections.items():
            with formatter.section(heading):
                formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        """Run the command; Ctrl-C raises ``Stopped`` with its text on the stored results."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupt:
            raise Stopped(str(interrupt)) from None


class WithExamples(TyperCommand):
    """A command whose help ends with examples."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write each example on a line of its own, without folding it."""
        text = examples_text(self.name or "")
        if text:
            formatter.write_paragraph()
            formatter.write(f"{text}\n")


# ---- flightid --version

# Package -> its name in the line of versions.
VERSION_NAMES = {"flightid": "flightid", "python": "Python", "numpy": "NumPy", "scipy": "SciPy"}


def show_version() -> None:
    """Print the versions of flightid, Python and its numerical packages in one line.

    Packages that are not installed are left out.
    """
    known = versions()
    print(
        ", ".join(f"{word} {known[name]}" for name, word in VERSION_NAMES.items() if name in known)
    )


# ---- The application

# Group -> its commands, in the order of the help.
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
            declare = app.command(_name_of(function), cls=WithExamples, rich_help_panel=group)
            declare(function)
    return app


def _name_of(function: Callable[..., Any]) -> str:
    """Return the name of a command; its function may have an underscore after it."""
    return function.__name__.rstrip("_")


app = _application()


# ---- Numbers in arguments


def refuse_foreign_digits(arguments: Sequence[str]) -> None:
    """Raise DeclarationError if an option's number has digits of another script or underscores.

    Python accepts such numbers, but a user hardly means them.
    """
    if not any(_is_foreign_number(word.rpartition("=")[2]) for word in arguments):
        return
    numbers = _numbers_of_options(arguments[0])
    for position, word in enumerate(arguments):
        name, equals, text = word.partition("=")
        if name not in numbers:
            continue
        # The words after the numbers of an option are its command's: a file may be called 1_0.
        first = position + 1
        for value in [text] if equals else arguments[first : first + numbers[name]]:
            if value.startswith("-") and not value[1:2].isdecimal():
                break  # the next option
            if _is_foreign_number(value):
                raise DeclarationError(
                    f"{value!r} is no plain number",
                    where=name,
                    remedy="write it in digits from 0 to 9",
                )


def _is_foreign_number(text: str) -> bool:
    """Return whether Python reads a text as a number though it is no plain one."""
    if text.isascii() and "_" not in text:
        return False
    try:
        float(text)
    except ValueError:
        return False
    return True


def _numbers_of_options(command: str) -> dict[str, int]:
    """Return option -> count of its numbers, for the options of a command that take numbers.

    The counts follow from the annotations of the command's function.
    """
    functions = {_name_of(function): function for group in COMMANDS.values() for function in group}
    if command not in functions:
        return {}
    hints = typing.get_type_hints(functions[command], include_extras=True).values()
    options = [(hint, option) for hint in hints for option in getattr(hint, "__metadata__", ())]
    # In an annotation, the library stores the first name of an option as its default.
    return {
        name: count
        for hint, option in options
        for name in (option.default, *(option.param_decls or ()))
        if isinstance(name, str) and (count := _number_count(hint.__origin__))
    }


def _number_count(kind: object) -> int:
    """Return how many numbers an option of the type ``kind`` takes.

    It is 2 for ``tuple[float, float]``, 0 for ``str``, and 1 for ``list[float] | None``, an option
    that is repeated for each number.
    """
    if kind in (int, float):
        return 1
    counts = [_number_count(part) for part in typing.get_args(kind)]
    return sum(counts) if typing.get_origin(kind) is tuple else max(counts, default=0)


# ---- The entry point

# Threads of the linear algebra that NumPy may use. The matrices of this package are small, so one
# thread is fastest.
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def run_typed(arguments: list[str] | None = None) -> None:
    """Run a command line and end the process with its exit code, see ``scenarios.cli.main``.

    ``arguments`` are the words after the program name; None takes those of the process.
    """
    for name in _THREADS:
        os.environ.setdefault(name, "1")  # read when a command loads NumPy
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A character that the terminal does not have must not end a study.
        sys.stdout.reconfigure(errors="backslashreplace")
    words = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    debug = "--debug" in words
    with escaped_streams(), ending_signals() as received, warnings.catch_warnings():
        if not debug:
            # Libraries warn of overflows. Results that are not finite are refused where they are
            # written or printed, so the warnings are not shown.
            warnings.showwarning = lambda *_, **__: None
        code = _run([word for word in words if word != "--debug"], debug)
    if arguments is None:
        _discard_output()
        # The process ends. Without a last garbage collection it ends 0.1 s sooner.
        gc.freeze()
    raise SystemExit(128 + received[0] if received else code)


def _run(arguments: list[str], debug: bool) -> int:
    """Run a command and return its exit code; with ``debug``, errors are raised."""
    try:
        refuse_foreign_digits(arguments)
        code = app(args=each_validated(arguments), prog_name="flightid", standalone_mode=False)
        if sys.stdout is not None:
            sys.stdout.flush()
    except BaseException as error:
        if debug and not isinstance(error, SystemExit):
            raise
        from scenarios.commands.failures import report

        return report(error)
    return code if isinstance(code, int) else 0


def _discard_output() -> None:
    """Discard the buffer of a full or closed stdout, so that the interpreter prints no error about
    it at its end.
    """
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            null_device = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null_device, sys.stdout.fileno())
            os.close(null_device)
