"""The shape of the discrete gust and where it is felt."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.effects.disturbance.gusts import GustDiscrete
from tests.bases import RIGID_VALUES, rigid_model

P = SimpleNamespace(peak=4.0, start=2.0, duration=1.5)
VEHICLE = SimpleNamespace(airspeed=200.0)


def gust(time: Any) -> Any:
    return GustDiscrete().increments(SimpleNamespace(time=time), VEHICLE, P)["gust"]


def test_shape_is_one_minus_cosine_within_and_zero_without() -> None:
    t = np.linspace(0.0, 5.0, 501)
    inside = (t > 2.0) & (t < 3.5)
    expected = np.where(inside, 0.02 * np.sin(np.pi * (t - 2.0) / 1.5) ** 2, 0.0)
    np.testing.assert_allclose(gust(t), expected, atol=1e-15)
    assert np.all(np.asarray(gust(t))[~inside] == 0.0)
    assert gust(2.75) == pytest.approx(0.02)
    assert gust(0.0) == 0.0 and gust(9.0) == 0.0


def test_adds_to_the_loads_and_the_vane_but_not_to_the_state() -> None:
    # At its peak the gust acts on rates and readings as an equal alpha would, and alpha itself is
    # unmoved.
    system = compile_model(rigid_model().with_effects(GustDiscrete()))
    names = system.parameters.names
    given = {"gust-discrete.peak": 4.0, "gust-discrete.start": 2.0, "gust-discrete.duration": 1.0}
    p = [given.get(name, float(system.parameters[name].value)) for name in names]
    angle = 4.0 / RIGID_VALUES["airspeed"]
    assert system.f(2.5, [0.0, 0.0], [0.0], p) == pytest.approx(
        system.f(0.0, [angle, 0.0], [0.0], p)
    )
    assert system.h(2.5, [0.0, 0.0], [0.0], p) == pytest.approx(
        system.h(0.0, [angle, 0.0], [0.0], p)
    )
    alpha, q, nz = system.h(2.5, [0.0, 0.0], [0.0], p)
    assert alpha == pytest.approx(angle) and q == 0.0 and nz > 0.0, (
        "an upward gust is an added alpha and lift"
    )
