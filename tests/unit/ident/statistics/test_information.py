"""Inverses of information matrices: against NumPy's, with a direction that nothing tells, and of no
unknown at all.
"""

from __future__ import annotations

import numpy as np

from ident.statistics.intervals import UNDETERMINED, inverse_information


def test_of_determined_unknowns_it_is_the_inverse() -> None:
    slopes = np.random.default_rng(1).standard_normal((20, 3)) * np.array([1.0, 1e3, 1e-4])
    found, determined = inverse_information(slopes.T @ slopes)
    np.testing.assert_allclose(found, np.linalg.inv(slopes.T @ slopes), rtol=1e-9)
    assert determined


def test_a_direction_that_nothing_tells_has_a_very_large_sigma() -> None:
    found, determined = inverse_information(np.array([[4.0, 4.0], [4.0, 4.0]]))
    assert not determined and np.sqrt(found[0, 0]) > 0.1 * 0.5 / np.sqrt(UNDETERMINED)


def test_of_no_unknown_nothing_is_open() -> None:
    found, determined = inverse_information(np.zeros((0, 0)), np.zeros(0))
    assert found.shape == (0, 0) and determined
