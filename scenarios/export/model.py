"""The model of a study, ready to be written for other programs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.files.declarations import read_toml_source
from scenarios.files.vehicles import AIRCRAFT, BESIDE
from scenarios.kept import read_kept
from sim.declaration.compile import compile_model
from sim.errors import DeclarationError, ModelError

if TYPE_CHECKING:
    from scenarios.files.user_models import OwnModel
    from sim.declaration.model import Model, System
    from sim.vehicles.aircraft import Aircraft


@dataclass(frozen=True, eq=False)
class ExportedModel:
    """A model with the values that a study found.

    Attributes
    ----------
    name : of the vehicle. model : the name of its equations. made_by : the command of the study.
    system : compiled, with its values and starting states; SI and radians.
    aircraft : the declaration of a model ``aircraft`` with these values, None of others.
    remarks : sentences on what the written model leaves out.
    """

    name: str
    model: str
    made_by: str
    system: System
    aircraft: Aircraft | None = None
    remarks: tuple[str, ...] = field(default=())

    @property
    def identifier(self) -> str:
        """The vehicle's name in letters, digits and underscores."""
        text = re.sub(r"\W+", "_", self.name, flags=re.ASCII).strip("_")
        return text if text and not text[0].isdigit() else f"model_{text}".rstrip("_")

    def aircraft_for(self, target: str, holds: str) -> Aircraft:
        """The declaration of the aircraft, for a format that holds nothing else.

        Parameters
        ----------
        target : of ``--to``. holds : what the format is for, as a sentence begins.

        Raises
        ------
        DeclarationError : a model of another kind.
        """
        if self.aircraft is None:
            raise DeclarationError(
                f"{holds}, and this is a model {self.model}",
                where=f"--to {target}",
                remedy="export a study of the model aircraft, or use --to python",
            )
        return self.aircraft


def exported(
    name: str,
    model: Model,
    values: Mapping[str, float] | None = None,
    starts: Mapping[str, float] | None = None,
    aircraft: Aircraft | None = None,
    made_by: str = "declaration",
) -> ExportedModel:
    """A model with values, compiled.

    Parameters
    ----------
    values : of parameters; others keep those of the model. starts : of states.
    aircraft : what the model was made of, of a model ``aircraft``.

    Raises
    ------
    DeclarationError : an effect of the model needs the whole record.
    """
    known = {item.name for item in model.parameters}
    chosen = {name: value for name, value in (values or {}).items() if name in known}
    model = model.with_values(chosen)
    given = {item.name for item in model.initial}
    model = model.with_initial(
        model.initial.with_values({n: v for n, v in (starts or {}).items() if n in given})
    )
    remarks = []
    try:
        system = compile_model(model)
        if system.input_stages or system.sensor_stages:
            system = compile_model(model, online=True)
            remarks.append("Delays and lags of inputs and sensors are written as states.")
        if system.input_stages or system.sensor_stages:
            left = ", ".join((*system.input_stages, *system.sensor_stages))
            remarks.append(f"Left out, since they act on whole records: {left}.")
    except ModelError as error:
        raise DeclarationError(error.what, where="export", remedy=error.remedy) from error
    if aircraft is not None:
        aircraft = aircraft.with_values(chosen)
    return ExportedModel(name, model.name, made_by, system, aircraft, tuple(remarks))


def model_of_study(folder: Path, user_model: Path | OwnModel | None = None) -> ExportedModel:
    """The model that a folder of ``identify`` or ``diagnose`` keeps, that which ``structure`` wrote
    into one, or that of a vehicle file of model ``aircraft``.

    Parameters
    ----------
    folder : of the study, or the file. user_model : the study's own model, which is run.

    Raises
    ------
    DeclarationError : no study, or one that keeps no model.
    """
    from scenarios.preparation.declared_model import model_of_file

    if (folder / "structure.json").is_file() and (folder / BESIDE).is_file():
        folder = folder / BESIDE
    if folder.is_file() and folder.suffix == ".toml":
        from scenarios.files.aircraft_files import read_aircraft
        from sim.vehicles.aircraft import aircraft_model

        aircraft, _ = read_aircraft(read_toml_source(folder))
        return exported(aircraft.name, aircraft_model(aircraft), aircraft=aircraft)
    from scenarios.prediction import vehicle_of_study

    file = read_kept(folder)
    vehicle = vehicle_of_study(file, user_model)
    kept = file.model()
    model = model_of_file(vehicle)
    if kept.after.effects:
        model = model.with_effects(*kept.after.effects)
    starts = {
        key[:-3]: value
        for key, value in (kept.after.own[0] if kept.after.own else {}).items()
        if key.endswith("(0)")
    }
    declared = None
    if kept.model == AIRCRAFT:
        declared = _aircraft_of(kept.vehicle_text, folder)
    return exported(vehicle.name, model, kept.after.shared, starts, declared, kept.made_by)


def _aircraft_of(text: str, folder: Path) -> Aircraft:
    """The declaration that a study keeps as text."""
    import tempfile

    from scenarios.files.aircraft_files import read_aircraft

    with tempfile.TemporaryDirectory(prefix="flightid-") as scratch:
        path = Path(scratch) / "vehicle.toml"
        path.write_text(text, encoding="utf-8", newline="\n")
        return read_aircraft(read_toml_source(path))[0]
