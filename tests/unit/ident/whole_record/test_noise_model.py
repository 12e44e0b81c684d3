"""The likelihood of white noise of unknown size."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.whole_record.noise_model import WHITE


@pytest.mark.parametrize(
    "smallest", [0.0, 1e-4, 100.0], ids=["no output", "one output", "both outputs"]
)
def test_the_cost_has_the_gradient_that_is_followed_also_at_the_least_variance(
    smallest: float,
) -> None:
    rng = np.random.default_rng(3)
    residual, slope, counts = (
        rng.normal(size=(2, 60)) * [[1e-3], [1.0]],
        rng.normal(size=(2, 60)),
        np.full(2, 60),
    )
    layout: Any = SimpleNamespace(used=np.full(2, True), smallest=np.full(2, smallest), problems=())
    line: Any = SimpleNamespace(jacobian=slope[:, :, None])

    def weighed(x: float) -> Any:
        return WHITE.weight_residuals(layout, np.zeros(1), [line], [residual - x * slope], counts)

    gradient = float(np.sum(slope * residual / weighed(0.0).variance[:, None]))
    assert (weighed(-1e-7).cost - weighed(1e-7).cost) / 2e-7 == pytest.approx(
        gradient, rel=1e-5, abs=1e-7
    )
