"""Effects that stand where what remains is not noise: reductions with their scatter, replication, one record left out, trims."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity
from ident.tracing.replication.by_record import Flight, Replication, replicate
from ident.tracing.replication.comparison import CrossValidation, choose
from ident.tracing.replication.cross_validation import cross_validate, within_reach, without_record
from ident.tracing.replication.error_reduction import reduction
from ident.tracing.screening.context import search_context
from ident.tracing.screening.pairs import joint_fall, likely_pairs
from ident.tracing.screening.score_test import Finding
from ident.tracing.selection.form_spread import form_spread
from ident.tracing.settings import TraceSettings
from ident.tracing.validation.held_out import held_out
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_covariance
from scenarios.preparation.trim import about_trim
from sim.declaration.proposal import Traceable, fitted_to
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.dynamics.control_nonlinearity import ControlNonlinearity
from sim.effects.dynamics.moment_nonlinearity import MOMENT_NONLINEARITY
from sim.effects.guards.products import GUARDS
from sim.effects.input_path.input_deadband import InputDeadband
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.record import Record
from sim.truth.noise import coloured_noise
from tests.bases import Flight as Flown
from tests.bases import rigid_flight
from tests.tracing_problem import OUTPUTS, declared, fit_of, planted, problem_of, with_output

LATE = SensorDelay("alpha")
SCALED = SensorScale("q")


def coloured(record: Record, seed: int) -> Record:
    """The record with noise added that remembers itself for 0.3 s and is twice as large as the white one."""
    rng = np.random.default_rng((seed, 7))
    for name, size in (("alpha", 0.002), ("q", 0.003), ("nz", 0.03)):
        record = with_output(record, name, record[name].values + coloured_noise(rng, record.time, size, 0.3))
    return record


def flight_of(records: list[Record]) -> Flight:
    masks = tuple(np.ones((len(OUTPUTS), len(record)), dtype=bool) for record in records)
    return Flight(tuple(records), masks, declared(), OUTPUTS, TraceSettings(max_step=0.02))


@pytest.fixture(scope="module")
def late() -> Flight:
    """Three coloured records with alpha 80 ms late."""
    values = {"sensor-delay:alpha.delay": 0.08}
    return flight_of([coloured(planted([LATE], values, seed), seed) for seed in (1, 2, 3)])


@pytest.fixture(scope="module")
def clean() -> Flight:
    return flight_of([coloured(planted([], None, seed), seed) for seed in (4, 5, 6)])


def root_of(flight: Flight) -> FittedModel:
    return fit_of(problem_of(list(flight.records)))


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


def test_what_differs_from_record_to_record_does_not_replicate(late: Flight) -> None:
    """The same delay, but in one record of three."""
    one = planted([LATE], {"sensor-delay:alpha.delay": 0.12}, 1)
    flight = flight_of([one, planted([], None, 2), planted([], None, 3)])
    fitted = flight.fit((LATE,), range(3), None, {"sensor-delay:alpha.delay": 0.04})
    assert fitted is not None
    copies = replicate(flight, fitted, LATE)
    assert not copies.agrees
    assert [found["delay"].value for found in copies.values] == [pytest.approx(0.12, abs=0.01), *[pytest.approx(0.0, abs=0.01)] * 2]


def test_leaving_a_record_out_by_one_step_is_nearly_a_fit_to_the_others(late: Flight) -> None:
    everything = fit_of(problem_of(list(late.records)), (LATE,), None, {"sensor-delay:alpha.delay": 0.07})
    others = fit_of(problem_of(list(late.records[1:])), (LATE,), None, {"sensor-delay:alpha.delay": 0.07})
    stepped = without_record(everything, 0).values.shared
    sigma = np.sqrt(np.diag(fit_covariance(others.fit)[0]))
    away = {name: abs(stepped[name] - value) / sigma[i] for i, (name, value) in enumerate(others.values.shared.items())}
    unmoved = {name: abs(everything.values.shared[name] - value) / sigma[i] for i, (name, value) in enumerate(others.values.shared.items())}
    assert max(away.values()) < 0.5, away
    assert sum(away.values()) < 0.5 * sum(unmoved.values())


def test_reduction_counts_channels_alike_and_knows_its_scatter(late: Flight) -> None:
    """Against errors of known size: half of alpha's error taken away is ln(1/2)/3 over three channels."""
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    halved = [replace(fit, weighted=replace(fit.weighted, residuals=(fit.residuals[0] * np.array([[0.5], [1.0], [1.0]]),))) for fit in before]
    found = reduction(before, halved)
    assert found.total == pytest.approx(np.log(0.5) / 3.0) and found.share == pytest.approx(0.5 ** (1 / 3))
    assert found.by_channel == pytest.approx([np.log(0.5), 0.0, 0.0]) and found.scatter == pytest.approx(0.0, abs=1e-12)
    assert len(found.by_record) == 3
    # Errors that are exchanged at random between before and after change nothing but for scatter.
    rng = np.random.default_rng(3)
    shuffled = [replace(fit, weighted=replace(fit.weighted, residuals=(rng.permuted(fit.residuals[0], axis=1),))) for fit in before]
    assert abs(reduction(before, shuffled).total) < 3.0 * reduction(before, shuffled).scatter + 1e-9


