"""The whole loop on records as they come: gaps, missing channels, uneven sampling. Finite numbers
everywhere, the same every time.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from enum import Enum
from typing import Any

import numpy as np
import pytest

from ident.tracing.diagnosis import Diagnosis, Verdict
from ident.tracing.held_out import fit_held_out
from ident.tracing.loop import diagnose
from ident.tracing.steady_search import NAMED_EFFECT_Z
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.unmeasured_input import discrepancy_for
from sim.effects.library import catch_all_terms_for, effects_for
from sim.effects.sensor_path.sensor_calibration import SensorScale
from sim.effects.sensor_path.sensor_mounting import VaneOffset
from sim.effects.sensor_path.sensor_spikes import InputSpikes, SensorSpikes
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.errors import FlightidError
from sim.record import Channel, Record
from sim.vehicles.uncoupled import ShortPeriod
from tests.bases import Flight
from tests.tracing_problem import (
    OUTPUTS,
    SETTINGS,
    coloured,
    declared,
    doublets,
    planted,
    problem_of,
    with_output,
    without_output,
)

LAG = {"sensor-lag:q.time_constant": 0.06}
SPIKES = (SensorSpikes("q", "rad/s", 0.05), InputSpikes("elevator"))
CANDIDATES: tuple[Traceable, ...] = (SensorLag("q"), SensorScale("nz"), *SPIKES)


def run(
    records: Sequence[Record],
    validation: Sequence[Record] = (),
    candidates: Sequence[Traceable] = CANDIDATES,
) -> Diagnosis:
    return diagnose(records, declared(), candidates, (), validation, SETTINGS)


def lagged(seed: int, flight: Flight | None = None) -> Record:
    return planted([SensorLag("q")], LAG, seed, flight=flight)


def gappy(record: Record, share: float, seed: int) -> Record:
    rng = np.random.default_rng(seed)
    for name in record.output_names:
        record = with_output(
            record, name, np.where(rng.random(len(record)) < share, np.nan, record[name].values)
        )
    return record


def uneven(seed: int) -> Flight:
    """Sampling that wanders by a third of its interval, with a hole of half a second."""
    even = doublets()
    time = even.time + 0.006 * np.random.default_rng(seed).uniform(-1.0, 1.0, even.time.size)
    kept = (time < 7.0) | (time > 7.5)
    return Flight(time[kept], even.u[:, kept], max_step=0.02)


def numbers(value: Any, path: str) -> Iterator[tuple[str, float]]:
    """Every number in a result, with its place; records themselves left out."""
    if isinstance(value, Record | str | bool | Enum) or value is None:
        return
    if isinstance(value, np.ndarray):
        yield from ((path, float(v)) for v in value.ravel())
    elif isinstance(value, int | float):
        yield path, float(value)
    elif isinstance(value, Mapping):
        for key, item in value.items():
            yield from numbers(item, f"{path}[{key}]")
    elif isinstance(value, Sequence):
        for i, item in enumerate(value):
            yield from numbers(item, f"{path}[{i}]")
    else:
        assert dataclasses.is_dataclass(value), f"{path} is a {type(value).__name__}"
        for item in dataclasses.fields(value):
            yield from numbers(getattr(value, item.name), f"{path}.{item.name}")


def check(
    diagnosis: Diagnosis,
    records: Sequence[Record],
    predicted: Sequence[Record],
    channels: Sequence[str],
) -> None:
    """What holds for every diagnosis."""
    found = list(numbers(diagnosis, "diagnosis"))
    assert len(found) > 1000
    assert [path for path, value in found if not np.isfinite(value)] == []
    quantities = [
        *diagnosis.before.values(),
        *diagnosis.after.values(),
        *diagnosis.derived_after.values(),
    ]
    assert all(quantity.std > 0 for quantity in quantities)
    derivatives = {
        item.name
        for item in declared().parameters
        if item.free and not item.name.startswith("bias_")
    }
    assert set(diagnosis.before) == set(diagnosis.after) == derivatives
    assert all(candidate.weight < candidate.gain for candidate in diagnosis.candidates)
    assert all(
        0.0 <= test.p_value <= 1.0 for test in (*diagnosis.tests_before, *diagnosis.tests_after)
    )
    for figures in (diagnosis.error_before, diagnosis.error_after):
        for each in (figures.rmse, figures.nrmse, figures.r2, figures.theil):
            assert set(each) == set(channels)
    assert len(diagnosis.predictions) == len(predicted)
    for prediction, record in zip(diagnosis.predictions, predicted, strict=True):
        assert prediction.record is record and prediction.channels == tuple(channels)
        assert prediction.before.shape == prediction.after.shape == (len(channels), len(record))
    for fit, record in zip(diagnosis.fitted, records, strict=True):
        np.testing.assert_array_equal(fit.record.time, record.time)
        assert (
            fit.before.shape
            == fit.after.shape
            == fit.used.shape
            == (len(fit.channels), len(record))
        )


def traces_the_lag(diagnosis: Diagnosis) -> None:
    assert diagnosis.verdict is Verdict.TRACED, diagnosis.warnings
    (claim,) = diagnosis.effects
    constant = claim.parameters["time_constant"]
    assert claim.name == "sensor-lag:q" and claim.claimed
    assert abs(constant.value - 0.06) < 4.0 * constant.std < 0.03
    assert diagnosis.error_after.rmse["q"] < diagnosis.error_before.rmse["q"]


@pytest.fixture(scope="module")
def usual() -> tuple[list[Record], list[Record], Diagnosis]:
    records, validation = [lagged(1)], [lagged(2)]
    return records, validation, run(records, validation)


@pytest.mark.long
def test_an_effect_is_traced_and_the_errors_are_those_of_held_out_data(
    usual: tuple[list[Record], list[Record], Diagnosis],
) -> None:
    records, validation, diagnosis = usual
    check(diagnosis, records, validation, OUTPUTS)
    traces_the_lag(diagnosis)
    assert diagnosis.held_out
    assert diagnosis.error_after.rmse["q"] == pytest.approx(0.002, rel=0.15)
    assert diagnosis.noise_floor["q"] == pytest.approx(0.002, rel=0.15)
    assert any("held out" in test.channel for test in diagnosis.tests_after)
    weights = {c.name: c.weight for c in diagnosis.candidates if c.within == () and c.fitted}
    assert weights["sensor-lag:q"] == max(weights.values()) > 100.0


@pytest.mark.long
def test_two_runs_are_equal_to_the_last_bit(
    usual: tuple[list[Record], list[Record], Diagnosis],
) -> None:
    records, validation, first = usual
    second = run(records, validation)
    assert list(numbers(first, "")) == list(numbers(second, ""))
    assert (
        first.steps == second.steps
        and first.candidates == second.candidates
        and first.warnings == second.warnings
    )


@pytest.mark.long
def test_without_validation_the_errors_are_those_of_the_fit() -> None:
    records = [lagged(1)]
    diagnosis = run(records)
    check(diagnosis, records, records, OUTPUTS)
    traces_the_lag(diagnosis)
    assert not diagnosis.held_out
    assert not any("held out" in test.channel for test in diagnosis.tests_after)


def test_a_clean_record_is_consistent() -> None:
    records, validation = [planted(seed=3)], [planted(seed=4)]
    diagnosis = run(records, validation)
    check(diagnosis, records, validation, OUTPUTS)
    assert diagnosis.verdict is Verdict.CONSISTENT and diagnosis.effects == ()
    for name, quantity in diagnosis.before.items():
        assert diagnosis.after[name].value == pytest.approx(quantity.value, abs=1e-3 * quantity.std)


@pytest.mark.long
def test_a_validation_record_may_lack_a_channel() -> None:
    records, validation = [lagged(1)], [without_output(lagged(2), "nz")]
    diagnosis = run(records, validation)
    check(diagnosis, records, validation, ("alpha", "q"))
    traces_the_lag(diagnosis)


@pytest.mark.long
def test_a_record_may_lack_nz() -> None:
    """Then nz is not predicted either, although the validation record has it."""
    records, validation = [without_output(lagged(1), "nz")], [lagged(2)]
    diagnosis = run(records, validation)
    check(diagnosis, records, validation, ("alpha", "q"))
    assert diagnosis.fitted[0].channels == ("alpha", "q")


def test_one_of_two_records_may_lack_nz() -> None:
    records, validation = [lagged(1), without_output(lagged(5), "nz")], [lagged(2)]
    diagnosis = run(records, validation)
    check(diagnosis, records, validation, OUTPUTS)
    traces_the_lag(diagnosis)


@pytest.mark.long
def test_a_tenth_of_the_samples_may_be_missing() -> None:
    records, validation = [gappy(lagged(1), 0.1, 1)], [gappy(lagged(2), 0.1, 2)]
    diagnosis = run(records, validation)
    check(diagnosis, records, validation, OUTPUTS)
    traces_the_lag(diagnosis)
    assert not np.any(diagnosis.fitted[0].used & ~records[0].output_array(OUTPUTS)[1])


@pytest.mark.long
def test_sampling_may_be_uneven() -> None:
    records, validation = [lagged(1, uneven(1))], [lagged(2, uneven(2))]
    assert np.ptp(np.diff(records[0].time)) > 0.4
    diagnosis = run(records, validation)
    check(diagnosis, records, validation, OUTPUTS)
    traces_the_lag(diagnosis)


@pytest.mark.long
def test_spikes_are_claimed_where_they_were_planted_and_spoil_nothing() -> None:
    record = lagged(1)
    values = record["q"].values.copy()
    values[[77, 301, 402]] += np.array([0.1, -0.08, 0.12])
    spiky = with_output(record, "q", values)
    validation = [lagged(2)]
    diagnosis = run([spiky], validation)
    check(diagnosis, [spiky], validation, OUTPUTS)
    assert diagnosis.verdict is Verdict.TRACED
    claims = {claim.name: claim for claim in diagnosis.effects}
    assert set(claims) == {"sensor-lag:q", "sensor-spikes:q"}
    assert claims["sensor-spikes:q"].parameters["count"].value == 3
    assert claims["sensor-spikes:q"].parameters["size"].value == pytest.approx(
        np.sqrt(np.mean(np.square([0.1, 0.08, 0.12]))), rel=0.05
    )
    assert np.flatnonzero(~diagnosis.fitted[0].used[1]).tolist() == [77, 301, 402]


def test_spikes_of_the_recorded_input_are_mended() -> None:
    record = planted(seed=3)
    elevator = record["elevator"].values.copy()
    elevator[[160, 333]] += np.array([0.2, -0.3])
    spiky = dataclasses.replace(record, inputs=(Channel.of("elevator", "rad", elevator),))
    validation = [planted(seed=4)]
    diagnosis = run([spiky], validation)
    check(diagnosis, [spiky], validation, OUTPUTS)
    assert [claim.name for claim in diagnosis.effects] == ["sensor-spikes:elevator"]
    assert diagnosis.effects[0].parameters["count"].value == 2
    # The fitted record holds the input as it was before it was spoilt.
    np.testing.assert_allclose(
        diagnosis.fitted[0].record["elevator"].values, record["elevator"].values, atol=1e-12
    )
    assert diagnosis.verdict is Verdict.TRACED


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "sizes"),
    [
        ("guard:alpha-q", {"lift": 0.0, "moment": 400.0}),
        ("guard:vane-near-control", {"gain": 0.15}),
    ],
)
def test_a_guard_is_never_claimed(name: str, sizes: dict[str, float]) -> None:
    """The truth is a guard's term, which the library does not name."""
    guard = next(guard for guard in catch_all_terms_for(ShortPeriod()) if guard.name == name)
    values = {f"{name}.{key}": size for key, size in sizes.items()}
    records, validation = [planted([guard], values, 1)], [planted([guard], values, 2)]
    diagnosis = diagnose(records, declared(), CANDIDATES, (guard,), validation, SETTINGS)
    check(diagnosis, records, validation, OUTPUTS)
    assert diagnosis.verdict is Verdict.UNEXPLAINED
    assert not any(claim.claimed for claim in diagnosis.effects)
    assert any(name in caution.sentence for caution in diagnosis.warnings)


