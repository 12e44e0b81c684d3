"""Dead band and saturation against their definitions, one number at a time."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.declaration.proposal import SearchContext
from sim.effects.input_path.actuator import ActuatorRateLimit, ActuatorSaturation
from sim.effects.input_path.input_play import InputBacklash, InputDeadband
from sim.effects.instances import large_input
from sim.maths import COMPLEX_STEP

numbers = st.floats(-1e3, 1e3)
sizes = st.floats(0.0, 1e3)
EDGES = np.arange(6) * 0.001


def dead(value: float, width: float) -> float:
    if abs(value) <= width:
        return 0.0
    return value - width if value > 0 else value + width


@given(st.lists(numbers, min_size=5, max_size=5), sizes)
def test_dead_band_is_its_definition(values: list[float], width: float) -> None:
    out = InputDeadband().act(EDGES, np.array(values), SimpleNamespace(half_width=width))
    np.testing.assert_allclose(out, [dead(value, width) for value in values], rtol=0.0, atol=1e-12)
    assert not np.any(out[np.abs(values) <= width])


@given(st.lists(numbers, min_size=5, max_size=5), sizes)
def test_saturation_is_its_definition(values: list[float], limit: float) -> None:
    out = ActuatorSaturation().act(EDGES, np.array(values), SimpleNamespace(limit=limit))
    np.testing.assert_array_equal(out, [max(-limit, min(value, limit)) for value in values])


def test_slopes_by_the_width_and_the_limit() -> None:
    u, step = np.array([-0.4, -0.1, 0.0, 0.1, 0.4]), complex(0.2, COMPLEX_STEP)
    slope = InputDeadband().act(EDGES, u, SimpleNamespace(half_width=step)).imag / COMPLEX_STEP
    np.testing.assert_allclose(slope, [1.0, 0.0, 0.0, 0.0, -1.0])
    slope = ActuatorSaturation().act(EDGES, u, SimpleNamespace(limit=step)).imag / COMPLEX_STEP
    np.testing.assert_allclose(slope, [-1.0, 0.0, 0.0, 0.0, 1.0])
    at_absence = (
        InputDeadband().act(EDGES, u, SimpleNamespace(half_width=complex(0.0, COMPLEX_STEP))).imag
        / COMPLEX_STEP
    )
    np.testing.assert_allclose(at_absence, [1.0, 1.0, 0.0, -1.0, -1.0])


@pytest.mark.parametrize(
    ("effect", "name"), [(InputDeadband(), "half_width"), (ActuatorSaturation(), "limit")]
)
def test_batches_and_scalars_are_one_by_one(
    effect: InputDeadband | ActuatorSaturation, name: str
) -> None:
    many, sizes_tried = np.random.default_rng(1).standard_normal((5, 3)), np.array([0.0, 0.4, 2.0])
    full = effect.act(EDGES, many, SimpleNamespace(**{name: sizes_tried[:, None]}))
    assert full.shape == (5, 3, 3)
    for i, size in enumerate(sizes_tried):
        p = SimpleNamespace(**{name: size})
        np.testing.assert_array_equal(full[:, i], effect.act(EDGES, many, p))
        np.testing.assert_array_equal(
            full[:, i, 1], [effect.pass_on(value, (), p) for value in many[:, 1]]
        )
        assert effect.rates(0.3, (), p) == () and effect.online_states == ()


@pytest.mark.parametrize(
    ("kind", "share"),
    [
        (ActuatorRateLimit, 3.0),
        (ActuatorSaturation, 0.5),
        (InputBacklash, 0.05),
        (InputDeadband, 0.1),
    ],
)
@pytest.mark.parametrize("peak", [0.02, 1.0, 4e5])
def test_where_a_unit_does_not_say_what_is_large_the_records_peak_does(
    kind: type, share: float, peak: float
) -> None:
    """As an effect on a surface begins at a share of a large deflection, one on a valve or a price
    begins at that share of its peak.
    """
    context = SearchContext(0.0, 9.0, 0.02, input_peak={"valve": peak, "elevator": 9.0})
    unknown = kind("valve", "m3/s", share * large_input("m3/s"), sized=False).fitted_to(context)
    assert unknown.typical == pytest.approx(share * peak)
    assert unknown.parameters[0].value == unknown.typical
    low, high = unknown.traits.plausible[unknown.parameters[0].name]
    assert low <= unknown.typical <= high
    surface = kind("elevator", "rad", share * large_input("rad"))
    assert surface.fitted_to(context) is surface
    still = kind("valve", "m3/s", sized=False)
    assert still.fitted_to(SearchContext(0.0, 9.0, 0.02, input_peak={"valve": 0.0})) is still
