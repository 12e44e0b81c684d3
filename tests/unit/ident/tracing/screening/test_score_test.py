"""Projected gains against full refits, and what the projection must not see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pytest

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.candidate_model.quantities import quantities
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, _resonances_first, screen
from ident.tracing.screening.score_test import _start as start_of
from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.elastic_mode import ElasticMode
from sim.effects.library import find_effect
from sim.effects.sensor_path.sensor_delay import SensorDelay
from sim.effects.sensor_path.sensor_hold import SensorHold
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.sensor_step import SensorStep
from sim.maths import each_column
from sim.vehicles.short_period import ShortPeriod
from tests.tracing_problem import doublets, fit_of, planted, problem_of


@dataclass(frozen=True)
class ControlPower:
    """All control derivatives times 1 + ``more``: nothing that CL_de and Cm_de could not do."""

    name: ClassVar[str] = "control-power"
    station: ClassVar[Station] = Station.INPUT_PATH
    signal: ClassVar[str] = "elevator"
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("more", 0.1, "1"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"more": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    traits: ClassVar[Traits] = Traits()
    explanation: ClassVar[str] = "The control is more powerful."

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"more": 0.0}, ("more",))]

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        return each_column(lambda row, more: row * (1.0 + more), u, p.more)


@dataclass(frozen=True)
class MomentOfControlSquared:
    """moment += ``gain`` elevator^2, between bounds: a regular effect of one parameter."""

    bounds: tuple[float, float] = (-np.inf, np.inf)

    name: ClassVar[str] = "control-squared"
    station: ClassVar[Station] = Station.DYNAMICS
    needs: ClassVar[tuple[str, ...]] = ("moment",)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"gain": 0.0})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    states: ClassVar[tuple[Signal, ...]] = ()
    traits: ClassVar[Traits] = Traits()
    explanation: ClassVar[str] = "The control is no straight line."

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("gain", 0.0, "1/rad2", bounds=self.bounds),)

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"gain": 0.0}, ("gain",))]

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": p.gain * s.elevator**2}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


def found(fitted: FittedModel, *effects: Traceable) -> list[Finding]:
    return screen(fitted, effects, search_context(fitted))


def cosine(a: Finding, b: Finding) -> float:
    """Of what two candidates would add to the projected outputs."""
    return abs(float(a.contribution @ b.contribution)) / float(
        np.linalg.norm(a.contribution) * np.linalg.norm(b.contribution)
    )


def root_of(
    effects: Sequence[Traceable] = (), values: Mapping[str, float] | None = None, seed: int = 1
) -> tuple[TraceProblem, FittedModel]:
    problem = problem_of([planted(effects, values, seed)])
    return problem, fit_of(problem)


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        (SensorScale("q"), {"sensor-scale:q.scale": 1.03}),
        (MomentOfControlSquared(), {"control-squared.gain": 0.4}),
        (find_effect("sensor-drift:nz", ShortPeriod()), {"sensor-drift:nz.slope": 8e-4}),
        (find_effect("speed-variation", ShortPeriod()), {"speed-variation.rate": 0.12}),
    ],
    ids=lambda item: getattr(item, "name", ""),
)
def test_the_projected_gain_of_a_small_regular_effect_is_that_of_a_refit(
    effect: Traceable, values: dict[str, float]
) -> None:
    problem, root = root_of([effect], values)
    (finding,) = found(root, effect)
    child = fit_of(problem, [effect], root, finding.starts[0])
    gain = root.fit.cost - child.fit.cost
    assert gain > 4.0
    assert finding.gain == pytest.approx(gain, rel=0.05)
    # The amplitude begins where the refit ends, but for the noise.
    (name,) = values
    end = child.values.shared.get(name, child.values.own[0].get(name, np.nan))
    away = (
        values[name]
        - {
            item.name: value
            for item, value in zip(effect.parameters, effect.absent.values(), strict=True)
        }[effect.parameters[0].name]
    )
    assert finding.starts[0][name] == pytest.approx(end, abs=0.2 * abs(away))


def test_beside_a_late_input_candidates_are_driven_by_the_input_as_it_was_fitted() -> None:
    """Not by one that is late by what the delay began with."""
    late, bent = find_effect("input-delay", ShortPeriod()), MomentOfControlSquared()
    assert isinstance(late, Traceable)
    values = {"input-delay.delay": 0.3, "control-squared.gain": 0.4}
    problem = problem_of([planted([late, bent], values)])
    beside = fit_of(problem, [late], fit_of(problem), {"input-delay.delay": 0.25})
    (finding,) = found(beside, bent)
    child = fit_of(problem, [late, bent], beside, finding.starts[0])
    assert finding.gain == pytest.approx(beside.fit.cost - child.fit.cost, rel=0.05)


def test_what_the_declared_parameters_absorb_gains_nothing() -> None:
    _, root = root_of([SensorScale("q")], {"sensor-scale:q.scale": 1.2})
    assert found(root, SensorScale("q"))[0].gain > 100.0
    findings = found(root, ControlPower())
    # The signature stands in the fitted model's own space: nothing is left of it but rounding, or
    # only what rounding can explain.
    assert not findings or findings[0].gain < 1e-3


def test_an_effect_in_the_set_is_not_proposed_again() -> None:
    problem, root = root_of([SensorScale("q")], {"sensor-scale:q.scale": 1.1})
    child = fit_of(problem, [SensorScale("q")], root)
    assert [
        finding.effect.name for finding in found(child, SensorScale("q"), SensorScale("nz"))
    ] == ["sensor-scale:nz"]


@pytest.mark.parametrize("after", [203, 251, 377])
def test_a_sharp_step_is_found_to_the_sample(after: int) -> None:
    """Places of a search are eight samples apart here; the fit of a step moves it by one."""
    time = doublets().time
    step = SensorStep("q", "rad/s", 0.01)
    true = {"sensor-step:q.at": 0.5 * (time[after] + time[after + 1]), "sensor-step:q.size": 0.02}
    problem, root = root_of([step], true)
    (finding,) = found(root, step)
    assert finding.starts[0]["sensor-step:q.at"] == pytest.approx(
        true["sensor-step:q.at"], abs=1e-9
    )
    child = fit_of(problem, [finding.effect], root, finding.starts[0])
    at = child.values.own[0]["sensor-step:q.at"]
    assert np.searchsorted(time, at) == after + 1


def test_a_held_channel_is_found_in_its_period_and_phase() -> None:
    hold = SensorHold("q")
    true = {"sensor-hold:q.period": 0.1, "sensor-hold:q.phase": 0.06}
    problem, root = root_of([hold], true)
    findings = found(root, hold, SensorDelay("q"))
    assert [finding.effect.name for finding in findings] == ["sensor-hold:q", "sensor-delay:q"]
    assert findings[0].starts[0] == pytest.approx(true)
    child = fit_of(problem, [findings[0].effect], root, findings[0].starts[0])
    (shown,) = (quantities(child, effect) for effect in child.effects)
    assert abs(shown["period"].value - 0.1) < 4.0 * shown["period"].std < 1e-4
    assert abs(shown["phase"].value - 0.06) < 4.0 * shown["phase"].std < 0.005


def test_findings_stand_by_gain_and_begin_at_distinct_places() -> None:
    _, root = root_of([SensorLag("q")], {"sensor-lag:q.time_constant": 0.06})
    findings = found(root, SensorScale("q"), SensorScale("nz"), SensorLag("q"), UnmeasuredInput())
    assert [f.gain for f in findings] == sorted((f.gain for f in findings), reverse=True)
    assert findings[0].effect.name == "sensor-lag:q"
    for finding in findings:
        assert finding.gain == finding.gains[0]
        assert list(finding.gains) == sorted(finding.gains, reverse=True)
        assert len(finding.starts) == len(finding.gains) <= 3
        size = np.linalg.norm(finding.contribution)
        assert np.isfinite(size) and size > 0


@dataclass(frozen=True)
class EveryOnset(UnmeasuredInput):
    """The pulse of `UnmeasuredInput`, each start simulated by itself instead of shifted."""

    starts: tuple[float, ...] = ()

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [
            Probe({**probe.values, "start": start}, probe.slopes)
            for probe in super().probes(context)
            for start in self.starts
        ]


def test_a_shifted_onset_equals_its_direct_computation() -> None:
    """Shifting by whole samples is exact for a model that does not know the time: gain, amplitudes
    and place agree.
    """
    effect = UnmeasuredInput()
    values = {
        "unmeasured-input.start": 4.3,
        "unmeasured-input.duration": 0.8,
        "unmeasured-input.moment": 0.004,
        "unmeasured-input.lift": 0.0,
    }
    _, root = root_of([effect], values)
    (shifted,) = found(root, effect)
    width = effect.fitted_to(search_context(root)).width
    places = tuple(
        0.02 * k + width
        for k in range(0, len(root.fit.layout.problems[0].record) - 2, max(1, 501 // 60))
    )
    (direct,) = found(root, EveryOnset(starts=places))
    assert shifted.gain == pytest.approx(direct.gain, rel=1e-6)
    assert dict(shifted.starts[0]) == pytest.approx(dict(direct.starts[0]), rel=1e-5)
    assert cosine(shifted, direct) == pytest.approx(1.0, abs=1e-9)
    assert abs(shifted.starts[0]["unmeasured-input.start"] - 4.3) < 0.2


def test_a_delay_and_a_lag_of_one_sensor_are_collinear_and_two_scales_are_not() -> None:
    _, root = root_of([SensorDelay("q")], {"sensor-delay:q.delay": 0.05})
    by_name = {
        f.effect.name: f for f in found(root, SensorDelay("q"), SensorLag("q"), SensorScale("nz"))
    }
    late = cosine(by_name["sensor-delay:q"], by_name["sensor-lag:q"])
    assert 0.97 < late <= 1.0 + 1e-12
    assert cosine(by_name["sensor-delay:q"], by_name["sensor-delay:q"]) == pytest.approx(
        1.0, abs=1e-12
    )
    assert cosine(by_name["sensor-delay:q"], by_name["sensor-scale:nz"]) < 0.9


@pytest.mark.parametrize("gain", [-1.5, 1.5])
def test_an_effect_that_points_the_unphysical_way_is_dropped(gain: float) -> None:
    """Bounded to one side of its absence, it is found where the truth lies on that side and dropped
    where it does not.
    """
    _, root = root_of([MomentOfControlSquared()], {"control-squared.gain": gain})
    assert found(root, MomentOfControlSquared())[0].starts[0]["control-squared.gain"] * gain > 0
    upward, downward = (
        found(root, MomentOfControlSquared((0.0, 50.0))),
        found(root, MomentOfControlSquared((-50.0, 0.0))),
    )
    assert [len(upward), len(downward)] == ([1, 0] if gain > 0 else [0, 1])


def test_an_early_sensor_is_no_late_one() -> None:
    """Where alpha and nz are late the pitch rate looks early: a delay of q, which could only be
    longer, is not proposed.
    """
    late = [SensorDelay("alpha"), SensorDelay("nz")]
    _, root = root_of(late, {"sensor-delay:alpha.delay": 0.06, "sensor-delay:nz.delay": 0.06})
    findings = {f.effect.name: f.gain for f in found(root, *late, SensorDelay("q"))}
    assert findings.get("sensor-delay:q", 0.0) < 0.2 * max(findings.values())


@pytest.mark.parametrize("which", [0, 1])
def test_an_event_of_one_record_is_found_where_the_other_lacks_it(which: int) -> None:
    effect = UnmeasuredInput()
    values = {
        "unmeasured-input.start": 4.3,
        "unmeasured-input.duration": 0.8,
        "unmeasured-input.moment": 0.006,
        "unmeasured-input.lift": 0.0,
    }
    records = [planted([effect], values, 1), planted(seed=2)]
    root = fit_of(problem_of(records if which == 0 else records[::-1]))
    (finding,) = found(root, effect)
    assert finding.gain > 50.0
    # Each record has all four for itself.
    assert finding.parameters == 8
    assert abs(finding.starts[0]["unmeasured-input.start"] - 4.3) < 0.3
    assert finding.starts[0]["unmeasured-input.moment"] > 0.002


def test_a_value_that_is_tried_is_a_start_only_where_its_signature_is_there_as_it_stands() -> None:
    """A probe without slopes is the difference that its values make: less than none of it is
    another sign, which it cannot have.
    """
    probe = Probe({"delay": 0.05})
    assert start_of(SensorDelay("q"), probe, np.array([0.8])) == {"sensor-delay:q.delay": 0.05}
    assert start_of(SensorDelay("q"), probe, np.array([-0.8])) is None
    assert start_of(SensorDelay("q"), probe, np.array([0.0])) is None


def test_places_of_a_mode_begin_with_the_frequency_that_stands_out() -> None:
    """At the end of the grid a mode hardly oscillates and promises most, as in a record whose pitch
    rate is late.
    """
    over = {
        4.0: 20.0,
        8.0: 30.0,
        14.5: 111.0,
        18.0: 90.0,
        48.0: 116.0,
        53.0: 105.0,
        115.0: 134.0,
        162.0: 130.0,
        250.0: 145.0,
    }
    results = sorted(
        ((gain, {"elastic-mode.frequency": at}, None) for at, gain in over.items()),
        key=lambda result: -result[0],
    )
    ordered = [
        start["elastic-mode.frequency"]
        for _, start, _ in _resonances_first(ElasticMode(), results)  # type: ignore[arg-type]
    ]
    assert ordered == [14.5, 48.0, 115.0, 250.0, 162.0, 53.0, 18.0, 8.0, 4.0]
    assert _resonances_first(SensorLag("q"), results) is results  # type: ignore[arg-type, comparison-overlap]


def test_a_peak_that_promises_next_to_nothing_is_none() -> None:
    """A fast mode promises as much as a slow one on its plateau: bumps at its foot stand out by
    more than the peak on top.
    """
    over = {
        2.2: 39.0,
        2.6: 14.0,
        3.7: 21.0,
        9.5: 15.0,
        15.9: 291.0,
        17.3: 288.0,
        31.0: 282.0,
        125.0: 279.0,
    }
    results = sorted(
        ((gain, {"elastic-mode.frequency": at}, None) for at, gain in over.items()),
        key=lambda result: -result[0],
    )
    ordered = [
        start["elastic-mode.frequency"]
        for _, start, _ in _resonances_first(ElasticMode(), results)  # type: ignore[arg-type]
    ]
    assert ordered == [15.9, 17.3, 31.0, 125.0, 2.2, 3.7, 9.5, 2.6]
