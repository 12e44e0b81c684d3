"""Effects on the falling body, against other parameters, restarts and the standard atmosphere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim.declaration.effect import Effect
from sim.declaration.proposal import SearchContext
from sim.effects.dynamics.atmosphere import DensityScaleHeight, DragMach
from sim.effects.dynamics.derivative_jump import DragJump
from sim.effects.library import catch_all_terms_for, find_effect
from sim.maths import combine
from sim.vehicles.other_vehicles import Ballistic
from tests.bases import BALLISTIC_VALUES, ballistic_flight, ballistic_model, fly_model

FLIGHT = replace(ballistic_flight(30.0), max_step=0.01)


def with_effect(effect: Effect, values: Mapping[str, float]) -> np.ndarray:
    given = {f"{effect.name}.{local}": value for local, value in values.items()}
    return fly_model(ballistic_model().with_effects(effect).with_values(given), FLIGHT)[0]


def fallen(
    drag: Callable[[float, float, float], float], cuts: tuple[float, ...] = ()
) -> np.ndarray:
    """Altitudes of the body written a second time; ``drag(t, altitude, speed)`` multiplies its
    drag, restarted at the cuts.
    """
    v = BALLISTIC_VALUES

    def rates(t: float, x: np.ndarray) -> list[float]:
        rho = v["air_density_reference"] * np.exp(-x[0] / v["density_scale_height"])
        return [
            x[1],
            -0.5 * rho * x[1] * abs(x[1]) * drag(t, x[0], abs(x[1])) / v["beta"] - v["gravity"],
        ]

    out, x, ends = [], np.array([60960.0, -1828.8]), [0.0, *cuts, 30.0]
    for a, b in pairwise(ends):
        inside = FLIGHT.time[(FLIGHT.time >= a) & ((FLIGHT.time < b) | (b == 30.0))]
        run = solve_ivp(
            rates,
            (a, b),
            x,
            method="DOP853",
            rtol=1e-11,
            atol=1e-9,
            t_eval=[*inside, *([b] if b not in inside else [])],
            max_step=0.1,
        )
        out += run.y[0, : len(inside)].tolist()
        x = run.y[:, -1]
    return np.array(out)


def test_another_scale_height_is_that_scale_height() -> None:
    expected = fly_model(
        ballistic_model(
            {
                **BALLISTIC_VALUES,
                "density_scale_height": 1.2 * BALLISTIC_VALUES["density_scale_height"],
            }
        ),
        FLIGHT,
    )[0]
    np.testing.assert_allclose(
        with_effect(DensityScaleHeight(), {"change": 0.2}), expected, rtol=0.0, atol=1e-6
    )


@pytest.mark.parametrize(("time", "factor"), [(21.0, 0.6), (24.337, 1.7)])
def test_drag_that_jumps(time: float, factor: float) -> None:
    expected = fallen(lambda t, h, v: factor if t >= time else 1.0, (time,))
    got = with_effect(DragJump(), {"time": time, "factor": factor})
    assert np.max(np.abs(got - fly_model(ballistic_model(), FLIGHT)[0])) > 100.0
    np.testing.assert_allclose(got, expected, rtol=0.0, atol=0.1)


def test_drag_over_mach_uses_the_standard_speed_of_sound() -> None:
    effect = DragMach(0.4, 6.2)
    sizes = [0.2, -0.1, 0.05, 0.03, -0.04]

    def drag(t: float, altitude: float, speed: float) -> float:
        a = np.sqrt(1.4 * 287.053 * max(288.15 - 0.0065 * altitude, 216.65))
        assert (altitude < 11000.0) or a == pytest.approx(295.07, abs=0.01)
        return float(np.exp(combine(effect.shapes, np.arcsinh((speed / a - 1.1) / 0.25), sizes)))

    got = with_effect(effect, {f"shape{i + 1}": size for i, size in enumerate(sizes)})
    np.testing.assert_allclose(got, fallen(drag), rtol=0.0, atol=0.01)
    assert np.max(np.abs(got - fly_model(ballistic_model(), FLIGHT)[0])) > 100.0


def test_drag_over_mach_leaves_beta_at_the_lowest_mach_number() -> None:
    for fine in (False, True):
        shapes = DragMach(0.7, 3.0, fine).shapes
        at = float(np.arcsinh((0.7 - 1.1) / 0.25))
        assert combine(shapes, at, [1.0] * shapes.count) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("centre", "width"), [(0.95, 0.25), (1.15, 0.4), (1.3, 0.3)])
def test_its_shapes_follow_a_drag_rise_of_another_form(centre: float, width: float) -> None:
    mach = np.linspace(0.6, 5.0, 500)
    rise = np.log1p(0.32 * np.exp(-(((mach - centre) / width) ** 2)))
    left = []
    for fine in (False, True):
        shapes = DragMach(0.6, 5.0, fine).shapes
        z = np.arcsinh((mach - 1.1) / 0.25)
        columns = np.array(
            [combine(shapes, z, row.tolist()) for row in np.eye(shapes.count)]
            + [np.ones_like(mach)]
        ).T
        left.append(np.sqrt(np.mean((rise - columns @ np.linalg.lstsq(columns, rise)[0]) ** 2)))
    assert left[0] < 0.012 and left[1] < 0.003


def test_drag_over_mach_takes_its_range_from_the_speeds_flown() -> None:
    effect = DragMach()
    assert effect.fitted_to(SearchContext(0.0, 10.0, 0.1)) == effect
    fitted = effect.fitted_to(SearchContext(0.0, 10.0, 0.1, flown={"velocity": (-1800.0, -170.0)}))
    assert isinstance(fitted, DragMach) and not fitted.fine
    assert fitted.low == pytest.approx(170.0 / 340.29, rel=1e-4) and fitted.high == pytest.approx(
        1800.0 / 295.07, rel=1e-4
    )
    high_up = effect.fitted_to(
        SearchContext(
            0.0, 10.0, 0.1, flown={"velocity": (-1800.0, -1000.0), "altitude": (20000.0, 40000.0)}
        )
    )
    assert isinstance(high_up, DragMach) and high_up.low == pytest.approx(
        1000.0 / 295.07, rel=1e-4
    ), "slowest where it is lowest, still high"
    both_ways = effect.fitted_to(SearchContext(0.0, 10.0, 0.1, flown={"velocity": (-300.0, 100.0)}))
    assert isinstance(both_ways, DragMach) and both_ways.low == 0.0


def test_drag_that_drifts_or_swings_is_a_guard_only() -> None:
    drift, swing = catch_all_terms_for(Ballistic())
    np.testing.assert_allclose(
        with_effect(drift, {"rate": 0.04}),
        fallen(lambda t, h, v: np.exp(0.04 * t)),
        rtol=0.0,
        atol=1e-3,
    )
    np.testing.assert_allclose(
        with_effect(swing, {"frequency": 1.5, "log_drag_cos": 0.1, "log_drag_sin": 0.2}),
        fallen(lambda t, h, v: np.exp(0.1 * np.cos(1.5 * t) + 0.2 * np.sin(1.5 * t))),
        rtol=0.0,
        atol=1e-3,
    )
    assert find_effect("drag-mach", Ballistic()) == DragMach()
