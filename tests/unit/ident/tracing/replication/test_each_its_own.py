"""What belongs to each record by itself: its values are paid for where they are learnt, and asked of one-step predictions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.replication.by_record import Replication
from ident.tracing.replication.each_its_own import own_values, predicted_gains, stands_by_prediction
from ident.tracing.replication.error_reduction import Reduction
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_drift import SensorDrift
from tests.residual_stubs import left_by
from tests.tracing_problem import fit_of, planted, problem_of

DRIFT = SensorDrift("nz", "g", 5e-3)
SLOPE = "sensor-drift:nz.slope"


def test_a_record_gains_what_its_innovations_fall_by_less_half_a_logarithm_of_its_samples_a_value() -> None:
    """Rissanen's price by hand; the colour of a residual that becomes half as large is the same, so that n ln 2 a channel is gained."""
    rng = np.random.default_rng(1)
    long, short = rng.standard_normal((2, 600)), np.cumsum(rng.standard_normal((1, 100)), axis=1)
    before, after = [left_by(long), left_by(short)], [left_by(0.5 * long), left_by(short)]
    one = predicted_gains(before, after, DRIFT)
    assert one == pytest.approx([1200.0 * np.log(2.0) - 0.5 * np.log(1200.0), -0.5 * np.log(100.0)])
    free = sum(item.free for item in UnmeasuredInput().parameters)
    more = predicted_gains(before, after, UnmeasuredInput())
    assert free > 1 and one - more == pytest.approx(0.5 * (free - 1) * np.log([1200.0, 100.0]))


@pytest.fixture(scope="module")
def drifting() -> FittedModel:
    """Three records, of which each has a drift of its own."""
    records = [planted([DRIFT], {SLOPE: slope}, seed) for seed, slope in ((1, 0.02), (2, -0.03), (3, 0.025))]
    return fit_of(problem_of(records, [DRIFT]), [DRIFT])


def without(fitted: FittedModel, *records: int) -> FittedModel:
    """The same fit, without a slope in some of the records."""
    theta = fitted.fit.theta.copy()
    theta[[fitted.fit.layout.names.index(f"{SLOPE}, record {r + 1}") for r in records]] = 0.0
    return replace(fitted, fit=replace(fitted.fit, theta=theta))


def test_values_of_each_record_have_to_stand_off_absence_in_more_than_half_of_them(drifting: FittedModel) -> None:
    found = own_values(drifting, DRIFT)
    assert found.agrees, "of one size they need not be, nor of one sign"
    for own, true in zip(found.values, (0.02, -0.03, 0.025), strict=True):
        assert abs(own["slope"].value - true) < 4.0 * own["slope"].std < 0.01
    assert own_values(without(drifting, 1), DRIFT).agrees
    assert not own_values(without(drifting, 0, 2), DRIFT).agrees


def test_where_no_free_value_is_an_absence_there_is_none_to_stand_off() -> None:
    phugoid = Phugoid()
    fitted = fit_of(problem_of([planted(seed=1), planted(seed=2)], [phugoid]), [phugoid])
    assert "attitude" not in phugoid.absent and own_values(fitted, phugoid).agrees


FALLS = Reduction(-0.2, 0.05, np.full(3, -0.2), np.full(3, 0.05), (-0.2, -0.2, -0.2), (0.1, 0.1, 0.1))


@pytest.mark.parametrize(
    ("gains", "scatter", "agrees", "why"),
    [
        ([9.0, 9.0, -9.0], 0.05, True, ""),
        ([9.0, 9.0, 9.0], 0.11, True, "within its scatter"),
        ([90.0, -1.0, -1.0], 0.05, True, "a colour of the residual"),
        ([9.0, -9.0], 0.05, True, "a colour of the residual"),
        ([9.0, 9.0, 9.0], 0.05, False, "on too few records"),
    ],
)
def test_each_bar_has_its_reason(gains: list[float], scatter: float, agrees: bool, why: str) -> None:
    stands, told = stands_by_prediction(np.array(gains), replace(FALLS, scatter=scatter), Replication((), agrees))
    assert stands is not bool(why) and (why or "cross-validated") in told