def standing(effect: Traceable, fitted: FittedModel, predictions: list[Fit], share: float, *, stands: bool = True) -> CrossValidation:
    """A candidate that leaves this share of every error, with one parameter a name in ``absent``."""
    left = {
        r: replace(fit, weighted=replace(fit.weighted, residuals=(share * fit.residuals[0],))) for r, fit in enumerate(predictions)
    }  # the same errors, smaller: a difference without scatter
    lowered = reduction(predictions, [left[r] for r in sorted(left)])
    finding = Finding(effect, 10.0, len(effect.absent), ({},), (10.0,), np.ones(3))
    return CrossValidation(effect, finding, fitted, lowered, Replication((), stands), 100.0, stands, "", left)


def test_a_guard_stands_against_an_effect_by_being_better_or_by_doing_as_well_and_replicating(late: Flight) -> None:
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    guard = next(effect for effect in GUARDS if effect.name == "guard:alpha-q")
    squared = next(effect for effect in GUARDS if effect.name == "guard:control-squared")
    bend, curved = replace(MOMENT_NONLINEARITY, low=-0.1, high=0.1), ControlNonlinearity()
    effect = standing(bend, fitted, before, 0.6)
    assert choose([effect]) is not None
    assert choose([effect, standing(guard, fitted, before, 0.5)]) is None
    assert choose([effect, standing(guard, fitted, before, 0.5, stands=False)]) is None
    assert choose([effect, standing(guard, fitted, before, 0.7)]) is not None
    assert choose([effect, standing(guard, fitted, before, 0.6)]) is None
    assert choose([effect, standing(guard, fitted, before, 0.6, stands=False)]) is not None
    # What an effect contains speaks for it.
    assert choose([standing(curved, fitted, before, 0.6), standing(squared, fitted, before, 0.5)]) is not None
    assert choose([effect, standing(squared, fitted, before, 0.5)]) is None


def test_the_same_trace_under_another_name_is_told_though_its_values_differ_from_record_to_record(late: Flight) -> None:
    fitted = root_of(late)
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    best, differing = standing(SCALED, fitted, before, 0.6), standing(LATE, fitted, before, 0.59, stands=False)
    told = replace(differing, replication=Replication(({"delay": Quantity(0.1, 0.01, "s")},), False))
    apart = replace(told, finding=replace(told.finding, contribution=np.array([1.0, -1.0, 0.0])))
    assert [item.effect.name for item in choose([best, told]).others] == [LATE.name]  # type: ignore[union-attr]
    assert choose([best, differing]).others == choose([best, apart]).others == ()  # type: ignore[union-attr]


def test_of_equals_a_witness_decides_and_only_then_is_asked(late: Flight) -> None:
    fitted = fit_of(problem_of(list(late.records)), (LATE, SCALED), None, {"sensor-delay:alpha.delay": 0.07, "sensor-scale:q.scale": 1.01})
    frozen = [held_out(fitted, [record], None, informed=False).frozen for record in late.records]
    before = [fit for fit in frozen if fit is not None]
    one, other = standing(LATE, fitted, before, 0.600), standing(SCALED, fitted, before, 0.605)
    asked: list[str] = []

    def witness(effect: str, parameters: Mapping[str, Quantity]) -> int:
        asked.append(effect)
        return int(effect == SCALED.name and parameters["scale"].value > 0)

    assert (first := choose([one, other])) is not None and first.best is one
    assert (second := choose([one, other], witness)) is not None and second.best is other and [item.effect for item in second.others] == [LATE]
    assert sorted(asked) == sorted([LATE.name, SCALED.name])
    asked.clear()
    assert (third := choose([one, standing(SCALED, fitted, before, 0.8)], witness)) is not None and third.best is one and asked == []


