"""One filter by the bank's engine against filterpy's: the estimate and every part of the
history.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from ident.banks.bank import filter_alone
from ident.estimate import FilterHistory, Outcome
from ident.filters.ekf import FilterSettings, filter_by_filterpy
from ident.filters.problem import filter_problem
from ident.filters.smoother import smooth
from tests import loes_problem as problem


@pytest.mark.parametrize("elsewhere", [False, True], ids=["about itself", "about a trajectory"])
def test_equal_to_the_single_filter(elsewhere: bool) -> None:
    flown = problem.record(3, duration=2.4, gaps=True)
    system = problem.system(flown)
    system = replace(system, parameters=system.parameters.with_values({"delay": 0.11}))
    laid_out, settings = filter_problem(flown, system, np.inf), FilterSettings()
    nominal = (
        np.random.default_rng(1).normal(1.0, 0.1, (14, len(flown))) * laid_out.start[:, None]
        if elsewhere
        else None
    )
    found, expected = (
        filter_alone(flown, system, settings, nominal),
        filter_by_filterpy(laid_out, settings, nominal=nominal),
    )
    assert (found.method, found.names, found.units, found.outcome, found.message) == (
        expected.method,
        expected.names,
        expected.units,
        expected.outcome,
        expected.message,
    )
    np.testing.assert_allclose((found.values - expected.values) / expected.std, 0.0, atol=1e-8)
    np.testing.assert_allclose(found.std, expected.std, rtol=1e-8)
    assert found.log_likelihood == pytest.approx(expected.log_likelihood, rel=1e-9)
    np.testing.assert_allclose(found.fitted[0], expected.fitted[0], atol=1e-9)
    assert found.history is not None and expected.history is not None
    sigma = expected.history.std[:, -1]
    for field in fields(FilterHistory):
        one, other = getattr(found.history, field.name), getattr(expected.history, field.name)
        if field.name in ("time", "names", "valid", "degrees"):
            np.testing.assert_array_equal(one, other)
        elif field.name in ("mean", "predicted_mean"):
            np.testing.assert_allclose((one - other) / sigma[:, None], 0.0, atol=1e-7)
        elif "covariance" in field.name and field.name != "innovation_covariance":
            spread = np.sqrt(np.einsum("kii,kjj->kij", other, other))
            np.testing.assert_allclose((one - other) / spread, 0.0, atol=1e-8, err_msg=field.name)
        else:
            np.testing.assert_allclose(
                one, other, rtol=1e-7, atol=1e-9 * np.abs(other).max(), err_msg=field.name
            )
    one, other = smooth(found.history).mean, smooth(expected.history).mean
    np.testing.assert_allclose((one - other) / sigma[:, None], 0.0, atol=1e-5)


def test_a_breakdown_is_told_as_the_single_filter_tells_it() -> None:
    flown = problem.record(5, duration=2.0)
    alpha = flown["alpha"].values.copy()
    alpha[30] = 1e60
    flown = replace(flown, outputs=(replace(flown["alpha"], values=alpha), *flown.outputs[1:]))
    found = filter_alone(flown, problem.system(flown))
    assert found.outcome is Outcome.DIVERGED and found.message.startswith("at ")
