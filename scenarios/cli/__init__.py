"""The command line: what each command takes; the work is done in `scenarios.commands`, imported
when it is run.

It may import `commands`, and from below only what loads neither NumPy nor SciPy: the help must
answer at once. To add a command: a function in `study_commands.py` or
`record_commands.py`, its entry in `COMMANDS` of `application.py`, and its work in `commands`.
"""

from __future__ import annotations

from typing import Any

__all__ = ["app", "main"]


def main(arguments: list[str] | None = None) -> None:
    """Entry point: exit code 0 done, 2 bad usage or input (one line on stderr), 130 stopped by
    Ctrl-C, 1 anything else.
    """
    try:
        from scenarios.cli.application import run_typed
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    run_typed(arguments)


def __getattr__(name: str) -> Any:
    """``app``, the application, made when it is requested."""
    if name == "app":
        from scenarios.cli.application import app

        return app
    raise AttributeError(name)
