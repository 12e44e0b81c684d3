"""A flight's fit as it is stored: likelihood and covariance of the independent samples."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from scenarios.survey.growing import _fit_content
from sim.effects.sensor_path.sensor_timing import SensorLag

DECLARED = ("CL_alpha", "Cm_alpha", "Cm_q")
INFORMATION = np.array([[9.0, 2.0, 0.5], [2.0, 4.0, 0.3], [0.5, 0.3, 1.0]])


def fitted() -> Any:
    """A fit of three unknowns, one of them a record's own; a declared one is not among them."""
    layout = SimpleNamespace(names=("CL_alpha", "Cm_alpha", "sensor-lag:q.time_constant, record 1"))
    fit = SimpleNamespace(
        normal_equations=lambda: (INFORMATION, np.zeros(3)),
        theta=np.array([5.0, -0.6, 0.04]),
        layout=layout,
        log_likelihood=200.0,
    )
    return SimpleNamespace(fit=fit)


@pytest.mark.parametrize("share", [1.0, 0.25])
def test_of_coloured_residuals_a_share_of_the_samples_counts(share: float) -> None:
    """A quarter of the samples has a quarter of the log likelihood and four times the variance."""
    kept = _fit_content(fitted(), DECLARED, [SensorLag("q")], share)
    assert kept["log_likelihood"] == pytest.approx(200.0 * share)
    assert kept["names"] == [*DECLARED, "sensor-lag:q.time_constant"]
    assert kept["estimate"] == pytest.approx([5.0, -0.6, 0.0, 0.04])
    sound = [0, 1, 3]
    expected = np.linalg.inv(INFORMATION) / share
    np.testing.assert_allclose(kept["covariance"][np.ix_(sound, sound)], expected, rtol=1e-9)
    assert kept["covariance"][2, 2] >= 1e30 and not np.any(kept["covariance"][2, sound])
