"""`flightid lab`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def lab(
    number: Annotated[int | None, typer.Argument(metavar="N", help="Number of the lab; all are listed when left out.")] = None,
    edit: Annotated[bool, typer.Option("--edit", help="Open a copy of your own in the editor, not as a page.")] = False,
    copy: Annotated[Path | None, typer.Option("--copy", metavar="DIR", help="Write a copy of your own into this folder.")] = None,
    key: Annotated[bool, typer.Option("--key", help="Print the instructor's key.")] = False,
    port: Annotated[int | None, typer.Option("--port", min=1, max=65535, metavar="P", help="Port on this machine; else a free one.")] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open it in a browser.")] = True,
) -> None:
    """A teaching notebook, opened in a browser."""
    from scenarios.commands.lab import copy_lab, list_labs, open_lab, show_key

    if number is None:
        list_labs()
    elif key:
        show_key(number)
    elif copy is not None and not edit:
        copy_lab(number, copy)
    else:
        raise SystemExit(open_lab(number, edit, port, browser, copy))
