"""The command line: options of each command, and its call of the functions that do the work.

The help must be fast. So this package imports only modules that load neither NumPy nor SciPy; a
command imports its work when it runs. To add a command, write a function in `study_commands.py`,
`record_commands.py` or `model_commands.py`, add it to `COMMANDS` in `application.py`, and its
examples to `examples.toml`. Work of many lines is in `scenarios.commands`.
"""

from __future__ import annotations

from typing import Any

__all__ = ["app", "main"]


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit.

    The exit code is 0 for success, 2 for bad usage or input (with one line on stderr), 130 after
    Ctrl-C, and 1 for anything else.
    """
    try:
        from scenarios.cli.application import run_typed
    except KeyboardInterrupt:
        raise SystemExit(130) from None
    run_typed(arguments)


def __getattr__(name: str) -> Any:
    """Return ``app``, the application; it is built at the first request."""
    if name == "app":
        from scenarios.cli.application import app

        return app
    raise AttributeError(name)
