"""The second simulator against closed forms: trim, conservation, derivatives, order of integration,
gusts, and equal bytes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from exam.independent import jsbsim_flights, own_flights, six_degrees
from exam.independent.airplanes import AIRPLANES, BEAVER, PHANTOM, TRANSPORT, Airplane
from exam.independent.settings import amplification, drawn_setting, true_curves
from exam.independent.six_degrees import (
    G0,
    STEP,
    Hidden,
    Loops,
    accelerations,
    derivatives,
    dryden,
    fly,
    start_of,
    trimmed,
)
from tests.independent.jsbsim_flight import AVAILABLE

IN_VACUUM = replace(PHANTOM, coefficients=lambda *given: (0.0,) * 6)


@pytest.mark.parametrize("plane", AIRPLANES, ids=lambda plane: plane.name)
def test_trim_is_level_and_stays(plane: Airplane) -> None:
    trim = trimmed(plane)
    rates, specific = accelerations(plane, start_of(plane, trim), trim.surfaces, trim.power)
    assert max(map(abs, rates)) < 1e-9
    assert math.hypot(*specific) == pytest.approx(G0, rel=1e-9)
    flown = fly(plane, trim, {"elevator": np.zeros(400)})
    for name in ("airspeed", "alpha", "q", "p", "r", "height"):
        assert np.ptp(flown[name]) < 1e-9, name


def test_a_tumbling_body_without_air_keeps_energy_and_angular_momentum() -> None:
    """Without air and thrust: energy of the fall, rotational energy, and angular momentum against
    the Earth.
    """
    ixx, iyy, izz, ixz = IN_VACUUM.inertia
    inertia = np.array([[ixx, 0.0, -ixz], [0.0, iyy, 0.0], [-ixz, 0.0, izz]])
    state = [100.0, 10.0, -5.0, 0.8, 0.3, -0.5, 0.2, 0.1, 0.4, 50.0]

    def invariants(x: list[float]) -> np.ndarray:
        u, v, w, p, q, r, phi, theta, psi, height = x
        rates = np.array([p, q, r])
        momentum = inertia @ rates
        c, s = math.cos, math.sin
        yaw = np.array([[c(psi), -s(psi), 0.0], [s(psi), c(psi), 0.0], [0.0, 0.0, 1.0]])
        pitch = np.array([[c(theta), 0.0, s(theta)], [0.0, 1.0, 0.0], [-s(theta), 0.0, c(theta)]])
        roll = np.array([[1.0, 0.0, 0.0], [0.0, c(phi), -s(phi)], [0.0, s(phi), c(phi)]])
        return np.array(
            [
                0.5 * (u * u + v * v + w * w) + G0 * height,
                rates @ momentum,
                *(yaw @ pitch @ roll @ momentum),
            ]
        )

    before = invariants(state)
    for _ in range(400):
        a = accelerations(IN_VACUUM, state, (0.0, 0.0, 0.0), 0.0)[0]
        b = accelerations(
            IN_VACUUM, six_degrees._moved(state, a, 0.5 * STEP), (0.0, 0.0, 0.0), 0.0
        )[0]
        c = accelerations(
            IN_VACUUM, six_degrees._moved(state, b, 0.5 * STEP), (0.0, 0.0, 0.0), 0.0
        )[0]
        d = accelerations(IN_VACUUM, six_degrees._moved(state, c, STEP), (0.0, 0.0, 0.0), 0.0)[0]
        state = [
            x + STEP / 6.0 * (k + 2.0 * (m + n) + o)
            for x, k, m, n, o in zip(state, a, b, c, d, strict=True)
        ]
    assert state[6] != pytest.approx(0.2, abs=0.1), "it did not tumble"
    np.testing.assert_allclose(invariants(state), before, rtol=1e-9)


@pytest.mark.parametrize("plane", AIRPLANES, ids=lambda plane: plane.name)
def test_derivatives_are_slopes_of_the_accelerations(plane: Airplane) -> None:
    """Moments and side force per derivative, from small changes of the state and the surfaces:
    another way than the coefficients.
    """
    trim = trimmed(plane)
    rest = start_of(plane, trim)
    pressed = 0.5 * plane.density * plane.airspeed**2 * plane.area
    ixx, iyy, izz, ixz = plane.inertia
    half_chord, half_span = (
        plane.chord / (2.0 * plane.airspeed),
        plane.span / (2.0 * plane.airspeed),
    )

    def slope(
        state: int | None, surface: int | None, small: float
    ) -> tuple[np.ndarray, np.ndarray]:
        both = []
        for sign in (1.0, -1.0):
            x, s = list(rest), list(trim.surfaces)
            if state is not None:
                x[state] += sign * small
            if surface is not None:
                s[surface] += sign * small
            rates, specific = accelerations(plane, x, s, trim.power)
            both.append((np.array(rates[3:6]), np.array(specific)))
        return (both[0][0] - both[1][0]) / (2.0 * small), (both[0][1] - both[1][1]) / (2.0 * small)

    rigid, lateral = derivatives(plane, trim, "rigid"), derivatives(plane, trim, "lateral")
    for name, state, surface, per in (("q", 4, None, half_chord), ("de", None, 0, 1.0)):
        turn, force = slope(state, surface, 1e-5)
        assert turn[1] * iyy / (pressed * plane.chord * per) == pytest.approx(
            rigid[f"Cm_{name}"], rel=1e-6
        )
        assert -force[2] * plane.mass / (pressed * per) == pytest.approx(
            rigid[f"CL_{name}"], rel=1e-6
        )
    for name, state, surface, per in (
        ("p", 3, None, half_span),
        ("r", 5, None, half_span),
        ("da", None, 1, 1.0),
        ("dr", None, 2, 1.0),
    ):
        turn, force = slope(state, surface, 1e-5)
        roll, yaw = ixx * turn[0] - ixz * turn[2], -ixz * turn[0] + izz * turn[2]
        assert roll / (pressed * plane.span * per) == pytest.approx(lateral[f"Cl_{name}"], rel=1e-6)
        assert yaw / (pressed * plane.span * per) == pytest.approx(
            lateral[f"Cn_{name}"], rel=1e-6, abs=1e-9
        )
        assert force[1] * plane.mass / (pressed * per) == pytest.approx(
            lateral[f"CY_{name}"], rel=1e-6, abs=1e-9
        )


def test_published_coefficients_of_the_beaver() -> None:
    """Three rows of table 3 of LR-556 by hand; the pitch rate is made non-dimensional with c/V
    there.
    """
    along, _, down, roll, pitch, yaw = BEAVER.coefficients(
        0.1, 0.0, 0.0, 0.01, 0.0, -0.05, 0.02, 0.0, 0.5
    )
    assert along == pytest.approx(
        -0.03554 + 0.000292 + 0.05459 - 0.005162 - 0.6748 * 0.02 + 0.1161 * 0.5 + 0.1453 * 0.025
    )
    assert down == pytest.approx(
        -0.05504 - 0.5578 + 0.003442 - 2.988 * 0.02 + 0.398 * 0.05 - 0.1563 * 0.5
    )
    assert pitch == pytest.approx(
        0.09448 - 0.06028 - 0.0214 - 15.56 * 0.02 + 1.921 * 0.05 - 0.07895 * 0.5
    )
    assert roll == pytest.approx(0.000591 - (0.09917 + 0.008269) * 0.02 - 0.01406 * 0.005)
    assert yaw == pytest.approx(-0.003117 - 0.003872 * 0.02 + 0.1595 * 0.02 - 0.003026 * 0.125)


@pytest.mark.parametrize("plane", AIRPLANES, ids=lambda plane: plane.name)
def test_signs_of_controls_and_stability(plane: Airplane) -> None:
    rigid, lateral = (derivatives(plane, trimmed(plane), model) for model in ("rigid", "lateral"))
    assert (
        rigid["CL_alpha"] > 0.0 > rigid["Cm_alpha"]
        and rigid["Cm_q"] < 0.0
        and rigid["CL_de"] > 0.0 > rigid["Cm_de"]
    )
    assert (
        lateral["CY_beta"] < 0.0 < lateral["Cn_beta"]
        and lateral["Cl_beta"] < 0.0
        and lateral["Cl_p"] < 0.0
    )
    assert (
        lateral["Cl_da"] < 0.0
        and lateral["Cn_dr"] < 0.0 < lateral["CY_dr"]
        and lateral["Cn_r"] < 0.0
    )


def test_records_obey_kinematics_and_gusts_reach_vane_and_loads() -> None:
    """alpha_dot = q - (g/V)(nz - cos theta cos phi) at small angles, and a gust that turns the air
    by w/V.
    """
    trim = trimmed(TRANSPORT)
    time = STEP * np.arange(1200)
    calm = fly(TRANSPORT, trim, {"elevator": 0.01 * np.sin(4.0 * time)})
    gravity = np.cos(calm["theta"] - calm["alpha"])
    lift = calm["nz"] * np.cos(calm["alpha"]) + calm["nx"] * np.sin(calm["alpha"])
    expected = calm["q"] - G0 / calm["airspeed"] * (lift - gravity)
    assert np.std(np.gradient(calm["alpha"], STEP) - expected)[()] < 1e-3 * np.std(calm["q"])
    gust = np.zeros((3, 1200))
    gust[2, 600:] = -1.0  # the z axis points down: rising air
    risen = fly(TRANSPORT, trim, {"elevator": np.zeros(1200)}, hidden=Hidden(gust=gust))
    jump = risen["alpha"][600] - risen["alpha"][599]
    assert jump == pytest.approx(1.0 / TRANSPORT.airspeed, rel=0.01)
    assert risen["nz"][600] - risen["nz"][599] > 0.0


@pytest.mark.long
def test_dryden_gusts_have_their_variance_and_their_seed() -> None:
    one, again, other = (
        dryden(50.0, 0.8, 5.0, 40000, np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, again)
    assert not np.array_equal(one, other)
    np.testing.assert_allclose(np.std(one, axis=1), 0.8, rtol=0.1)


def test_a_damper_damps_and_a_stop_stops() -> None:
    trim = trimmed(PHANTOM)
    time = STEP * np.arange(3200)
    command = {"elevator": 0.01 * ((time > 1.0) & (time < 1.5))}
    open_loop, damped = (
        fly(PHANTOM, trim, command),
        fly(PHANTOM, trim, command, Loops(pitch_rate=0.5)),
    )
    assert np.std(damped["q"][-1600:]) < 0.3 * np.std(open_loop["q"][-1600:])
    stopped = fly(
        PHANTOM, trim, command, hidden=Hidden(linkage={"elevator": lambda x: min(x, 0.004)})
    )
    np.testing.assert_array_equal(stopped["elevator"], open_loop["elevator"])
    assert np.ptp(stopped["q"]) < 0.5 * np.ptp(open_loop["q"])


@pytest.mark.long
def test_the_same_number_gives_the_same_bytes(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        own_flights.fly_flight(8, tmp_path / folder)
    names = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert names == ["train-1.csv", "train-2.csv", "truth.json", "validate.csv", "vehicle.toml"]
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.mark.long
def test_curves_that_the_airplane_has_are_found() -> None:
    """The Beaver's moment bends with alpha; the lift of its fitted polynomial hardly does."""
    number = 1
    setting, bend = drawn_setting(
        number, "rigid", np.random.default_rng([own_flights.SEED, 2, number])
    )
    assert setting.plane.name == BEAVER.name and bend > 0.1
    assert "moment-nonlinearity" in true_curves(setting) and "lift-nonlinearity" not in true_curves(
        setting
    )


