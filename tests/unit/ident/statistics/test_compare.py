"""Differences between estimates: single ones, all together, and what cannot be compared."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from ident.estimate import Estimate, Outcome
from ident.statistics.residuals import compare_estimates
from sim.errors import ModelError


def estimate(
    names: tuple[str, ...], values: list[float], covariance: np.ndarray, unit: str = "1"
) -> Estimate:
    return Estimate(
        "ekf",
        names,
        (unit,) * len(names),
        np.array(values),
        covariance,
        Outcome.CONVERGED,
        0.0,
        ("q",),
        np.ones(1),
        (),
    )


def test_z_scores_use_both_covariances_and_the_largest_comes_first() -> None:
    a = estimate(("x", "y", "z"), [1.0, 2.0, 3.0], np.diag([9.0, 1.0, 4.0]))
    b = estimate(("z", "w", "y"), [3.5, 0.0, 7.0], np.diag([0.0, 1.0, 3.0]))
    out = compare_estimates(a, b)
    assert [item.name for item in out.differences] == ["y", "z"]
    assert [item.z for item in out.differences] == pytest.approx([5.0 / 2.0, 0.5 / 2.0])
    assert [item.name for item in out.beyond] == ["y"]
    assert out.degrees == 2 and out.statistic == pytest.approx(2.5**2 + 0.25**2)
    assert out.p_value == pytest.approx(chi2.sf(out.statistic, 2))


def test_correlation_enters_the_joint_test_only() -> None:
    P = np.array([[1.0, 0.99], [0.99, 1.0]])
    a, b = estimate(("x", "y"), [0.0, 0.0], 0.5 * P), estimate(("x", "y"), [1.0, -1.0], 0.5 * P)
    out = compare_estimates(a, b)
    assert not out.beyond
    assert out.statistic == pytest.approx(np.array([1.0, -1.0]) @ np.linalg.solve(P, [1.0, -1.0]))
    assert out.p_value < 1e-9


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("away", "beyond"), [(2.9, False), (3.1, True)])
def test_a_difference_is_beyond_the_limit_on_either_side(
    sign: float, away: float, beyond: bool
) -> None:
    a, b = (
        estimate(("x",), [1.0], np.diag([9.0])),
        estimate(("x",), [1.0 + sign * 5.0 * away], np.diag([16.0])),
    )
    forwards, backwards = compare_estimates(a, b, 3.0), compare_estimates(b, a, 3.0)
    assert [item.beyond for item in (*forwards.differences, *backwards.differences)] == [
        beyond,
        beyond,
    ]
    assert forwards.differences[0].z == pytest.approx(sign * away) == -backwards.differences[0].z
    assert (
        forwards.p_value == pytest.approx(backwards.p_value) == pytest.approx(chi2.sf(away**2, 1))
    )


def test_nothing_in_common_and_other_units_are_refused() -> None:
    a = estimate(("x",), [0.0], np.eye(1))
    with pytest.raises(ModelError, match="no parameter in common"):
        compare_estimates(a, estimate(("y",), [0.0], np.eye(1)))
    with pytest.raises(ModelError, match="comparison, x: one is in 1, the other in s"):
        compare_estimates(a, estimate(("x",), [0.0], np.eye(1), "s"))
