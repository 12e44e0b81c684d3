"""The command line: options of each command, and its call of the functions that do the work."""

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
