"""Simulate a flight vehicle, identify it from its record, and trace what the model lacks.

    import flightid as fid

    record = fid.read_record(frame)
    found = fid.identify(record, model="rigid", vehicle="vehicle.toml")
    found.to_dataframe()

Names are loaded when they are first used, so that the import itself takes no time; the work is done
in `scenarios.api`.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from flightid import plot
    from scenarios.api import estimators
    from scenarios.api.checks import (
        Check,
        FrequencyResponse,
        Maneuvers,
        check,
        find_maneuvers,
        frequency_response,
    )
    from scenarios.api.design import Design, Structure, design, export, structure
    from scenarios.api.diagnosis import Diagnosis, Survey, diagnose, survey
    from scenarios.api.identification import Identification, Prediction, identify, predict
    from scenarios.api.record import Record, read_record
    from scenarios.api.shown import Parameter, Parameters
    from scenarios.api.study import Campaign, Study, campaign, run, simulate
    from scenarios.api.tables import InputError, Table, effects, models, scenarios, vehicles
    from scenarios.api.vehicle import Vehicle, vehicle
    from sim.declaration import own_model

    __version__: str

# Module of each name.
_EXPORTS = {
    **dict.fromkeys(("Campaign", "campaign"), "study"),
    **dict.fromkeys(("Check", "check"), "checks"),
    **dict.fromkeys(("Design", "design"), "design"),
    **dict.fromkeys(("Diagnosis", "diagnose"), "diagnosis"),
    **dict.fromkeys(("FrequencyResponse", "frequency_response"), "checks"),
    "InputError": "tables",
    **dict.fromkeys(("Identification", "identify"), "identification"),
    **dict.fromkeys(("effects", "models", "scenarios", "vehicles"), "tables"),
    **dict.fromkeys(("Maneuvers", "find_maneuvers"), "checks"),
    **dict.fromkeys(("Parameter", "Parameters"), "shown"),
    **dict.fromkeys(("Prediction", "predict"), "identification"),
    **dict.fromkeys(("Record", "read_record"), "record"),
    **dict.fromkeys(("Structure", "export", "structure"), "design"),
    **dict.fromkeys(("Study", "run", "simulate"), "study"),
    **dict.fromkeys(("Survey", "survey"), "diagnosis"),
    "Table": "tables",
    **dict.fromkeys(("Vehicle", "vehicle"), "vehicle"),
}

__all__ = [
    "Campaign",
    "Check",
    "Design",
    "Diagnosis",
    "FrequencyResponse",
    "Identification",
    "InputError",
    "Maneuvers",
    "Parameter",
    "Parameters",
    "Prediction",
    "Record",
    "Structure",
    "Study",
    "Survey",
    "Table",
    "Vehicle",
    "__version__",
    "campaign",
    "check",
    "design",
    "diagnose",
    "effects",
    "estimators",
    "export",
    "find_maneuvers",
    "frequency_response",
    "identify",
    "models",
    "own_model",
    "plot",
    "predict",
    "read_record",
    "run",
    "scenarios",
    "simulate",
    "structure",
    "survey",
    "vehicle",
    "vehicles",
]

_PACKAGES = ("sim", "ident", "scenarios")


def _refuse_hidden(ours: str) -> None:
    """Raise ImportError if a user's module hides a package beside the folder of the file ``ours``.

    The error names the hiding file. Nothing is imported.
    """
    folder = Path(ours).resolve().parent.parent
    for package in _PACKAGES:
        result = _place_of(package)
        if result is not None and result.resolve() != folder / package:
            module = result.with_suffix(".py")
            shown = module if module.is_file() and not result.is_dir() else result
            remedy = (
                "rename it, or move it out of the folders that Python searches (sys.path), then "
                "start Python again"
            )
            # With this name, `python -m flightid` prints the error in one line.
            raise ImportError(
                f"{shown} hides the package {package!r} of flightid: {remedy}",
                name="flightid",
                path=str(shown),
            )


def _place_of(package: str) -> Path | None:
    """Return the folder of a package, or the file of a module without its ending.

    None if there is neither.
    """
    loaded = sys.modules.get(package)
    try:
        spec = loaded.__spec__ if loaded is not None else find_spec(package)
    except ValueError:  # a module without a spec, made by hand
        spec = None
    places = (
        list(getattr(loaded, "__path__", []))
        if loaded is not None
        else list(spec.submodule_search_locations or [])
        if spec is not None
        else []
    )
    if places:
        return Path(places[0])
    file = getattr(loaded, "__file__", None) or (spec.origin if spec is not None else None)
    return Path(file).with_suffix("") if file else None


_refuse_hidden(__file__)


def __getattr__(name: str) -> Any:
    """Return a public name, imported on first use (PEP 562)."""
    from importlib import import_module

    if name in _EXPORTS:
        value = getattr(import_module(f"scenarios.api.{_EXPORTS[name]}"), name)
    elif name == "plot":
        value = import_module("flightid.plot")
    elif name == "estimators":
        value = import_module("scenarios.api.estimators")
    elif name == "own_model":
        value = import_module("sim.declaration").own_model
    elif name == "__version__":
        from scenarios.files.sources import own_version

        value = own_version()
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
