"""`flightid identify`: a measured record to parameters, printed and written."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scenarios.identification.result import PLAIN, Options
from scenarios.plots.formats import Formats
from scenarios.preparation.request import Request

ALL = "all"  # of --profile: every parameter


def options_of(profile: Sequence[str] | None, band: tuple[float, float] | None, engine: str | None = None) -> Options:
    """What a command line asks besides the method."""
    names = None if profile is None else () if ALL in profile else tuple(dict.fromkeys(profile))
    return Options(names, band, engine)


def identify_records(
    request: Request, method: str, out: Path | None, figures: Formats, options: Options = PLAIN, matrices: Path | None = None
) -> None:
    """Read, identify, write the study and the linearised model's ``matrices``, print."""
    from scenarios.files.measured.record_file import path_of
    from scenarios.identification.from_files import identify_files
    from scenarios.identification.report.text import print_identification
    from scenarios.identification.state_space import refuse_place, state_space_of, write_state_space
    from scenarios.terminal.summary import details_in, written_to

    if matrices is not None:
        ours = [out / "comparison.json", out / "record.csv"] if out is not None else []
        given = [path for record in (*request.records, *request.validate) if (path := path_of(record)) is not None]
        refuse_place(matrices, [*given, *ours])
    identified = identify_files(request, method, options)
    space = state_space_of(identified.found) if matrices is not None else None
    if out is not None:
        from scenarios.identification.report.files import write_identification

        write_identification(identified, out, figures=figures)
    print_identification(identified.found, identified.flown, details=details_in(out))
    if matrices is not None and space is not None:
        write_state_space(space, matrices)
        print(f"matrices written to {matrices}")
    if out is not None:
        print(written_to(out))
