"""Six degrees of freedom against Newton and Euler written with matrices."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.errors import DeclarationError
from sim.maths import G0
from sim.propagation import rk4_step
from sim.record import Hold
from sim.vehicles.aircraft import STATES, Aircraft, Thrust, aircraft_model, declaration_of
from sim.vehicles.attitude import ATTITUDES, QUATERNION
from tests.airliner import AIRLINER, ALPHA, COEFFICIENTS, CONSTANTS, ELEVATOR, THRUST
from tests.bases import airliner_flight, fly_model

X = [125.0, 0.08, -0.06, 0.3, -0.12, 0.2, 0.4, 0.1]
U = [0.05, -0.04, 0.03, 15e3]
CG = {"cg_x": 0.4, "cg_y": -0.1, "cg_z": 0.2, "thrust_arm": 0.5, "thrust_angle": 0.05}
OFF_CENTRE = replace(AIRLINER, constants={**CONSTANTS, **CG})
BODY_COEFFICIENTS = {"CX": 0.03, "CZ": -0.7}


def system_of(aircraft: Aircraft) -> System:
    return compile_model(aircraft_model(aircraft))


def rotation(phi: float, theta: float, psi: float) -> np.ndarray:
    """From the Earth's axes to the body's: yaw, then pitch, then roll."""
    c, s = np.cos, np.sin
    roll = np.array([[1, 0, 0], [0, c(phi), s(phi)], [0, -s(phi), c(phi)]])
    pitch = np.array([[c(theta), 0, -s(theta)], [0, 1, 0], [s(theta), 0, c(theta)]])
    yaw = np.array([[c(psi), s(psi), 0], [-s(psi), c(psi), 0], [0, 0, 1]])
    return roll @ pitch @ yaw


def oracle(aircraft: Aircraft, x: list[float], u: list[float]) -> dict[str, np.ndarray]:
    """Accelerations in body axes, linear (with and without weight) and angular."""
    k = aircraft.constants
    V, alpha, beta, p, q, r, phi, theta = x
    elevator, aileron, rudder, thrust = u
    half = 1.0 / (2.0 * V)
    signals = {
        "1": 1.0,
        "alpha": alpha,
        "alpha^2": alpha**2,
        "beta": beta,
        "p": p * k["span"] * half,
        "q": q * k["chord"] * half,
        "r": r * k["span"] * half,
        "elevator": elevator,
        "aileron": aileron,
        "rudder": rudder,
    }
    C = {a: sum(v * signals[t] for t, v in terms.items()) for a, terms in COEFFICIENTS.items()}
    qS = 0.5 * k["air_density"] * V**2 * k["wing_area"]
    turn = np.array(
        [[np.cos(alpha), 0, -np.sin(alpha)], [0, 1, 0], [np.sin(alpha), 0, np.cos(alpha)]]
    )
    air = qS * turn @ np.array([-C["CD"], C["CY"], -C["CL"]])
    pull = thrust * np.array([np.cos(k["thrust_angle"]), 0.0, -np.sin(k["thrust_angle"])])
    cg = np.array([k["cg_x"], k["cg_y"], k["cg_z"]])
    lengths = np.array([k["span"], k["chord"], k["span"]])
    moment = qS * lengths * np.array([C["Cl"], C["Cm"], C["Cn"]]) - np.cross(cg, air)
    moment[1] += thrust * k["thrust_arm"]
    inertia = np.diag([k["roll_inertia"], k["pitch_inertia"], k["yaw_inertia"]])
    inertia[0, 2] = inertia[2, 0] = -k["cross_inertia"]
    omega = np.array([p, q, r])
    velocity = V * np.array(
        [np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)]
    )
    felt = (air + pull) / k["mass"]
    weight = rotation(phi, theta, 0.0) @ np.array([0.0, 0.0, G0])
    return {
        "felt": felt,
        "linear": felt + weight - np.cross(omega, velocity),
        "angular": np.linalg.solve(inertia, moment - np.cross(omega, inertia @ omega)),
        "velocity": velocity,
        "omega": omega,
    }


@pytest.mark.sampled
@pytest.mark.parametrize("aircraft", [AIRLINER, OFF_CENTRE], ids=["plain", "off centre"])
def test_rates_are_newtons_and_eulers(aircraft: Aircraft) -> None:
    system = system_of(aircraft)
    p = system.parameters.values().tolist()
    rates = dict(zip(system.state_names, system.f(0.0, X, U, p), strict=True))
    true = oracle(aircraft, X, U)
    assert [rates[name] for name in "pqr"] == pytest.approx(true["angular"].tolist(), rel=1e-12)
    # The velocity's rate by differences of the state's.
    step = 1e-6
    ends = []
    for sign in (1.0, -1.0):
        V, a, b = (
            X[i] + sign * step * rates[n] for i, n in enumerate(("airspeed", "alpha", "beta"))
        )
        ends.append(V * np.array([np.cos(a) * np.cos(b), np.sin(b), np.sin(a) * np.cos(b)]))
    assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(true["linear"], rel=1e-6)
    # Attitude: the matrix turns at -omega x.
    Q, R, phi, theta = X[4:]
    psi_dot = (Q * np.sin(phi) + R * np.cos(phi)) / np.cos(theta)
    turned = [
        rotation(phi + s * rates["phi"], theta + s * rates["theta"], s * psi_dot)
        for s in (step, -step)
    ]
    skew = np.cross(true["omega"], np.eye(3)).T
    expected = -skew @ rotation(phi, theta, 0.0)
    assert (turned[0] - turned[1]) / (2 * step) == pytest.approx(expected, abs=1e-6)


def test_sensors_read_where_they_are() -> None:
    system = system_of(OFF_CENTRE)
    p = system.parameters.values().tolist()
    read = dict(zip(system.output_names, system.h(0.0, X, U, p), strict=True))
    true = oracle(OFF_CENTRE, X, U)
    at = {name: np.array(place) for name, place in AIRLINER.sensors.items()}
    u, v, w = true["velocity"] + np.cross(true["omega"], at["alpha"])
    assert read["alpha"] == pytest.approx(np.arctan2(w, u), rel=1e-12)
    u, v, w = true["velocity"] + np.cross(true["omega"], at["beta"])
    assert read["beta"] == pytest.approx(np.arcsin(v / np.sqrt(u * u + v * v + w * w)), rel=1e-12)
    arm, omega = at["accelerometer"], true["omega"]
    felt = true["felt"] + np.cross(true["angular"], arm) + np.cross(omega, np.cross(omega, arm))
    assert [read[name] for name in ("ax", "ay", "az")] == pytest.approx(felt.tolist(), rel=1e-12)


def test_a_place_that_is_estimated_reads_as_one_that_is_declared() -> None:
    places = {"accelerometer": (1.0, -0.5, 0.3), "beta": (8.0, 0.0, -0.2)}
    free = ("beta_x", "accelerometer_y", "accelerometer_z")
    aircraft = replace(AIRLINER, sensors={"accelerometer": (1.0, 0.0, 0.0)}, estimated=free)
    values = {"beta_x": 8.0, "accelerometer_y": -0.5, "accelerometer_z": 0.3}
    declared = replace(AIRLINER, sensors={**places, "beta": (8.0, 0.0, 0.0)})
    moved = aircraft.with_values(values)
    assert moved.sensors == declared.sensors
    assert moved.positions == {name: (values[name], "m") for name in free}
    flights = []
    for each in (aircraft_model(aircraft).with_values(values), aircraft_model(declared)):
        flights.append(fly_model(each, airliner_flight(2.0)))
    assert np.array_equal(flights[0], flights[1])
    kept = declaration_of(aircraft_model(aircraft).with_values(values))
    assert kept is not None
    assert kept.sensors == declared.sensors


def test_level_flight_stays_level() -> None:
    system = system_of(AIRLINER)
    x = [130.0, ALPHA, 0.0, 0.0, 0.0, 0.0, 0.0, ALPHA]
    rates = system.f(0.0, x, [ELEVATOR, 0.0, 0.0, THRUST], system.parameters.values().tolist())
    assert np.abs(rates) == pytest.approx(np.zeros(8), abs=1e-5)


def test_wind_is_taken_off_the_velocity() -> None:
    windy = replace(AIRLINER, wind="earth", further=("psi",), sensors={})
    system = system_of(windy)
    p = system.parameters.values().tolist()
    psi, wind = 0.7, np.array([8.0, -5.0, 2.0])
    inputs = dict(zip(system.input_names, [0.0] * len(system.inputs), strict=True))
    inputs |= dict(zip(("wind_north", "wind_east", "wind_down"), wind, strict=True))
    read = dict(
        zip(system.output_names, system.h(0.0, [*X, psi], [*inputs.values()], p), strict=True)
    )
    body = oracle(AIRLINER, X, U)["velocity"] - rotation(X[6], X[7], psi) @ wind
    assert read["airspeed"] == pytest.approx(float(np.linalg.norm(body)), rel=1e-12)
    assert read["alpha"] == pytest.approx(np.arctan2(body[2], body[0]), rel=1e-12)


def flown(aircraft: Aircraft, wind: np.ndarray, start: dict[str, float]) -> dict[str, np.ndarray]:
    """Outputs of four seconds with moving surfaces in a wind of shape ``(3, N)``."""
    flight = airliner_flight()
    at_start = replace(aircraft, start={**aircraft.start, **start})
    model = aircraft_model(at_start)
    u = np.vstack([flight.u, wind]) if aircraft.wind else flight.u
    rows = fly_model(model, replace(flight, u=u))
    return dict(zip((each.name for each in model.equations.outputs), rows, strict=True))


def test_a_steady_wind_carries_the_aircraft_along() -> None:
    """Galileo: against the air, motion and forces are those of still air."""
    still = flown(replace(AIRLINER, further=("psi",)), np.empty(0), {})
    blowing, samples = np.array([8.0, -5.0, 2.0]), len(still["q"])
    ground = 130.0 * np.array([np.cos(ALPHA), 0.0, np.sin(ALPHA)])
    ground = ground + rotation(0.0, ALPHA, 0.0) @ blowing
    V = float(np.linalg.norm(ground))
    start = {
        "airspeed": V,
        "alpha": float(np.arctan2(ground[2], ground[0])),
        "beta": float(np.arcsin(ground[1] / V)),
    }
    wind = np.repeat(blowing[:, None], samples, axis=1)
    carried = flown(replace(AIRLINER, further=("psi",), wind="earth"), wind, start)
    for name, row in still.items():
        assert carried[name] == pytest.approx(row, abs=1e-4 * float(np.ptp(row))), name


def test_wind_in_body_axes_is_that_of_the_earth_turned() -> None:
    psi, wind = 0.7, np.array([8.0, -5.0, 2.0])
    found = []
    for axes, parts in (("earth", wind), ("body", rotation(X[6], X[7], psi) @ wind)):
        system = system_of(replace(AIRLINER, wind=axes, further=("psi",)))
        p = system.parameters.values().tolist()
        at = ([*X, psi], [*U, *parts], p)
        found.append([*system.f(0.0, *at), *system.h(0.0, *at)])
    assert found[1] == pytest.approx(found[0], rel=1e-12)
    assert "psi" not in system_of(replace(AIRLINER, wind="body")).state_names


def test_a_wind_in_unknown_axes_is_refused() -> None:
    with pytest.raises(DeclarationError, match="no axes of a wind"):
        aircraft_model(replace(AIRLINER, wind="wing"))
    with pytest.raises(DeclarationError, match="the heading is no state"):
        aircraft_model(replace(AIRLINER, wind="earth"))


@pytest.mark.parametrize("place", [(6.0, 0.0, 0.0), (0.0, 2.0, 0.0), (3.0, -2.0, 1.0)])
def test_vanes_away_from_the_centre_turn_with_the_aircraft(place: tuple) -> None:
    """The corrections of first order in rates and sideslip, at small alpha and beta."""
    V, alpha, beta, p, q, r = 130.0, 0.002, 0.001, 0.02, -0.03, 0.01
    system = system_of(replace(AIRLINER, sensors=dict.fromkeys(("alpha", "beta"), place)))
    values = system.parameters.values().tolist()
    row = system.h(0.0, [V, alpha, beta, p, q, r, 0.0, 0.0], U, values)
    read = dict(zip(system.output_names, row, strict=True))
    x, y, z = place
    assert read["alpha"] - alpha == pytest.approx((-x * q + y * p) / V, abs=5e-6)
    assert read["beta"] - beta == pytest.approx((x * r - z * p) / V, abs=5e-6)


LONGITUDINAL = ("airspeed", "alpha", "q", "theta")


@pytest.mark.parametrize("recorded", [LONGITUDINAL, ("beta", "p", "r", "phi"), ("alpha", "beta")])
def test_states_that_are_recorded_are_inputs_of_the_same_equations(recorded: tuple) -> None:
    whole, part = system_of(AIRLINER), system_of(replace(AIRLINER, recorded=recorded))
    p = whole.parameters.values().tolist()
    state = dict(zip(whole.state_names, X, strict=True))
    read = dict(zip(whole.output_names, whole.h(0.0, X, U, p), strict=True))
    given = {**state, **dict(zip(whole.input_names, U, strict=True))}
    # Vanes read the motion of their place; what is recorded is their reading.
    given |= {name: read[name] for name in recorded if name in ("alpha", "beta")}
    x, u = [given[n] for n in part.state_names], [given[n] for n in part.input_names]
    assert not set(recorded) & {*part.state_names, *part.output_names}
    rates = dict(zip(whole.state_names, whole.f(0.0, X, U, p), strict=True))
    found = dict(zip(part.state_names, part.f(0.0, x, u, p), strict=True))
    found |= dict(zip(part.output_names, part.h(0.0, x, u, p), strict=True))
    for name, value in found.items():
        expected = read[name] if name in part.output_names and name in read else rates[name]
        # The vane is brought to the centre of gravity to first order in rate times arm over speed.
        assert value == pytest.approx(expected, rel=3e-3, abs=1e-4), name


def test_recorded_longitudinal_motion_needs_no_lift() -> None:
    """Lateral motion with wrong lift, drag and pitching moment is that of the true aircraft."""
    bare = replace(AIRLINER, sensors={})
    flight = replace(airliner_flight(), hold=Hold.LINEAR)
    true = aircraft_model(bare)
    names = [each.name for each in true.equations.outputs]
    rows = dict(zip(names, fly_model(true, flight), strict=True))
    wrong = {
        axis: {t: 0.8 * v for t, v in bare.coefficients[axis].items()} for axis in ("CL", "Cm")
    }
    part = replace(
        bare,
        coefficients={**bare.coefficients, **wrong},
        recorded=("airspeed", "alpha", "q", "theta"),
    )
    model = aircraft_model(part)
    u = np.vstack([flight.u, *(rows[name] for name in part.recorded)])
    found = fly_model(model, replace(flight, u=u))
    read = dict(zip((each.name for each in model.equations.outputs), found, strict=True))
    plain = fly_model(aircraft_model(replace(part, recorded=())), flight)
    off = dict(zip(names, plain, strict=True))
    for name in ("beta", "p", "r", "phi"):
        size = float(np.ptp(rows[name]))
        assert np.max(np.abs(read[name] - rows[name])) < 2e-3 * size, name
    worst = max(np.max(np.abs(off[n] - rows[n])) / np.ptp(rows[n]) for n in ("q", "alpha"))
    assert worst > 0.1


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"recorded": tuple(STATES)}, "nothing is left to simulate"),
        ({"recorded": ("alpha",), "wind": "body"}, "recorded against the air"),
        ({"recorded": ("theta",), "attitude": QUATERNION}, "a quaternion integrates both"),
        ({"attitude": "matrix"}, "no way to integrate"),
    ],
)
def test_recorded_states_that_make_no_sense_are_refused(changed: dict, told: str) -> None:
    with pytest.raises(DeclarationError, match=told):
        aircraft_model(replace(AIRLINER, **changed))


TURNED = replace(AIRLINER, attitude=QUATERNION, further=("psi", "altitude"), start={"psi": 2.8})


@settings(deadline=None, max_examples=60)
@given(
    phi=st.floats(-3.1, 3.1),
    theta=st.floats(-1.5, 1.5),
    psi=st.floats(-3.1, 3.1),
    length=st.floats(0.3, 3.0),
)
def test_a_quaternion_turns_as_the_matrix_does(
    phi: float, theta: float, psi: float, length: float
) -> None:
    attitude = ATTITUDES[QUATERNION]
    state = dict(attitude.at_start(phi, theta, psi))
    for name in ("e0", "e1", "e2", "e3"):  # of any length
        state[name] *= length
    s = SimpleNamespace(**state, p=0.3, q=-0.2, r=0.5)
    matrix = rotation(phi, theta, psi)
    assert np.array(attitude.motion(s)[0]) == pytest.approx(matrix @ [0.0, 0.0, 1.0], abs=1e-9)
    vector = [3.0, -2.0, 0.7]
    assert np.array(attitude.to_body(s, *vector)) == pytest.approx(matrix @ vector, abs=1e-7)
    angles = attitude.angles(s, True)
    assert rotation(*(angles[n] for n in ("phi", "theta", "psi"))) == pytest.approx(
        matrix, abs=1e-7
    )
    # The matrix turns at -omega x, by differences of the quaternion.
    step, rates = 1e-6, attitude.motion(s)[1]
    ends = []
    for sign in (step, -step):
        moved = SimpleNamespace(**{n: v + sign * rates[n] for n, v in state.items()})
        ends.append(np.array(attitude.to_body(moved, *vector)))
    turned = -np.cross([0.3, -0.2, 0.5], matrix @ vector)
    assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(turned, abs=1e-6)


def test_a_quaternion_flies_as_euler_angles_do() -> None:
    """Through turns of all axes, to the error of the integration."""
    start = {"phi": 0.5, "theta": 0.2, "psi": 2.8}
    euler = flown(replace(TURNED, attitude="euler"), np.empty(0), {**AIRLINER.start, **start})
    other = flown(TURNED, np.empty(0), {**AIRLINER.start, **start})
    assert list(euler) == list(other)
    for name, row in euler.items():
        assert other[name] == pytest.approx(row, abs=1e-6 * max(float(np.ptp(row)), 1e-3)), name


def test_a_loop_through_the_vertical_is_integrated() -> None:
    """Energy is kept without thrust and drag, and the nose comes round where it was."""
    free = {axis: dict.fromkeys(terms, 0.0) for axis, terms in AIRLINER.coefficients.items()}
    turning = replace(
        TURNED,
        coefficients=free,
        start={"airspeed": 200.0, "alpha": 0.0, "theta": 0.0, "psi": 2.8, "q": 0.4},
        sensors={},
    )
    system = system_of(turning)
    x, p = system.initial.values().tolist(), system.parameters.values().tolist()
    dt, count = 0.01, round(2.0 * np.pi / 0.4 / 0.01)
    read = []
    for _ in range(count + 1):
        read.append(dict(zip(system.output_names, system.h(0.0, x, [0.0] * 4, p), strict=True)))
        u = [[0.0] * 4] * 3
        x = rk4_step(system.f, 0.0, x, (u[0], u[1], u[2]), p, dt)
    theta = np.array([each["theta"] for each in read])
    assert np.max(theta) > 1.5 and np.min(theta) < -1.5
    energy = [0.5 * each["airspeed"] ** 2 + G0 * each["altitude"] for each in read]
    assert np.ptp(energy) < 1e-6 * energy[0]
    assert theta[-1] == pytest.approx(0.4 * count * dt - 2.0 * np.pi, abs=1e-6)
    assert abs(read[-1]["psi"]) == pytest.approx(2.8, abs=1e-6)
    top = read[count // 2]
    assert abs(top["phi"]) == pytest.approx(np.pi, abs=1e-6)


@pytest.mark.long
def test_a_throttle_a_mass_column_and_mixed_surfaces() -> None:
    aircraft = replace(
        AIRLINER,
        surfaces={"left": "rad", "right": "rad", "rudder": "rad"},
        mixes={
            "elevator": {"left": 0.5, "right": 0.5},
            "aileron": {"left": 0.5, "right": -0.5},
        },
        thrust=Thrust("throttle", ((0.0, 0.5, 1.0), (0.0, 8e3, 20e3))),
        varying=("mass",),
    )
    system, plain = system_of(aircraft), system_of(AIRLINER)
    given = {"left": 0.02, "right": 0.08, "rudder": 0.03, "throttle": 0.75, "mass": 17600.0}
    values = [given[name] for name in system.input_names]
    p, q = (each.parameters.values().tolist() for each in (system, plain))
    same = plain.f(0.0, X, [0.05, -0.03, 0.03, 14e3], q)
    assert system.f(0.0, X, values, p) == pytest.approx(same, rel=1e-12)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"constants": {**CONSTANTS, "yaw_inertia": 900e3}}, "which no body has"),
        ({"constants": {**CONSTANTS, "cross_inertia": 3e5}}, "too large"),
        ({"constants": {**CONSTANTS, "mass": 0.0}}, "mass = 0 is not positive"),
        ({"coefficients": {**AIRLINER.coefficients, "CX": {}}}, None),
        ({"coefficients": {**AIRLINER.coefficients, "Cm": {}}}, "Cm has no term"),
    ],
)
def test_what_no_aircraft_has_is_refused(changed: dict, told: str | None) -> None:
    aircraft = replace(AIRLINER, **changed)
    if told is None:
        told = "body axes and in wind axes"
    with pytest.raises(DeclarationError, match=told):
        aircraft_model(aircraft)
