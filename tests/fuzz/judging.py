"""A command in this process with a clock beside it, and whether it ended as a command may: refused
in one line, or right.
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import os
import re
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from scenarios.cli import main

LONGEST = 30.0  # s, of one command
LONGEST_LINE = 3100  # characters of a refusal
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")
# of long work, a line every ten seconds
_PROGRESS = re.compile(r"flightid: (?!.*;)(.*, )?\d+ (s|min|h)\b[\w ,]*$")
# of a stream, about a row that it goes on without
_ROW = re.compile(r"flightid: .*, row \d+: .*others like it are counted$")
_NO_NUMBER = re.compile(r"(?<![\w/.'-])(nan|inf)(?![\w/.'=-])")


@dataclass(frozen=True)
class Ended:
    """Exit code and the two streams of a command; ``late``: it was stopped by the clock."""

    code: object
    out: str
    err: str
    late: bool


class _TooLong(BaseException):
    """The clock's exception, which no handler of the program's own errors takes."""


@contextlib.contextmanager
def _clock(seconds: float, rang: list[bool]) -> Iterator[None]:
    def ring(number: int, frame: object) -> None:
        rang.append(True)
        raise _TooLong

    # Computing is measured in time of the processor, which does not hang on what else it does;
    # waiting only by the clock on the wall.
    limits = (
        (signal.SIGPROF, signal.ITIMER_PROF, seconds),
        (signal.SIGALRM, signal.ITIMER_REAL, 10.0 * seconds),
    )
    former = [signal.signal(number, ring) for number, _, _ in limits]
    for _, timer, most in limits:
        signal.setitimer(timer, most)
    try:
        yield
    finally:
        for (number, timer, _), handler in zip(limits, former, strict=True):
            signal.setitimer(timer, 0.0)
            signal.signal(number, handler)


def _print_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    print(f"{category.__name__}: {message}", file=sys.stderr)


def run(arguments: Sequence[str], folder: Path, seconds: float = LONGEST) -> Ended:
    """Run ``flightid`` in this process with ``folder`` as the current one; warnings are printed as
    Python prints them.
    """
    out, err = (
        io.TextIOWrapper(
            io.BytesIO(), encoding="utf-8", errors="backslashreplace", write_through=True
        )
        for _ in range(2)
    )
    rang: list[bool] = []
    code: object = "no exit code"
    here = os.getcwd()
    os.chdir(folder)
    try:
        with (
            warnings.catch_warnings(),
            contextlib.redirect_stdout(out),
            contextlib.redirect_stderr(err),
        ):
            warnings.simplefilter("default")
            warnings.showwarning = _print_warning
            try:
                with _clock(seconds, rang):
                    main(list(arguments))
            except SystemExit as ended:
                code = ended.code
            except BaseException as error:
                code = f"{type(error).__name__}: {error}"
    finally:
        os.chdir(here)
    said, told = (each.buffer.getvalue().decode("utf-8", "replace") for each in (out, err))
    return Ended(code, said, told, bool(rang))


def fault_of(ended: Ended, folder: Path, before: frozenset[str]) -> str:
    """What is wrong with the end of a command, empty where nothing is.

    A refusal is exit code 2 with one line on stderr and no new file; success is exit code 0 with
    finite numbers on stdout and in every JSON file. Neither holds a control character, a traceback
    or a warning of a library. ``before``: the files that were there.
    """
    lines = [
        line for line in ended.err.splitlines() if not (_PROGRESS.match(line) or _ROW.match(line))
    ]
    if ended.late:
        return "it takes too long"
    if ended.code not in (0, 2):
        return f"exit code {ended.code}"
    if found := _CONTROL.search(ended.out + ended.err.replace("\n", "")):
        return f"a control character {found[0]!r} is printed"
    if any(not line.startswith("flightid: ") for line in lines):
        return "stderr holds lines that are not the program's own"
    new = files_in(folder) - before
    if ended.code == 2:
        if len(lines) != 1:
            return f"{len(lines)} lines on stderr"
        if len(lines[0]) > LONGEST_LINE:
            return f"a line of {len(lines[0])} characters"
        if "; " not in lines[0]:
            return "the line has no remedy"
        return f"something is left behind: {sorted(new)[0]}" if new else ""
    if found := _NO_NUMBER.search(ended.out):
        return f"{found[0]} is printed"
    return next(
        (
            told
            for name in sorted(new)
            if name.endswith(".json") and (told := _not_strict(folder / name))
        ),
        "",
    ) or _leftover(new)


def files_in(folder: Path) -> frozenset[str]:
    """Every file and folder below a folder."""
    return frozenset(str(path.relative_to(folder)) for path in folder.rglob("*"))


def _leftover(new: frozenset[str]) -> str:
    return next(
        (
            f"something temporary is left: {name}"
            for name in sorted(new)
            if Path(name).name.startswith(".")
        ),
        "",
    )


def _not_strict(path: Path) -> str:
    def refuse(word: str) -> float:
        raise ValueError(word)

    def finite(text: str) -> float:
        number = float(text)
        if not math.isfinite(number):
            raise ValueError(text)
        return number

    try:
        json.loads(path.read_bytes(), parse_constant=refuse, parse_float=finite)
    except ValueError as error:
        return f"{path.name} is no strict JSON ({error})"
    return ""
