"""`flightid map`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.options import ClockRate, Columns


def map_(
    record: Annotated[Path, typer.Argument(metavar="FILE", help="A recorder's file, in any format.")],
    rate: ClockRate = None,
    columns: Columns = None,
    topics: Annotated[bool, typer.Option("--topics", help="Show every topic of a log.")] = False,
    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Write channels.toml and vehicle.toml into this folder.")] = None,
) -> None:
    """What a recorder's file holds, with a draft of the channel map and of the vehicle file."""
    from scenarios.commands.map import draft_map

    draft_map(record, out, rate, columns, topics)
