"""The command-line application: groups of commands, help with examples, check of numbers, exit
codes.
"""

from __future__ import annotations

import contextlib
import errno
import gc
import io
import os
import re
import signal
import sys
import threading
import tomllib
import typing
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.resources import files
from traceback import walk_tb
from types import FrameType
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from scenarios.cli.model_commands import diagnose, export, identify, predict, survey, watch
from scenarios.cli.record_commands import check, maneuvers, map_, response, structure
from scenarios.cli.study_commands import (
    campaign,
    compare,
    design,
    effects,
    lab,
    list_,
    models,
    report,
    run,
    simulate,
    vehicles,
)
from scenarios.files.declarations import MODULE
from scenarios.files.sources import escaped_streams, versions
from sim.errors import DeclarationError, FlightidError

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


# ---- Failures as one line on stderr with an exit code

LONGEST_WORD = 300  # characters of a path or name; the middle of a longer one is left out
LONGEST_LINE = 3000  # characters of a line; the middle of a longer one is left out
_NO_SPACE = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
FAILED, BAD_INPUT = 1, 2  # exit codes
INTERRUPTED_EXIT_CODE = 130  # after Ctrl-C: 128 and the number of the signal


class Stopped(Exception):
    """Ctrl-C, hidden from the command-line library; its text names the stored results."""


def report_error(error: BaseException) -> int:
    """Print one line for an error and return the exit code.

    The code is 2 for bad usage or input, 130 for Ctrl-C, 0 for a clean exit, and 1 for anything
    else. An error in a user's model or effects, SystemExit included, is reported with file and
    line. The text of a KeyboardInterrupt names the stored results. Errors of the command-line
    library are recognised by their attributes, because the names of its classes change.
    """
    if not isinstance(error, FlightidError | MemoryError | KeyboardInterrupt) and (
        place := _place_in_users_file(error)
    ):
        return _print_line(f"{place}: {type(error).__name__}: {error}; mend that line", BAD_INPUT)
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    if isinstance(error, FlightidError):
        return _print_line(str(error), BAD_INPUT)
    if isinstance(error, MemoryError):
        reason = f": {error}" if str(error) else ""
        return _print_line(
            f"out of memory{reason}; give less data at once, or ask for fewer samples or runs",
            FAILED,
        )
    if isinstance(error, BrokenPipeError):
        return FAILED
    if isinstance(error, OSError) and error.errno is not None:
        return _print_line(_system_error_text(error), BAD_INPUT)
    name = type(error).__name__
    if isinstance(error, KeyboardInterrupt | Stopped) or name == "Abort":
        results = str(error) or "nothing was written"
        return _print_line(f"stopped; {results}", INTERRUPTED_EXIT_CODE)
    if name == "NoArgsIsHelpError":
        return _print_line("no command is given; see flightid --help", BAD_INPUT)
    if hasattr(error, "format_message") and hasattr(error, "exit_code"):
        return _print_line(_usage_error_text(error), BAD_INPUT)
    if hasattr(error, "exit_code"):
        return int(error.exit_code)
    return _print_line(
        f"internal error: {name}: {error}; run it again with --debug and report what it prints",
        FAILED,
    )


def _place_in_users_file(error: BaseException) -> str:
    """Return file and line of the innermost frame in the user's Python code; empty without one."""
    place = ""
    for frame, line in walk_tb(error.__traceback__):
        if str(frame.f_globals.get("__name__", "")).startswith(MODULE):
            place = f"{frame.f_code.co_filename}, line {line}"
    return place


def _usage_error_text(error: Any) -> str:
    """Return the message of the command-line library, and the command that prints its help."""
    text = error.format_message().rstrip(".")
    command = getattr(getattr(error, "ctx", None), "command_path", None) or "flightid"
    return f"{text[:1].lower()}{text[1:]}; see {' '.join(command.split())} --help"


