"""Every failure as one line on stderr and an exit code."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import sys
from traceback import walk_tb
from typing import Any

from scenarios.files.python_files import MODULE
from sim.errors import FlightidError

LONGEST_WORD = 300  # characters of a path or name; the middle of a longer one is left out
LONGEST = 3000  # characters of a line; the middle of a longer one is left out
_FULL = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG})
STOPPED = 130  # exit code of what Ctrl-C ended: 128 and the number of the signal


class Stopped(Exception):
    """Ctrl-C on its way through the command-line library, which would print a line of its own; the text says what is kept."""


def report(error: BaseException) -> int:
    """Print one line for an error and return the exit code: 2 bad usage or input, 130 Ctrl-C, 1 anything else, 0 a clean exit.

    What came through a user's model or effects is a fault of that file, SystemExit too.

    What a command keeps when it is stopped is the text of its KeyboardInterrupt; most keep nothing.
    The command-line library's own errors are known by their form, for it ships click under changing names.
    """
    if not isinstance(error, FlightidError | MemoryError | KeyboardInterrupt) and (place := _in_users_file(error)):
        return _say(f"{place}: {type(error).__name__}: {error}; mend that line", 2)
    if isinstance(error, SystemExit):
        return error.code if isinstance(error.code, int) else int(error.code is not None)
    if isinstance(error, FlightidError):
        return _say(str(error), 2)
    if isinstance(error, MemoryError):
        return _say(f"out of memory{f': {error}' if str(error) else ''}; give less data at once, or ask for fewer samples or runs", 1)
    if isinstance(error, BrokenPipeError):
        return 1
    if isinstance(error, OSError) and error.errno is not None:
        return _say(_of_system(error), 2)
    name = type(error).__name__
    if isinstance(error, KeyboardInterrupt | Stopped) or name == "Abort":
        return _say(f"stopped; {str(error) or 'nothing was written'}", STOPPED)
    if name == "NoArgsIsHelpError":
        return _say("no command is given; see flightid --help", 2)
    if hasattr(error, "format_message") and hasattr(error, "exit_code"):
        return _say(_usage(error), 2)
    if hasattr(error, "exit_code"):
        return int(error.exit_code)
    return _say(f"internal error: {name}: {error}; run it again with --debug and report what it prints", 1)


def _in_users_file(error: BaseException) -> str:
    """File and line of the user's Python code that an error came through last; empty where it came through none."""
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
    """What the operating system refused, of which file, and what may help."""
    remedies = {
        **dict.fromkeys(_FULL, "make room, or write to another place"),
        **dict.fromkeys((errno.EMFILE, errno.ENFILE), "raise the limit of open files (ulimit -n), or use fewer processes (--jobs)"),
        **dict.fromkeys((errno.ENAMETOOLONG, errno.ELOOP, errno.ENOTDIR, errno.ENOENT), "check the path"),
        **dict.fromkeys((errno.EAGAIN, errno.ENOMEM), "use fewer processes (--jobs), or wait until others have ended"),
    }
    number = error.errno or 0
    place = os.fsdecode(error.filename) if isinstance(error.filename, str | bytes) else "the output" if number in _FULL else "the system"
    return f"{place}: {error.strerror or error}; {remedies.get(number, 'check the path and its permissions')}"


def _say(text: str, code: int) -> int:
    line = " ".join(text.split()).removeprefix("flightid: ")
    line = re.sub(rf"\S{{{LONGEST_WORD},}}", lambda word: f"{word[0][: LONGEST_WORD // 2]}...{word[0][-LONGEST_WORD // 4 :]}", line)
    if len(line) > LONGEST:
        line = f"{line[: LONGEST // 2]} ... {line[-LONGEST // 2 :]}"
    if sys.stderr is not None:  # it may be closed, or full: the exit code says enough then
        with contextlib.suppress(OSError, ValueError):
            print(f"flightid: {line}", file=sys.stderr)
    return code
