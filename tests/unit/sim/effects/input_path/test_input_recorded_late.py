"""An input that is recorded late: the inverse of a delay, but for the record's end."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.effects.input_path.input_delay import InputDelay, RecordedInputDelay
from sim.errors import ModelError
from sim.maths import COMPLEX_STEP
from tests.bases import Flight, fly_model, rigid_flight, rigid_model


def act(edges: np.ndarray, u: np.ndarray, delay: object) -> np.ndarray:
    return np.asarray(RecordedInputDelay().act(edges, u, SimpleNamespace(delay=delay)))


def test_a_step_moves_forward_by_exactly_the_delay_and_the_last_value_holds() -> None:
    edges = np.arange(1001) * 0.001
    u = (edges[:-1] >= 0.4995).astype(float)
    out = act(edges, u, 0.0604)
    np.testing.assert_allclose(out[:439], 0.0, atol=1e-12)
    # the step falls 0.6 of the way through this cell
    assert out[439] == pytest.approx(0.4, abs=1e-9)
    np.testing.assert_allclose(out[440:], 1.0, atol=1e-12)
    np.testing.assert_array_equal(act(edges, np.arange(1000.0), 5.0), np.full(1000, 999.0))


def test_it_undoes_a_delay_where_the_record_knows_the_input() -> None:
    generator = np.random.default_rng(3)
    edges = np.concatenate([[1.0], 1.0 + np.cumsum(generator.uniform(5e-4, 1e-3, 400))])
    u = np.cumsum(generator.standard_normal(400)) * 0.01
    held = np.repeat(u[::20], 20)
    late = np.asarray(InputDelay().act(edges, held, SimpleNamespace(delay=0.02)))
    back = act(edges, late, 0.02)
    known = edges[1:] < edges[-1] - 0.02
    away = np.abs(back - held)[known]
    assert np.median(away) < 1e-12 and away.max() <= np.abs(np.diff(held)).max(), (
        "only cells with a jump in them are smeared"
    )


@pytest.mark.parametrize("none", [0.0, 0j, np.zeros(3)])
def test_no_delay_is_the_identity_bit_for_bit(none: object) -> None:
    generator = np.random.default_rng(1)
    edges = np.concatenate([[0.3], 0.3 + np.cumsum(generator.uniform(5e-4, 1e-3, 50))])
    u = generator.standard_normal((50, 3))
    np.testing.assert_array_equal(act(edges, u, none), u)


@pytest.mark.parametrize("delay", [0.0, 0.0137, 0.5])
def test_derivative_is_that_towards_longer_delays(delay: float) -> None:
    edges = np.arange(41) * 0.001
    u = np.random.default_rng(2).standard_normal(40)
    exact = act(edges, u, complex(delay, COMPLEX_STEP)).imag / COMPLEX_STEP
    np.testing.assert_allclose(
        exact, (act(edges, u, delay + 1e-7) - act(edges, u, delay)) / 1e-7, atol=1e-3
    )


def test_the_aircraft_answers_ahead_of_the_record() -> None:
    flight = rigid_flight(6.0)
    shift = 3  # samples, 60 ms
    recorded = Flight(
        flight.time, np.concatenate([np.zeros((1, shift)), flight.u[:, :-shift]], axis=1)
    )
    model = (
        rigid_model()
        .with_effects(RecordedInputDelay())
        .with_values({"input-recorded-late.delay": shift / 50.0})
    )
    for got, expected in zip(
        fly_model(model, recorded), fly_model(rigid_model(), flight), strict=True
    ):
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-9 * np.max(np.abs(expected)))


def test_no_filter_takes_it_even_held_and_the_refusal_names_it() -> None:
    model = rigid_model().with_effects(RecordedInputDelay())
    held = model.with_parameters(model.parameters.hold(["input-recorded-late.delay"]))
    for refused in (model, held):
        with pytest.raises(
            ModelError, match=r"input-recorded-late needs the input's future.*on line"
        ):
            compile_model(refused, online=True)