@pytest.mark.long
def test_beside_a_residual_that_is_not_noise_a_claim_has_its_spread_and_its_values_of_each_record() -> (  # noqa: E501
    None
):
    """A vane 9 m ahead under errors that remember themselves for 0.3 s: the discrepancy takes
    those, and is no part of what predicts.
    """
    records = [
        coloured(planted([VaneOffset()], {"vane-offset.arm": 9.0}, seed), seed, 0.5)
        for seed in (1, 2, 3)
    ]
    discrepancy = discrepancy_for(effects_for(ShortPeriod()))
    assert discrepancy is not None
    offered = (VaneOffset(), SensorScale("q"), SensorLag("q"))
    diagnosis = diagnose(
        records[:2], declared(), offered, (), records[2:], SETTINGS, discrepancy=discrepancy
    )
    check(diagnosis, records[:2], records[2:], OUTPUTS)
    (claim,) = diagnosis.effects
    assert diagnosis.verdict is Verdict.PARTIAL and claim.name == "vane-offset" and claim.claimed
    assert claim.spread is not None and claim.spread > NAMED_EFFECT_Z
    assert len(claim.by_record) == 2
    for each in (claim.parameters, *claim.by_record):
        assert abs(each["arm"].value - 9.0) < 4.0 * each["arm"].std < 2.0
    assert all(each["arm"].std > claim.parameters["arm"].std for each in claim.by_record)
    assert diagnosis.trained_after is not None
    assert [effect.name for effect in diagnosis.trained_after.effects] == ["vane-offset"]
    # Errors of simulations are those of output error, before and after: here by a fit of its own.
    problem = problem_of(records[:2], offered)
    alone = problem.fit(offered[:1], problem.fit((), None))
    assert alone is not None
    held = fit_held_out(alone, records[2:], None, informed=False).frozen
    assert held is not None
    residual = np.where(held.layout.problems[0].valid, held.residuals[0], 0.0)
    assert diagnosis.error_after.rmse == pytest.approx(
        dict(zip(OUTPUTS, np.sqrt(np.mean(residual**2, axis=1)), strict=True)), rel=0.01
    )
    assert diagnosis.error_after.rmse["alpha"] < diagnosis.error_before.rmse["alpha"]
    assert diagnosis.one_step is not None
    before, after = diagnosis.one_step.before, diagnosis.one_step.after
    assert after.rmse["alpha"] < 0.98 * before.rmse["alpha"]
    assert min(diagnosis.one_step.gains) > 0.0
    noises = list(dict.fromkeys(each.noise for each in diagnosis.sets))
    assert len(noises) == 2
    for noise in noises:
        odds = [
            each.log_evidence + each.log_prior for each in diagnosis.sets if each.noise == noise
        ]
        assert odds == sorted(odds, reverse=True) and len(odds) > 1
    beside = [each for each in diagnosis.sets if each.noise == noises[1]]
    assert beside[0].effects == ("model-discrepancy", "vane-offset") and beside[0].log_prior < -3.0


