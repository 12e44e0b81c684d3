"""Output error in the frequency domain: against output error in time, on an unstable aircraft, in
coloured noise, and its coverage.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ident.estimate import Estimate, Outcome
from ident.frequency_domain import transform
from ident.frequency_domain.output_error import (
    FrequencySettings,
    fit_frequency_domain,
    fit_transforms,
    frequency_fit,
    from_best_start,
)
from ident.frequency_domain.transform import equal_bands, levels_differ
from ident.statistics.intervals import clustered_share
from ident.whole_record.output_error import fit_output_error
from scenarios.identification.conditions import delays_of
from scenarios.preparation.declared_model import model_of_file, outputs_with_bias
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System
from sim.errors import ModelError
from sim.record import Record
from tests.bases import ballistic_model
from tests.every_model import Case, case_of
from tests.rigid_problem import FREE, UNSTABLE, ballistic_record, rigid_record, rigid_start


def model_for(case: Case) -> Model:
    model = model_of_file(case.vehicle)
    return model.with_biases(
        outputs_with_bias(model, [signal.name for signal in model.equations.outputs])
    )


@cache
def system_for(model: str) -> tuple[System, dict[str, str]]:
    case = model_for(case_of(model))
    return compile_model(case), delays_of(case)


def errors(found: Estimate, case: Case) -> np.ndarray:
    return np.array(
        [(found.value(name) - true) / found.sigma(name) for name, true in case.true.items()]
    )


@pytest.mark.sampled
@pytest.mark.parametrize("model", ["rigid", "loes", "lateral", "own"])
def test_it_is_output_error_by_other_means(model: str) -> None:
    """The same data but for what lies outside the band: estimates and sigmas differ by that
    alone.
    """
    case, (system, delays) = case_of(model, 3), system_for(model)
    in_time, found = (
        fit_output_error([case.record], system),
        fit_frequency_domain([case.record], system, delays=delays),
    )
    assert found.outcome is Outcome.CONVERGED and found.names == in_time.names
    # An estimate with less information scatters about one with more by the root of the variances'
    # difference (Hausman 1978).
    apart = np.sqrt(np.maximum(found.std**2 - in_time.std**2, (0.3 * in_time.std) ** 2))
    assert np.all(np.abs(found.values - in_time.values) < 3.5 * apart)
    assert np.all(np.abs(found.std / in_time.std - 1.0) < 0.35) and np.all(
        np.abs(errors(found, case)) < 4.0
    )


def test_the_whole_band_leaves_hardly_a_difference() -> None:
    """Of 401 samples only the mean and the last frequency are left out."""
    case, (system, _) = case_of("rigid", 5), system_for("rigid")
    in_time = fit_output_error([case.record], system)
    found = fit_frequency_domain([case.record], system, FrequencySettings((0.0, 25.0)))
    assert np.all(np.abs(found.values - in_time.values) < 0.15 * in_time.std)
    assert found.noise_std == pytest.approx(in_time.noise_std, rel=0.02)


def test_without_noise_nothing_is_left() -> None:
    case, (system, delays) = case_of("loes", 0, noise=1e-7), system_for("loes")
    found = fit_frequency_domain([case.record], system, delays=delays)
    off = [
        abs(found.value(name) / true - 1.0) for name, true in case.true.items() if name != "delay"
    ]
    # The simulation of the record steps the delayed input at its own grid, the response at the
    # sample: hence not to the last digit.
    assert max(off) < 2e-3 and found.value("delay") == pytest.approx(0.118, abs=5e-5)


def test_several_records_are_fitted_together() -> None:
    records = [case_of("rigid", seed).record for seed in range(4)]
    system, _ = system_for("rigid")
    one, all_four = (fit_frequency_domain(some, system) for some in (records[:1], records))
    assert all_four.outcome is Outcome.CONVERGED and len(all_four.fitted) == 4
    assert all_four.std == pytest.approx(0.5 * one.std, rel=0.3)
    assert np.all(np.abs(errors(all_four, case_of("rigid"))) < 4.0)


@pytest.mark.parametrize("missing", ["alpha", "q", "nz"])
def test_an_output_that_no_record_has_takes_no_part(missing: str) -> None:
    """Its noise is one by convention and no degenerate zero; the others' are what they are."""
    case, (system, _) = case_of("rigid", 3), system_for("rigid")
    with_all = fit_frequency_domain([case.record], system)
    fewer = replace(case.record, outputs=tuple(c for c in case.record.outputs if c.name != missing))
    found = fit_frequency_domain([fewer], system)
    at = system.output_names.index(missing)
    assert found.outcome is Outcome.CONVERGED and found.noise_std[at] == 1.0
    assert np.delete(found.noise_std, at) == pytest.approx(
        np.delete(with_all.noise_std, at), rel=0.1
    )
    # Another record with it: then it counts.
    both = fit_frequency_domain([fewer, case.record], system)
    assert both.noise_std[at] == pytest.approx(with_all.noise_std[at], rel=0.1)


