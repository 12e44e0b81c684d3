"""`flightid watch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scenarios.cli.completion import of
from scenarios.cli.options import AsJson, Channels, Columns, Out, Quiet
from scenarios.preparation.plan import plan_of


def watch(
    record: Annotated[str, typer.Argument(metavar="RECORD|-", help="A CSV file that grows, or - for standard input.")],
    model: Annotated[
        str,
        typer.Option(
            "--model",
            metavar="M",
            autocompletion=of("loes", "rigid", "lateral", "longitudinal"),
            help="loes, rigid, lateral, longitudinal, or your own model file.",
        ),
    ],
    vehicle: Annotated[Path | None, typer.Option("--vehicle", metavar="V.toml", help="Constants and starting values.")] = None,
    reference: Annotated[
        Path | None, typer.Option("--reference", metavar="STUDY", help="A study to compare with; without --vehicle the filter starts from it.")
    ] = None,
    channels: Channels = None,
    columns: Columns = None,
    rate: Annotated[float | None, typer.Option("--rate", metavar="HZ", help="Of a stream without a clock: its rows a second.")] = None,
    out: Out = None,
    idle: Annotated[
        float | None, typer.Option("--idle", min=0.0, metavar="S", help="End after so many seconds without a row; a file: 5, a pipe: never.")
    ] = None,
    until_end: Annotated[bool, typer.Option("--until-end", help="Do not wait for the file to grow.")] = False,
    refine: Annotated[bool, typer.Option(help="Linearise anew on the way, and refine over all rows when the stream has ended.")] = True,
    page: Annotated[bool, typer.Option("--page", help="Serve a page of the stream to the browser of this machine, until Ctrl-C.")] = False,
    port: Annotated[int | None, typer.Option("--port", min=1, max=65535, metavar="N", help="The page's port; without it 8040 or a free one.")] = None,
    band: Annotated[
        tuple[float, float] | None, typer.Option("--band", metavar="LOW HIGH", help="Hz, of the regression in the frequency domain: 0.1 2.")
    ] = None,
    quiet: Quiet = False,
    as_json: AsJson = False,
) -> None:
    """Identification of a stream: rows as they arrive, estimates against a reference."""
    from scenarios.cli.telling import telling
    from scenarios.commands.watch import watch_stream

    plan = plan_of(rate=rate, columns=columns)
    with telling(out, (), quiet=quiet, as_json=as_json, documents=["comparison.json"]) as told:
        watch_stream(record, model, vehicle, reference, channels, told.out, idle, until_end, refine, page, port, plan, band)
