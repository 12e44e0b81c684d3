"""Simulate a flight vehicle, identify it from its record, and trace what the model lacks.

    import flightid as fid

    record = fid.read_record(frame)
    found = fid.identify(record, model="rigid", vehicle="vehicle.toml")
    found.to_dataframe()

Names are loaded when they are first used, so that the import itself takes no time; the work is done
in `scenarios.api`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from flightid.hiding import refuse_hidden

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

# Where each name stands.
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

refuse_hidden(__file__)


def __getattr__(name: str) -> Any:
    """A public name, loaded from where it stands (PEP 562)."""
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
