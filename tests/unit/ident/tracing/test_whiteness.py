"""Honest p-values of what remains."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import butter, lfilter
from scipy.stats import kstest

from ident.statistics.residuals import flat_spectrum, largest_burst, ljung_box
from ident.tracing.fitted_model import FittedModel
from ident.tracing.whiteness import is_noise, whiteness
from tests.tracing_problem import OUTPUTS, fit_of, planted, problem_of, with_output, without_output


@pytest.mark.long
@pytest.mark.parametrize(
    ("count", "interval", "missing"), [(1001, 0.02, 0.0), (800, 0.05, 0.0), (1001, 0.02, 0.1)]
)
def test_flat_spectrum_rejects_white_noise_no_more_often_than_said(
    count: int, interval: float, missing: float
) -> None:
    rng = np.random.default_rng(count)
    time = interval * np.arange(count)
    runs = 1500
    p = np.array(
        [
            flat_spectrum(
                rng.standard_normal(count), rng.random(count) >= missing, time, "q"
            ).p_value
            for _ in range(runs)
        ]
    )
    # Exceeded once in a thousand such tests; with samples missing the test is a little careful.
    assert kstest(p, "uniform", alternative="greater").pvalue > 1e-3


def test_flat_spectrum_sees_slow_motion_and_no_filter_above() -> None:
    rng = np.random.default_rng(2)
    time = 0.02 * np.arange(1000)
    white, valid = rng.standard_normal(1000), np.ones(1000, dtype=bool)
    slow = flat_spectrum(white + 0.5 * np.sin(2.0 * np.pi * 1.0 * time), valid, time, "q")
    b, a = butter(2, 8.0 * 2.0 * 0.02)
    smooth = lfilter(b, a, white) + 0.3 * rng.standard_normal(1000)
    assert slow.p_value < 1e-5 and "below 1" in slow.sentence
    assert flat_spectrum(smooth, valid, time, "q").p_value > 0.01
    assert ljung_box(smooth, valid, "q").p_value < 1e-10


def test_flat_spectrum_says_nothing_of_a_short_or_empty_record() -> None:
    few, valid = np.arange(20.0), np.ones(20, dtype=bool)
    assert flat_spectrum(few, valid, 0.02 * few, "q").p_value == 1.0
    nothing = flat_spectrum(
        np.zeros(500), np.ones(500, dtype=bool), 0.02 * np.arange(500), "altitude"
    )
    assert nothing.p_value == 1.0 and np.isfinite(nothing.statistic)


def test_whiteness_tests_every_channel_with_enough_samples_of_every_record(
    fitted: FittedModel,
) -> None:
    tests = whiteness(fitted.fit, "fitted")
    assert len(tests) == 3 * 2
    assert {test.channel for test in tests} == {
        f"{name}, fitted record {r}" for name in OUTPUTS for r in (1, 2)
    }
    assert min(test.p_value for test in tests) > 1e-4
    short = without_output(planted(), "nz")
    alpha = short["alpha"].values.copy()
    alpha[15:] = np.nan
    few = fit_of(problem_of([with_output(short, "alpha", alpha)]))
    assert {test.channel for test in whiteness(few.fit, "fitted")} == {"q, fitted"}


def test_a_fit_leaves_noise_where_no_channel_of_any_record_has_a_smaller_p_value() -> None:
    records = [planted(seed=1), planted(seed=2)]
    sound = fit_of(problem_of(records)).fit
    least = min(test.p_value for test in whiteness(sound, "fitted"))
    assert is_noise(sound) and is_noise(sound, 0.999 * least) and not is_noise(sound, least)
    slow = with_output(
        records[1], "q", records[1]["q"].values + 0.01 * np.sin(2.0 * records[1].time)
    )
    assert not is_noise(fit_of(problem_of([records[0], slow])).fit)
    few = np.full(len(slow), np.nan)
    few[:: len(slow) // 15] = slow["q"].values[:: len(slow) // 15]
    assert is_noise(fit_of(problem_of([records[0], with_output(slow, "q", few)])).fit)


@pytest.mark.parametrize("colour", [0.0, 0.6])
def test_noise_that_is_louder_for_a_while_is_found_and_noise_alone_is_not(colour: float) -> None:
    """Also of noise with memory, as a filter leaves it: its squares are correlated."""
    time = np.arange(1000) / 50.0
    alarms = 0
    for seed in range(200):
        rng = np.random.default_rng(seed)
        noise = lfilter([1.0], [1.0, -colour], rng.standard_normal(1100))[100:]
        alarms += largest_burst(noise, time, "q, fitted") is not None
        if seed < 20:
            inside = (time >= 8.0) & (time < 11.0)
            found = largest_burst(np.where(inside, 4.0, 1.0) * noise, time, "q, fitted")
            assert found is not None and found.channel == "q, fitted"
            assert found.begin == pytest.approx(8.0, abs=0.6)
            assert found.end == pytest.approx(11.0, abs=0.6)
            assert found.ratio == pytest.approx(4.0, rel=0.35)
    assert alarms <= 2


def test_a_short_residual_tells_of_no_spell() -> None:
    rng = np.random.default_rng(1)
    assert largest_burst(rng.standard_normal(30), np.arange(30) / 50.0, "q") is None