def test_an_unstable_aircraft_is_as_easy() -> None:
    record = rigid_record(np.random.default_rng(4), 4.0, values=UNSTABLE)
    system = compile_model(rigid_start(1.2, values=UNSTABLE))
    found = fit_frequency_domain([record], system)
    off = np.array([(found.value(name) - UNSTABLE[name]) / found.sigma(name) for name in FREE])
    assert found.outcome is Outcome.CONVERGED and np.all(np.abs(off) < 4.0)


def test_a_band_of_ones_own_leaves_out_what_lies_beside_it() -> None:
    """A hum that is far above the motion spoils a fit of all frequencies, and not one below it."""
    case, (system, _) = case_of("rigid", 6), system_for("rigid")
    hum = 0.02 * np.sin(2.0 * np.pi * 17.0 * case.record.time)
    channels = tuple(
        replace(channel, values=channel.values + hum) if channel.name == "q" else channel
        for channel in case.record.outputs
    )
    found = fit_frequency_domain(
        [replace(case.record, outputs=channels)], system, FrequencySettings((0.0, 4.0))
    )
    clean = fit_frequency_domain([case.record], system, FrequencySettings((0.0, 4.0)))
    assert np.all(np.abs(found.values - clean.values) < 1.0 * clean.std)
    assert found.noise_std == pytest.approx(clean.noise_std, rel=0.3)


def test_refusals_are_one_line() -> None:
    case, (system, _) = case_of("loes"), system_for("loes")
    with pytest.raises(
        ModelError, match="input-delay act on the input or sensor path; use output-error"
    ):
        fit_frequency_domain([case.record], system)
    with pytest.raises(ModelError, match="it has no input"):
        fit_frequency_domain(
            [ballistic_record(np.random.default_rng(0))], compile_model(ballistic_model())
        )
    longitudinal = case_of("longitudinal")
    with pytest.raises(
        ModelError, match="the rate of airspeed is no linear function of states and inputs"
    ):
        fit_frequency_domain([longitudinal.record], compile_model(model_for(longitudinal)))


def noise_with_memory(rng: np.random.Generator, record: Record, share: float = 0.9) -> Record:
    """The record with noise that remembers the sample before, three times its own."""
    channels = []
    for channel in record.outputs:
        drawn, row = rng.standard_normal(len(record)), np.zeros(len(record))
        for k in range(1, len(record)):
            row[k] = share * row[k - 1] + np.sqrt(1.0 - share**2) * drawn[k]
        channels.append(
            replace(
                channel,
                values=channel.values
                + 3.0 * {"alpha": 0.001, "q": 0.002, "nz": 0.01}[channel.name] * row,
            )
        )
    return replace(record, outputs=tuple(channels))


def test_a_delay_of_whole_samples_is_no_trap() -> None:
    """A held input makes a kink of the likelihood there: seed 3 has its maximum upon one, three
    samples of 0.04 s late.
    """
    case, (system, delays) = case_of("loes", 3), system_for("loes")
    found = fit_frequency_domain(
        [case.record], system, FrequencySettings((0.0, 12.5)), delays=delays
    )
    assert found.outcome is Outcome.CONVERGED and found.value("delay") == pytest.approx(
        0.12, abs=1e-6
    )


def test_noise_that_is_not_level_gets_bands() -> None:
    case, (system, _) = case_of("rigid", 8), system_for("rigid")
    found = fit_frequency_domain(
        [noise_with_memory(np.random.default_rng(8), case.record)],
        system,
        FrequencySettings((0.0, 12.0)),
    )
    assert "the noise level depends on frequency: 6 bands" in found.message
    assert found.outcome is Outcome.CONVERGED and np.all(np.abs(errors(found, case)) < 4.0)


