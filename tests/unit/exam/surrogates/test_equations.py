"""The pieces that a surrogate flight flies with, against independent mathematics: kinematics, a
filter, a table, pseudo-true values.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal
from scipy.integrate import quad

from exam.hidden_terms.anti_alias_filter import AntiAliasFilter
from exam.hidden_terms.curved_loads import CurvedLoads
from exam.surrogates.flights.drawing import Dominant, draw, hiding, short_period, with_term
from exam.surrogates.flights.flying import fly_drawn
from exam.surrogates.flights.maneuvers import KINDS, Table, maneuver
from exam.surrogates.pseudo_true import pseudo_true
from sim.effects.library import find_effect
from sim.errors import DeclarationError
from sim.record import Record
from tests.surrogates import CALM, short

G0 = 9.80665


def smooth_record() -> tuple[Record, float]:
    """A flight with gravity, trim lift and thrust, nothing else, at 200 Hz; and its trim angle of
    attack.
    """
    causes = replace(CALM, gravity=1.0, trim_lift=1.0, speed_drift=0.05, moment_curvature=0.1)
    plan = draw(short(causes, rates=(200.0,), step=0.005), np.random.default_rng(3))
    return fly_drawn(plan, np.random.default_rng(4), count=1)[0].record, plan.model.parameters[
        "trim_alpha"
    ].value


def test_channels_obey_rigid_body_kinematics() -> None:
    """Without aerodynamics: theta_dot = q; V (theta - alpha)_dot = g (nz - cos climb); u_dot = ax -
    g sin theta - q w.
    """
    record, trim = smooth_record()
    at = {channel.name: channel.values for channel in record.channels}
    rate = {name: np.gradient(values, record.time) for name, values in at.items()}
    inside = slice(5, -5)
    climb = at["theta"] - at["alpha"]
    assert np.allclose(rate["theta"][inside], at["q"][inside], atol=2e-4)
    path = at["airspeed"] * (rate["theta"] - rate["alpha"])
    assert np.allclose(path[inside], (G0 * (at["nz"] - np.cos(climb)))[inside], atol=0.01)
    u, w = at["airspeed"] * np.cos(at["alpha"]), at["airspeed"] * np.sin(at["alpha"])
    along = np.gradient(u, record.time) + at["q"] * w + G0 * np.sin(at["theta"])
    assert np.allclose(along[inside], at["ax"][inside], atol=0.003)
    assert np.ptp(at["ax"]) > 0.5 and np.ptp(climb) > 0.02 and trim == 0.05


@pytest.mark.parametrize("corner", [2.0, 7.0])
def test_anti_alias_filter_is_butterworths(corner: float) -> None:
    time = np.arange(0.0, 4.0, 0.01)
    values = np.interp(time, [0.0, 0.5, 1.0, 1.2, 2.5, 4.0], [0.3, 0.3, 1.0, -0.5, 0.0, 0.2])
    found, ends = AntiAliasFilter("q").act(
        np.diff(time), values, values[1:], type("P", (), {"corner": corner})()
    )
    poles = signal.butter(2, 2.0 * math.pi * corner, analog=True)
    _, wanted, _ = signal.lsim(poles, values - values[0], time)
    assert np.allclose(found, wanted + values[0], atol=1e-9)
    assert np.array_equal(found[1:], ends)


def test_curved_loads_are_their_polynomials() -> None:
    s, p = (
        type("S", (), {"alpha_air": 0.1})(),
        type(
            "P",
            (),
            {"moment_square": 2.0, "moment_cube": 3.0, "lift_square": -1.0, "lift_cube": 5.0},
        )(),
    )
    loads = CurvedLoads().increments(s, None, p)
    assert loads["moment"] == pytest.approx(0.02 + 0.003)
    assert loads["lift"] == pytest.approx(-0.01 + 0.005)


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=2, max_size=8),
    st.floats(-0.5, 1.5),
    st.floats(0.01, 2.0),
)
def test_mean_of_a_table(levels: list[float], begin: float, length: float) -> None:
    table = Table(np.array(levels), 0.2, 0.1)
    edges = [0.1 + 0.2 * i for i in range(len(levels)) if begin < 0.1 + 0.2 * i < begin + length]
    wanted, _ = quad(
        lambda t: float(table(t)), begin, begin + length, points=edges or None, limit=200
    )
    assert float(table.mean(begin, begin + length)) == pytest.approx(wanted / length, abs=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_maneuvers_begin_at_rest_and_move_the_elevator(kind: str) -> None:
    for seed in range(5):
        move = maneuver(kind, np.random.default_rng(seed), 0.05, 0.4, 20.0, 20.0)
        t = np.linspace(0.0, 20.0, 2001)
        assert np.all(move(t[t < 0.9]) == 0.0)
        assert (0.016 if kind == "held" else 0.02) < float(np.max(np.abs(move(t)))) < 0.12
        # The servo rounds every step: at most 20/s times the amplitude over e, for two equal lags.
        assert (
            float(np.max(np.abs(np.diff(move.values)))) / move.spacing < 2.5 * 0.05 * 20.0 / math.e
        )


def test_a_maneuver_that_is_not_there() -> None:
    with pytest.raises(DeclarationError, match="there is no maneuver 'roll'"):
        maneuver("roll", np.random.default_rng(0), 0.05, 0.4, 20.0, 20.0)


def test_short_period_frequency() -> None:
    """omega^2 = -(M_alpha + M_q Z_alpha) with Z_alpha = -L/(m V), by hand for numbers in which CL_q
    is nothing.
    """
    plan = draw(short(), np.random.default_rng(5))
    model = plan.declared.with_values({"CL_q": 0.0})
    v = {item.name: item.value for item in model.parameters}
    pressure_area = 0.5 * v["air_density"] * v["airspeed"] ** 2 * v["wing_area"]
    moment, lift = (
        pressure_area * v["chord"] / v["pitch_inertia"],
        pressure_area * v["CL_alpha"] / (v["mass"] * v["airspeed"]),
    )
    wanted = math.sqrt(
        -moment * (v["Cm_alpha"] + lift * v["Cm_q"] * v["chord"] / (2.0 * v["airspeed"]))
    )
    assert short_period(model) == pytest.approx(wanted, rel=1e-9)


def test_pseudo_true_values_of_a_perfect_model_are_the_true_ones() -> None:
    plan = draw(short(rates=(50.0,)), np.random.default_rng(5))
    delay = Dominant(
        find_effect("sensor-lag:q", plan.model.equations), {"time_constant": 0.08}, (0, 1)
    )
    found = pseudo_true(hiding(plan, (delay,)), {"sensor-lag:q": {}}, 2, np.random.default_rng(1))
    for name, value in found.nominal.items():
        assert found.values[name] == pytest.approx(value, rel=0.02), name
        assert abs(found.bias(name)) < 0.02
    assert found.values["sensor-lag:q.time_constant"] == pytest.approx(0.08, rel=0.01)


def test_downwash_moves_the_damping_derivative_by_as_much() -> None:
    """Quasi-steady theory: Cm_q and Cm_alpha_dot add up where alpha_dot and q are nearly one."""
    plan = draw(short(replace(CALM, downwash=0.2, downwash_lag=0.02)), np.random.default_rng(5))
    found = pseudo_true(plan, {}, 2, np.random.default_rng(1))
    assert found.bias("Cm_q") == pytest.approx(-0.2, abs=0.05)
    assert abs(found.bias("CL_alpha")) < 0.02


def test_small_causes_scatter_pseudo_true_values_and_more_draws_settle_them() -> None:
    plan = draw(short(replace(CALM, inertia_scatter=0.02)), np.random.default_rng(5))
    found = pseudo_true(plan, {}, 8, np.random.default_rng(1))
    share = found.std["Cm_alpha"] / abs(found.nominal["Cm_alpha"])
    # Two records a draw: 0.02 over the root of two, over that of eight draws.
    assert 0.4 * 0.005 < share < 2.0 * 0.005


def test_effects_of_one_record_have_no_pseudo_true_value() -> None:
    plan = draw(short(), np.random.default_rng(5))
    found = pseudo_true(
        plan,
        {"gust-discrete": {}, "gust-turbulence": {}, "sensor-spikes:q": {}},
        2,
        np.random.default_rng(1),
    )
    assert set(found.values) == set(found.nominal)


def test_a_term_by_local_values() -> None:
    plan = draw(short(), np.random.default_rng(5))
    model = with_term(plan.model, CurvedLoads(), {"moment_cube": 7.0})
    assert model.parameters["own:curved-loads.moment_cube"].value == 7.0
