"""From a user's vehicle file to the model it declares: constants held, derivatives free, started where the file says."""

from __future__ import annotations

from collections.abc import Sequence

from scenarios.files.vehicles import VehicleFile
from sim.declaration.model import Biased, Model
from sim.vehicles.factory import MODE_CONSTANTS, model_from_constants

# The vehicle file speaks of frequency and damping; the equations of omega and zeta.
FILE_NAMES = {"frequency": "omega", "damping": "zeta", "generalized_mass": "generalized_mass"}
RELATIVE_PRIOR = 0.5


def model_of_file(vehicle: VehicleFile) -> Model:
    """The declared model of a vehicle file for one of ``MODELS``.

    Each free parameter gets a prior standard deviation of half its starting value (files may be 30 % wrong), for
    filters, which need one; whole-record fits use priors only where the data alone cannot fix a scale.
    """
    if vehicle.own is not None:
        return _with_prior(vehicle.own, list(vehicle.derivatives))
    values = {**vehicle.derivatives}
    constants = {**vehicle.constants}
    for number, mode in vehicle.modes:
        for name, value in mode.items():
            if name in FILE_NAMES:
                constants[f"{FILE_NAMES[name]}{number}"] = value
            else:
                values[name] = value
    kind = "rigid" if vehicle.model == "flexible" else vehicle.model
    start = {"airspeed": constants["reference_airspeed"]} if "reference_airspeed" in constants else {}
    model = model_from_constants(kind, constants, values, modes=len(vehicle.modes), initial=start)
    free = [item.name for item in model.parameters if item.name in values and not _coupling(item.name, len(vehicle.modes))]
    return _with_prior(model, free)


def outputs_with_bias(model: Model, outputs: Sequence[str]) -> list[str]:
    """Which of the outputs have a free constant bias in a fit: those that the equations name, else all but an altitude.

    Of a falling body an altitude's bias is the same as another ballistic coefficient.
    """
    if isinstance(model.equations, Biased):
        return [name for name in outputs if name in model.equations.biased_outputs]
    return [name for name in outputs if name != "altitude"]


def _with_prior(model: Model, free: Sequence[str]) -> Model:
    parameters = model.parameters.only_free(free)
    typical = max((abs(parameters[name].value) for name in free), default=1.0)
    prior = {name: RELATIVE_PRIOR * (abs(parameters[name].value) or 0.01 * typical or 1.0) for name in free}
    return model.with_parameters(parameters.with_prior(prior))


def _coupling(name: str, modes: int) -> bool:
    """Couplings between two modes are held at what the file says."""
    return any(name in (f"Ceta{i}_eta{j}", f"Ceta{i}_etadot{j}") for i in range(1, modes + 1) for j in range(1, modes + 1) if i != j) or any(
        name == f"{local}{i}" for local in MODE_CONSTANTS for i in range(1, modes + 1)
    )
