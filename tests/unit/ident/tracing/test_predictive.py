"""The predictive test: are data that were not fitted more probable with an effect than without?"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from scipy.stats import norm

from ident.tracing import loop
from ident.tracing.decision import Decision
from ident.tracing.diagnosis import Verdict
from ident.tracing.fitted_model import FittedModel
from ident.tracing.held_out import HeldOut, HeldOutData, fit_held_out, predicted_by
from ident.tracing.names import Named
from ident.tracing.predictive import PredictiveGain, least_gain, predictive_gains
from ident.tracing.search import Search
from ident.tracing.wrong_samples import measured_masks
from ident.whole_record.gauss_newton import Fit
from sim.effects.disturbance.gusts import GustTurbulence
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.record import Record
from tests.tracing_problem import OUTPUTS, doublets, fit_of, planted, problem_of
from tests.turbulence import rough_record

LAG = {"sensor-lag:q.time_constant": 0.06}


def lagged(seed: int) -> Record:
    return planted([SensorLag("q")], LAG, seed)


def held_of(root: FittedModel, *records: Record) -> HeldOutData:
    """Data that were not fitted, and what the declared model predicts there."""
    masks = measured_masks(records, OUTPUTS)
    return HeldOutData(records, masks, fit_held_out(root, records, masks, informed=False))


@pytest.fixture(scope="module")
def sets() -> tuple[FittedModel, FittedModel]:
    """The declared model and the set with the lag, fitted to a record that has it."""
    problem = problem_of([lagged(1)])
    root = fit_of(problem)
    return root, fit_of(problem, [SensorLag("q")], root)


def test_the_gain_is_that_of_the_density_of_free_simulations(
    sets: tuple[FittedModel, FittedModel],
) -> None:
    """Of noise levels that are estimated where they are applied: N ln sigma of each output and
    record.
    """
    root, best = sets
    held = held_of(root, lagged(2), lagged(3))
    out = predicted_by(best, held)
    (gain,) = predictive_gains(root, best, held, out).values
    assert held.declared.frozen is not None and out.frozen is not None
    sums = [
        sum(np.sum(residual**2, axis=1) for residual in fit.residuals)
        for fit in (held.declared.frozen, out.frozen)
    ]
    count = sum(len(record) for record in held.records)
    assert gain == pytest.approx(0.5 * count * float(np.sum(np.log(sums[0] / sums[1]))), rel=1e-6)
    assert gain > 300.0


def test_what_is_not_there_lowers_it_and_what_hardly_moves_hardly_tells(
    sets: tuple[FittedModel, FittedModel],
) -> None:
    root, best = sets
    still = planted([SensorLag("q")], LAG, 5, flight=doublets(size=0.0003))
    found: list[PredictiveGain] = []
    for record in (planted(seed=7), still):
        held = held_of(root, record)
        found.append(predictive_gains(root, best, held, predicted_by(best, held)))
    assert found[0].total < -100.0 and found[0].contradicts
    assert abs(found[1].total) < 5.0 and not found[1].contradicts


def test_the_least_gain_is_three_sigmas_below_the_mean_of_a_true_effect() -> None:
    """Of many draws of noise about the simulation with the effect, as many lie below it as the
    normal distribution says.
    """
    rng, sigma, n, draws = np.random.default_rng(3), 0.2, 400, 200_000
    apart = 0.03 * np.sin(0.1 * np.arange(n))
    problem = SimpleNamespace(valid=np.ones((1, n), dtype=bool))
    line = [(SimpleNamespace(y=y[None]),) for y in (np.zeros(n), apart)]
    less, more = (
        SimpleNamespace(
            layout=SimpleNamespace(problems=(problem,)),
            linearisations=y,
            variance=np.array([sigma**2]),
        )
        for y in line
    )
    least = least_gain(cast("Fit", less), cast("Fit", more))
    assert -4.5 <= least < -3.0  # -4.5 is the lowest for any mean
    mean = 0.5 * float(np.sum(apart**2)) / sigma**2
    gains = mean + rng.standard_normal(draws) * math.sqrt(2.0 * mean)
    exact = [
        0.5 * float(np.sum(y**2 - (y - apart) ** 2) / sigma**2)
        for y in apart + sigma * rng.standard_normal((2000, n))
    ]
    assert np.mean(exact) == pytest.approx(mean, abs=0.2)
    assert np.std(exact) == pytest.approx(math.sqrt(2.0 * mean), rel=0.08)
    assert np.mean(gains < least) == pytest.approx(norm.cdf(-3.0), rel=0.2)


def test_where_the_records_test_an_effect_well_the_gain_must_be_positive(
    sets: tuple[FittedModel, FittedModel],
) -> None:
    root, best = sets
    held = held_of(root, lagged(2))
    without, informed = predicted_by(root, held).informed, predicted_by(best, held).informed
    assert without is not None and informed is not None
    assert least_gain(without, informed) == 0.0


def test_frozen_values_that_bring_nothing_are_not_the_last_word(
    sets: tuple[FittedModel, FittedModel],
) -> None:
    """Where derivatives of the fit are off by a little that its own sigmas allow for, the gain is
    that under what training leaves open.
    """
    root, best = sets
    held = held_of(root, lagged(2))
    out = predicted_by(best, held)
    assert out.frozen is not None and out.informed is not None
    assert held.declared.frozen is not None
    worse = replace(out, frozen=held.declared.frozen)
    (gain,) = predictive_gains(root, best, held, worse).values
    plain = predicted_by(root, held).informed
    assert plain is not None
    assert gain == pytest.approx(plain.cost - out.informed.cost) and gain > 100.0


def test_nothing_without_such_data_and_minus_infinity_where_the_larger_set_fails(
    sets: tuple[FittedModel, FittedModel],
) -> None:
    root, best = sets
    nothing = predictive_gains(root, best, HeldOutData(), HeldOut(None, None))
    assert nothing.values == () and not nothing.contradicts
    held = held_of(root, lagged(2))
    failed = predictive_gains(root, best, held, HeldOut(None, None))
    assert failed.values == (-math.inf,) and failed.contradicts


@pytest.mark.long
def test_with_process_noise_predictions_one_step_ahead_are_compared_record_by_record() -> None:
    """Turbulence improves no free simulation: it has to predict a step ahead, and what flies in
    still air it does not.
    """
    problem = problem_of([rough_record(np.random.default_rng(1))])
    root = fit_of(problem)
    rough = fit_of(problem, [GustTurbulence()], root)
    records = tuple(
        replace(rough_record(np.random.default_rng(seed)), name=f"{seed}.csv") for seed in (2, 3)
    )
    held = held_of(root, *records)
    gains = predictive_gains(root, rough, held, predicted_by(rough, held)).values
    assert len(gains) == 2 and min(gains) > 100.0
    still = fit_of(problem_of([planted(seed=3)]))
    held = held_of(still, planted(seed=4))
    (loss,) = predictive_gains(still, rough, held, predicted_by(rough, held)).values
    assert loss < 0.0


@pytest.mark.parametrize("missing", [False, True])
def test_claims_that_held_out_data_contradict_leave_a_declared_model_that_leaves_noise(
    monkeypatch: pytest.MonkeyPatch, missing: bool
) -> None:
    """If the declared model does not leave noise, the claims stay for the verdict to reject."""
    record = lagged(5) if missing else planted(seed=5)
    problem = problem_of([record])
    root, more = fit_of(problem), fit_of(problem, [SensorLag("q")])
    claim = Named("sensor-lag:q", 1.0, {})
    traced = Decision(Verdict.TRACED, more, root, (claim,), (), ())
    monkeypatch.setattr(loop, "decide", lambda *_: traced)
    monkeypatch.setattr(loop, "predictive_gains", lambda *_: PredictiveGain((-20.0,), -4.5))
    search = cast(Search, SimpleNamespace(problem=problem))
    decision, _, gain = loop._decide_and_predict(search, None, HeldOutData())
    if missing:
        assert decision.named == (claim,) and gain.contradicts
        return
    assert decision.verdict is Verdict.CONSISTENT and decision.best.names == ()
    assert decision.named == () and not gain.contradicts
    (hint,) = decision.hints
    assert hint.name == "sensor-lag:q" and hint.within is not None and "-20" in hint.reason
