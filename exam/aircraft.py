"""Random aircraft for trials of the tracing loop."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim.declaration.model import Model
from sim.vehicles.factory import model_from_constants

NOISE = {"alpha": 0.0012, "q": 0.0015, "nz": 0.012}


AIRCRAFT: Mapping[str, Mapping[str, float]] = {
    "light": {
        "mass": 1150.0,
        "wing_area": 16.2,
        "chord": 1.5,
        "pitch_inertia": 1820.0,
        "airspeed": 55.0,
        "air_density": 1.1,
    },
    "fighter": {
        "mass": 7500.0,
        "wing_area": 30.0,
        "chord": 2.4,
        "pitch_inertia": 32000.0,
        "airspeed": 130.0,
        "air_density": 0.96,
    },
    "transport": {
        "mass": 60000.0,
        "wing_area": 122.0,
        "chord": 4.2,
        "pitch_inertia": 3.3e6,
        "airspeed": 190.0,
        "air_density": 0.74,
    },
}


USUAL = {
    "CL_alpha": 5.2,
    "CL_q": 7.0,
    "CL_de": 0.4,
    "Cm_alpha": -0.95,
    "Cm_q": -17.0,
    "Cm_de": -1.3,
}


def drawn_aircraft(rng: np.random.Generator) -> tuple[str, Model]:
    """Draw one of ``AIRCRAFT`` with derivatives within 20 % of usual ones."""
    name = sorted(AIRCRAFT)[int(rng.integers(len(AIRCRAFT)))]
    derivatives = {key: value * rng.uniform(0.8, 1.2) for key, value in USUAL.items()}
    return name, model_from_constants("rigid", AIRCRAFT[name], derivatives)
