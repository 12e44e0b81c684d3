"""Honest p-values of what remains."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.validation.whiteness import is_white, low_frequency_power, whiteness
from tests.tracing_problem import OUTPUTS, fit_of, planted, problem_of, with_output, without_output


def uniform_distance(p_values: np.ndarray) -> float:
    """Kolmogorov's distance from the uniform distribution."""
    ordered, n = np.sort(p_values), len(p_values)
    return float(np.max(np.maximum(np.arange(1, n + 1) / n - ordered, ordered - np.arange(n) / n)))


@pytest.mark.parametrize(
    ("count", "interval", "missing"), [(501, 0.02, 0.0), (400, 0.05, 0.0), (501, 0.02, 0.1)]
)
def test_low_frequency_power_has_uniform_p_values_on_white_noise(
    count: int, interval: float, missing: float
) -> None:
    rng = np.random.default_rng(count)
    time = interval * np.arange(count)
    runs = 1500
    p = np.array(
        [
            low_frequency_power(
                rng.standard_normal(count), rng.random(count) >= missing, time, "q"
            ).p_value
            for _ in range(runs)
        ]
    )
    # Exceeded once in a thousand such tests: sqrt(-ln(0.0005)/2)/sqrt(n).
    assert uniform_distance(p) < 1.95 / np.sqrt(runs)


def test_low_frequency_power_sees_slow_motion_and_not_fast() -> None:
    rng = np.random.default_rng(2)
    time = 0.02 * np.arange(500)
    white, valid = rng.standard_normal(500), np.ones(500, dtype=bool)
    slow = low_frequency_power(white + np.sin(2.0 * np.pi * 1.0 * time), valid, time, "q")
    fast = low_frequency_power(white + np.sin(2.0 * np.pi * 9.0 * time), valid, time, "q")
    assert slow.p_value < 1e-12 and slow.statistic > 2.0
    assert fast.p_value > 0.9 and fast.statistic < 1.0


def test_low_frequency_power_says_nothing_where_all_lies_below() -> None:
    test = low_frequency_power(
        np.ones(100), np.ones(100, dtype=bool), 0.2 * np.arange(100.0), "altitude"
    )
    assert test.p_value == 1.0 and np.isfinite(test.statistic)
    assert (
        low_frequency_power(
            np.zeros(500), np.ones(500, dtype=bool), 0.02 * np.arange(500), "q"
        ).p_value
        == 1.0
    )


def test_whiteness_tests_every_channel_with_enough_samples_of_every_record(
    fitted: FittedModel,
) -> None:
    tests = whiteness(fitted.fit, "fitted")
    assert len(tests) == 2 * 3 * 2
    assert {test.channel for test in tests} == {
        f"{name}, fitted record {r}" for name in OUTPUTS for r in (1, 2)
    }
    assert min(test.p_value for test in tests) > 1e-4
    short = without_output(planted(), "nz")
    alpha = short["alpha"].values.copy()
    alpha[15:] = np.nan
    few = fit_of(problem_of([with_output(short, "alpha", alpha)]))
    assert {test.channel for test in whiteness(few.fit, "fitted")} == {"q, fitted"}


def test_a_fit_is_white_where_no_channel_of_any_record_has_a_smaller_p_value() -> None:
    """It asks Ljung-Box alone, of channels with enough samples."""
    records = [planted(seed=1), planted(seed=2)]
    sound = fit_of(problem_of(records)).fit
    boxes = [test.p_value for test in whiteness(sound, "fitted") if test.name == "ljung-box"]
    assert (
        is_white(sound) and is_white(sound, 0.999 * min(boxes)) and not is_white(sound, min(boxes))
    )
    slow = with_output(
        records[1], "q", records[1]["q"].values + 0.01 * np.sin(2.0 * records[1].time)
    )
    assert not is_white(fit_of(problem_of([records[0], slow])).fit)
    few = np.full(len(slow), np.nan)
    few[:: len(slow) // 15] = slow["q"].values[:: len(slow) // 15]
    assert is_white(fit_of(problem_of([records[0], with_output(slow, "q", few)])).fit)
