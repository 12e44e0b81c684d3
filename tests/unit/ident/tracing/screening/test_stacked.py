"""All instances of the general form in one pass, against each of them screened by itself."""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from ident.tracing.screening.stacked import screen_varying
from ident.tracing.settings import TraceSettings
from ident.tracing.spikes.masks import measured_masks
from scenarios.diagnosis.candidates import candidates_for
from sim.declaration.proposal import Traceable
from sim.effects.dynamics.curves.varies import Varies
from sim.effects.library import find_effect
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.record import Channel, Record
from sim.vehicles.factory import model_from_constants
from sim.vehicles.short_period import ShortPeriod
from tests.bases import three_two_one_one
from tests.own_models import roll
from tests.tracing_problem import declared, fit_of, planted, problem_of, with_output
from tests.whole_axes import CONSTANTS, TRUE, flown


@pytest.fixture(scope="module")
def rigid() -> FittedModel:
    """The declared model at two records of an aircraft whose damping depends on the angle of attack, a stretch of one missing."""
    damping = [found for found in candidates_for(declared()) if found.name == "varies:Cm_q(alpha)"]
    first, second = (planted(damping, {"varies:Cm_q(alpha).shape1": 2.0, "varies:Cm_q(alpha).shape2": -8.0}, seed) for seed in (1, 2))
    q = first["q"].values.copy()
    q[100:140] = np.nan
    return fit_of(problem_of([with_output(first, "q", q), second]))


def instances(fitted: FittedModel) -> list[Varies]:
    return [effect for effect in candidates_for(fitted.declared) if isinstance(effect, Varies)]


def compare(fitted: FittedModel, instances: list[Varies]) -> None:
    context = search_context(fitted)
    together, apart = screen_varying(fitted, instances, context), screen(fitted, instances, context)
    one_by_one = {finding.effect.name: finding for finding in apart}
    assert [finding.gain for finding in together] == sorted((finding.gain for finding in together), reverse=True)
    assert {finding.effect.name for finding in together} == {*one_by_one}
    largest = apart[0].gain
    for finding in together:
        other = one_by_one[finding.effect.name]
        assert finding.parameters == other.parameters == 2
        assert finding.gain == pytest.approx(other.gain, rel=0.01, abs=0.002 * largest)
        size = np.linalg.norm(finding.contribution) * np.linalg.norm(other.contribution)
        assert finding.gain < 0.05 * largest or finding.contribution @ other.contribution > 0.999 * size
        for name, value in finding.starts[0].items():
            assert finding.gain < 0.05 * largest or value == pytest.approx(
                other.starts[0][name], rel=0.02, abs=0.02 * finding.effect.parameters[0].value
            )


def test_in_one_pass_they_gain_what_they_gain_one_by_one(rigid: FittedModel) -> None:
    compare(rigid, instances(rigid))


def test_the_one_that_acts_leads(rigid: FittedModel) -> None:
    found = screen_varying(rigid, instances(rigid), search_context(rigid))
    assert found[0].effect.name == "varies:Cm_q(alpha)" and found[0].gain > found[1].gain + 10.0


def test_those_in_the_model_are_left_out_and_a_sensor_with_a_memory_has_them_screened_one_by_one(rigid: FittedModel) -> None:
    problem = problem_of([layout.record for layout in rigid.fit.layout.problems])
    few = instances(rigid)[:2]
    late = fit_of(problem, (SensorLag("q"),), rigid, {"sensor-lag:q.time_constant": 0.01})
    context = search_context(late)
    assert late.system.sensor_stages
    assert [(f.effect.name, f.gain) for f in screen_varying(late, few, context)] == [(f.effect.name, f.gain) for f in screen(late, few, context)]
    inside = fit_of(problem, (few[0],), rigid)
    assert {f.effect.name for f in screen_varying(inside, few, context)} == {few[1].name}
    assert screen_varying(inside, few[:1], context) == []


@pytest.mark.slow
@pytest.mark.parametrize("model", ["lateral", "longitudinal"])
def test_on_whole_axes_as_well(model: str) -> None:
    record = flown(model, 3)
    outputs = [channel.name for channel in record.outputs]
    wrong = model_from_constants(model, CONSTANTS[model], {name: 0.8 * value for name, value in TRUE[model].items()}).with_biases(outputs)
    fitted = TraceProblem([record], measured_masks([record], outputs), wrong, (), outputs, TraceSettings()).fit((), None)
    assert fitted is not None
    # On noise alone all gains are small: they agree to a hundredth of what counts.
    context = search_context(fitted)
    apart = {finding.effect.name: finding.gain for finding in screen(fitted, instances(fitted), context)}
    assert len(apart) > 25
    assert all(abs(finding.gain - apart[finding.effect.name]) < 0.1 for finding in screen_varying(fitted, instances(fitted), context))


def test_a_signal_of_an_own_model_may_have_the_name_of_a_port() -> None:
    model = roll(inputs={"gust": "rad"}, rates=lambda s, p: {"p": p.L_p * s.p + p.L_da * s.gust, "phi": s.p}).with_biases(["p", "phi"])
    time, rng = np.arange(151) / 25.0, np.random.default_rng(0)
    inputs = (Channel.of("gust", "rad", three_two_one_one(time, size=0.08)),)
    record = Record(time, inputs, tuple(Channel.of(name, unit, 0.01 * rng.standard_normal(151)) for name, unit in (("p", "rad/s"), ("phi", "rad"))))
    fitted = TraceProblem([record], measured_masks([record], ["p", "phi"]), model, (), ["p", "phi"], TraceSettings()).fit((), None)
    assert fitted is not None
    over = [effect for effect in instances(fitted) if effect.over == "gust"]
    assert {finding.effect.name for finding in screen_varying(fitted, over, search_context(fitted))} == {"varies:L_p(gust)", "varies:L_da(gust)"}


def test_behind_a_late_input_the_drive_is_the_late_one() -> None:
    """Beside an actuator that is part of the fitted model, inputs over which a parameter varies are those at the vehicle."""
    delay = find_effect("input-delay", ShortPeriod())
    assert isinstance(delay, Traceable)
    problem = problem_of([planted([delay], {"input-delay.delay": 0.1}, 4)])
    fitted = fit_of(problem, (delay,), None, {"input-delay.delay": 0.1})
    over_input = [effect for effect in instances(fitted) if effect.over == "elevator"][:3]
    found = screen_varying(fitted, over_input, search_context(fitted))
    assert len(found) == 3 and max(finding.gain for finding in found) < 10.0
