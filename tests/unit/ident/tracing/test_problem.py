"""Fits of the tracing loop that are kept."""

from __future__ import annotations

import pytest

from ident.tracing.diagnosis import TraceSettings
from ident.tracing.problem import TraceProblem
from ident.tracing.wrong_samples import measured_masks
from sim.maneuvers import Sum, step, three_two_one_one
from sim.vehicles.factory import model_from_constants
from tests.whole_axes import CONSTANTS, NOISE, TRUE, flown, trim


def test_a_fit_that_is_kept_ends_in_one_minimum_from_two_starts(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A small maneuver at constant thrust: polars, biases and airspeed trade off, and 60 iterations
    leave some log likelihood (1.2 here, 1070 on an independent flight), which looks like an effect.
    """
    _, elevator, thrust = trim()
    small = {
        "elevator": Sum((step(elevator), three_two_one_one(0.01, 0.3, 1.0))),
        "thrust": step(thrust),
    }
    monkeypatch.setattr("tests.whole_axes.maneuvers", lambda model: small)
    record, names = flown("longitudinal", seed=1), tuple(NOISE["longitudinal"])
    costs = []
    for share in (0.75, 1.3):
        values = {name: share * value for name, value in TRUE["longitudinal"].items()}
        model = model_from_constants("longitudinal", CONSTANTS["longitudinal"], values)
        problem = TraceProblem(
            [record],
            measured_masks([record], names),
            model.with_biases(names),
            (),
            names,
            TraceSettings(max_step=0.04),
        )
        fitted = problem.fit((), None)
        assert fitted is not None
        costs.append(fitted.fit.cost)
    assert costs[0] == pytest.approx(costs[1], abs=0.05)
