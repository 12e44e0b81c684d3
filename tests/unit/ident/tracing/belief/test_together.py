"""Two words for one cause: events that begin at one moment, and two forces in a single curve."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.belief.standing import cautions_of
from ident.tracing.belief.together import is_open_form, may_begin_together, one_cause
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.quantities import quantities
from ident.tracing.diagnosis import Concern, Quantity
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.gust_discrete import GustDiscrete
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.dynamics.curves.varies import Varies
from sim.effects.dynamics.density_scale_height import DensityScaleHeight
from sim.effects.dynamics.derivative_jump import DerivativeJump
from sim.effects.dynamics.drag_jump import DragJump
from sim.effects.guards.drag_drift import DragDrift
from sim.effects.input_path.input_recorded_late import InputRecordedLate
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.effects.sensor_path.sensor_step import SensorStep
from tests.tracing_problem import fit_of, planted, problem_of

PULSE, GUST = UnmeasuredInput(), GustDiscrete()
PUSHED = {"unmeasured-input.start": 6.0, "unmeasured-input.duration": 0.8, "unmeasured-input.moment": 0.01, "unmeasured-input.lift": 0.0}


def at(name: str, value: float, std: float = 0.01) -> dict[str, Quantity]:
    return {name: Quantity(value, std, "s")}


def flown(outputs: tuple[str, ...], inputs: tuple[str, ...], *effects: Traceable, records: int = 1, span: float = 20.0) -> FittedModel:
    """What is asked of a fitted set: its effects, signals and records."""
    problem = SimpleNamespace(record=SimpleNamespace(time=np.array([0.0, span])))
    fit = SimpleNamespace(layout=SimpleNamespace(problems=[problem] * records))
    system = SimpleNamespace(output_names=outputs, input_names=inputs)
    return cast(FittedModel, SimpleNamespace(fit=fit, system=system, effects=effects, foreground=effects))


AIRCRAFT = flown(("alpha", "q", "nz"), ("elevator",))


def test_events_that_begin_at_one_moment_are_one_occurrence() -> None:
    told = one_cause(AIRCRAFT, [(GUST, at("start", 6.71)), (PULSE, at("start", 6.73))])
    assert [caution.concern for caution in told] == [Concern.ONE_CAUSE] and "gust-discrete and unmeasured-input begin at the same moment" in told[
        0
    ].sentence
    near = thresholds.COINCIDENT * 20.0
    assert one_cause(AIRCRAFT, [(GUST, at("start", 6.0)), (PULSE, at("start", 6.0 + 1.1 * near))]) == []
    # What the records cannot tell apart in time counts as one, too.
    assert len(one_cause(AIRCRAFT, [(GUST, at("start", 6.0, std=0.5)), (PULSE, at("start", 6.0 + 1.1 * near))])) == 1
    assert len(one_cause(AIRCRAFT, [(SensorStep("alpha", "rad", 0.01), at("at", 3.0)), (SensorStep("q", "rad/s", 0.01), at("at", 3.0))])) == 1


def test_by_chance_one_pair_in_twenty_begins_as_near() -> None:
    rng = np.random.default_rng(1)
    near = np.abs(np.subtract(*rng.uniform(size=(2, 200_000)))) < thresholds.COINCIDENT
    assert near.mean() == pytest.approx(0.05, abs=0.002)


def test_one_occurrence_may_have_a_change_of_the_aircraft_for_a_part_and_loads_of_several_axes() -> None:
    assert may_begin_together(DerivativeJump(), PULSE)
    assert may_begin_together(UnmeasuredInput(label="yaw"), UnmeasuredInput(label="roll"))
    assert not may_begin_together(GUST, PULSE) and not may_begin_together(SensorStep("q", "rad/s", 0.01), PULSE)
    assert one_cause(AIRCRAFT, [(DerivativeJump(), at("time", 4.0)), (PULSE, at("start", 4.0))]) == []


def test_one_curve_of_one_output_shows_one_force() -> None:
    two = (DragJump(), DensityScaleHeight())
    told = one_cause(flown(("altitude",), (), *two), [(two[0], at("time", 20.0))])
    assert [caution.concern for caution in told] == [Concern.ONE_CAUSE] and "drag-jump and density-scale-height" in told[0].sentence
    assert one_cause(flown(("altitude",), (), two[0]), []) == []
    assert one_cause(flown(("altitude",), (), two[0], SensorScale("altitude")), []) == []
    assert one_cause(flown(("altitude",), (), two[0], DragDrift()), []) == [], "a guard says unexplained by itself"
    assert one_cause(flown(("altitude",), (), *two, records=2), []) == [], "another height tells the air from the body"
    assert one_cause(flown(("q",), ("elevator",), *two), []) == []


def test_the_form_of_a_force_that_leaves_more_than_noise_is_open_in_one_curve() -> None:
    air = DensityScaleHeight()
    assert is_open_form(flown(("altitude",), (), air))
    assert not is_open_form(flown(("altitude",), (), air, records=2)) and not is_open_form(flown(("q",), ("elevator",), air))
    assert not is_open_form(flown(("altitude",), (), SensorScale("altitude"))) and not is_open_form(flown(("altitude",), ()))


def test_what_a_general_form_needs_beside_it_is_not_told_from_what_it_misses() -> None:
    curve, late = Varies(), InputRecordedLate()
    told = one_cause(flown(("q",), ("elevator",), curve, late), [])
    assert [caution.concern for caution in told] == [Concern.ONE_CAUSE] and f"{curve.name} leaves noise only with {late.name}" in told[0].sentence
    assert one_cause(flown(("q",), ("elevator",), curve, SensorScale("q")), []) == [], "a sensor acts behind all forces"
    assert one_cause(flown(("q",), ("elevator",), curve), []) == [] and one_cause(flown(("q",), ("elevator",), late, SensorScale("q")), []) == []


def test_a_set_is_asked_before_it_is_claimed() -> None:
    there = {**PUSHED, "gust-discrete.start": 6.0, "gust-discrete.duration": 2.0, "gust-discrete.peak": 4.0}
    problem = problem_of([planted([PULSE, GUST], there)], (PULSE, GUST))
    root = fit_of(problem)
    both = fit_of(problem, [PULSE, GUST], root, there)
    found = [(effect, quantities(both, effect)) for effect in both.effects]
    assert all(values["start"].value == pytest.approx(6.0, abs=0.1) for _, values in found)
    assert Concern.ONE_CAUSE in {caution.concern for caution in cautions_of(root, both, found)}
