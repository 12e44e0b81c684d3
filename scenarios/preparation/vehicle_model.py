"""From a user's vehicle file to the model it declares: constants held, derivatives free, started where the file says."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from scenarios.files.constraints import constrained
from scenarios.files.own_models import inputs_at_rest, is_own
from scenarios.files.vehicles import VehicleFile, with_priors
from sim.declaration.compile import compile_model
from sim.declaration.model import Biased, Model, System
from sim.maths import complex_step_jacobian
from sim.record import Record
from sim.vehicles.factory import MODE_CONSTANTS, model_from_constants

# The vehicle file speaks of frequency and damping; the equations of omega and zeta.
FILE_NAMES = {"frequency": "omega", "damping": "zeta", "generalized_mass": "generalized_mass"}
SLOW = 1e-9  # rad/s, below which a root is an integrator
RESOLVED = 0.15  # of a root's time: a Runge-Kutta step of that length is good to a millionth
FINEST = 200.0  # sub-steps between samples: what is quicker still does not show
RARE = 10.0  # usual sub-steps: samples that lie farther apart are of a slower motion


def model_of_file(vehicle: VehicleFile) -> Model:
    """The declared model of a vehicle file for one of ``MODELS``.

    Each free parameter gets a prior standard deviation of half its starting value (files may be 30 % wrong), for
    filters, which need one; whole-record fits use priors only where the data alone cannot fix a scale.
    """
    if vehicle.own is not None:
        return constrained(with_priors(vehicle.own, list(vehicle.derivatives)), vehicle.constraints)
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
    return constrained(with_priors(model, free), vehicle.constraints)


def outputs_with_bias(model: Model, outputs: Sequence[str]) -> list[str]:
    """Which of the outputs have a free constant bias in a fit: those that the equations name, else all but an altitude.

    Of a falling body an altitude's bias is the same as another ballistic coefficient.
    """
    if isinstance(model.equations, Biased):
        return [name for name in outputs if name in model.equations.biased_outputs]
    return [name for name in outputs if name != "altitude"]


def step_for(model: Model, records: Sequence[Record], usual: float) -> float:
    """Longest integration sub-step, s: ``usual`` but for an own model, whose motion may be a thousand times slower or faster than an aircraft's.

    A share of the quickest root's time, never longer than the usual one or, where samples are rarer, than the sampling interval.
    """
    if not is_own(model) or not records:
        return usual
    return step_of(model, float(np.median(np.diff(records[0].time))), usual)


def step_of(model: Model, interval: float, usual: float) -> float:
    """That sub-step of an own model for samples ``interval`` apart, s."""
    sizes = root_sizes(compile_model(model), inputs_at_rest(model))
    quick = RESOLVED / float(np.max(sizes)) if len(sizes) else math.inf
    return min(max(quick, interval / FINEST), usual if interval <= RARE * usual else interval)


def root_sizes(system: System, u: list[float]) -> np.ndarray:
    """Sizes of the roots about the initial state, rad/s, integrators left out; none where the slopes are not finite."""
    p = system.parameters.values().tolist()
    slopes = complex_step_jacobian(lambda x: system.f(0.0, x, u, p), system.initial.values().tolist())
    sizes = np.abs(np.linalg.eigvals(slopes)) if np.all(np.isfinite(slopes)) else np.zeros(0)
    return np.asarray(sizes[sizes > SLOW])


def _coupling(name: str, modes: int) -> bool:
    """Couplings between two modes are held at what the file says."""
    return any(name in (f"Ceta{i}_eta{j}", f"Ceta{i}_etadot{j}") for i in range(1, modes + 1) for j in range(1, modes + 1) if i != j) or any(
        name == f"{local}{i}" for local in MODE_CONSTANTS for i in range(1, modes + 1)
    )
