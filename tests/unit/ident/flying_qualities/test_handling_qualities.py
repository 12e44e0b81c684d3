"""Flying qualities against closed forms, a Monte-Carlo of their sigmas, and the edges of every
level.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.estimate import Estimate, Outcome
from ident.flying_qualities.levels import (
    LevelCriterion,
    Quality,
    criteria,
    level_of,
    levels,
    qualities,
)
from sim.errors import ModelError
from tests.bases import LOES_CONSTANTS, LOES_VALUES

V, G = LOES_CONSTANTS["airspeed"], LOES_CONSTANTS["gravity"]
SIGMA = {
    "L_alpha": 0.02,
    "M_alpha": 0.1,
    "L_delta": 1e-5,
    "M_delta": 0.003,
    "L_q": 0.004,
    "M_q": 0.05,
    "inv_tau": 0.2,
    "delay": 0.002,
}


def estimate(values: dict[str, float] = LOES_VALUES) -> Estimate:
    names, std = tuple(values), np.array([SIGMA[name] for name in values])
    correlation = np.full((len(std), len(std)), 0.3) + 0.7 * np.eye(len(std))
    units = ("1",) * len(names)
    covariance = correlation * np.outer(std, std)
    return Estimate(
        "ekf",
        names,
        units,
        np.array(list(values.values())),
        covariance,
        Outcome.CONVERGED,
        0.0,
        ("q",),
        np.ones(1),
        (),
    )


def by_name(e: Estimate, fixed: dict[str, float] | None = None) -> dict[str, Quality]:
    return {quality.name: quality for quality in qualities(e, V, G, fixed)}


def test_values_are_those_of_the_state_equations() -> None:
    v = LOES_VALUES
    A = np.array([[v["L_alpha"], v["L_q"]], [v["M_alpha"], v["M_q"]]])
    root = np.linalg.eigvals(A)[0]
    found = by_name(estimate())
    assert found["natural_frequency"].value == pytest.approx(abs(root))
    assert found["damping_ratio"].value == pytest.approx(-root.real / abs(root))
    alpha, q = np.linalg.solve(A, -np.array([v["L_delta"], v["M_delta"]]))
    assert found["load_factor_slope"].value == pytest.approx(V / G * q / alpha)
    assert found["control_anticipation"].value == pytest.approx(
        abs(root) ** 2 / (V / G * q / alpha)
    )
    assert found["total_delay"].value == pytest.approx(v["delay"] + 1.0 / v["inv_tau"])


def test_sigmas_are_those_of_a_sample() -> None:
    e = estimate()
    draws = np.random.default_rng(1).multivariate_normal(e.values, e.covariance, 3000)
    sample: dict[str, list[float]] = {}
    for row in draws:
        for name, quality in by_name(replace(e, values=row)).items():
            sample.setdefault(name, []).append(quality.value)
    for name, quality in by_name(e).items():
        assert quality.std == pytest.approx(np.std(sample[name]), rel=0.06), name


def test_fixed_parameters_carry_no_uncertainty_and_missing_ones_are_named() -> None:
    part = estimate({name: value for name, value in LOES_VALUES.items() if name != "delay"})
    assert by_name(part, {"delay": 0.1})["delay"] == Quality("delay", 0.1, 0.0, "s")
    with pytest.raises(ModelError, match="handling qualities, delay"):
        qualities(part, V, G)


def test_an_aperiodic_short_period_has_no_frequency() -> None:
    found = by_name(estimate({**LOES_VALUES, "M_alpha": 20.0}))
    assert "natural_frequency" not in found and "control_anticipation" not in found
    assert found["delay"].value == LOES_VALUES["delay"]


@pytest.mark.parametrize("criterion", criteria(), ids=lambda c: f"{c.quantity} {c.category}")
def test_edges_of_every_level(criterion: LevelCriterion) -> None:
    assert criterion.source and len(criterion.levels) == 3
    inner = 0.5 * (
        criterion.levels[0][0] + min(criterion.levels[0][1], criterion.levels[0][0] + 1e-6)
    )
    assert level_of(inner, criterion) == 1
    for number, (low, high) in enumerate(criterion.levels, start=1):
        for edge, outward in ((low, -1.0), (high, 1.0)):
            if not np.isfinite(edge):
                continue
            assert level_of(edge, criterion) <= number
            assert (
                level_of(np.nextafter(edge, outward * np.inf), criterion) > number
                or edge == 0.0
                or edge in _shared(criterion, number)
            )
    for better, worse in zip(criterion.levels[:-1], criterion.levels[1:], strict=True):
        assert worse[0] <= better[0] and worse[1] >= better[1], (
            "a worse level holds the better one's range"
        )


def _shared(criterion: LevelCriterion, number: int) -> set[float]:
    """Edges of a level that a better or an equal one shares."""
    return {edge for other in criterion.levels[: number - 1] for edge in other}


def test_uncertainty_that_crosses_a_boundary_shows() -> None:
    rule = LevelCriterion(
        "damping_ratio", "A", ((0.35, 1.3), (0.25, 2.0), (0.15, float("inf"))), "test"
    )
    cases = [
        (0.40, 0.01, (1, 1, 1)),
        (0.36, 0.01, (1, 1, 2)),
        (0.2, 0.2, (3, 1, 4)),
        (0.8, 0.4, (1, 1, 4)),
        (2.5, 0.1, (3, 3, 3)),
    ]
    for value, std, expected in cases:
        (found,) = levels([Quality("damping_ratio", value, std, "1")], [rule])
        assert (found.level, found.best, found.worst) == expected
        assert found.uncertain == (expected[1] != expected[2])
