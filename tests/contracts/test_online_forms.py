"""Laws of the forms that effects take in a filter that runs sample by sample."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.declaration.effect import (
    Anticipating,
    Effect,
    InputEffect,
    OnlineForm,
    SensorEffect,
    full_name,
)
from sim.declaration.model import System
from sim.errors import ModelError
from tests.bases import Flight, base_for, fly, fly_model
from tests.effect_cases import CASES, absent, typical

ONLINE = [case for case in CASES if isinstance(case.values[0], OnlineForm)]
NO_STATE_FORM = [
    case
    for case in CASES
    if isinstance(case.values[0], (InputEffect, SensorEffect))
    and not isinstance(case.values[0], OnlineForm)
]


def online_start(
    system: System, effect: Effect, flight: Flight, first_reading: float
) -> list[float]:
    """Initial state with the effect's own states settled at the signal that enters first."""
    signals = dict(zip(system.input_names, flight.u[:, 0], strict=True))
    entering = signals[effect.signal] if isinstance(effect, InputEffect) else first_reading
    own = (
        {signal.name for signal in effect.online_states}
        if isinstance(effect, OnlineForm)
        else set()
    )
    return [
        entering if name in own else value
        for name, value in zip(system.state_names, system.initial.values(), strict=True)
    ]


@pytest.mark.sampled
@pytest.mark.parametrize(("effect", "base"), ONLINE)
def test_online_form_converges_to_the_grid_form(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    present = typical(model, effect)
    channel = getattr(effect, "channel", model.equations.outputs[0].name)
    row = [signal.name for signal in model.equations.outputs].index(channel)
    grid_form, state_form = compile_model(present), compile_model(present, online=True)
    added = effect.online_states if isinstance(effect, OnlineForm) else ()
    assert state_form.state_names == grid_form.state_names + tuple(signal.name for signal in added)
    start = online_start(state_form, effect, flight, float(fly_model(model, flight)[row][0]))
    differences = []
    for max_step in (0.02, 0.01, 0.005):
        finer = replace(flight, max_step=max_step)
        differences.append(
            np.max(np.abs(fly(grid_form, finer)[row] - fly(state_form, finer, x0=list(start))[row]))
        )
    if not added:  # without memory the two are the same on a held input, whatever the step
        assert max(differences) < 1e-12 * np.max(np.abs(fly(grid_form, flight)[row]))
        return
    orders = np.log2(np.divide(differences[:-1], differences[1:]))
    assert differences[-1] < 1e-4 * np.max(np.abs(fly(grid_form, flight)[row]))
    assert np.all(orders > 1.8), f"order {orders}"


@pytest.mark.sampled
@pytest.mark.parametrize(("effect", "base"), ONLINE)
def test_online_form_is_the_identity_when_absent(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    for expected, got in zip(
        fly_model(model, flight),
        fly(compile_model(absent(model, effect), online=True), flight),
        strict=True,
    ):
        np.testing.assert_array_equal(got, expected)


@pytest.mark.sampled
@pytest.mark.parametrize(("effect", "base"), NO_STATE_FORM)
def test_running_online_without_a_state_form_names_the_effect(effect: Effect, base: str) -> None:
    model, _ = base_for(base)
    with pytest.raises(ModelError, match=re.escape(effect.name)):
        compile_model(model.with_effects(effect), online=True)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("effect", "base"), [case for case in NO_STATE_FORM if isinstance(case.values[0], InputEffect)]
)
def test_a_held_input_effect_may_stay_online(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    present = typical(model, effect)
    held = present.with_parameters(
        present.parameters.hold([full_name(effect, item.name) for item in effect.parameters])
    )
    if isinstance(effect, Anticipating) and effect.anticipates:
        with pytest.raises(ModelError, match=f"{effect.name} needs the input's future"):
            compile_model(held, online=True)
        return
    for expected, got in zip(
        fly_model(present, flight), fly(compile_model(held, online=True), flight), strict=True
    ):
        np.testing.assert_array_equal(got, expected)
