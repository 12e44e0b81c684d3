"""Tracing scenarios: laws for every one of them, the files of one that is run, and how a diagnosis
is scored.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ident.tracing.diagnosis import Claim, Verdict
from scenarios.studies.catalogue import (
    load_document,
    load_scenario,
    scenario_kind,
    scenario_names,
    scenario_text,
)
from scenarios.studies.estimating import vehicle_model
from scenarios.studies.schema import unit_of
from scenarios.trials.planted_declaration import (
    OWN,
    Expectation,
    Grade,
    TraceScenario,
    grade,
    own_terms,
)
from scenarios.trials.planted_flights import fly_trace, trace_scenario_of, write_simulated
from scenarios.trials.planted_study import run_trace
from sim.declaration.model import Noise
from sim.effects.library import effect_names
from sim.errors import DeclarationError
from tests.diagnoses import tracing_of

NAMES = scenario_names("trace")
EXPECTED = {
    "elastic",
    "breakout",
    "density",
    "drag",
    "delay",
    "vane",
    "turbulence",
    "pair",
    "other-form",
    "outside",
    "nothing",
    "flexible",
}
LATERAL = {"lateral-rudder", "lateral-vane", "lateral-backlash", "lateral-gust"}
LONGITUDINAL = {
    "longitudinal-thrust",
    "longitudinal-pitot",
    "longitudinal-drag",
    "longitudinal-wind",
}
HEADERS = {
    "lateral": {"time", "aileron", "rudder", "beta", "p", "r", "phi", "ny"},
    "longitudinal": {"time", "elevator", "thrust", "airspeed", "alpha", "theta", "q", "nz", "nx"},
}
USUAL_HEADER = {"time", "elevator", "stick", "alpha", "q", "nz", "altitude"}


def scenario(name: str, *changes: str) -> TraceScenario:
    return trace_scenario_of(*load_document(name, changes))


def test_the_kinds_of_the_catalogue() -> None:
    assert {f"trace-{name}" for name in EXPECTED | LATERAL | LONGITUDINAL} <= set(NAMES)
    assert set(scenario_names("identification")).isdisjoint(NAMES)
    assert all(scenario_kind(name) == "trace" for name in NAMES)
    with pytest.raises(DeclarationError, match="kind 'trace'"):
        load_scenario("trace-nothing")


@pytest.mark.sampled
@pytest.mark.parametrize("name", NAMES)
def test_declares_what_is_hidden_and_what_should_be_found(name: str) -> None:
    declared = scenario(name)
    assert declared.title and declared.about and "[own]" in scenario_text(name)
    library = {each.partition(":")[0] for each in effect_names()}
    own = {term.name for term in declared.flight.hidden if term.name.startswith(OWN)}
    assert own <= set(own_terms())
    assert bool(own) == (
        declared.distance in ("effect of another form missing", "nothing in the library fits")
    )
    for names in declared.expect.effects:
        assert {each.partition(":")[0] for each in names} <= library
    assert ("unexplained" in declared.expect.verdicts) == (
        declared.distance == "nothing in the library fits"
    )
    assert (
        declared.flight.train.maneuvers != declared.flight.validate.maneuvers
        or declared.model == "ballistic"
    )


@pytest.mark.sampled
@pytest.mark.parametrize("name", NAMES)
def test_the_files_hold_no_truth(name: str, tmp_path: Path) -> None:
    whole = scenario(name)
    first, second = (
        replace(plan, duration=2.0) for plan in (whole.flight.train, whole.flight.validate)
    )
    flown = fly_trace(
        replace(whole, flight=replace(whole.flight, step=0.01, train=first, validate=second)), 1
    )
    train, validate, vehicle = write_simulated(flown, tmp_path)
    header = train.read_text().splitlines()[0].split(",")
    own = whole.flight.own
    declared = (
        {"time", *(signal.name for signal in (*own.equations.inputs, *own.equations.outputs))}
        if own is not None
        else USUAL_HEADER
    )
    assert set(header) <= HEADERS.get(whole.model, declared)
    assert not np.array_equal(flown.train.output_array()[0], flown.validate.output_array()[0])
    text = vehicle.read_text()
    for key, value in flown.derivatives.items():
        assert f"{key} = {value!r}\n" not in text, "the file starts at the truth"
    assert validate.is_file()


@pytest.mark.sampled
@pytest.mark.parametrize("name", sorted(LATERAL | LONGITUDINAL))
def test_what_is_hidden_acts_and_every_input_moves(name: str) -> None:
    whole = scenario(f"trace-{name}")
    coarse = replace(whole, flight=replace(whole.flight, step=0.02))
    flown, bare = (
        fly_trace(coarse, 1),
        fly_trace(replace(coarse, flight=replace(coarse.flight, hidden=())), 1),
    )
    for record, without in ((flown.train, bare.train), (flown.validate, bare.validate)):
        assert all(np.ptp(channel.values) > 0 for channel in record.inputs)
        assert {channel.name for channel in (*record.inputs, *record.outputs)} == HEADERS[
            whole.model
        ] - {"time"}
        misfit = record.output_array()[0] - without.output_array()[0]
        sigma = np.array([[flown.noise_std[channel.name]] for channel in record.outputs])
        # The noise is the same, so that what differs is what is hidden; its log likelihood is half
        # of this.
        assert np.sum((misfit / sigma) ** 2) > 100.0
        assert np.max(np.abs(misfit / sigma)[:, record.time < 0.5]) < 1.0, (
            "both begin alike, before anything moves"
        )
    free = vehicle_model(whole.flight.vehicle, 0, Noise()).parameters.free_names
    assert len(free) > 8 and set(flown.derivatives) == set(free), (
        "a sideslip derivative is none of an elastic mode"
    )
    for plan in (whole.flight.train, whole.flight.validate):
        times = [
            maneuver.numbers[key] * whole.flight.rate
            for maneuver in plan.maneuvers
            for key in ("start", "unit")
            if key in maneuver.numbers
        ]
        assert times == pytest.approx(np.round(times)), (
            "a switch between two samples would be recorded late"
        )


def test_sideslip_is_an_angle_and_no_ballistic_coefficient() -> None:
    assert scenario("trace-lateral-vane").flight.noise_std["beta"] == pytest.approx(np.deg2rad(0.1))
    assert (
        unit_of("beta") == "kg/m2"
        and unit_of("beta", "lateral") == "rad"
        and unit_of("p", "lateral") == "rad/s"
    )


@pytest.mark.long
def test_a_study_is_written_with_truth_before_and_after(tmp_path: Path) -> None:
    from scenarios.trials.planted_report import trace_text, write_trace

    study = run_trace(scenario("trace-nothing"))
    assert study.grade is Grade.RIGHT
    write_trace(study, tmp_path / "study", figures=())
    page = json.loads((tmp_path / "study" / "report.json").read_text(encoding="utf-8"))
    assert page["sections"][0]["title"] == "Against the truth"
    content = json.loads((tmp_path / "study" / "comparison.json").read_text())
    assert content["schema"] == "flightid/comparison/1"
    assert set(content["parameters"]) == {"CL_alpha", "CL_q", "CL_de", "Cm_alpha", "Cm_q", "Cm_de"}
    for entry in content["parameters"].values():
        assert entry["std"] > 0
        assert abs(entry["estimate"] - entry["true"]) < 5.0 * entry["std"]
    assert set(content["methods"]) == {"declared-model"}
    assert json.loads((tmp_path / "study" / "truth.json").read_text())["effects"] == []
    assert (
        json.loads((tmp_path / "study" / "diagnosis.json").read_text())["verdict"] == "consistent"
    )
    for name in ("train.csv", "validate.csv", "vehicle.toml", "validate_prediction.csv"):
        assert (tmp_path / "study" / name).is_file()
    text = trace_text(study)
    assert "nothing was hidden" in text and "the diagnosis is right" in text


def graded(verdict: Verdict, claims: tuple[Claim, ...], expect: Expectation) -> Grade:
    made = tracing_of(verdict)
    return grade(expect, replace(made, diagnosis=replace(made.diagnosis, effects=claims)))


def test_grades() -> None:
    expect = Expectation(("traced",), (("input-delay",),))
    delay, lag = Claim("input-delay", {}), Claim("actuator-lag", {}, ("input-delay",))
    assert graded(Verdict.TRACED, (delay,), expect) is Grade.RIGHT
    assert graded(Verdict.AMBIGUOUS, (lag,), expect) is Grade.AMBIGUOUS
    # The right name first, with another that could take its place, is no worse.
    assert (
        graded(Verdict.AMBIGUOUS, (Claim("input-delay", {}, ("actuator-lag",)),), expect)
        is Grade.AMBIGUOUS
    )
    assert (
        graded(Verdict.AMBIGUOUS, (Claim("vane-offset", {}, ("actuator-lag",)),), expect)
        is Grade.WRONG
    )
    assert graded(Verdict.TRACED, (Claim("vane-offset", {}),), expect) is Grade.WRONG
    assert graded(Verdict.TRACED, (delay, Claim("vane-offset", {})), expect) is Grade.WRONG
    assert graded(Verdict.CONSISTENT, (), expect) is Grade.WRONG
    assert (
        graded(Verdict.UNEXPLAINED, (Claim("input-delay", {}, claimed=False),), expect)
        is Grade.UNDECIDED
    )
    assert graded(Verdict.UNEXPLAINED, (), Expectation(("unexplained",))) is Grade.RIGHT
    assert graded(Verdict.CONSISTENT, (), Expectation(("consistent",))) is Grade.RIGHT
    assert graded(Verdict.TRACED, (delay,), Expectation(("consistent",))) is Grade.WRONG


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("hidden.1.name=input-dely", "did you mean"),
        ("hidden.1.values.width=3", "has no width"),
        ("flight.vehicle=bomber", "no vehicle"),
        ("estimate.start.beta=3", "there is no beta"),
        ("expect.verdicts=[]", "nothing in it"),
    ],
)
def test_wrong_declarations_are_told(change: str, told: str) -> None:
    with pytest.raises(DeclarationError, match=told):
        fly_trace(scenario("trace-delay", change), 1)


@pytest.mark.slow
def test_a_late_rudder_is_told_from_the_ailerons() -> None:
    study = run_trace(scenario("trace-lateral-rudder"))
    assert study.grade is Grade.RIGHT
    (delay,) = study.effects
    assert delay.name == "input-delay:rudder.delay" and abs(delay.after.value - 0.07) < 0.002
    assert {row.name for row in study.derivatives} == set(study.simulated.derivatives)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_the_loop_finds_what_is_hidden(name: str) -> None:
    assert run_trace(scenario(name)).grade in (Grade.RIGHT, Grade.AMBIGUOUS)


@pytest.mark.long
def test_a_record_of_eight_thousand_samples_is_traced() -> None:
    """At 400 samples/s lags of the actuator promised more than the delay, which was not tried."""
    study = run_trace(scenario("trace-delay", 'flight.rate="400 Hz"'))
    assert study.grade is Grade.RIGHT
    (delay,) = study.effects
    assert delay.name == "input-delay.delay" and abs(delay.after.value - 0.06) < 0.001
