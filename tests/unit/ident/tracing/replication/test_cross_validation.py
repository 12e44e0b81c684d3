"""Effects that stand where what remains is not noise: found by leaving one record out, alone and as a pair."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.replication.by_record import Flight
from ident.tracing.replication.cross_validation import _promising, cross_validate
from ident.tracing.replication.weighing import within_reach, without_record
from ident.tracing.screening.context import search_context
from ident.whole_record.output_error import fit_covariance
from sim.declaration.proposal import fitted_to
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.disturbance.speed_variation import SpeedVariation
from sim.effects.dynamics.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.guards.products import GUARDS
from sim.effects.input_path.input_deadband import InputDeadband
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_drift import SensorDrift
from sim.effects.sensor_path.sensor_scale import SensorScale
from tests.bases import Flight as Flown
from tests.bases import rigid_flight
from tests.tracing_problem import all_records, coloured, fit_of, planted, problem_of, root_of

LATE = SensorDelay("alpha")
SCALED = SensorScale("q")


@pytest.fixture(scope="module")
def clean() -> Flight:
    return all_records([coloured(planted([], None, seed), seed) for seed in (4, 5, 6)])


def test_a_cause_stands_in_coloured_noise_and_comes_out_alike(late: Flight) -> None:
    validated, weighed = cross_validate(late, (LATE, SCALED, *GUARDS[:3]), root_of(late))
    assert [item.best.effect.name for item in validated] == ["sensor-delay:alpha"]
    best = validated[0].best
    assert best.replication.agrees and all(change < 0 for change in best.reduction.by_record)
    for found in best.replication.values:
        assert found["delay"].value == pytest.approx(0.08, abs=4.0 * found["delay"].std)
    assert {item.effect.name for item in weighed} >= {"sensor-delay:alpha"}


def test_nothing_stands_where_there_is_only_colour(clean: Flight) -> None:
    validated, weighed = cross_validate(clean, (LATE, SCALED, InputDeadband("elevator", "rad", 0.01), *GUARDS[:3]), root_of(clean))
    assert validated == []
    assert not any(item.stands for item in weighed)


def test_leaving_a_record_out_by_one_step_is_nearly_a_fit_to_the_others(late: Flight) -> None:
    everything = fit_of(problem_of(list(late.records)), (LATE,), None, {"sensor-delay:alpha.delay": 0.07})
    others = fit_of(problem_of(list(late.records[1:])), (LATE,), None, {"sensor-delay:alpha.delay": 0.07})
    stepped = without_record(everything, 0).values.shared
    sigma = np.sqrt(np.diag(fit_covariance(others.fit)[0]))
    away = {name: abs(stepped[name] - value) / sigma[i] for i, (name, value) in enumerate(others.values.shared.items())}
    unmoved = {name: abs(everything.values.shared[name] - value) / sigma[i] for i, (name, value) in enumerate(others.values.shared.items())}
    assert max(away.values()) < 0.5, away
    assert sum(away.values()) < 0.5 * sum(unmoved.values())


def test_a_curve_is_not_asked_for_what_only_one_record_flew() -> None:
    flight = rigid_flight(8.0, 50.0)
    records = [planted([], None, seed, flight=Flown(flight.time, share * flight.u, max_step=0.02)) for seed, share in ((1, 1.0), (2, 1.0), (3, 2.0))]
    fitted = root_of(all_records(records))
    bend = fitted_to(MOMENT_NONLINEARITY, search_context(fitted))
    assert within_reach(fitted, bend) == [0, 1]
    assert within_reach(fitted, SCALED) == [0, 1, 2]
    alike = root_of(all_records(records[:2]))
    assert within_reach(alike, fitted_to(MOMENT_NONLINEARITY, search_context(alike))) == [0, 1]


def test_two_faults_that_hide_each_other_are_found_as_a_pair() -> None:
    """A scale of nz and a late q: the derivatives take in most of what either does alone."""
    values = {"sensor-scale:nz.scale": 1.35, "sensor-delay:q.delay": 0.04}
    scale, late = SensorScale("nz"), SensorDelay("q")
    flight = all_records([coloured(planted([scale, late], values, seed), seed) for seed in (1, 2, 3)])
    validated, _ = cross_validate(flight, (LATE, SCALED, scale, late, *GUARDS[:3]), root_of(flight))
    assert {item.best.effect.name for item in validated} == {"sensor-scale:nz", "sensor-delay:q"}


def test_beside_a_phugoid_an_even_change_of_speed_is_not_tried() -> None:
    """Not even where it would explain what the phugoid leaves: here it is trimmed anew at every speed."""
    even, drift = SpeedVariation(weight=False), SensorDrift("nz", "g", 5e-3)
    values = {"speed-variation.rate": 6.0, "sensor-drift:nz.slope": 0.01}
    problem = problem_of([planted([even, drift], values, seed) for seed in (1, 2)])
    tried = [{finding.effect.name for finding in _promising(fit_of(problem, known), [even, drift])} for known in ([], [Phugoid()])]
    assert even.name in tried[0] and tried[1] == {drift.name}