def test_a_validation_record_that_nothing_can_simulate_gives_finite_numbers() -> None:
    bad = lagged(2)
    bad = dataclasses.replace(
        bad, inputs=(Channel.of("elevator", "rad", 1e300 * bad["elevator"].values),)
    )
    records = [lagged(1)]
    diagnosis = run(records, [bad])
    check(diagnosis, records, [bad], OUTPUTS)
    assert diagnosis.verdict is Verdict.UNEXPLAINED
    # What was measured is predicted by its mean: the spread is the error.
    assert diagnosis.error_after.nrmse == {name: pytest.approx(1.0) for name in OUTPUTS}


@pytest.mark.sampled
@pytest.mark.parametrize("count", [2, 4])
def test_a_validation_record_may_be_very_short(count: int) -> None:
    records, whole = [lagged(1)], lagged(2)
    inputs, outputs = (
        tuple(Channel.of(c.name, c.unit, c.values[:count]) for c in group)
        for group in (whole.inputs, whole.outputs)
    )
    validation = [Record(whole.time[:count], inputs, outputs, whole.hold)]
    check(run(records, validation), records, validation, OUTPUTS)


def test_progress_is_told_from_nothing_to_all() -> None:
    told: list[float] = []
    diagnose(
        [lagged(1)],
        declared(),
        CANDIDATES,
        (),
        [],
        SETTINGS,
        lambda text, share: told.append(share),
    )
    assert told[0] == 0.0 and len(told) >= 3
    assert told == sorted(told) and told[-1] <= 1.0


def test_a_record_without_any_output_is_refused() -> None:
    record = planted()
    other = Record(
        record.time,
        record.inputs,
        (Channel.of("theta", "rad", np.zeros(len(record))),),
        record.hold,
        "nothing.csv",
    )
    with pytest.raises(FlightidError, match=r"nothing\.csv"):
        run([lagged(1), other])


def test_masks_of_a_search_begin_with_what_was_measured() -> None:
    record = gappy(lagged(1), 0.1, 1)
    np.testing.assert_array_equal(problem_of([record]).masks[0], record.output_array(OUTPUTS)[1])
