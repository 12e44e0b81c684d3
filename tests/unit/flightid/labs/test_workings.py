"""What the labs compute from a study: errors in sigmas, a doublet's spectrum, time to double."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from flightid.labs.workings import flexibility, honest_sigmas, residuals, short_period, sigmas_off
from flightid.labs.workings.augmented import bare_airframe, doubling_time
from scenarios.studies.declaration import Row
from sim.record import Channel, Record
from sim.vehicles.library import read_parameter_set


@pytest.mark.parametrize(("estimate", "sigmas"), [(-1.2, -2.0), (-0.9, 1.0)])
def test_an_error_in_sigmas_is_positive_above_the_reference(estimate: float, sigmas: float) -> None:
    assert sigmas_off(Row("Cm_alpha", "1/rad", estimate, 0.1, true=-1.0)) == pytest.approx(sigmas)


def test_a_residual_is_measured_less_fitted() -> None:
    time, fitted = np.arange(5) * 0.1, np.array([[1.0, 2.0, 3.0, 4.0, 5.0], np.zeros(5)])
    outputs = (
        Channel.of("q", "rad/s", np.zeros(5) + 0.5),
        Channel.of("alpha", "rad", fitted[0] + 0.25),
    )
    estimate = SimpleNamespace(output_names=("alpha", "q"), fitted=(fitted,))
    found: Any = SimpleNamespace(
        record=Record(time, (), outputs),
        main=SimpleNamespace(result=SimpleNamespace(estimate=estimate)),
    )
    left = residuals(found)
    np.testing.assert_allclose(left["alpha"], 0.25)
    np.testing.assert_allclose(left["q"], 0.5)


@pytest.mark.parametrize("frequency", [0.8, 3.0])
def test_the_spectrum_of_the_tuned_doublet_peaks_at_the_frequency(frequency: float) -> None:
    """By quadrature of exp(-j omega t) over a doublet, at the frequency and a little off it."""
    unit = short_period.tuned_doublet(frequency)
    t = (np.arange(20000) + 0.5) / 20000 * 2.0 * unit
    doublet = np.where(t < unit, 1.0, -1.0)
    omega = frequency * np.array([0.97, 1.0, 1.03])
    size = np.abs(np.exp(-1j * omega[:, None] * t) @ doublet)
    assert size[1] > max(size[0], size[2])
    # In the middle of a parabola through the three the top lies at the frequency.
    assert abs(size[2] - size[0]) < 0.1 * (2.0 * size[1] - size[0] - size[2])


def test_the_mode_frequencies_are_those_of_the_vehicle() -> None:
    values = read_parameter_set("bomber_ac1").values
    expected = [2.0 * values[f"omega{i}"] for i in range(1, 5)]
    assert flexibility.mode_frequencies(2.0) == pytest.approx(expected, abs=0.011)


def test_a_disturbance_doubles_in_the_time_to_double() -> None:
    """x_dot = A x from the unstable eigenvector, by the exponential of the matrix."""
    from scipy.linalg import expm

    airframe = SimpleNamespace(L_alpha=-0.8, L_q=1.0, M_alpha=3.0, M_q=-0.6)
    flown: Any = SimpleNamespace(x29=SimpleNamespace(airframe=airframe))
    A = np.array([[-0.8, 1.0], [3.0, -0.6]])
    start = np.array([1.0, bare_airframe(flown)[-1] + 0.8])
    np.testing.assert_allclose(expm(A * doubling_time(flown)) @ start, 2.0 * start, rtol=1e-12)
    assert math.isclose(bare_airframe(flown).sum(), np.trace(A))


def test_errors_of_a_campaign_are_in_the_sigmas_of_each_run() -> None:
    found: Any = SimpleNamespace(
        names=("a", "b"),
        spreads=(SimpleNamespace(reference=1.0), SimpleNamespace(reference=-2.0)),
        values=np.array([[1.2, 0.9], [-2.0, -5.0]]),
        std=np.array([[0.1, 0.2], [0.5, 1.5]]),
    )
    errors = honest_sigmas.errors(found)
    np.testing.assert_allclose(errors["a"], [2.0, -0.5])
    np.testing.assert_allclose(errors["b"], [0.0, -2.0])


def test_lab_7_prints_commands_that_can_be_copied() -> None:
    from flightid.labs.workings import own_data as lab

    given = lab.kept(lab.example(), lab.vehicle_text("rigid"), lab.MAP)
    lines = "\n".join(
        (*lab.check_remarks(lab.checked(given)), *lab.fit_remarks(lab.identified(given, "rigid")))
    )
    assert (
        "next: flightid diagnose point_1.csv --model rigid --vehicle vehicle.toml --validate "
        "point_2.csv --channels map.toml"
    ) in lines
    assert "flightid." not in lines and str(given.folder.path) not in lines
    radians = lab.MAP.replace('"AoA1", unit = "deg"', '"AoA1", unit = "rad"')
    refused = lab.kept(lab.example(), lab.vehicle_text("rigid"), radians)
    found, error = lab.tried(lambda: lab.identified(refused, "rigid"))
    assert found is None and "--trust-record" in error