def test_a_curve_is_not_asked_for_what_only_one_record_flew() -> None:
    flight = rigid_flight(8.0, 50.0)
    records = [planted([], None, seed, flight=Flown(flight.time, share * flight.u, max_step=0.02)) for seed, share in ((1, 1.0), (2, 1.0), (3, 2.0))]
    fitted = root_of(flight_of(records))
    bend = fitted_to(MOMENT_NONLINEARITY, search_context(fitted))
    assert within_reach(fitted, bend) == [0, 1]
    assert within_reach(fitted, SCALED) == [0, 1, 2]
    alike = root_of(flight_of(records[:2]))
    assert within_reach(alike, fitted_to(MOMENT_NONLINEARITY, search_context(alike))) == [0, 1]


def test_inputs_about_their_trim() -> None:
    """A rest before the first move is a trim; a step that is held from the first sample on is none."""
    flight = rigid_flight(8.0, 50.0)
    waiting = Flown(flight.time, np.where(flight.time < 1.0, 0.0, flight.u), max_step=0.02)
    record = planted([], None, 1, flight=waiting)
    assert about_trim(record) == (record, {})
    shifted = replace(record, inputs=tuple(replace(c, values=c.values + 0.02) for c in record.inputs))
    moved, trims = about_trim(shifted)
    assert trims == {"elevator": pytest.approx(0.02)}
    assert moved["elevator"].values == pytest.approx(record["elevator"].values)
    stepped = planted([], None, 1, flight=Flown(flight.time, (0.05 * (flight.time < 1.5) - 0.05 * (flight.time > 3.0))[None], max_step=0.02))
    assert about_trim(stepped) == (stepped, {})


def test_settings_for_replication_are_those_of_a_search() -> None:
    """A fit of a Flight is that of the engine at twice the declared step."""
    flight = flight_of([planted([], None, 1)])
    fitted = flight.fit((), [0], None)
    assert fitted is not None and fitted.fit.layout.settings.max_step == FitSettings(max_step=0.04).max_step
    assert not any(isinstance(effect, GustDiscrete) for effect in fitted.effects)


def test_the_form_of_a_curve_widens_what_hangs_on_it_and_nothing_else() -> None:
    """A moment that bends more sharply than four shapes follow: the slope at trim moves with the form; a delay has one form only."""
    bend = replace(MOMENT_NONLINEARITY, low=-0.12, high=0.12)
    values = {f"moment-nonlinearity.{name}": 0.0 for name in bend.absent}
    sharp = {f"moment-nonlinearity.{name}": 0.0 for name in bend.finer().absent} | {"moment-nonlinearity.shape6": 0.01}
    record = planted([bend.finer()], sharp, 1)
    problem = problem_of([record])
    fitted = fit_of(problem, (bend,), None, values)
    spread = form_spread(problem, fitted)
    assert set(spread) <= set(declared().parameters.names) and spread["Cm_alpha"] > 0.0
    plain = problem_of([planted([], None, 1)])
    assert form_spread(plain, fit_of(plain, (LATE,))) == {}


def test_two_faults_that_hide_each_other_are_found_as_a_pair() -> None:
    """A scale of nz and a late q: the derivatives take in most of what either does alone."""
    values = {"sensor-scale:nz.scale": 1.35, "sensor-delay:q.delay": 0.04}
    scale, late = SensorScale("nz"), SensorDelay("q")
    flight = flight_of([coloured(planted([scale, late], values, seed), seed) for seed in (1, 2, 3)])
    validated, _ = cross_validate(flight, (LATE, SCALED, scale, late, *GUARDS[:3]), root_of(flight))
    assert {item.best.effect.name for item in validated} == {"sensor-scale:nz", "sensor-delay:q"}


def test_the_projected_fall_of_a_pair_is_that_of_least_squares() -> None:
    """Against the regression of a residual on two columns, and on each alone."""
    rng = np.random.default_rng(2)
    residual, columns = rng.standard_normal(300), rng.standard_normal((300, 2))
    columns[:, 1] -= 0.9 * columns[:, 0]
    residual += columns @ [0.4, 0.5]

    def finding(effect: Traceable, column: np.ndarray) -> Finding:
        along = column * (column @ residual) / (column @ column)
        share = (along @ along) / (residual @ residual)
        return Finding(effect, -150.0 * np.log1p(-share), 1, ({},), (1.0,), along)

    one, other = finding(LATE, columns[:, 0]), finding(SCALED, columns[:, 1])
    left = np.linalg.lstsq(columns, residual, rcond=None)[1][0]
    assert joint_fall(one, other, 300.0) == pytest.approx(-0.5 * np.log(left / (residual @ residual)))
    assert joint_fall(one, one, 300.0) == pytest.approx(one.gain / 300.0)
    assert likely_pairs([one, other], [], 300.0) == [(one, other)]
    assert likely_pairs([one, other], [LATE.name, SCALED.name], 300.0) == []
    assert likely_pairs([one, finding(next(iter(GUARDS)), columns[:, 1])], [], 300.0) == []
