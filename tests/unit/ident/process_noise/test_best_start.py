"""Filter error of an aircraft that only its loop holds, and fits whose likelihood has no honest
maximum.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.estimate import Estimate, Outcome
from ident.process_noise import filter_error
from ident.process_noise.best_start import (
    fit_from_best_start,
    implausibly_small_sigmas,
    levels_at_limit,
    white_noise_level,
)
from ident.process_noise.filter_error import fit_filter_error
from ident.whole_record.layout import FitSettings, lay_out
from sim.declaration.compile import compile_model
from sim.effects.disturbance.gusts import GustTurbulence
from sim.record import Record
from tests.bases import fly, rigid_flight, rigid_model
from tests.rigid_problem import noisy
from tests.turbulence import calm_model, rough_model
from tests.unstable_flight import DERIVATIVES, FIGHTER, fighter_start, flown_in_a_loop

SETTINGS = FitSettings(0.01)
TRUE = np.array([FIGHTER[name] for name in DERIVATIVES])


def estimated(record: Record, factors: float) -> Estimate:
    """Of the fighter in turbulence from a start off by a factor."""
    start = fighter_start(factors)
    return fit_filter_error(
        [record],
        compile_model(start.with_effects(GustTurbulence())),
        SETTINGS,
        calm=compile_model(start),
    )


@pytest.mark.slow
@pytest.mark.parametrize("gust", [0.0, 0.003])
def test_an_unstable_aircraft_is_found_in_still_and_in_rough_air(gust: float) -> None:
    scores = []
    for seed in range(4):
        estimate = estimated(flown_in_a_loop(np.random.default_rng(seed), gust=gust), 1.3)
        assert estimate.outcome is Outcome.CONVERGED and estimate.iterations < 60
        np.testing.assert_allclose(estimate.noise_std, [0.001, 0.001, 0.01], rtol=0.15)
        at = [estimate.names.index(name) for name in DERIVATIVES]
        scores.append((estimate.values[at] - TRUE) / estimate.std[at])
    assert np.max(np.abs(scores)) < 4.5
    # In still air no intensity is found beyond its own sigma.
    assert gust > 0.0 or estimate.value("gust-turbulence.sigma") < estimate.sigma(
        "gust-turbulence.sigma"
    )


@pytest.mark.slow
def test_a_start_that_hides_an_unstable_aircraft_is_given_up(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Declared stable: what settles from there is far less likely than the truth, and is not
    returned; a second start that is worse is not either.
    """
    record, start = flown_in_a_loop(np.random.default_rng(2)), fighter_start(1.0)
    hidden = start.with_parameters(start.parameters.with_values({"Cm_alpha": -0.3}))
    rough, calm = compile_model(hidden.with_effects(GustTurbulence())), compile_model(hidden)
    found = fit_filter_error([record], rough, SETTINGS, calm=calm)
    at = [found.names.index(name) for name in DERIVATIVES]
    assert (
        found.outcome is Outcome.CONVERGED
        and np.max(np.abs((found.values[at] - TRUE) / found.std[at])) < 4.5
    )
    monkeypatch.setattr(filter_error, "with_unstable_start", lambda *_: None)
    first = fit_filter_error([record], rough, SETTINGS, calm=calm)
    assert (
        first.outcome is Outcome.CONVERGED and first.log_likelihood < found.log_likelihood - 100.0
    )
    true = compile_model(start)
    monkeypatch.setattr(filter_error, "with_unstable_start", lambda *_: calm)
    kept = fit_filter_error(
        [record], compile_model(start.with_effects(GustTurbulence())), SETTINGS, calm=true
    )
    assert kept.log_likelihood > first.log_likelihood + 100.0


def with_alpha(record: Record, values: np.ndarray) -> Record:
    """The record with another angle of attack."""
    return replace(
        record,
        outputs=tuple(
            replace(c, values=values) if c.name == "alpha" else c for c in record.outputs
        ),
    )


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 1])
def test_a_noise_level_that_runs_to_its_limit_is_an_outcome_of_its_own(seed: int) -> None:
    """An alpha that is computed, not measured: a filter follows it alone, and sigmas shrink to
    nothing.
    """
    flight, model = rigid_flight(6.0, 50.0), rigid_model()
    record = with_alpha(
        noisy(model, flight, np.random.default_rng(seed)), fly(compile_model(model), flight)[0]
    )
    estimate = fit_filter_error(
        [record], compile_model(rough_model()), FitSettings(0.02), calm=compile_model(calm_model())
    )
    assert estimate.outcome is Outcome.DEGENERATE and estimate.noise_std[0] < 1e-7
    assert np.all(np.isfinite(estimate.values)) and np.all(np.isfinite(estimate.covariance))


@pytest.mark.long
def test_a_sensor_that_stands_still_is_degenerate_with_a_filter() -> None:
    record = noisy(rigid_model(), rigid_flight(6.0, 50.0), np.random.default_rng(1))
    stuck = with_alpha(record, np.full(len(record), 0.01))
    estimate = fit_filter_error(
        [stuck], compile_model(rough_model()), FitSettings(0.02), calm=compile_model(calm_model())
    )
    assert estimate.outcome is Outcome.DEGENERATE


@pytest.mark.long
def test_the_output_whose_level_was_lost_is_told_by_name() -> None:
    record = noisy(rigid_model(), rigid_flight(6.0, 50.0), np.random.default_rng(3))
    computed = with_alpha(record, fly(compile_model(rigid_model()), rigid_flight(6.0, 50.0))[0])
    found = [
        fit_from_best_start(
            lay_out([one], compile_model(rough_model()), FitSettings(0.02)),
            compile_model(calm_model()),
        )
        for one in (record, computed)
    ]
    assert [levels_at_limit(fit) for fit in found if fit is not None] == [(), ("alpha",)]


def test_a_sigma_below_what_the_samples_can_give_is_absurd() -> None:
    record = noisy(rigid_model(), rigid_flight(6.0, 50.0), np.random.default_rng(2))
    layout = lay_out([record], compile_model(rough_model(1.0)), FitSettings(0.02))
    fit = fit_from_best_start(layout, compile_model(calm_model()))
    assert fit is not None
    honest = np.sqrt(
        np.diag(np.linalg.inv(fit.normal_equations()[0] + 1e-12 * np.eye(len(fit.theta))))
    )[: len(layout.shared)]
    assert implausibly_small_sigmas(fit, honest) == []
    wrong = honest.copy()
    wrong[layout.shared.index("Cm_q")] = 1e-9
    assert implausibly_small_sigmas(fit, wrong) == ["Cm_q"]


def test_third_differences_show_white_noise_and_pass_over_what_is_slow() -> None:
    rng, time = np.random.default_rng(3), np.arange(4000) * 0.02
    rows = np.array([np.sin(time) + 0.01 * rng.standard_normal(len(time)), 3.0 * time**2])
    valid = rng.random(rows.shape) > 0.1
    shown = white_noise_level([rows], [valid])
    assert shown[0] == pytest.approx(0.01, rel=0.06) and shown[1] < 1e-9
    assert np.isinf(white_noise_level([rows], [np.zeros_like(valid)])).all()
