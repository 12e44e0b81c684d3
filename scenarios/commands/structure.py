"""Work of the commands on model structure and on models for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.preparation.plan import Request
from scenarios.report.figure_formats import Formats
from scenarios.report.summary import written_to
from scenarios.report.text_tables import terminal_width

if TYPE_CHECKING:
    from scenarios.structure.study import StructureOptions

# ---- flightid structure


def find_structure(
    request: Request, options: StructureOptions, out: Path | None, figures: Formats
) -> None:
    """Read, choose, write, print.

    Parameters
    ----------
    request : records and vehicle file. options : how terms are offered and chosen. out : folder.
    """
    from scenarios.structure.report import VEHICLE, structure_text, write_structure
    from scenarios.structure.study import structure_of_files

    found = structure_of_files(request, options)
    if out is not None:
        write_structure(found, out, figures=figures)
    print(structure_text(found, terminal_width()), end="")
    if out is not None:
        names = " ".join(str(each) for each in request.records)
        print(
            f"refine: flightid identify {names} --model aircraft --vehicle {out / VEHICLE} "
            "--out FIT"
        )
        print(written_to(out))


# ---- flightid export


def export_model(study: Path, to: str, out: Path | None, model: Path | None) -> None:
    """Read the study's model, write it for a target, print a line: see ``written_model``."""
    from scenarios.export.targets import written_model

    path, found, told = written_model(study, to, out, model)
    print(f"{path}: {found.model} model of {found.name}, {told}")
    for remark in found.remarks:
        print(f"note: {remark}")
