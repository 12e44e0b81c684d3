"""Tracing studies are scored with what the fitted model should find, predict a third record, and
say why a hint is not claimed.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from ident.tracing.diagnosis import Requirement, Verdict
from ident.whole_record.output_error import estimate_of
from scenarios.studies.catalogue import load_document, scenario_names
from scenarios.trials import planted_study as comparable
from scenarios.trials.planted_declaration import Grade, TraceScenario, true_vehicle
from scenarios.trials.planted_flights import fly_trace, trace_scenario_of, write_simulated
from scenarios.trials.planted_report import trace_text, write_trace
from scenarios.trials.planted_study import (
    NOISE_FREE,
    Scored,
    TraceStudy,
    comparable_to,
    noise_free_fit,
    quantities_of,
    run_trace,
    truth_of,
)
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.maths import complex_step_jacobian

SIGMAS = 4.0  # of a score that is right: one in 16,000


def scenario(name: str) -> TraceScenario:
    return trace_scenario_of(*load_document(name, ()))


@cache
def study(name: str, seed: int = 1) -> TraceStudy:
    return run_trace(scenario(name), seed)


def rows(found: TraceStudy) -> dict[str, Scored]:
    return {row.name: row for row in (*found.derivatives, *found.effects, *found.modes)}


def condensed_by_the_equations(vehicle: Model) -> dict[str, float]:
    """The six derivatives with the bending states eliminated from the linear equations of motion,
    their rates set to zero.
    """
    system, v = compile_model(vehicle), {item.name: item.value for item in vehicle.parameters}
    p = system.parameters.values().tolist()
    A = complex_step_jacobian(lambda x: system.f(0.0, x, [0.0], p), [0.0] * len(system.states))
    B = complex_step_jacobian(lambda u: system.f(0.0, [0.0] * len(system.states), u, p), [0.0])
    moves = np.linalg.solve(A[2:, 2:], np.hstack([A[2:, :2], B[2:]]))
    reduced = np.hstack([A[:2, :2], B[:2]]) - A[:2, 2:] @ moves
    lift = 2.0 * v["mass"] / (v["air_density"] * v["airspeed"] * v["wing_area"])
    moment = (
        2.0
        * v["pitch_inertia"]
        / (v["air_density"] * v["airspeed"] ** 2 * v["wing_area"] * v["chord"])
    )
    per_rate = 2.0 * v["airspeed"] / v["chord"]
    loads = np.vstack([lift * (np.array([0.0, 1.0, 0.0]) - reduced[0]), moment * reduced[1]])
    scale = {"alpha": 1.0, "q": per_rate, "de": 1.0}
    return {
        f"{load}_{by}": float(loads[i, j] * scale[by])
        for i, load in enumerate(("CL", "Cm"))
        for j, by in enumerate(scale)
    }


@pytest.mark.long
def test_of_a_closed_loop_the_flown_lift_equation_and_gearing_are_the_truth() -> None:
    found = study("trace-breakout")
    row = rows(found)
    assert row["L_q"].true == 0.994, "as the airframe flies"
    assert all(abs(each.sigmas) < SIGMAS for each in row.values())
    # A gearing that steepens by 5 % an inch, flown with inputs of up to an inch, and nothing else
    # raises the gain.
    true = row["M_delta"].true
    assert true is not None and 1.05 < row["M_delta"].comparable / true < 1.08
    (geared,) = [reason for reason in found.reasons if "gearing" in reason]
    assert (
        "5 % an inch" in geared
        and "M_delta" in geared
        and "half_width 0.15 with a straight gearing" in geared
    )
    assert geared in trace_text(found, width=10_000)


@pytest.mark.long
def test_of_a_flexible_aircraft_condensed_values_and_the_coupled_mode_are_the_truth() -> None:
    found = study("trace-elastic")
    row, vehicle = rows(found), true_vehicle(scenario("trace-elastic").flight)
    for name, value in condensed_by_the_equations(vehicle).items():
        assert row[name].condensed == pytest.approx(value, rel=1e-6)
    assert row["CL_alpha"].open and row["CL_alpha"].comparable == pytest.approx(2.721, abs=5e-4)
    frequency, damping = row["elastic_mode_1_frequency"], row["elastic_mode_1_damping"]
    assert frequency.true == pytest.approx(12.402, abs=5e-4) and damping.true == pytest.approx(
        0.0381, abs=5e-5
    )
    # By the true equations and by a fit of the library's mode to the flight without noise.
    assert frequency.comparable == pytest.approx(frequency.true, rel=1e-3)
    assert damping.comparable == pytest.approx(damping.true, rel=1e-2)
    assert all(abs(each.sigmas) < SIGMAS for each in row.values())
    assert "(2.7212)" in trace_text(found) and "static condensation" in trace_text(
        found, width=10_000
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["trace-vane", "trace-drag", "trace-lateral-rudder", "trace-own-model"]
)
def test_where_the_model_holds_the_truth_the_noise_free_fit_finds_it(name: str) -> None:
    found = study(name)
    d, truth = found.tracing.diagnosis, truth_of(found.scenario, found.simulated)
    assert d.verdict is Verdict.TRACED and d.trained_after is not None
    estimates = quantities_of(d)
    fit = noise_free_fit(found.tracing.model, d.trained_after, estimates, found.simulated)
    assert fit is not None
    estimate = estimate_of(fit)
    shared = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    compared = [name for name in truth.values if name in shared]
    assert set(found.simulated.derivatives) <= set(compared)
    for each in compared:
        assert abs(shared[each] - truth.values[each]) < 0.15 * estimates[each].std, each
    assert found.basis == NOISE_FREE and not found.reasons


@pytest.mark.long
def test_python_compares_with_the_same_values() -> None:
    """``sigmas`` of a data frame are those that the command prints."""
    import flightid as fid

    frame, printed = fid.run("trace-breakout").to_dataframe(), rows(study("trace-breakout"))
    assert frame.loc["M_delta", "true"] == pytest.approx(printed["M_delta"].comparable, rel=1e-12)
    assert frame.loc["M_delta", "sigmas"] == pytest.approx(printed["M_delta"].sigmas, abs=1e-6)


@pytest.mark.long
def test_the_noise_of_both_copies_cancels(monkeypatch: pytest.MonkeyPatch) -> None:
    found = study("trace-breakout")
    first = {row.name: row.comparable for row in (*found.derivatives, *found.effects)}
    monkeypatch.setattr(comparable, "NOISE_SEED", 123)
    again = comparable_to(
        found.tracing, found.simulated, truth_of(found.scenario, found.simulated)
    ).values
    sigma = {
        name: quantity.std for name, quantity in quantities_of(found.tracing.diagnosis).items()
    }
    assert all(abs(again[name] - value) < 0.15 * sigma[name] for name, value in first.items())


@pytest.mark.sampled
@pytest.mark.parametrize("name", scenario_names("trace"))
def test_the_third_record_is_flown_apart(name: str, tmp_path: Path) -> None:
    whole = scenario(name)
    flight = whole.flight
    assert flight.test is not None and flight.test != flight.validate, (
        "its own maneuvers, or where none moves its own length"
    )
    train, validate, test = (
        replace(plan, duration=2.0) for plan in (flight.train, flight.validate, flight.test)
    )
    short = replace(
        whole, flight=replace(flight, step=0.01, train=train, validate=validate, test=test)
    )
    flown = fly_trace(short, 1)
    assert not np.array_equal(flown.test.output_array()[0], flown.validate.output_array()[0])
    write_simulated(flown, tmp_path)
    assert sorted(path.name for path in tmp_path.glob("*.csv")) == ["train.csv", "validate.csv"], (
        "the loop is not given it"
    )
    plain = fly_trace(replace(short, flight=replace(short.flight, test=None)), 1)
    assert np.array_equal(plain.train.output_array()[0], flown.train.output_array()[0])
    assert np.array_equal(plain.validate.output_array()[0], flown.validate.output_array()[0])


@pytest.mark.long
def test_errors_on_the_third_record_are_told_before_and_after(tmp_path: Path) -> None:
    found = study("trace-delay")
    before, after = found.test.before.rmse, found.test.after.rmse
    for name, noise in found.simulated.noise_std.items():
        assert after[name] == pytest.approx(noise, rel=0.1) and before[name] > 1.5 * noise
    write_trace(found, tmp_path / "study", figures=())
    content = json.loads((tmp_path / "study" / "comparison.json").read_text())
    third = content["third_record"]
    assert third["after"]["rmse"] == after and third["before"]["rmse"] == before
    assert third["used_in_fit"] is False and third["used_to_choose"] is False
    header = (tmp_path / "study" / "test_prediction.csv").read_text().splitlines()[0]
    assert header.startswith("time,before_") and (tmp_path / "study" / "test.csv").is_file()
    assert (
        content["parameters"]["CL_alpha"]["comparable"] == 2.922
        and content["comparable"]["basis"] == NOISE_FREE
    )
    assert "third record, test.csv, which took no part" in trace_text(found, width=10_000)
    assert "third record" in (tmp_path / "study" / "report.html").read_text()


def missed(requirement: Requirement) -> bool:
    return (
        requirement.value <= requirement.bar
        if requirement.at_least
        else requirement.value >= requirement.bar
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "seed", "told"),
    [
        ("trace-outside", 1, "which is no effect of the library"),
        ("trace-rhythm", 1, "which is no effect of the library"),
    ],
)
def test_what_is_not_claimed_says_why_with_its_number_and_bar(
    name: str, seed: int, told: str, tmp_path: Path
) -> None:
    found = study(name, seed)
    d = found.tracing.diagnosis
    assert d.verdict is Verdict.UNEXPLAINED
    assert d.not_met and all(missed(requirement) for requirement in d.not_met)
    assert any(told in caution.sentence for caution in d.warnings)
    text = trace_text(found, width=10_000)
    assert all(f"not claimed: {requirement.sentence}" in text for requirement in d.not_met)
    for claim in d.effects:
        assert not claim.claimed and claim.reasons, "a hint says why it is none"
    write_trace(found, tmp_path / "study", figures=())
    content = json.loads((tmp_path / "study" / "diagnosis.json").read_text())
    assert [entry["sentence"] for entry in content["not_met"]] == [
        requirement.sentence for requirement in d.not_met
    ]
    assert all(
        {"value", "required", "asked", "effects"} <= entry.keys() for entry in content["not_met"]
    )
    assert all(entry["reasons"] for entry in content["effects"])


@pytest.mark.long
def test_a_scale_height_is_found_beside_a_drag_that_drifts() -> None:
    """In a fall a guard, drag that drifts, is nearly the same: the cause that has a name is the
    more probable.
    """
    found = study("trace-density")
    d = found.tracing.diagnosis
    (claim,) = d.effects
    assert d.verdict is Verdict.TRACED and found.grade is Grade.RIGHT
    assert claim.name == "density-scale-height" and claim.probability[claim.name] > 0.95
    change = claim.parameters["change"]
    assert abs(change.value - 0.05) < 4.0 * change.std < 0.01


@pytest.mark.long
def test_a_requirement_is_a_sentence_with_both_numbers() -> None:
    low = Requirement("the damping over its standard deviation", 1.14, 2.0, at_least=True)
    high = Requirement("the standard deviation of CL_q", 28.3, 10.0, at_least=False, unit="1/rad")
    assert low.sentence == "the damping over its standard deviation is 1.14, required is at least 2"
    assert (
        high.sentence
        == "the standard deviation of CL_q is 28.3 1/rad, required is at most 10 1/rad"
    )
    assert study("trace-delay").tracing.diagnosis.not_met == ()