@pytest.mark.parametrize(
    "plan",
    [own_flights.SPECS, [("rigid", draws) for draws in jsbsim_flights.SPECS]],
    ids=["own", "jsbsim"],
)
def test_a_third_is_clean_and_sixty_are_flown(plan: list[tuple[str, tuple[object, ...]]]) -> None:
    assert 2 * len(plan) == 60
    assert sum(not draws for _, draws in plan) == 10
    assert sum(len(draws) == 2 for _, draws in plan) >= 2


def test_aircraft_that_are_kept_for_other_examinations_are_not_flown() -> None:
    names = {aircraft.name for aircraft in jsbsim_flights.FLEET}
    assert len(names) == 12
    assert not names & {
        "737",
        "B747",
        "A4",
        "F80C",
        "global5000",
        "f16",
        "c172p",
        "c172r",
        "c172x",
        "c182",
    }


@pytest.mark.long
@pytest.mark.skipif(
    not AVAILABLE, reason="JSBSim is not installed (pip install 'flightid[jsbsim]')"
)
def test_a_flight_by_jsbsim_is_the_same_again(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        jsbsim_flights.fly_flight(4, tmp_path / folder)
    for name in ("train-1.csv", "validate.csv", "vehicle.toml", "truth.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()


@pytest.mark.long
def test_amplification_is_that_of_the_free_decay() -> None:
    """The yaw rate of the F-4 after a pulse: its peaks fall by exp(-2 pi zeta/sqrt(1 - zeta^2)) a
    period.
    """
    setting, _ = drawn_setting(8, "lateral", np.random.default_rng([own_flights.SEED, 2, 8]))
    assert setting.plane.name == PHANTOM.name
    time = STEP * np.arange(6000)
    flown = fly(setting.plane, setting.trim, {"rudder": 0.002 * ((time > 0.5) & (time < 1.5))})
    rate = np.gradient(flown["beta"], STEP)
    peaks = [
        rate[k] for k in range(800, 5999) if rate[k - 1] < rate[k] >= rate[k + 1] and rate[k] > 0.0
    ]
    decrement = math.log(peaks[0] / peaks[1])
    zeta = decrement / math.hypot(2.0 * math.pi, decrement)
    assert amplification(setting) == pytest.approx(1.0 / (2.0 * zeta), rel=0.1)
