"""The command line: what each command takes; the work is done in `scenarios.commands`, imported when it is run."""

from scenarios.cli.application import app
from scenarios.cli.entry import main

__all__ = ["app", "main"]
