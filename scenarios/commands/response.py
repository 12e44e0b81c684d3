"""`flightid response`: frequency responses, printed and written."""

from __future__ import annotations

from pathlib import Path

from scenarios.plots.formats import Formats
from scenarios.preparation.request import Request
from scenarios.responses.analysis import Options, responses_of
from scenarios.responses.fitting import FitOptions
from scenarios.responses.qualities import LevelOptions
from scenarios.responses.reading import Names
from scenarios.responses.text import print_responses
from scenarios.terminal.summary import details_in, written_to

Texts = tuple[str, ...]


def respond(
    request: Request,
    names: tuple[Texts, Texts, Texts],
    options: tuple[tuple[float, float] | None, tuple[float, ...], int, float],
    fit: tuple[Texts, Texts, bool],
    bandwidth: str | None,
    margins: str | None,
    levels: tuple[str | None, float | None],
    out: Path | None,
    figures: Formats,
) -> None:
    """Read, estimate, write the folder, print.

    ``names`` : inputs, outputs, references. ``options`` : band, windows, tapers, least coherence.
    ``fit`` : forms, fixed parameters, shared poles. ``bandwidth`` : rate or attitude, what the outputs are.
    ``margins`` : minus or plus, how the loop takes back the output.
    ``levels`` : class and category, airspeed.
    """
    found = responses_of(request, Names(*names), Options(*options), FitOptions(*fit), bandwidth, margins, LevelOptions(*levels))
    if out is not None:
        from scenarios.responses.files import write_responses

        write_responses(found, out, figures=figures)
    print_responses(found, details=details_in(out))
    if out is not None:
        print(written_to(out))
