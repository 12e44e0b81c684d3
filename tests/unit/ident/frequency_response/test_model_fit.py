"""A short period fitted to two responses at once: the truth without noise, deviations with it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from ident.frequency_response.model_fit import fit_model
from ident.frequency_response.transfer_function import (
    ResponseTarget,
    mismatch_cost,
    neighbour_correlation,
)
from sim.errors import ModelError

OMEGA = np.geomspace(0.5, 20.0, 50)
TRUE = {"Z_a": -1.2, "M_a": -8.0, "M_q": -2.0, "M_d": -6.0, "delay": 0.05}
LENGTH = 20.0


def responses(p: Mapping[str, float], omega: np.ndarray = OMEGA) -> list[np.ndarray]:
    """Angle of attack and pitch rate of a short period over the elevator."""
    A = np.array([[p["Z_a"], 1.0], [p["M_a"], p["M_q"]]])
    B = np.array([0.0, p["M_d"]])
    late = np.exp(-1j * omega * p["delay"])
    x = np.array([np.linalg.solve(1j * w * np.eye(2) - A, B) for w in omega]).T
    return [x[0] * late, x[1] * late]


def targets(share: float, rng: np.random.Generator | None = None) -> list[ResponseTarget]:
    out = []
    apart = np.subtract.outer(OMEGA, OMEGA) / (2.0 * np.pi) * LENGTH
    root = np.linalg.cholesky(neighbour_correlation(apart) + 1e-9 * np.eye(OMEGA.size))
    for name, exact in zip(("alpha", "q"), responses(TRUE), strict=True):
        noise = np.zeros(OMEGA.size, dtype=complex)
        if rng is not None:
            noise = root @ rng.standard_normal(OMEGA.size) + 1j * (
                root @ rng.standard_normal(OMEGA.size)
            )
        measured = exact * (1.0 + share * noise)
        std = share * np.abs(measured)
        out.append(ResponseTarget(name, OMEGA, measured, np.full(OMEGA.size, 0.95), std, LENGTH))
    return out


def start(share: float) -> dict[str, float]:
    return {name: share * value for name, value in TRUE.items()}


@pytest.mark.parametrize("share", [0.75, 1.3])
def test_without_noise_the_truth_is_found(share: float) -> None:
    found = fit_model(targets(1e-4), responses, start(share), {}, {"delay": 0.0})
    assert found.converged and found.cost < 1e-6
    np.testing.assert_allclose(found.values, list(TRUE.values()), rtol=1e-4)


@pytest.mark.long
def test_deviations_hold_over_seeds() -> None:
    z = []
    for seed in range(20):
        given = targets(0.05, np.random.default_rng(seed))
        found = fit_model(given, responses, start(0.8), {}, {"delay": 0.0})
        z.append((found.values - np.array(list(TRUE.values()))) / found.std)
    errors = np.array(z)
    # 100 of 95 %, five of which are near one another: 88 % is two and a half deviations.
    assert np.mean(np.abs(errors) < 1.96) > 0.88
    assert np.all(errors.std(axis=0) < 1.6)


def test_bound_and_insensitivity_are_of_the_curvature() -> None:
    """Against second differences of the sum of the costs."""
    given = targets(0.05, np.random.default_rng(1))
    free = {name: value for name, value in TRUE.items() if name != "delay"}
    found = fit_model(given, responses, free, {"delay": TRUE["delay"]})

    def cost(p: np.ndarray) -> float:
        values = {"delay": TRUE["delay"], **dict(zip(found.names, p.tolist(), strict=True))}
        models = responses(values)
        return sum(
            mismatch_cost(each.response, model, each.coherence)
            for each, model in zip(given, models, strict=True)
        )

    steps = 1e-3 * np.abs(found.values)
    size = len(steps)
    hessian = np.empty((size, size))
    for i in range(size):
        for j in range(size):
            moves = [
                sa
                * sb
                * cost(found.values + sa * steps * np.eye(size)[i] + sb * steps * np.eye(size)[j])
                for sa in (1.0, -1.0)
                for sb in (1.0, -1.0)
            ]
            hessian[i, j] = sum(moves) / (4.0 * steps[i] * steps[j])
    exact = 1.0 / np.sqrt(np.diag(hessian))
    np.testing.assert_allclose(found.insensitivity, exact, rtol=0.05)
    bound = 2.0 * np.sqrt(np.diag(np.linalg.inv(hessian)))
    np.testing.assert_allclose(found.cramer_rao, bound, rtol=0.1)
    assert found.as_dict["delay"] == TRUE["delay"] and "delay" not in found.names


def test_refusals() -> None:
    with pytest.raises(ModelError, match="0 free parameters"):
        fit_model(targets(0.1), responses, {}, TRUE)

    def broken(p: Mapping[str, float]) -> list[np.ndarray]:
        return [np.full(OMEGA.size, np.nan, dtype=complex)] * 2

    with pytest.raises(ModelError, match="no finite responses"):
        fit_model(targets(0.1), broken, start(1.0), {})