def test_level_noise_is_not_split() -> None:
    """The threshold is one in a thousand records: of 400 draws three or more would be one in a
    hundred.
    """
    rng, accused = np.random.default_rng(9), 0
    bands = equal_bands([np.arange(90.0)])
    for _ in range(400):
        residual = rng.standard_normal((3, 90)) + 1j * rng.standard_normal((3, 90))
        accused += levels_differ([residual], [np.ones(3, dtype=bool)], bands, np.full(3, 1e-30))
    assert accused < 3


def test_level_noise_is_split_as_often_as_is_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 600 draws at a level of one in ten 60, give or take four deviations and what chi-squared
    misses with 30 harmonics a band.
    """
    monkeypatch.setattr(transform, "LEAST_UNIFORM_NOISE_PROBABILITY", 0.1)
    rng, accused = np.random.default_rng(10), 0
    bands = equal_bands([np.arange(180.0)])
    for _ in range(600):
        residual = rng.standard_normal((3, 180)) + 1j * rng.standard_normal((3, 180))
        accused += levels_differ([residual], [np.ones(3, dtype=bool)], bands, np.full(3, 1e-30))
    assert accused / 600 == pytest.approx(0.1, abs=0.05)


def test_a_bound_is_kept() -> None:
    case, (system, _) = case_of("rigid", 2), system_for("rigid")
    low = 0.95 * case.true["Cm_alpha"]  # above the truth, which is negative
    bounded = replace(
        system,
        parameters=system.parameters.with_values(
            {"Cm_alpha": 0.9 * case.true["Cm_alpha"]}
        ).with_bounds({"Cm_alpha": (low, 0.0)}),
    )
    fit, problem = frequency_fit([case.record], bounded, FrequencySettings((0.0, 4.0)))
    assert fit is not None and fit.theta[problem.names.index("Cm_alpha")] == low
    again = fit_transforms(fit.problem, fit)
    assert (
        again is not None
        and again.iterations <= 2
        and again.cost == pytest.approx(fit.cost, abs=1e-6)
    )


def test_a_prior_stays_where_it_was_declared_when_the_fit_begins_elsewhere() -> None:
    """A fit that does not settle is begun at equation error as well: a tight prior far from the
    truth still holds the parameter where it is.
    """
    case, (system, _) = case_of("rigid", 2), system_for("rigid")
    far = 0.5 * case.true["Cm_alpha"]
    held = replace(
        system,
        parameters=system.parameters.with_values({"Cm_alpha": far}).with_prior({"Cm_alpha": 1e-6}),
    )
    _, problem = frequency_fit([case.record], held, FrequencySettings(use_priors=True))
    found = from_best_start(replace(problem, iterations=1), [case.record])
    assert (
        found is not None
        and found.outcome is not Outcome.CONVERGED
        and found.problem.start.tolist() == problem.start.tolist()
    )
    assert found.theta[problem.names.index("Cm_alpha")] == pytest.approx(far, abs=0.01 * abs(far))


@pytest.mark.slow
@pytest.mark.parametrize("model", ["loes", "lateral", "rigid"])
def test_intervals_hold_the_truth_as_often_as_they_should(model: str) -> None:
    """Of the two-sigma intervals of 120 records 95.4 % should, the parameters of a record counted
    together.
    """
    system, delays = system_for(model)
    held = []
    for seed in range(120):
        case = case_of(model, 1000 + seed)
        found = fit_frequency_domain([case.record], system, delays=delays)
        assert found.outcome is Outcome.CONVERGED
        held.append(np.count_nonzero(np.abs(errors(found, case)) < 2.0))
    low, high = clustered_share(
        np.array(held), np.full(120, len(case.true)), np.random.default_rng(0), 0.999
    )
    assert low <= 0.9545 <= high, (np.sum(held) / (120 * len(case.true)), low, high)


@pytest.mark.slow
def test_in_noise_with_memory_intervals_are_better_than_those_in_time() -> None:
    """Noise of nearly the motion's own spectrum, on 28 harmonics: nine in ten (less two deviations
    of 60 records) against 86 in a hundred.
    """
    system, delays = system_for("loes")
    held, in_time = [], []
    for seed in range(60):
        case = case_of("loes", 1000 + seed)
        record = noise_with_memory(np.random.default_rng(seed), case.record)
        found = fit_frequency_domain([record], system, delays=delays)
        assert found.outcome is Outcome.CONVERGED
        held.append(np.mean(np.abs(errors(found, case)) < 2.0))
        in_time.append(np.mean(np.abs(errors(fit_output_error([record], system), case)) < 2.0))
    assert np.mean(held) > 0.88 and np.mean(held) > np.mean(in_time)
