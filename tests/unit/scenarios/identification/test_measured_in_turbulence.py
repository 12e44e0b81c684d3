"""Filter error where output error goes wrong: no measurement noise, an unstable aircraft, a
measured record in turbulence.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import flightid
from ident.estimate import Outcome
from sim.declaration import own_model
from sim.declaration.model import Model
from sim.maths import cos, sin

SHARED = Path(__file__).parents[5] / "shared" / "flightdata" / "aircraft"
LATERAL = {
    "L_p": -5.8,
    "L_r": 1.8,
    "L_da": -16.4,
    "L_dr": 0.44,
    "L_v": -0.097,
    "N_p": -0.66,
    "N_r": -0.71,
    "N_da": -0.43,
}
LATERAL |= {"N_dr": -2.8, "N_v": 0.0085}
SIDE = {"Y_p": -0.28, "Y_r": 1.4, "Y_da": -0.45, "Y_dr": 2.66, "Y_v": -0.18}
LEVELS = ("L_0", "N_0", "Y_0")
UNSTABLE = {
    "Z_w": -1.4249,
    "Z_q": -1.4768,
    "Z_de": -6.2632,
    "M_w": 0.2163,
    "M_q": -3.7067,
    "M_de": -12.784,
}
PUBLISHED = {
    "CD_V": -0.0645,
    "CD_alpha": 0.320,
    "CL_V": 0.1487,
    "CL_alpha": 4.328,
    "Cm_alpha": -0.968,
    "Cm_q": -34.7,
    "Cm_de": -1.529,
}


def lateral(values: dict[str, float]) -> Model:
    """Roll and yaw with the lateral velocity as an input; rates, accelerations and side force are
    measured.
    """

    def flow(s, p):
        moved = {}
        for letter in "LNY":
            terms = [getattr(p, f"{letter}_{end}") for end in ("0", "p", "r", "da", "dr", "v")]
            moved[letter] = (
                terms[0]
                + terms[1] * s.p
                + terms[2] * s.r
                + terms[3] * s.aileron
                + terms[4] * s.rudder
                + terms[5] * s.v
            )
        return {"roll": moved["L"], "yaw": moved["N"], "side": moved["Y"]}

    return own_model(
        name="lateral forces",
        states={"p": "rad/s", "r": "rad/s"},
        inputs={"aileron": "rad", "rudder": "rad", "v": "m/s"},
        outputs={"p_dot": "rad/s2", "r_dot": "rad/s2", "ay": "m/s2", "p": "rad/s", "r": "rad/s"},
        parameters={name: (value, "1") for name, value in values.items()},
        flow=flow,
        rates=lambda s, p: {"p": s.roll, "r": s.yaw},
        readings=lambda s, p: {"p_dot": s.roll, "r_dot": s.yaw, "ay": s.side, "p": s.p, "r": s.r},
        biases=(),
    )


def short_period(values: dict[str, float]) -> Model:
    """The short period in vertical velocity and pitch rate."""
    return own_model(
        name="short period in w",
        states={"w": "m/s", "q": "rad/s"},
        inputs={"elevator": "rad"},
        outputs={"az": "m/s2", "w": "m/s", "q": "rad/s"},
        constants={"u0": (44.57, "m/s")},
        parameters={name: (value, "1") for name, value in values.items()},
        flow=lambda s, p: {"z": p.Z_w * s.w + p.Z_q * s.q + p.Z_de * s.elevator},
        rates=lambda s, p: {
            "w": s.z + p.u0 * s.q,
            "q": p.M_w * s.w + p.M_q * s.q + p.M_de * s.elevator,
        },
        readings=lambda s, p: {"az": s.z, "w": s.w, "q": s.q},
        biases=(),
    )


def longitudinal() -> Model:
    """HFB-320 in lift, drag and pitching moment about its axes, all forces total."""
    g, area, mass, inertia, chord, density, speed, tilt = (
        9.80665,
        30.1,
        7472.0,
        91420.0,
        2.43,
        0.792,
        104.67,
        0.0524,
    )

    def flow(s, p):
        force, v = 0.5 * density * s.airspeed * s.airspeed * area, s.airspeed / speed
        moment = (
            p.Cm_0
            + p.Cm_V * v
            + p.Cm_alpha * s.alpha
            + p.Cm_q * s.q * chord / (2 * speed)
            + p.Cm_de * s.elevator
        )
        drag, lift = (
            getattr(p, f"{c}_0") + getattr(p, f"{c}_V") * v + getattr(p, f"{c}_alpha") * s.alpha
            for c in ("CD", "CL")
        )
        return {
            "drag": force * drag / mass,
            "lift": force * lift / mass,
            "pitch": force * chord * moment / inertia,
            "push": s.thrust / mass,
        }

    starts = {
        "CD_0": 0.12,
        "CD_V": -0.06,
        "CD_alpha": 0.3,
        "CL_0": -0.1,
        "CL_V": 0.1,
        "CL_alpha": 4.0,
    }
    starts |= {"Cm_0": 0.1, "Cm_V": 0.0, "Cm_alpha": -1.0, "Cm_q": -25.0, "Cm_de": -1.5}
    return own_model(
        name="totals",
        states={"airspeed": "m/s", "alpha": "rad", "theta": "rad", "q": "rad/s"},
        inputs={"elevator": "rad", "thrust": "N"},
        outputs={
            "airspeed": "m/s",
            "alpha": "rad",
            "theta": "rad",
            "q": "rad/s",
            "q_dot": "rad/s2",
            "ax": "m/s2",
            "az": "m/s2",
        },
        parameters={name: (value, "1") for name, value in starts.items()},
        flow=flow,
        rates=lambda s, p: {
            "airspeed": -s.drag + s.push * cos(s.alpha + tilt) + g * sin(s.alpha - s.theta),
            "alpha": s.q
            + (-s.lift - s.push * sin(s.alpha + tilt) + g * cos(s.alpha - s.theta)) / s.airspeed,
            "theta": s.q,
            "q": s.pitch,
        },
        readings=lambda s, p: {
            **{name: getattr(s, name) for name in ("airspeed", "alpha", "theta", "q")},
            "q_dot": s.pitch,
            "ax": s.lift * sin(s.alpha) - s.drag * cos(s.alpha) + s.push * cos(tilt),
            "az": -s.lift * cos(s.alpha) - s.drag * sin(s.alpha) - s.push * sin(tilt),
        },
        initial={"airspeed": 106.0, "alpha": 0.11, "theta": 0.105, "thrust": 11548.0},
        biases=(),
    )


def shaken_laterally(seed: int) -> pd.DataFrame:
    """Twin of the simulated lateral record: white noise on both accelerations, sensors without any,
    seven decimals written.
    """
    rng, dt, fine = np.random.default_rng(seed), 0.05, 20
    time = np.arange(321) * dt
    u = np.stack(
        [
            0.05 * np.sign(np.sin(1.3 * time)) * (time < 8),
            0.1 * np.sign(np.sin(0.9 * time)),
            2.0 * np.sin(1.1 * time),
        ]
    )
    A = np.array(
        [[LATERAL[f"{row}_{name}"] for name in ("p", "r", "da", "dr", "v")] for row in "LN"]
    )
    side, x, rows = np.array(list(SIDE.values())), np.zeros(2), []
    for k in range(len(time)):
        both = np.concatenate([x, u[:, k]])
        rows.append([*(A @ both), side @ both, *x])
        for _ in range(fine):
            x = (
                x
                + dt / fine * (A @ np.concatenate([x, u[:, k]]))
                + np.sqrt(dt / fine) * np.array([0.2, 0.1]) * rng.standard_normal(2)
            )
    columns = dict(
        zip(("p_dot", "r_dot", "ay", "p", "r"), np.round(np.array(rows).T, 7), strict=True)
    )
    return pd.DataFrame({"time": time, "aileron": u[0], "rudder": u[1], "v": u[2], **columns})


def unstable_in_a_loop(seed: int) -> pd.DataFrame:
    """Twin of the simulated unstable record: a loop holds the aircraft, a faint forcing, sensors
    without noise, six decimals written.
    """
    rng, dt, fine, x, e, rows = np.random.default_rng(seed), 0.05, 50, np.zeros(2), 0.0, []
    A = np.array([[UNSTABLE["Z_w"], 44.57 + UNSTABLE["Z_q"]], [UNSTABLE["M_w"], UNSTABLE["M_q"]]])
    B, z = (
        np.array([UNSTABLE["Z_de"], UNSTABLE["M_de"]]),
        np.array([UNSTABLE["Z_w"], UNSTABLE["Z_q"]]),
    )
    h = dt / fine
    for k in range(251):
        t = k * dt
        rows.append([t, e, z @ x + UNSTABLE["Z_de"] * e, *x])
        after = 0.06 * np.sin(1.1 * t) + 0.04 * np.sin(0.4 * t * t) + 0.03 * x[0] + 0.5 * x[1]
        for step in range(fine):
            middle = x + 0.5 * h * (A @ x + B * (e + (after - e) * step / fine))
            x = (
                x
                + h * (A @ middle + B * (e + (after - e) * (step + 0.5) / fine))
                + np.sqrt(h) * np.array([1e-3, 5e-4]) * rng.standard_normal(2)
            )
        e = after
    return pd.DataFrame(np.round(rows, 6), columns=["time", "elevator", "az", "w", "q"])


def rolling(outputs: dict[str, float], idle: bool = False) -> Model:
    """Roll alone; each output is the roll rate times a factor. ``idle``: with a parameter that acts
    nowhere.
    """
    values = {
        "L_p": (-1.5, "1/s"),
        "L_da": (6.0, "1/s2"),
        **({"L_idle": (1.0, "1/s2")} if idle else {}),
    }
    return own_model(
        name="roll",
        states={"p": "rad/s"},
        inputs={"aileron": "rad"},
        outputs=dict.fromkeys(outputs, "rad/s"),
        parameters=values,
        rates=lambda s, p: {
            "p": p.L_p * s.p + p.L_da * s.aileron + (0.0 * p.L_idle if idle else 0.0)
        },
        readings=lambda s, p: {name: factor * s.p for name, factor in outputs.items()},
        biases=(),
    )


def rolled(noise: float, forcing: float) -> pd.DataFrame:
    """A roll with white noise on its acceleration, and its rate by one sensor that is written into
    two columns.
    """
    rng, dt, fine, p, rows = np.random.default_rng(2), 0.02, 10, 0.0, []
    for k in range(500):
        aileron = 0.1 * np.sign(np.sin(1.7 * k * dt))
        measured = p + noise * rng.standard_normal()
        rows.append([k * dt, aileron, measured, 2.0 * measured])
        for _ in range(fine):
            p += (
                dt / fine * (-2.0 * p + 8.0 * aileron)
                + np.sqrt(dt / fine) * forcing * rng.standard_normal()
            )
    return pd.DataFrame(rows, columns=["time", "aileron", "p", "p_copy"])


def off(found: flightid.Identification, truth: dict[str, float]) -> dict[str, float]:
    """By how many of its sigmas each value is off."""
    return {name: (found[name].value - value) / found[name].sigma for name, value in truth.items()}


def begun(truth: dict[str, float], factor: float = 0.7) -> dict[str, float]:
    return {name: factor * value for name, value in truth.items()}


def outcome(found: flightid.Identification) -> Outcome:
    result: Outcome = found.details.found.estimate.outcome
    return result


def said_unstable(found: flightid.Identification) -> bool:
    """Whether a caution says that the model is unstable and names the method for it."""
    return any(
        "the model is unstable at the estimate" in text and "--method filter-error" in text
        for text in found.warnings
    )


def settled(found: flightid.Identification) -> bool:
    return outcome(found) is Outcome.CONVERGED


@pytest.mark.long
def test_process_noise_without_measurement_noise_is_no_degenerate_fit() -> None:
    truth = {**LATERAL, **SIDE}
    start = {**begun(truth), **dict.fromkeys(LEVELS, 0.0)}
    found = flightid.identify(
        shaken_laterally(1), lateral(start), method="filter-error", hold="previous"
    )
    assert settled(found)
    # The accelerations are measured without noise: each derivative is known to a thousandth and
    # better.
    assert all(found[name].value == pytest.approx(value, rel=2e-3) for name, value in truth.items())
    assert np.max(np.abs(list(off(found, truth).values()))) < 4.0


@pytest.mark.long
def test_an_unstable_aircraft_whose_sensors_have_no_noise() -> None:
    record, model = unstable_in_a_loop(4), short_period(begun(UNSTABLE))
    plain = flightid.identify(record, model, hold="linear")
    assert any("--method filter-error" in note for note in plain.details.found.notes)
    assert said_unstable(plain), "a faint forcing that the loop answers is not in its sigmas"
    found = flightid.identify(record, model, method="filter-error", hold="linear")
    assert settled(found) and not said_unstable(found)
    for name in ("Z_w", "Z_q", "Z_de"):
        assert found[name].value == pytest.approx(UNSTABLE[name], rel=1e-4), name
    moments = {name: UNSTABLE[name] for name in ("M_w", "M_q", "M_de")}
    assert np.max(np.abs(list(off(found, moments).values()))) < 4.0


@pytest.mark.sampled
@pytest.mark.parametrize("noise", [0.02, 0.0])
def test_a_channel_recorded_twice_is_degenerate(noise: float) -> None:
    """A filter that follows one column meets both: two outputs met exactly say no more of the
    derivatives than one.
    """
    both = flightid.identify(
        rolled(noise, 0.05),
        rolling({"p": 1.0, "p_copy": 2.0}),
        method="filter-error",
        hold="previous",
    )
    assert outcome(both) is Outcome.DEGENERATE
    assert any(
        "values and sigmas mean nothing" in caution for caution in both.details.found.cautions
    )


def test_process_noise_that_takes_all_of_an_output_is_degenerate() -> None:
    swallowed = flightid.identify(
        rolled(0.0, 0.05), rolling({"p": 1.0}), method="filter-error", hold="previous"
    )
    assert outcome(swallowed) is Outcome.DEGENERATE
    sound = flightid.identify(
        rolled(0.02, 0.05), rolling({"p": 1.0}), method="filter-error", hold="previous"
    )
    assert (
        settled(sound)
        and np.max(np.abs(list(off(sound, {"L_p": -2.0, "L_da": 8.0}).values()))) < 3.0
    )


def test_a_parameter_that_acts_nowhere_is_not_identifiable_with_a_filter() -> None:
    found = flightid.identify(
        rolled(0.02, 0.05), rolling({"p": 1.0}, idle=True), method="filter-error", hold="previous"
    )
    assert outcome(found) is Outcome.NOT_IDENTIFIABLE


def measured(name: str, columns: dict[str, int]) -> pd.DataFrame:
    path = SHARED / name
    if not path.exists():
        pytest.skip(f"the measured record {name} is not here")
    table = np.loadtxt(path)
    frame = pd.DataFrame({"time": table[:, 0] - table[0, 0]})
    return frame.assign(**{channel: table[:, column - 1] for channel, column in columns.items()})


@pytest.mark.long
def test_the_simulated_lateral_record_with_process_noise() -> None:
    columns = {
        "aileron": 17,
        "rudder": 18,
        "v": 19,
        "p_dot": 12,
        "r_dot": 13,
        "ay": 14,
        "p": 15,
        "r": 16,
    }
    start = {**begun({**LATERAL, **SIDE}), **dict.fromkeys(LEVELS, 0.0)}
    found = flightid.identify(
        measured("y13aus_da1.asc", columns), lateral(start), method="filter-error", hold="previous"
    )
    assert settled(found)
    # The same flight without process noise stands in the file's first columns.
    calm = dict(zip(columns, (7, 8, 9, 2, 3, 4, 5, 6), strict=True))
    plain = flightid.identify(
        measured("y13aus_da1.asc", calm), lateral(start), method="equation-error", hold="previous"
    )
    assert found["L_p"].value == pytest.approx(-5.82, abs=0.002)
    for name in LATERAL:
        assert abs(found[name].value - plain[name].value) < 4.0 * np.hypot(
            plain[name].sigma, found[name].sigma
        ), name


@pytest.mark.long
def test_the_simulated_unstable_record() -> None:
    """Its elevator was held at the mean of two samples, neither at the first nor on a line: a free
    simulation doubles that error every second.
    """
    record = measured("unStabAC_sim.asc", {"elevator": 5, "w": 3, "q": 4, "az": 6})
    plain = flightid.identify(record, short_period(begun(UNSTABLE)))
    assert np.max(np.abs(list(off(plain, UNSTABLE).values()))) > 100.0 and said_unstable(plain)
    found = flightid.identify(record, short_period(begun(UNSTABLE)), method="filter-error")
    assert settled(found)
    assert np.max(np.abs(list(off(found, UNSTABLE).values()))) < 3.0


@pytest.mark.slow
def test_hfb_320_in_turbulence() -> None:
    columns = {
        "elevator": 2,
        "thrust": 4,
        "airspeed": 5,
        "alpha": 6,
        "theta": 7,
        "q": 8,
        "q_dot": 9,
        "ax": 10,
        "az": 11,
    }
    record = measured("hfb320_1_10.asc", columns)
    plain = flightid.identify(record, longitudinal(), hold="linear")
    assert any("--method filter-error" in note for note in plain.details.found.notes)
    found = flightid.identify(record, longitudinal(), method="filter-error", hold="linear")
    assert settled(found)
    for name in ("CD_V", "CD_alpha", "CL_V", "CL_alpha", "Cm_alpha"):
        assert abs(found[name].value - PUBLISHED[name]) < 3.0 * found[name].sigma, name


@pytest.mark.slow
def test_hfb_320_by_the_longitudinal_model() -> None:
    columns = {
        "elevator": 2,
        "thrust": 4,
        "airspeed": 5,
        "alpha": 6,
        "theta": 7,
        "q": 8,
        "ax": 10,
        "az": 11,
    }
    record = measured("hfb320_1_10.asc", columns)
    record["nx"], record["nz"] = record.pop("ax") / 9.80665, -record.pop("az") / 9.80665
    constants = {
        "mass": 7472.0,
        "wing_area": 30.1,
        "chord": 2.43,
        "pitch_inertia": 91420.0,
        "air_density": 0.792,
    }
    starts = {
        "CD_0": 0.12,
        "CD_V": -0.06,
        "CD_alpha": 0.3,
        "CL_0": -0.1,
        "CL_V": 0.1,
        "CL_alpha": 4.0,
    }
    starts |= {"Cm_0": 0.1, "Cm_V": 0.0, "Cm_alpha": -1.0, "Cm_q": -25.0, "Cm_de": -1.5}
    vehicle = {
        "name": "HFB-320",
        **constants,
        "reference_airspeed": 104.67,
        "thrust_arm": 0.0,
        "derivatives": starts,
    }
    found = flightid.identify(
        record,
        "longitudinal",
        {**vehicle, "fixed": {"CL_q": 0.0, "CL_de": 0.0}},
        method="filter-error",
        hold="linear",
    )
    assert settled(found)
    assert any("white noise on airspeed, alpha, q" in note for note in found.details.found.notes)
    for name, value in PUBLISHED.items():
        assert abs(found[name].value - value) < 3.0 * found[name].sigma, name
