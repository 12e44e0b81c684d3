"""Two effects that hide each other, by the projection of the residual on both."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.screening.pairs import joint_fall, likely_pairs
from ident.tracing.screening.score_test import Finding
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.speed_variation import SpeedVariation
from sim.effects.guards.products import GUARDS
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale

LATE = SensorDelay("alpha")
SCALED = SensorScale("q")


def finding(effect: Traceable, column: np.ndarray, residual: np.ndarray) -> Finding:
    """What one column explains of a residual of 300 samples."""
    along = column * (column @ residual) / (column @ column)
    share = (along @ along) / (residual @ residual)
    return Finding(effect, -150.0 * np.log1p(-share), 1, ({},), (1.0,), along)


def test_the_projected_fall_of_a_pair_is_that_of_least_squares() -> None:
    """Against the regression of a residual on two columns, and on each alone."""
    rng = np.random.default_rng(2)
    residual, columns = rng.standard_normal(300), rng.standard_normal((300, 2))
    columns[:, 1] -= 0.9 * columns[:, 0]
    residual += columns @ [0.4, 0.5]

    one, other = finding(LATE, columns[:, 0], residual), finding(SCALED, columns[:, 1], residual)
    left = np.linalg.lstsq(columns, residual, rcond=None)[1][0]
    assert joint_fall(one, other, 300.0) == pytest.approx(-0.5 * np.log(left / (residual @ residual)))
    assert joint_fall(one, one, 300.0) == pytest.approx(one.gain / 300.0)
    assert likely_pairs([one, other], [], 300.0) == [(one, other)]
    assert likely_pairs([one, other], [LATE.name, SCALED.name], 300.0) == []
    assert likely_pairs([one, finding(next(iter(GUARDS)), columns[:, 1], residual)], [], 300.0) == []


def test_signatures_that_are_nearly_one_make_no_pair() -> None:
    """However much they promise together: their difference, not they, would do the work."""
    rng = np.random.default_rng(4)
    first, apart = rng.standard_normal((2, 300))
    residual = 0.2 * rng.standard_normal(300) + 0.5 * first + apart
    for share, expected in ((0.3, 0), (0.6, 1)):
        column = first + share * apart
        assert (abs(float(np.corrcoef(first, column)[0, 1])) > thresholds.COLLINEAR) is (expected == 0)
        one, other = (finding(effect, each, residual) for effect, each in ((LATE, first), (SCALED, column)))
        assert joint_fall(one, other, 300.0) > max(one.gain, other.gain) / 300.0 + 0.3
        assert len(likely_pairs([one, other], [], 300.0)) == expected


def test_two_forms_of_one_effect_make_no_pair() -> None:
    """Nor do a lag and a delay of one channel; two effects of the same signatures do."""
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((2, 300))
    residual = rng.standard_normal(300) + columns[0] + columns[1]
    forms = (SpeedVariation(), SpeedVariation(weight=False))
    for first, second, pairs in ((*forms, 0), (SensorDelay("q"), SensorLag("q"), 0), (forms[0], SCALED, 1)):
        one, other = finding(first, columns[0], residual), finding(second, columns[1], residual)
        assert len(likely_pairs([one, other], [], 300.0)) == pairs
