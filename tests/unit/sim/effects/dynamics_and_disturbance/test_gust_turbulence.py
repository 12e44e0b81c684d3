"""Dryden turbulence: spectrum, variance, and what a forced flight shows of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.effects.disturbance.gusts import GustTurbulence
from sim.maths import complex_step_jacobian
from sim.truth.flight import fly, sample_times
from tests.bases import RIGID_VALUES, loes_model, rigid_model

V = RIGID_VALUES["airspeed"]
SIGMA, LENGTH = 1.7, 240.0
TURBULENCE = {"gust-turbulence.sigma": SIGMA, "gust-turbulence.length": LENGTH}


def system_in_turbulence() -> System:
    return compile_model(rigid_model().with_effects(GustTurbulence()).with_values(TURBULENCE))


def gust_filter() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Matrices of the gust's states and the vertical speed as their combination, from the compiled
    system.
    """
    system = system_in_turbulence()
    p = [float(value) for value in system.parameters.values()]
    A = complex_step_jacobian(lambda x: system.f(0.0, x, [0.0], p), [0.0] * 4)
    C = V * complex_step_jacobian(lambda x: system.h(0.0, x, [0.0], p), [0.0] * 4)[0, 2:]
    assert np.all(A[2:, :2] == 0.0)
    return A[2:, 2:], np.diag(system.noise(p)[0][2:]), C


def test_spectrum_is_that_of_the_specification() -> None:
    A, Q, C = gust_filter()
    for spatial in np.geomspace(1e-5, 1.0, 30):
        omega = spatial * V
        transfer = C @ np.linalg.solve(1j * omega * np.eye(2) - A, np.eye(2))
        # One-sided over the spatial frequency: twice the two-sided density over two pi, times V.
        got = float(np.real(transfer @ Q @ transfer.conj())) / np.pi * V
        expected = (
            SIGMA**2
            * LENGTH
            / np.pi
            * (1.0 + 3.0 * (LENGTH * spatial) ** 2)
            / (1.0 + (LENGTH * spatial) ** 2) ** 2
        )
        assert got == pytest.approx(expected, rel=1e-12)


def test_its_integral_is_the_variance() -> None:
    A, Q, C = gust_filter()
    covariance = solve_continuous_lyapunov(A, -Q)
    assert C @ covariance @ C == pytest.approx(SIGMA**2, rel=1e-12)
    # Of the states in air that has been rough for long; the length does not enter.
    np.testing.assert_allclose(
        SIGMA**2 * np.array([[0.5, 0.25], [0.25, 0.25]]), covariance, rtol=1e-12
    )


def test_gust_acts_on_loads_and_vane_of_both_aircraft() -> None:
    w = 3.0
    for model in (rigid_model(), loes_model()):
        system = compile_model(model.with_effects(GustTurbulence()))
        p = system.parameters.values().tolist()
        n = len(model.equations.states)
        angle = w / float(model.parameters["airspeed"].value)
        # Both states at w are a steady gust of w, as an equal alpha to loads and vane, and alpha
        # itself is unmoved.
        gusty, tilted = [0.0] * n + [w, w], [angle] + [0.0] * (n + 1)
        assert system.h(0.0, gusty, [0.0], p) == pytest.approx(system.h(0.0, tilted, [0.0], p))
        assert system.f(0.0, gusty, [0.0], p)[:n] == pytest.approx(
            system.f(0.0, tilted, [0.0], p)[:n]
        )


@pytest.mark.long
def test_a_forced_flight_has_gusts_of_that_size() -> None:
    model = rigid_model().with_effects(GustTurbulence()).with_values(TURBULENCE)
    _, truth = fly(model, None, sample_times(5.0, 800.0), np.random.default_rng(4), step=0.02)
    w = np.sqrt(3.0) * truth.states["gust_1"] + (1.0 - np.sqrt(3.0)) * truth.states["gust_2"]
    # 800 s hold some 300 independent gusts: the variance is known to about eight per cent.
    assert np.var(w) == pytest.approx(SIGMA**2, rel=0.25)
