"""The entry point: what was typed, run, and every end of it as an exit code."""

from __future__ import annotations

import contextlib
import gc
import io
import os
import sys
import warnings

from scenarios.cli.application import app
from scenarios.cli.signals import ending_signals
from scenarios.cli.typed_numbers import refuse_foreign_digits
from scenarios.commands.arguments import each_validated
from scenarios.files.escaping import escaped_streams

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
        sys.stdout.reconfigure(errors="backslashreplace")  # a letter that the terminal does not have ends no study
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
