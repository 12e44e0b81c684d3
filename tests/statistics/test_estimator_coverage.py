"""Coverage of the estimators by the independent simulator, with fewer runs than the page has."""

from __future__ import annotations

import pytest

from exam.coverage.estimators import HIGH, LOW, run_of, statistics

pytestmark = pytest.mark.slow
RUNS = 60


@pytest.mark.parametrize("noise", ["white", "ar1"])
@pytest.mark.parametrize("model", ["rigid", "lateral"])
@pytest.mark.parametrize("estimator", ["output-error", "equation-error", "frequency-domain"])
def test_two_sigmas_hold_what_they_should(estimator: str, model: str, noise: str) -> None:
    found = statistics([run_of((estimator, model, noise), run) for run in range(RUNS)])
    assert found["settled"] >= 0.95 * RUNS
    # The interval of so few runs has to meet 93 to 97 %; no parameter may be off its true value by
    # more than chance.
    assert found["high"] >= LOW and found["low"] <= HIGH, found
    assert found["bias"] < 0.55, found


@pytest.mark.parametrize("noise", ["markov-gusts", "dryden-gusts"])
def test_equation_error_and_filter_error_hold_in_gusts(noise: str) -> None:
    for estimator in ("equation-error", "filter-error"):
        found = statistics([run_of((estimator, "rigid", noise), run) for run in range(RUNS)])
        assert found["high"] >= LOW and found["low"] <= HIGH, (estimator, found)


def test_output_error_in_gusts_is_cautioned() -> None:
    found = statistics(
        [run_of(("output-error", "lateral", "dryden-gusts"), run) for run in range(30)]
    )
    assert found["cautioned"] >= 0.9 * found["settled"]