def _system_error_text(error: OSError) -> str:
    """Return file, message and remedy of an error of the operating system."""
    remedies = {
        **dict.fromkeys(_NO_SPACE, "make room, or write to another place"),
        **dict.fromkeys(
            (errno.EMFILE, errno.ENFILE),
            "raise the limit of open files (ulimit -n), or use fewer processes (--jobs)",
        ),
        **dict.fromkeys(
            (errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.ENOENT), "check the path"
        ),
        **dict.fromkeys(
            (errno.EAGAIN, errno.ENOMEM),
            "use fewer processes (--jobs), or wait until others have ended",
        ),
    }
    number = error.errno or 0
    place = "the output" if number in _NO_SPACE else "the system"
    if isinstance(error.filename, str | bytes):
        place = os.fsdecode(error.filename)
    remedy = remedies.get(number, "check the path and its permissions")
    return f"{place}: {error.strerror or error}; {remedy}"


def _print_line(text: str, code: int) -> int:
    """Print a text as one line on stderr, shortened if very long, and return the exit code."""
    line = " ".join(text.split()).removeprefix("flightid: ")
    line = re.sub(
        rf"\S{{{LONGEST_WORD},}}",
        lambda word: f"{word[0][: LONGEST_WORD // 2]}...{word[0][-LONGEST_WORD // 4 :]}",
        line,
    )
    if len(line) > LONGEST_LINE:
        line = f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"
    if sys.stderr is not None:  # if stderr is closed or full, only the exit code remains
        with contextlib.suppress(OSError, ValueError):
            print(f"flightid: {line}", file=sys.stderr)
    return code


# ---- Examples of every command

# Command -> explanation by command line.
EXAMPLES: Mapping[str, Mapping[str, str]] = tomllib.loads(
    files("scenarios.cli").joinpath("examples.toml").read_text(encoding="utf-8")
)


def examples_text(command: str) -> str:
    """Return the examples at the end of a command's help; empty if there are none."""
    lines = []
    for command_line, explanation in EXAMPLES.get(command, {}).items():
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


# ---- Arguments, rewritten for the command-line library

# Command -> options that take every word up to the next option.
SEVERAL = {"diagnose": ("--validate",), "identify": ("--validate", "--profile")}
DEFAULT_WORD = {"--profile": "all"}  # value of an option that is given without a word
FLAGS = ("--no-figures", "--trust-record", "--quiet", "--json")  # options without a word
TWO_WORDS = ("--band",)  # options of two words
RECORD_SUFFIXES = (".csv", ".parquet", ".mat", ".tsv", ".txt")  # a word with one is a record


def each_validated(arguments: list[str]) -> list[str]:
    """Return the arguments with ``--validate A B`` as ``--validate A --validate B``.

    ``--validate`` and ``--profile`` take every word up to the next option. If no record to fit
    remained, ``--validate`` takes one word only. ``--profile`` does not take records; without a
    word it means all parameters.
    """
    several = SEVERAL.get(arguments[0], ()) if arguments else ()
    if not several:
        return arguments
    expanded, fitted = _expanded(arguments, several)
    if not fitted:
        several = tuple(option for option in several if option != "--validate")
        expanded, _ = _expanded(arguments, several)
    return expanded


def _expanded(arguments: list[str], several: Sequence[str]) -> tuple[list[str], int]:
    """Repeat the options ``several`` before each of their words.

    Returns
    -------
    The new arguments, and the number of records to be fitted among them.
    """
    expanded, option, taken, fitted = [arguments[0]], "", 0, 0
    for word in arguments[1:]:
        if word.startswith("-") and word != "-":
            expanded += _default_word(option, taken)
            option, taken = word, 0
            expanded.append(word)
            continue
        is_record = word.lower().endswith(RECORD_SUFFIXES)
        if option in several and not (option == "--profile" and is_record):
            expanded += [word] if taken == 0 else [option, word]
            taken += 1
            continue
        if taken >= _word_count(option, several):
            expanded += _default_word(option, taken)
            fitted += 1
            if option in several:
                option, taken = "", 0
        else:
            taken += 1
        expanded.append(word)
    expanded += _default_word(option, taken)
    return expanded, fitted


def _word_count(option: str, several: Sequence[str]) -> int:
    """Return the number of words that follow an option; 0 for ``--option=word``."""
    if option in ("", *FLAGS, *several) or "=" in option:
        return 0
    return 2 if option in TWO_WORDS else 1


def _default_word(option: str, taken: int) -> list[str]:
    """Return the default word of an option that took none; empty if it needs none."""
    return [DEFAULT_WORD[option]] if option in DEFAULT_WORD and taken == 0 else []


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
        return report_error(error)
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
