"""Gains and places of candidates in the linear world against full refits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pytest

from ident.tracing.evidence import evidence_of, set_prior
from ident.tracing.fitted_model import FittedModel
from ident.tracing.linear_sets import likely_starts, most_probable_sets
from ident.tracing.problem import TraceProblem, search_context
from ident.tracing.scan import leads_of, whitened_fit
from ident.tracing.signatures import candidate_signatures
from sim.declaration.effect import Parameter, Regularity, Signal, Station
from sim.declaration.proposal import Probe, SearchContext, Traceable, Traits
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.library import find_effect
from sim.effects.sensor_path.sensor_calibration import SensorScale, SensorStep
from sim.effects.sensor_path.sensor_timing import SensorDelay, SensorHold, SensorLag
from sim.maths import each_column
from sim.vehicles.uncoupled import ShortPeriod
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
        return (
            Parameter("gain", 0.5 if self.bounds[1] > 0.0 else -0.5, "1/rad2", bounds=self.bounds),
        )

    def probes(self, context: SearchContext) -> Sequence[Probe]:
        return [Probe({"gain": 0.0}, ("gain",))]

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": p.gain * s.elevator**2}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return ()


@dataclass(frozen=True)
class Found:
    """The best place of a candidate: gain of log evidence there, and where a fit begins."""

    effect: Traceable
    gain: float
    start: Mapping[str, float]


def found(fitted: FittedModel, *effects: Traceable) -> list[Found]:
    """Of each candidate that can act its best place, the largest gain first."""
    context = search_context(fitted)
    gains: dict[str, float] = {}
    whitened = whitened_fit(fitted, set_prior(fitted, context))
    for lead in leads_of(
        fitted, whitened, [*candidate_signatures(fitted, effects, context).values()], context
    ):
        gains[lead.effect.name] = max(gains.get(lead.effect.name, -np.inf), lead.gain)
    places = {effect.name: likely_starts(fitted, effect, context) for effect in effects}
    best = [Found(places[name][0][0], gain, places[name][0][1][0]) for name, gain in gains.items()]
    return sorted(best, key=lambda one: -one.gain)


def root_of(
    effects: Sequence[Traceable] = (), values: Mapping[str, float] | None = None, seed: int = 1
) -> tuple[TraceProblem, FittedModel]:
    problem = problem_of([planted(effects, values, seed)])
    return problem, fit_of(problem)


def evidence_gain(child: FittedModel, root: FittedModel) -> float:
    context = search_context(root)
    return evidence_of(child, context)[0] - evidence_of(root, context)[0]


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
def test_the_gain_of_a_small_regular_effect_is_that_of_a_refit(
    effect: Traceable, values: dict[str, float]
) -> None:
    problem, root = root_of([effect], values)
    (finding,) = found(root, effect)
    child = fit_of(problem, [effect], root, finding.start)
    # The noise of the low band falls in the refit: the linear world promises less.
    assert 0.6 * (gain := evidence_gain(child, root)) < finding.gain < 1.05 * gain + 0.5
    # The amplitude begins where the refit ends, but for the noise.
    (name,) = values
    end = child.values.shared.get(name, child.values.own[0].get(name, np.nan))
    gone = next(iter(effect.absent.values()))
    assert finding.start[name] == pytest.approx(end, abs=0.2 * abs(values[name] - gone))


def test_beside_a_late_input_candidates_are_driven_by_the_input_as_it_was_fitted() -> None:
    """Not by one that is late by what the delay began with."""
    late, bent = find_effect("input-delay", ShortPeriod()), MomentOfControlSquared()
    assert isinstance(late, Traceable)
    values = {"input-delay.delay": 0.3, "control-squared.gain": 0.4}
    problem = problem_of([planted([late, bent], values)])
    beside = fit_of(problem, [late], fit_of(problem), {"input-delay.delay": 0.25})
    (finding,) = found(beside, bent)
    child = fit_of(problem, [late, bent], beside, finding.start)
    assert 0.6 * (gain := evidence_gain(child, beside)) < finding.gain < 1.05 * gain + 0.5


def test_what_the_declared_parameters_absorb_gains_little() -> None:
    """A scale of the pitch rate they cannot absorb; of control power, their priors alone oppose."""
    _, root = root_of([SensorScale("q")], {"sensor-scale:q.scale": 1.2})
    scale, power = found(root, SensorScale("q"), ControlPower())
    assert scale.effect.name == "sensor-scale:q" and scale.gain > 25.0
    assert power.gain < 5.0


def test_an_effect_in_the_set_is_not_proposed_again() -> None:
    problem, root = root_of([SensorScale("q")], {"sensor-scale:q.scale": 1.1})
    child = fit_of(problem, [SensorScale("q")], root)
    names = [one.effect.name for one in found(child, SensorScale("q"), SensorScale("nz"))]
    assert names == ["sensor-scale:nz"]


@pytest.mark.parametrize("after", [203, 251, 377])
def test_a_sharp_step_is_found_to_the_sample(after: int) -> None:
    """Places of a search are eight samples apart here; the fit of a step moves it by one."""
    time = doublets().time
    step = SensorStep("q", "rad/s", 0.01)
    true = {"sensor-step:q.at": 0.5 * (time[after] + time[after + 1]), "sensor-step:q.size": 0.02}
    problem, root = root_of([step], true)
    (finding,) = found(root, step)
    assert finding.start["sensor-step:q.at"] == pytest.approx(true["sensor-step:q.at"], abs=1e-9)
    child = fit_of(problem, [finding.effect], root, finding.start)
    assert np.searchsorted(time, child.values.own[0]["sensor-step:q.at"]) == after + 1


def test_a_held_channel_is_found_in_its_period_and_phase() -> None:
    hold = SensorHold("q")
    _, root = root_of([hold], {"sensor-hold:q.period": 0.1, "sensor-hold:q.phase": 0.06})
    findings = found(root, hold, SensorDelay("q"))
    assert [one.effect.name for one in findings] == ["sensor-hold:q", "sensor-delay:q"]
    assert findings[0].start["sensor-hold:q.period"] == pytest.approx(0.1, abs=0.02)


@pytest.mark.parametrize("start", [4.3, 4.41, 6.07])
def test_an_event_is_placed_between_the_places_that_are_tried(start: float) -> None:
    effect = UnmeasuredInput()
    values = {
        "unmeasured-input.start": start,
        "unmeasured-input.duration": 0.8,
        "unmeasured-input.moment": 0.004,
        "unmeasured-input.lift": 0.0,
    }
    _, root = root_of([effect], values)
    (finding,) = found(root, effect)
    assert abs(finding.start["unmeasured-input.start"] - start) < 0.2


@dataclass(frozen=True)
class Nowhere(UnmeasuredInput):
    """A pulse that changes no output."""

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"moment": 0.0 * p.moment}


def test_an_event_that_changes_no_output_has_no_place() -> None:
    _, root = root_of()
    assert likely_starts(root, Nowhere(), search_context(root)) == []
    assert found(root, Nowhere()) == []


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
    """Shifting by whole samples is exact for a model that does not know the time."""
    effect = UnmeasuredInput()
    values = {
        "unmeasured-input.start": 4.3,
        "unmeasured-input.duration": 0.8,
        "unmeasured-input.moment": 0.004,
        "unmeasured-input.lift": 0.0,
    }
    _, root = root_of([effect], values)
    (shifted,) = found(root, effect)
    (direct,) = found(root, EveryOnset(starts=(shifted.start["unmeasured-input.start"],)))
    assert shifted.gain == pytest.approx(direct.gain, rel=1e-6)
    assert dict(shifted.start) == pytest.approx(dict(direct.start), rel=1e-5)


def test_a_delay_and_a_lag_of_one_sensor_are_alike_and_two_scales_are_not() -> None:
    _, root = root_of([SensorDelay("q")], {"sensor-delay:q.delay": 0.05})
    context = search_context(root)
    whitened = whitened_fit(root, set_prior(root, context))
    offered = (SensorDelay("q"), SensorLag("q"), SensorScale("nz"))
    leads = leads_of(
        root, whitened, [*candidate_signatures(root, offered, context).values()], context
    )
    _, alike = most_probable_sets(whitened, leads, lambda lead: 0.0, lambda one, other: True, 1)
    assert alike[frozenset(("sensor-delay:q", "sensor-lag:q"))] > 0.94
    assert alike[frozenset(("sensor-delay:q", "sensor-scale:nz"))] < 0.9


@pytest.mark.parametrize("gain", [-1.5, 1.5])
def test_an_effect_that_points_the_unphysical_way_is_dropped(gain: float) -> None:
    """Bounded to one side of its absence, it is found where the truth lies on that side and dropped
    where it does not.
    """
    _, root = root_of([MomentOfControlSquared()], {"control-squared.gain": gain})
    assert found(root, MomentOfControlSquared())[0].start["control-squared.gain"] * gain > 0
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
    findings = {one.effect.name: one.gain for one in found(root, *late, SensorDelay("q"))}
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
    places = likely_starts(root, effect, search_context(root))
    start, other = places[0][1][which], places[0][1][1 - which]
    assert abs(start["unmeasured-input.start"] - 4.3) < 0.3
    assert start["unmeasured-input.moment"] > 0.002
    assert abs(other["unmeasured-input.moment"]) < 0.2 * start["unmeasured-input.moment"]
