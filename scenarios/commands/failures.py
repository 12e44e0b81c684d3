"""Arguments before they are parsed, and failures as one line on stderr with an exit code."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from traceback import walk_tb
from typing import TYPE_CHECKING, Any

from scenarios.files.declarations import MODULE
from sim.errors import DeclarationError, FlightidError

if TYPE_CHECKING:
    from scenarios.preparation.plan import Plan
    from scenarios.trials.planted.own_flight import OwnFlight


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


def one_segment(plan: Plan) -> Plan:
    """Return a plan with a single segment of a record; raise DeclarationError if it has several."""
    if len(plan.segments) > 1:
        raise DeclarationError(
            "a prediction is of one part of a record",
            where="--from, --to, --maneuver",
            remedy="give each of them once",
        )
    return plan


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
    from scenarios.trials.planted.own_flight import OwnFlight

    return OwnFlight(
        model, vehicle, tuple(inputs or ()), tuple(noise or ()), tuple(hidden or ()), duration, rate
    )


# ---- Failures as one line on stderr with an exit code

LONGEST_WORD = 300  # characters of a path or name; the middle of a longer one is left out
LONGEST_LINE = 3000  # characters of a line; the middle of a longer one is left out
_NO_SPACE = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
FAILED, BAD_INPUT = 1, 2  # exit codes
INTERRUPTED_EXIT_CODE = 130  # after Ctrl-C: 128 and the number of the signal


class Stopped(Exception):
    """Ctrl-C, hidden from the command-line library; its text names the stored results."""


def report(error: BaseException) -> int:
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
