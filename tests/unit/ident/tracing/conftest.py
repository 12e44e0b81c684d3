"""A fitted model that several tests share."""

from __future__ import annotations

import pytest

from ident.tracing.fitted_model import FittedModel
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_timing import SensorLag
from tests.tracing_problem import fit_of, planted, problem_of

PULSE = {
    "unmeasured-input.start": 4.0,
    "unmeasured-input.duration": 0.8,
    "unmeasured-input.moment": 0.006,
    "unmeasured-input.lift": 0.0,
}
LAG = {"sensor-lag:q.time_constant": 0.05}


@pytest.fixture(scope="module")
def fitted() -> FittedModel:
    """Two records, a shared effect and one of each record."""
    effects = (SensorLag("q"), UnmeasuredInput())
    problem = problem_of([planted(effects, {**LAG, **PULSE}, seed) for seed in (1, 2)])
    return fit_of(problem, effects, None, {**LAG, **PULSE})
