"""The table of a bilinear function: values and Jacobians are the function's own; what is not
bilinear is found out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ident.bilinear_table import Function, bilinear
from sim.maths import complex_step_jacobian, sqrt

# Two states x, y, two parameters a, b, one input u.
FAIR: Function = lambda w: [w[2] * w[0] + 3.0 * w[1] - 1.5, w[3] * (w[4] - w[1]) + w[2] * w[3]]  # noqa: E731
WRONG: dict[str, Function] = {
    "a state squared": lambda w: [w[0] * w[0]],
    "a state times an input": lambda w: [w[0] * w[4]],
    "three factors": lambda w: [w[0] * w[2] * w[3]],
    "a root": lambda w: [w[2] * sqrt(w[0] * w[0] + 1.0)],
    "a quotient": lambda w: [w[0] / w[3]],
    "a bend": lambda w: [w[0] if w[0].real < 1.0 else 1.0 + 0.0 * w[0]],
}


@given(st.lists(st.floats(-1e3, 1e3), min_size=5, max_size=5))
def test_table_gives_values_and_jacobian(point: list[float]) -> None:
    table = bilinear(FAIR, 4, 2, 1)
    assert table is not None
    found = table.at(np.array([[1.0, *point], [1.0, 0.0, 0.0, 0.0, 0.0, 0.0]]))
    scale = 1.0 + float(np.max(np.abs(point))) ** 2
    np.testing.assert_allclose(
        found[0, :, 4], np.array(FAIR([*point]), dtype=float), rtol=0.0, atol=1e-13 * scale
    )
    np.testing.assert_allclose(
        found[0, :, :4], complex_step_jacobian(FAIR, point)[:, :4], rtol=0.0, atol=1e-13 * scale
    )
    np.testing.assert_array_equal(found[1, :, 4], [-1.5, 0.0])


def test_feed_through() -> None:
    table = bilinear(FAIR, 4, 2, 1)
    assert table is not None and table.feeds_through
    without = bilinear(lambda w: [w[0] * w[2]], 4, 2, 1)
    assert without is not None and not without.feeds_through
    alone = bilinear(lambda w: [w[0] * w[2] + 0.5 * w[4]], 4, 2, 1)
    assert alone is not None and alone.feeds_through, (
        "an input that no parameter multiplies, as a force over a known mass"
    )


@pytest.mark.parametrize("name", WRONG)
def test_anything_else_is_found_out(name: str) -> None:
    def counted(w: list[Any]) -> Sequence[Any]:
        return WRONG[name](w)

    assert bilinear(counted, 4, 2, 1) is None
