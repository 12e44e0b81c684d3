"""Work of the commands on model structure and on models for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.files.writing import write_content
from scenarios.preparation.plan import Request
from scenarios.report.figure_formats import Formats
from scenarios.report.summary import written_to
from scenarios.report.text_tables import terminal_width
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.export.model import ExportedModel
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


def _python(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.python_module import python_module

    return python_module(model).encode(), "needs NumPy alone"


def _fmu(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.fmu import fmu

    return fmu(model)


def _jsbsim(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.jsbsim import jsbsim_file

    name = model.identifier
    return jsbsim_file(model).encode(), f"JSBSim loads it as aircraft/{name}/{name}.xml"


# By target: what writes the file, and the ending of its name.
_WRITERS: dict[str, tuple[Callable[[ExportedModel], tuple[bytes, str]], str]] = {
    "python": (_python, ".py"),
    "fmu": (_fmu, ".fmu"),
    "jsbsim": (_jsbsim, ".xml"),
}


def export_model(study: Path, to: str, out: Path | None, model: Path | None) -> None:
    """Read the study's model, write it for a target, print a line.

    Parameters
    ----------
    study : folder, or a vehicle file. to : the target. out : the file. model : the user's own.

    Raises
    ------
    DeclarationError : no such target, no model in the study, or one that cannot be written.
    """
    from scenarios.export.model import model_of_study

    if to not in _WRITERS:
        raise DeclarationError(
            f"there is no target {to!r}", where="--to", remedy=f"use {' or '.join(_WRITERS)}"
        )
    write, ending = _WRITERS[to]
    found = model_of_study(study, model)
    content, told = write(found)
    path = out or Path(f"{found.identifier}{ending}")
    if path.is_dir():
        remedy = f"name a file, {path / (found.identifier + ending)}"
        raise DeclarationError("this is a folder", where=str(path), remedy=remedy)
    write_content(path, content)
    print(f"{path}: {found.model} model of {found.name}, {told}")
    for remark in found.remarks:
        print(f"note: {remark}")
