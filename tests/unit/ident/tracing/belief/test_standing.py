"""Whether a claim stands by its own numbers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from ident.tracing.belief.standing import in_a_gap, in_lost_rows, too_fast, undetermined, why_not
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Concern, Quantity
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.disturbance.gust_turbulence import GustTurbulence
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.elastic_mode import ElasticMode
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.sensor_step import SensorStep
from sim.effects.sensor_path.vane_offset import VaneOffset
from sim.record import Channel, Record
from tests.tracing_problem import fit_of, planted, problem_of

LATE = SensorDelay("alpha")


@pytest.fixture(scope="module")
def fitted() -> FittedModel:
    """The declared model, fitted to a record at 50 Hz."""
    return fit_of(problem_of([planted()]))


def told(**found: tuple[float, float, str]) -> dict[str, Quantity]:
    return {name: Quantity(*parts) for name, parts in found.items()}


def test_a_time_whose_sigma_exceeds_it_is_not_claimed(fitted: FittedModel) -> None:
    assert undetermined(LATE, told(delay=(0.02, 0.03, "s"))) == ["delay"]
    assert undetermined(LATE, told(delay=(0.02, 0.004, "s"))) == []
    why = why_not(LATE, told(delay=(0.02, 0.03, "s")), fitted)
    assert why is not None and why.concern is Concern.UNDETERMINED and "delay 0.02 +- 0.03 s" in why.sentence
    assert why_not(LATE, told(delay=(0.02, 0.004, "s")), fitted) is None
    scale = why_not(SensorScale("q"), told(scale=(1.1, 1.21, "1")), fitted)
    assert scale is not None and "scale 1.1 +- 1.2)" in scale.sentence


def test_a_number_of_either_sign_is_undetermined_where_its_sigma_fills_its_range() -> None:
    load = UnmeasuredInput()
    lift = load.traits.plausible["lift"][1]
    assert undetermined(load, told(lift=(0.5 * lift, 3.0 * lift, "1"))) == ["lift"]
    assert undetermined(load, told(lift=(0.1 * lift, 0.4 * lift, "1"))) == []


def test_a_mode_that_need_not_die_out_is_a_load_that_swings(fitted: FittedModel) -> None:
    for std, stands in ((0.004, True), (0.0075, False), (0.02, False)):
        why = why_not(ElasticMode(), told(frequency=(12.0, 0.1, "rad/s"), damping=(0.01, std, "1"), lift=(0.1, 0.01, "1/rad")), fitted)
        assert (why is None) is stands
        assert why is None or "a load that swings all along does as much" in why.sentence


def test_gusts_of_a_few_centimetres_a_second_are_not_believed(fitted: FittedModel) -> None:
    for sigma, believed in ((0.06, False), (0.3, True)):
        why = why_not(GustTurbulence(), told(sigma=(sigma, 0.01, "m/s"), length=(300.0, 90.0, "m")), fitted)
        assert (why is None) is believed


def test_what_a_claim_need_not_know_is_left_out() -> None:
    assert undetermined(GustTurbulence(), told(sigma=(1.0, 0.1, "m/s"), length=(300.0, 900.0, "m"))) == []


def test_what_acts_just_while_a_control_is_held_is_that_control(fitted: FittedModel) -> None:
    """Both ends at steps of the elevator, to two samples and two sigmas; one end alone, or a course without edges, says nothing."""
    (record,) = (problem.record for problem in fitted.fit.layout.problems)
    u = record["elevator"].values
    edges = record.time[1:][np.abs(np.diff(u)) > 0.5 * np.ptp(u)]
    first, last = float(edges[0]), float(edges[2])
    assert last - first > 0.5

    def why(begin: float, end: float, std: float = 0.002) -> str:
        found = told(start=(begin, std, "s"), duration=(end - begin, std, "s"), moment=(0.005, 1e-4, "1"))
        caution = why_not(UnmeasuredInput(), found, fitted)
        return "" if caution is None else f"{caution.concern.name}: {caution.sentence}"

    assert why(first, last).startswith("ONE_CAUSE") and "a step of the elevator" in why(first, last)
    assert why(first + 0.2, last), "a surface takes its time"
    steps = record.time[1:][np.abs(np.diff(u)) > 1e-6]
    quiet = float(next(at for at in record.time if at > first + 0.5 and np.min(np.abs(steps - at)) > 0.45))
    assert not why(first, quiet) and why(first, quiet, std=0.3)
    assert not why(quiet, float(next(at for at in edges if at > quiet + 0.5)))
    gust = told(start=(first, 0.002, "s"), duration=(last - first, 0.002, "s"), peak=(2.0, 0.1, "m/s"))
    assert why_not(GustDiscrete(), gust, fitted) is None


def test_a_number_beyond_belief_is_refused_without_slack(fitted: FittedModel) -> None:
    why = why_not(VaneOffset(), told(arm=(41.0, 30.0, "m")), fitted)
    assert why is not None and why.concern is Concern.BEYOND_BELIEF and "arm" in why.sentence
    assert why_not(SensorScale("q"), told(scale=(1.2, 0.01, "1")), fitted) is None


@pytest.mark.parametrize(("moment", "believed"), [(0.05, True), (-0.05, True), (0.07, False), (-0.07, False)])
def test_a_moment_of_the_engines_is_believed_to_three_times_what_is_known_of_it(fitted: FittedModel, moment: float, believed: bool) -> None:
    """Also where the airspeed is recorded, and nothing else is left to find."""
    prior = next(item.prior_std for item in Phugoid().parameters if item.name == "trim_moment")
    assert (prior is not None and abs(moment) < 3.0 * prior) or not believed
    for phugoid in (Phugoid(), Phugoid(speed_recorded=True)):
        why = why_not(phugoid, told(trim_moment=(moment, 1e-3, "1")), fitted)
        assert (why is None) is believed and (why is None or (why.concern is Concern.BEYOND_BELIEF and "trim_moment" in why.sentence))


@pytest.mark.parametrize(("interval", "frequency", "resolved"), [(0.02, 120.0, True), (0.02, 125.6, False), (0.05, 45.0, True), (0.05, 60.0, False)])
def test_a_mode_lies_below_four_fifths_of_half_the_sampling_rate(interval: float, frequency: float, resolved: bool) -> None:
    """Half the rate is 157 rad/s at 50 Hz and 63 rad/s at 20 Hz."""
    assert (too_fast(ElasticMode(), told(frequency=(frequency, 1.0, "rad/s")), interval) == []) is resolved


def with_a_gap(record: Record, begin: float, end: float) -> Record:
    kept = (record.time < begin) | (record.time > end)
    inputs, outputs = (tuple(Channel.of(c.name, c.unit, c.values[kept]) for c in group) for group in (record.inputs, record.outputs))
    return replace(record, time=record.time[kept], inputs=inputs, outputs=outputs)


@pytest.mark.parametrize(("start", "inside"), [(4.3, True), (3.97, True), (4.55, True), (3.5, False), (6.0, False)])
def test_an_event_that_begins_in_missing_rows_is_not_claimed(start: float, inside: bool) -> None:
    """Rows from 4 to 4.5 s are missing at 50 Hz; three samples to both sides count as theirs."""
    fitted = fit_of(problem_of([with_a_gap(planted(), 4.0, 4.5)]))
    load = UnmeasuredInput()
    found = told(start=(start, 0.01, "s"), duration=(0.5, 0.02, "s"), moment=(0.01, 0.001, "1"))
    assert (in_a_gap(load, found, fitted) is not None) is inside
    why = why_not(load, found, fitted)
    assert (why is not None and why.concern is Concern.ROWS_MISSING) is inside
    assert np.median(np.diff(fitted.fit.layout.problems[0].record.time)) == pytest.approx(0.02)


@pytest.mark.parametrize(("samples", "stands"), [(2.5, True), (1.5, False)])
def test_an_event_no_longer_than_two_samples_is_the_recorders(fitted: FittedModel, samples: float, stands: bool) -> None:
    """At 50 Hz; a gust and a load alike."""
    lasts = (samples * 0.02, 1e-4, "s")
    why = why_not(UnmeasuredInput(), told(start=(4.0, 0.01, "s"), duration=lasts, moment=(0.01, 0.001, "1")), fitted)
    assert (why is None or "the recorder did that" not in why.sentence) is stands


@pytest.mark.parametrize(("std", "stands"), [(0.1, True), (0.2, False)])
def test_an_event_that_may_be_no_longer_than_two_samples_may_be_rows_that_were_lost(fitted: FittedModel, std: float, stands: bool) -> None:
    """States that go on from elsewhere, as where rows are lost, are a load without length."""
    why = why_not(UnmeasuredInput(), told(start=(4.0, 0.01, "s"), duration=(0.4, std, "s"), moment=(0.01, 0.001, "1")), fitted)
    assert (why is None or "rows that the recorder lost" not in why.sentence) is stands


@pytest.mark.parametrize(("size", "lost"), [(-1140.0, 0.6), (-100.0, 0.0), (1140.0, 0.0)], ids=["with the motion", "a few metres", "against it"])
def test_a_jump_of_the_only_output_as_far_as_the_motion_goes_may_be_rows_that_were_lost(size: float, lost: float) -> None:
    """A body that falls at 1900 m/s, recorded ten times a second."""
    time = np.arange(0.0, 12.0, 0.1)
    record = Record(time, (), (Channel.of("altitude", "m", 5e4 - 1900.0 * time),))
    problem = SimpleNamespace(record=record)

    def fall(*outputs: str) -> FittedModel:
        fit = SimpleNamespace(layout=SimpleNamespace(problems=(problem,)))
        return cast("FittedModel", SimpleNamespace(fit=fit, system=SimpleNamespace(output_names=outputs)))

    found = {"at": Quantity(6.04, 0.01, "s"), "size": Quantity(size, 2.0, "m")}
    step = SensorStep("altitude", "m", 50.0)
    assert in_lost_rows(step, found, fall("altitude")) == pytest.approx(lost, rel=1e-6)
    why = why_not(step, found, fall("altitude"))
    assert (why is not None and why.concern is Concern.ROWS_MISSING and "0.6 s" in why.sentence) is (lost > 0.0)
    # Another output would go on from elsewhere at once, and another effect does not jump.
    assert in_lost_rows(step, found, fall("altitude", "velocity")) == 0.0
    assert in_lost_rows(SensorScale("altitude"), found, fall("altitude")) == 0.0
