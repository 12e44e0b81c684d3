"""Arguments as typed, and every failure as one line on stderr and an exit code."""

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


# ---- Arguments as they are typed, made into those that the command-line library understands

# options that take every word up to the next option
SEVERAL = {"diagnose": ("--validate",), "identify": ("--validate", "--profile")}
NONE_MEANS = {"--profile": "all"}  # value of such an option without a word
FLAGS = ("--no-figures", "--trust-record", "--quiet", "--json")
BAND = ("--band",)  # options of two words
FILES = (".csv", ".parquet", ".mat", ".tsv", ".txt")  # ends of what is a record and no parameter


def each_validated(given: list[str]) -> list[str]:
    """``--validate A B`` as ``--validate A --validate B``, and so ``--profile``: they take every
    word up to the next option, as documented.

    Where that would leave no record to fit, ``--validate`` takes one file only. ``--profile`` takes
    no record, and alone means all parameters.
    """
    several = SEVERAL.get(given[0], ()) if given else ()
    if not several:
        return given
    out, fitted = _expanded(given, several)
    return (
        out
        if fitted
        else _expanded(given, [option for option in several if option != "--validate"])[0]
    )


def _expanded(given: list[str], several: Sequence[str]) -> tuple[list[str], int]:
    """Return the words with the options ``several`` before each of theirs, and how many of them are
    records to be fitted.
    """
    out, option, taken, fitted = [given[0]], "", 0, 0
    for text in given[1:]:
        if text.startswith("-") and text != "-":
            out += _unsaid(option, taken)
            option, taken = text, 0
            out.append(text)
            continue
        if option in several and not (option == "--profile" and text.lower().endswith(FILES)):
            out += [text] if taken == 0 else [option, text]
            taken += 1
            continue
        wanted = (
            0 if option in ("", *FLAGS, *several) or "=" in option else 2 if option in BAND else 1
        )
        if taken >= wanted:
            out += _unsaid(option, taken)
            fitted += 1
            option, taken = ("", 0) if option in several else (option, taken)
        else:
            taken += 1
        out.append(text)
    out += _unsaid(option, taken)
    return out, fitted


def _unsaid(option: str, taken: int) -> list[str]:
    """Return the default meaning of an option without a value."""
    return [NONE_MEANS[option]] if option in NONE_MEANS and taken == 0 else []


def one_segment(plan: Plan) -> Plan:
    """Return a plan for one part of a record; DeclarationError where it has several."""
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
    """Return the flight to simulate: a scenario by its name, or a user model with the given
    properties of its flight.

    Raises
    ------
    DeclarationError : both or neither, or an option that only ``--model`` takes.
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


# ---- Every failure as one line on stderr and an exit code

LONGEST_WORD = 300  # characters of a path or name; the middle of a longer one is left out
LONGEST_LINE = 3000  # characters of a line; the middle of a longer one is left out
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
INTERRUPTED_EXIT_CODE = 130  # exit code of what Ctrl-C ended: 128 and the number of the signal


class Stopped(Exception):
    """Ctrl-C, hidden from the command-line library; its text names the stored results."""


def report(error: BaseException) -> int:
    """Print one line for an error and return the exit code: 2 bad usage or input, 130 Ctrl-C, 1
    anything else, 0 a clean exit.

    Errors from a user's model or effects, SystemExit included, are reported as faults of that file.
    The text of a KeyboardInterrupt says which results are stored. Errors of the command-line
    library are recognised by their attributes, since it ships click under changing names.
    """
    if not isinstance(error, FlightidError | MemoryError | KeyboardInterrupt) and (
        place := _in_users_file(error)
    ):
        return _say(f"{place}: {type(error).__name__}: {error}; mend that line", 2)
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    if isinstance(error, FlightidError):
        return _say(str(error), 2)
    if isinstance(error, MemoryError):
        return _say(
            f"out of memory{f': {error}' if str(error) else ''}; give less data at once, or ask "
            "for fewer samples or runs",
            1,
        )
    if isinstance(error, BrokenPipeError):
        return 1
    if isinstance(error, OSError) and error.errno is not None:
        return _say(_of_system(error), 2)
    name = type(error).__name__
    if isinstance(error, KeyboardInterrupt | Stopped) or name == "Abort":
        return _say(f"stopped; {str(error) or 'nothing was written'}", INTERRUPTED_EXIT_CODE)
    if name == "NoArgsIsHelpError":
        return _say("no command is given; see flightid --help", 2)
    if hasattr(error, "format_message") and hasattr(error, "exit_code"):
        return _say(_usage(error), 2)
    if hasattr(error, "exit_code"):
        return int(error.exit_code)
    return _say(
        f"internal error: {name}: {error}; run it again with --debug and report what it prints", 1
    )


def _in_users_file(error: BaseException) -> str:
    """File and line of the user's Python code that an error came through last; empty if it came
    through none.
    """
    found = ""
    for frame, line in walk_tb(error.__traceback__):
        if str(frame.f_globals.get("__name__", "")).startswith(MODULE):
            found = f"{frame.f_code.co_filename}, line {line}"
    return found


def _usage(error: Any) -> str:
    text = error.format_message().rstrip(".")
    command = getattr(getattr(error, "ctx", None), "command_path", None) or "flightid"
    return f"{text[:1].lower()}{text[1:]}; see {' '.join(command.split())} --help"


def _of_system(error: OSError) -> str:
    """Return error, file and remedy of an operating-system error."""
    remedies = {
        **dict.fromkeys(_FULL, "make room, or write to another place"),
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
    place = (
        os.fsdecode(error.filename)
        if isinstance(error.filename, str | bytes)
        else "the output"
        if number in _FULL
        else "the system"
    )
    return (
        f"{place}: {error.strerror or error}; "
        f"{remedies.get(number, 'check the path and its permissions')}"
    )


def _say(text: str, code: int) -> int:
    line = " ".join(text.split()).removeprefix("flightid: ")
    line = re.sub(
        rf"\S{{{LONGEST_WORD},}}",
        lambda word: f"{word[0][: LONGEST_WORD // 2]}...{word[0][-LONGEST_WORD // 4 :]}",
        line,
    )
    if len(line) > LONGEST_LINE:
        line = f"{line[: LONGEST_LINE // 2]} ... {line[-LONGEST_LINE // 2 :]}"
    if sys.stderr is not None:  # it may be closed or full; the exit code remains
        with contextlib.suppress(OSError, ValueError):
            print(f"flightid: {line}", file=sys.stderr)
    return code
