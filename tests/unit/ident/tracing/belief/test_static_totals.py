"""What a derivative and a mode come to at rest."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.belief.static_totals import static_total, told_totals
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.whole_record.output_error import fit_covariance
from sim.effects.dynamics.elastic_mode import ElasticMode
from tests.tracing_problem import fit_of, planted, problem_of

MODE = {"frequency": 15.0, "damping": 0.03, "lift": 0.1, "moment": -0.3, "angle_gain": 0.5, "gyro": 0.02}


@pytest.fixture(scope="module")
def bent() -> FittedModel:
    start = {f"elastic-mode.{name}": value for name, value in MODE.items()}
    return fit_of(problem_of([planted([ElasticMode()], start, 3)]), (ElasticMode(),), None, start)


def test_the_sum_and_its_sigma_by_drawing(bent: FittedModel) -> None:
    """The sigma of Cm_alpha + moment angle_gain, a product, against draws from the fit's covariance."""
    names, theta = bent.fit.layout.names, bent.fit.theta
    total = static_total(bent, "Cm_alpha", fit_covariance(bent.fit)[0])
    assert total is not None and total[0] == "Cm_alpha + moment angle_gain of elastic-mode"
    at = [names.index(name) for name in ("Cm_alpha", "elastic-mode.moment", "elastic-mode.angle_gain")]
    assert total[1].value == pytest.approx(theta[at[0]] + theta[at[1]] * theta[at[2]], rel=1e-12)
    covariance = fit_covariance(bent.fit)[0][np.ix_(at, at)] * 1e-4
    drawn = np.random.default_rng(1).multivariate_normal(theta[at], covariance, 40_000, method="eigh")
    assert total[1].std == pytest.approx(100.0 * float(np.std(drawn[:, 0] + drawn[:, 1] * drawn[:, 2])), rel=0.05)


def test_the_total_is_known_better_than_its_parts_where_they_trade(bent: FittedModel) -> None:
    """A fast mode is a change of the control derivative: the sum is known, each part less."""
    covariance, _ = fit_covariance(bent.fit)
    names = bent.fit.layout.names
    part = float(np.sqrt(covariance[names.index("Cm_de"), names.index("Cm_de")]))
    total = static_total(bent, "Cm_de", fit_covariance(bent.fit)[0])
    assert total is not None and total[1].std < part
    assert "Cm_de + moment of elastic-mode keep" in told_totals(bent, ["Cm_de", "Cm_q"])


def test_nothing_is_said_where_no_effect_adds_anything(bent: FittedModel) -> None:
    root = fit_of(problem_of([planted()]))
    mine, plain = fit_covariance(bent.fit)[0], fit_covariance(root.fit)[0]
    assert static_total(bent, "Cm_q", mine) is None is static_total(root, "Cm_de", plain) is static_total(root, "unknown", plain)
    assert told_totals(root, ["Cm_de"]) == ""
