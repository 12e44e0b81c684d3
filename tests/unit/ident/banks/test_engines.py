"""The bank of delays by filterpy, filter by filter, and batched: the same numbers, whoever runs
it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.banks.delays import run_delay_bank
from ident.banks.engines import BATCHED, ENGINES, FILTERPY, bank_differences
from ident.filters.ekf import filter_by_filterpy, run_ekf, run_iterated_ekf
from tests import loes_problem as problem

HELD = {"delay": np.array([0.1, 0.125, 0.15])}


@pytest.mark.parametrize("gaps", [False, True])
def test_both_engines_give_one_bank_and_one_iterated_bank(gaps: bool) -> None:
    flown = problem.record(1, duration=1.8, gaps=gaps)
    system = problem.system(flown)
    plain = bank_differences(
        BATCHED.run(flown, system, None, fixed_values=HELD),
        FILTERPY.run(flown, system, None, fixed_values=HELD),
    )
    assert plain.sound and plain.largest < 1e-8
    (one, nominal), (other, same) = (
        engine.iterated(flown, system, None, fixed_values=HELD, tolerance=np.inf)
        for engine in (BATCHED, FILTERPY)
    )
    assert bank_differences(one, other).sound and bank_differences(one, other).largest < 1e-6
    np.testing.assert_array_equal(one.iterations, other.iterations)
    np.testing.assert_allclose((nominal - same) / one.std[:, None, :], 0.0, atol=1e-5)


def test_filterpys_bank_is_its_filters_one_by_one() -> None:
    # The second writing calls the single filters; the plain one by ``run_ekf``, the iterated one by
    # ``run_iterated_ekf``.
    flown = problem.record(2, duration=1.4)
    system = problem.system(flown)
    held = replace(system, parameters=system.parameters.with_values({"delay": 0.125}))
    alone, iterated = (
        run_ekf(flown, held, by=filter_by_filterpy),
        run_iterated_ekf(flown, held, by=filter_by_filterpy),
    )
    plain = FILTERPY.run(flown, system, None, fixed_values={"delay": np.array([0.125])})
    settled, _ = FILTERPY.iterated(flown, system, None, fixed_values={"delay": np.array([0.125])})
    assert (plain.log_likelihood[0], settled.log_likelihood[0]) == (
        alone.log_likelihood,
        iterated.log_likelihood,
    )
    np.testing.assert_array_equal(settled.mean[3:, 0], iterated.values)
    assert settled.sound[0] and settled.iterations[0] == iterated.iterations


def test_a_filter_that_breaks_down_is_told_by_both() -> None:
    flown = problem.record(5, duration=1.2)
    alpha = flown["alpha"].values.copy()
    alpha[20] = 1e60
    flown = replace(flown, outputs=(replace(flown["alpha"], values=alpha), *flown.outputs[1:]))
    found = bank_differences(
        *(
            engine.run(flown, problem.system(flown), None, fixed_values=HELD)
            for engine in (BATCHED, FILTERPY)
        )
    )
    assert found.sound
    _, nominal = FILTERPY.iterated(
        flown, problem.system(flown), None, fixed_values=HELD, iterations=1
    )
    assert np.all(np.isfinite(nominal))


def test_the_refined_delay_does_not_hang_on_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    flown = problem.record(3, duration=1.6)
    system = problem.system(flown)
    calls: list[int] = []

    def counted(*arguments: object, **keywords: object) -> object:
        calls.append(1)
        return filter_by_filterpy(*arguments, **keywords)  # type: ignore[arg-type]

    monkeypatch.setattr("ident.banks.engines.filter_by_filterpy", counted)
    one, other = (
        run_delay_bank(flown, system, (0.1, 0.125, 0.15), widenings=0, engine=engine)
        for engine in ENGINES.values()
    )
    assert len(calls) > 7, "filterpy's filters ran"
    assert other.refined == pytest.approx(
        one.refined, abs=1e-8
    ) and other.refined_std == pytest.approx(one.refined_std, rel=1e-5)
    np.testing.assert_allclose(
        (one.estimate.values - other.estimate.values) / one.estimate.std, 0.0, atol=1e-5
    )
