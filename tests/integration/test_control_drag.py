"""Drag of the elevator, which the longitudinal equations do not have, is not told as an
accelerometer away from the centre of gravity.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.diagnosis import Diagnosis, Verdict
from ident.tracing.loop import diagnose
from sim.declaration.effect import Effect
from sim.declaration.model import Noise
from sim.declaration.proposal import Traceable
from sim.effects.guards.changing_loads import ControlDrag
from sim.effects.library import catch_all_terms_for, effects_for, find_effect
from sim.record import Record
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import model_from_constants
from tests.whole_axes import CONSTANTS, NOISE, RATE, TRUE, maneuvers, true_model

AXIS = "longitudinal"


def flown_with(effect: Effect, value: float, seed: int) -> Record:
    (parameter,) = effect.parameters
    model = (
        true_model(AXIS)
        .with_noise(Noise(NOISE[AXIS]))
        .with_effects(effect)
        .with_values({f"{effect.name}.{parameter.name}": value})
    )
    record, _ = fly(
        model,
        maneuvers(AXIS),
        sample_times(RATE, 24.0),
        np.random.default_rng(seed),
        step=0.01,
        name=f"{seed}.csv",
    )
    return record


def diagnosed(effect: Effect, value: float) -> Diagnosis:
    fitted, held_out = flown_with(effect, value, 1), flown_with(effect, value, 2)
    start = {
        name: number * (1.0 + 0.2 * (-1.0) ** i)
        for i, (name, number) in enumerate(TRUE[AXIS].items())
    }
    begun = {item.name: item.value for item in true_model(AXIS).initial}
    model = model_from_constants(AXIS, CONSTANTS[AXIS], start, initial=begun).with_biases(
        fitted.output_names
    )
    offered = [each for each in effects_for(model.equations) if isinstance(each, Traceable)]
    return diagnose([fitted], model, offered, catch_all_terms_for(model.equations), [held_out])


@pytest.mark.slow
def test_drag_of_the_elevator_is_no_accelerometer() -> None:
    found = diagnosed(ControlDrag(), 0.1)
    assert found.verdict is Verdict.UNEXPLAINED and not any(
        claim.claimed for claim in found.effects
    )


@pytest.mark.slow
def test_an_accelerometer_below_the_centre_of_gravity_is_found_beside_it() -> None:
    found = diagnosed(find_effect("accelerometer-offset:nx"), -0.5)
    assert found.verdict is Verdict.TRACED and [
        claim.name for claim in found.effects if claim.claimed
    ] == ["accelerometer-offset:nx"]
    arm = found.effects[0].parameters["arm"]
    assert abs(arm.value + 0.5) < 3.0 * arm.std
