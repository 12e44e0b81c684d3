"""What an addition brings, how evenly, and whether anything is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.selection.criterion import few_samples, gain, is_coloured_throughout, is_white, unevenness
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.record import Record
from tests.tracing_problem import fit_of, planted, problem_of, with_output, without_output

PULSE = {"unmeasured-input.start": 4.0, "unmeasured-input.duration": 0.8, "unmeasured-input.moment": 0.006, "unmeasured-input.lift": 0.0}


@pytest.fixture(scope="module")
def root() -> FittedModel:
    return fit_of(problem_of([planted()]))


def with_residuals(fitted: FittedModel, residuals: Sequence[np.ndarray], lift: np.ndarray | float = 0.0) -> FittedModel:
    """The node with other residuals, and with fitted outputs raised by ``lift``."""
    lines = tuple(replace(line, y=line.y + lift) for line in fitted.fit.lines)
    return replace(fitted, fit=replace(fitted.fit, lines=lines, weighted=replace(fitted.fit.weighted, residuals=tuple(residuals))))


def spoiled(record: Record, first: float, factor: float) -> Record:
    """The record with noise ``factor`` times as large for two seconds from ``first``, in all channels."""
    rng = np.random.default_rng(5)
    within = (record.time > first) & (record.time < first + 2.0)
    for name, sigma in (("alpha", 0.002), ("q", 0.002), ("nz", 0.01)):
        extra = np.sqrt(factor**2 - 1.0) * sigma * rng.standard_normal(len(record))
        record = with_output(record, name, record[name].values + np.where(within, extra, 0.0))
    return record


@pytest.mark.parametrize("seed", range(4))
def test_unevenness_is_about_one_on_gaussian_residuals(seed: int) -> None:
    lag = SensorLag("q")
    problem = problem_of([planted([lag], {"sensor-lag:q.time_constant": 0.05}, seed)])
    root = fit_of(problem)
    child = fit_of(problem, [lag], root, {"sensor-lag:q.time_constant": 0.05})
    # A mean of squares weighted over some hundred samples scatters by a tenth.
    assert 1.0 <= unevenness(root, child) < 1.3


def test_unevenness_is_large_where_large_residuals_coincide_with_the_change() -> None:
    """The same noisy stretch, once where the addition acts and once where it does not: only the first divides its gain."""
    effect = UnmeasuredInput()
    found = {}
    for first in (4.0, 7.8):
        problem = problem_of([spoiled(planted([effect], PULSE), first, 4.0)])
        root = fit_of(problem)
        child = fit_of(problem, [effect], root, PULSE)
        found[first] = unevenness(root, child)
        price = 4.0 * np.log(child.fit.counts.sum()) + problem.settings.event
        assert gain(root, child, problem.settings.accept) <= 2.0 * (root.fit.cost - child.fit.cost) / found[first] - price + 1e-9
    assert found[4.0] > 1.5
    assert found[7.8] < 1.1


def test_unevenness_by_hand(root: FittedModel) -> None:
    rng = np.random.default_rng(1)
    shape = root.fit.residuals[0].shape
    e, change = rng.standard_normal(shape) * np.array([[1.0], [2.0], [3.0]]), rng.standard_normal(shape)
    sigma = np.sqrt(root.fit.variance)[:, None]
    child = with_residuals(root, [10.0 * e * sigma], change)
    c = change / sigma
    assert unevenness(root, child) == pytest.approx(np.sum(c**2 * (10.0 * e) ** 2) / np.sum(c**2), rel=1e-9)
    # Never below one, and one where nothing changes.
    assert unevenness(root, with_residuals(root, [0.1 * e * sigma], change)) == 1.0
    assert unevenness(root, root) == 1.0


def test_few_samples_is_the_share_of_the_three_most_improved(root: FittedModel) -> None:
    residual = root.fit.residuals[0]
    sigma = np.sqrt(root.fit.variance)
    before = residual.copy()
    before[1, [10, 200, 400]] = 30.0 * sigma[1]
    after = before.copy()
    after[1, [10, 200, 400]] = 0.0
    parent = with_residuals(root, [before])
    assert few_samples(parent, with_residuals(root, [after])) == pytest.approx(1.0)
    # A fourth sample improved alike leaves three quarters.
    before[1, 300], after[1, 300] = 30.0 * sigma[1], 0.0
    assert few_samples(with_residuals(root, [before]), with_residuals(root, [after])) == pytest.approx(0.75)
    # All improved alike: three of N.
    even = np.repeat(sigma[:, None], residual.shape[1], axis=1)
    assert few_samples(with_residuals(root, [2.0 * even]), with_residuals(root, [even])) == pytest.approx(3.0 / residual.shape[1])
    # Nothing improved, or worse: no evidence at all.
    assert few_samples(root, root) == 1.0
    assert few_samples(with_residuals(root, [even]), with_residuals(root, [2.0 * even])) == 1.0


def test_a_real_effect_does_not_hang_on_few_samples() -> None:
    lag = SensorLag("q")
    problem = problem_of([planted([lag], {"sensor-lag:q.time_constant": 0.05})])
    root = fit_of(problem)
    child = fit_of(problem, [lag], root, {"sensor-lag:q.time_constant": 0.05})
    assert few_samples(root, child) < 0.2
    assert gain(root, child, problem.settings.accept) > 100.0


def test_is_white_of_the_right_set_and_of_a_lacking_one(root: FittedModel) -> None:
    assert is_white(root)
    problem = problem_of([planted([UnmeasuredInput()], PULSE)])
    lacking = fit_of(problem)
    assert not is_white(lacking)
    assert is_white(fit_of(problem, [UnmeasuredInput()], lacking, PULSE))


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_one_coloured_channel_is_enough(root: FittedModel, channel: int) -> None:
    residual = root.fit.residuals[0].copy()
    residual[channel] = np.convolve(residual[channel], [0.5, 0.5], mode="same")
    assert not is_white(with_residuals(root, [residual]))


def test_whiteness_is_asked_at_the_level_given(root: FittedModel) -> None:
    """A weak colour: white at one in a billion, not at one in ten."""
    residual = root.fit.residuals[0].copy()
    residual[0] = np.convolve(residual[0], [0.1, 0.9, 0.0], mode="same")
    fitted = with_residuals(root, [residual])
    assert is_white(fitted, 1e-9)
    assert not is_white(fitted, 0.999)


def test_a_channel_that_one_record_lacks_does_not_make_it_white() -> None:
    fitted = fit_of(problem_of([planted([], None, 1), without_output(planted([], None, 2), "nz")]))
    rng = np.random.default_rng(1)
    wandering = [np.where(problem.valid, np.cumsum(rng.standard_normal(problem.valid.shape), axis=1), 0.0) for problem in fitted.fit.layout.problems]
    assert is_coloured_throughout(with_residuals(fitted, wandering), 1e-20)
    assert not is_coloured_throughout(fitted, 1e-20) and is_white(fitted)


def test_a_gain_that_hangs_on_three_samples_counts_for_half_of_what_is_to_be_brought(root: FittedModel) -> None:
    """By hand: the lesser of twice the gain over its unevenness and of what the other samples bring plus half of ``accept``, less the price."""
    accept, price, brought = 10.0, 7.3, 400.0
    before = [np.full_like(residual, 0.01) for residual in root.fit.residuals]
    parent = with_residuals(root, before)

    def child(better: slice) -> FittedModel:
        after = [residual.copy() for residual in before]
        after[0][1, better] = 0.0
        changed = with_residuals(root, after)
        cost = parent.fit.cost - 0.5 * brought
        return replace(changed, fit=replace(changed.fit, cost=cost), criterion=2.0 * cost + parent.criterion - 2.0 * parent.fit.cost + price)

    assert gain(parent, child(slice(10, 13)), accept) == pytest.approx(0.5 * accept - price)
    assert gain(parent, child(slice(10, 16)), accept) == pytest.approx(0.5 * brought + 0.5 * accept - price)
    # Where hundreds of samples bring it the first of the two is the lesser.
    assert gain(parent, child(slice(0, 500)), accept) == pytest.approx(brought - price)
