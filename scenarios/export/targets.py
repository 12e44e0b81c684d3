"""What writes the model of a study for each target."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from scenarios.export.model import ExportedModel, model_of_study
from scenarios.files.writing import write_content
from sim.errors import DeclarationError


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


def _dave_ml(model: ExportedModel) -> tuple[bytes, str]:
    from scenarios.export.dave_ml import dave_ml_file

    return dave_ml_file(model).encode(), "coefficients and check cases, no equations of motion"


# By target: what writes the file, and the ending of its name.
_WRITERS: dict[str, tuple[Callable[[ExportedModel], tuple[bytes, str]], str]] = {
    "python": (_python, ".py"),
    "fmu": (_fmu, ".fmu"),
    "jsbsim": (_jsbsim, ".xml"),
    "dave-ml": (_dave_ml, ".dml"),
}


def written_model(
    study: Path, to: str, out: Path | None, model: Path | None
) -> tuple[Path, ExportedModel, str]:
    """Read the study's model and write it for a target: the file, the model, and a remark.

    Parameters
    ----------
    study : folder, or a vehicle file. to : the target. out : the file. model : the user's own.

    Raises
    ------
    DeclarationError : no such target, no model in the study, or one that cannot be written.
    """
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
    return path, found, told
