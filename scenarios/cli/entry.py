"""The entry point: what was typed, run, and every end of it as an exit code."""

from __future__ import annotations

import gc
import io
import os
import sys

from scenarios.cli.application import app
from scenarios.commands.arguments import each_validated

# Threads of the linear algebra that NumPy may have been built with: matrices here are small, and more than one only waits for another.
_THREADS = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def run_typed(arguments: list[str] | None = None) -> None:
    """Run what was typed (None: in the shell) and end with its exit code, as ``scenarios.cli.main`` says."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")  # read when NumPy is loaded, by the command itself
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a letter that the terminal does not have ends no study
    given = (sys.argv[1:] if arguments is None else arguments) or ["--help"]
    debug = "--debug" in given
    try:
        code = app(args=each_validated([text for text in given if text != "--debug"]), prog_name="flightid", standalone_mode=False)
    except BaseException as error:
        if debug and not isinstance(error, SystemExit):
            raise
        from scenarios.commands.failures import report

        raise SystemExit(report(error)) from None
    if arguments is None:
        gc.freeze()  # the process ends: nothing is worth the tenth of a second that a last search for garbage takes
    raise SystemExit(code if isinstance(code, int) else 0)
