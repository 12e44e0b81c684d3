"""Whether an effect stands out of what the records leave open, one parameter by itself or all of them together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.quantities import stands_out_somewhere
from sim.declaration.effect import full_name
from sim.effects.dynamics.curves.moment_nonlinearity import VARIANTS

CURVE = VARIANTS[0]
NAMES = tuple(full_name(CURVE, local) for local in list(CURVE.absent)[:2])


def fitted_to(values: tuple[float, float], correlation: float, suffix: str = "") -> FittedModel:
    """A fit of two shapes, each known to one unit, with a derivative that takes up much of what both do."""
    covariance = np.array([[1.0, correlation], [correlation, 1.0]])
    theta = np.array([0.3, *values])
    normal = np.zeros((3, 3))
    normal[0, 0], normal[1:, 1:] = 4.0, np.linalg.inv(covariance)
    problems = (SimpleNamespace(record=SimpleNamespace(time=np.arange(100) / 25.0)),) * (2 if suffix else 1)
    layout = SimpleNamespace(names=("Cm_alpha", *(f"{name}{suffix}" for name in NAMES)), problems=problems)
    return cast("FittedModel", SimpleNamespace(fit=SimpleNamespace(layout=layout, theta=theta, normal_equations=lambda: (normal, None))))


@pytest.mark.parametrize(
    ("values", "correlation", "suffix", "out"),
    [
        ((1.0, -1.0), 0.99, "", True),  # either one sigma from nothing, both together ten
        ((1.0, 1.0), 0.99, "", False),
        ((1.0, -1.0), 0.0, "", False),
        ((2.5, 0.0), 0.0, "", True),
        ((1.0, -1.0), 0.99, ", record 2", True),
    ],
)
def test_shapes_that_are_open_by_themselves_stand_out_together(values: tuple[float, float], correlation: float, suffix: str, out: bool) -> None:
    assert stands_out_somewhere(fitted_to(values, correlation, suffix), CURVE) is out
