"""Terms that only a truth has, against closed forms and against their own absence."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from exam.hidden_terms.library import every_term
from exam.random_cases.vehicles import drawn_vehicle
from sim.declaration.effect import Station, full_name
from sim.declaration.model import Model, Noise
from sim.effects.library import applies
from sim.maneuvers import doublet
from sim.propagation import rk4_step
from sim.truth.flight import fly, sample_times
from sim.vehicles.factory import model_of
from sim.vehicles.library import read_parameter_set

TERMS = every_term()
MODELS: dict[str, Model] = {
    name: drawn_vehicle(name, np.random.default_rng(2))[1]
    for name in ("rigid", "loes", "ballistic")
}
MODELS["longitudinal"] = model_of(read_parameter_set("navion_longitudinal"))
DYNAMIC = [name for name, term in TERMS.items() if hasattr(term, "increments")]


def values(name: str, **changed: float) -> SimpleNamespace:
    return SimpleNamespace(
        **{**{item.name: item.value for item in TERMS[name].parameters}, **changed}
    )


def increments(name: str, signals: dict[str, float], **changed: float) -> dict[str, Any]:
    return dict(TERMS[name].increments(SimpleNamespace(**signals), None, values(name, **changed)))  # type: ignore[attr-defined]


def motion(model: Model, duration: float = 2.0, step: float = 0.02) -> dict[str, np.ndarray]:
    """Outputs and time of a short flight without noise; a stick's doublet where there is one."""
    start = (
        model.initial.with_values({"altitude": 50e3, "velocity": -1700.0})
        if model.equations.name == "ballistic"
        else model.initial
    )
    control = [signal.name for signal in model.equations.inputs]
    size = 0.05 if control[:1] == ["elevator"] else 2.0
    time = sample_times(50.0, duration)
    moved = {control[0]: doublet(size, 0.8, 0.5)} if control else None
    _, truth = fly(
        model.with_initial(start).with_noise(Noise()),
        moved,
        time,
        np.random.default_rng(0),
        step=step,
        method=rk4_step,
    )
    return {
        "time": time,
        **truth.outputs,
        **{f"state {key}": row for key, row in truth.states.items()},
    }


def with_term(model: Model, name: str, **changed: float) -> Model:
    term = TERMS[name]
    return model.with_effects(term).with_values(
        {full_name(term, key): value for key, value in changed.items()}
    )


@pytest.mark.sampled
@pytest.mark.parametrize("name", sorted(TERMS))
def test_absent_is_the_model_without_it_bit_for_bit(name: str) -> None:
    able = [model for model in MODELS.values() if applies(TERMS[name], model.equations)]
    assert able
    for model in able:
        bare, absent = motion(model), motion(with_term(model, name, **TERMS[name].absent))
        assert all(
            np.array_equal(absent[signal.name], bare[signal.name])
            for signal in model.equations.outputs
        )


def test_moments_by_the_rate() -> None:
    for q in (-0.3, 0.2):
        assert increments("own:rate-damping", {"q": q}, size=-0.5) == {"moment": -0.5 * q * abs(q)}
    assert increments("own:friction", {"q": 0.3}, size=0.005, width=0.4)["moment"] == pytest.approx(
        -0.003
    )
    assert increments("own:alpha-rate-product", {"q": 0.2, "alpha_air": -0.1}, moment=3.0)[
        "moment"
    ] == pytest.approx(-0.06)
    assert increments("own:travelling-mass", {"time": 10.0, "alpha_air": 0.05}, rate=-0.02)[
        "moment"
    ] == pytest.approx(-0.01)


def test_the_hysteresis_follows_the_turn_at_any_speed() -> None:
    term, p = TERMS["own:hysteresis"], values("own:hysteresis", width=0.03)
    for q in (0.05, -0.2):
        z, h = 0.0, 5e-4 * 0.03 / abs(q)
        for _ in range(2000):  # the nose turns by one width
            z += h * term.derivatives(SimpleNamespace(q=q, memory=z), None, p)[0]  # type: ignore[attr-defined]
        assert z == pytest.approx(math.copysign(1.0 - math.exp(-1.0), q), rel=5e-4)


def test_loads_in_two_stages_follow_a_ramp_late_by_both_times() -> None:
    term, p = (
        TERMS["own:lagged-loads"],
        values("own:lagged-loads", fast=0.2, slow=1.0, moment=-0.3, lift=1.0),
    )
    slope, x, h = 0.01, [0.0, 0.0], 1e-3
    for i in range(20000):
        s = SimpleNamespace(alpha_air=slope * i * h, fast_angle=x[0], slow_angle=x[1])
        x = [old + h * rate for old, rate in zip(x, term.derivatives(s, None, p), strict=True)]  # type: ignore[attr-defined]
    late = slope * (0.6 * 0.2 + 0.4 * 1.0)
    found = term.increments(  # type: ignore[attr-defined]
        SimpleNamespace(alpha_air=slope * 20.0, fast_angle=x[0], slow_angle=x[1]), None, p
    )
    assert found["lift"] == pytest.approx(late, rel=1e-3) and found["moment"] == pytest.approx(
        -0.3 * late, rel=1e-3
    )


def test_what_a_vane_reads() -> None:
    for name, signals, more, told in (
        ("own:control-upwash", {"elevator": 0.1}, {"gain": 0.2}, 0.07),
        ("own:control-upwash", {"elevator": 9.0, "delta": 0.1}, {"gain": 0.2}, 0.07),
        ("own:cubic-vane", {}, {"cubic": 40.0}, 0.05 + 40.0 * 0.05**3),
    ):
        found = TERMS[name].read(  # type: ignore[attr-defined]
            SimpleNamespace(**signals), {"alpha": 0.05}, None, values(name, **more)
        )
        assert found == {"alpha": pytest.approx(told)}


def test_drag_of_a_falling_body() -> None:
    assert increments("own:drag-decay", {"time": 10.0}, rate=0.02) == {"log_drag": 0.2}
    assert increments("own:drag-rhythm", {"time": 1.0}, size=0.3, frequency=0.5 * math.pi)[
        "log_drag"
    ] == pytest.approx(0.3)
    for speed, told in ((3.5 * 300.0, 0.0), (-(3.5 + 0.8) * 300.0, 0.3 / math.sqrt(2.0))):
        assert increments("own:mach-drag", {"velocity": speed}, size=0.3, middle=3.5, width=0.8)[
            "log_drag"
        ] == pytest.approx(told)


@pytest.mark.parametrize("depths", [-2.0, -1.0, 0.0, 0.5, 1.0, 3.0])
def test_a_layer_of_air_is_a_bell_of_its_depth_about_its_middle(depths: float) -> None:
    """Thickest in the middle, by 1/e less a depth above and below, 1/e^4 two depths away."""
    air = {"size": 0.3, "middle": 18000.0, "depth": 2500.0}
    found = increments("own:density-layer", {"altitude": 18000.0 + 2500.0 * depths}, **air)
    assert found == {"log_density": pytest.approx(0.3 * math.exp(-(depths**2)), rel=1e-12)}


def test_drag_outside_of_the_bucket() -> None:
    for alpha, told in ((0.01, 0.0), (0.05, 0.015), (-0.07, 0.024), (100.0, 0.03)):
        found = increments(
            "own:drag-bucket", {"alpha_air": alpha}, depth=0.03, middle=0.01, width=0.04
        )
        assert found == {"drag": pytest.approx(told, rel=1e-4)}


def test_the_low_order_equivalent_loses_its_own_control_power() -> None:
    signals = SimpleNamespace(delta=2.0, elevator=9.0)
    vehicle = SimpleNamespace(M_delta=0.3, L_delta=-0.003)
    found = TERMS["own:weakening-control"].increments(signals, vehicle, SimpleNamespace(cubic=0.05))  # type: ignore[attr-defined]
    assert found == {"moment": pytest.approx(-0.12), "lift": pytest.approx(0.0012)}


def test_dynamic_terms_say_where_they_act() -> None:
    assert len(DYNAMIC) > 12 and all(
        TERMS[name].station in (Station.DYNAMICS, Station.DISTURBANCE) for name in DYNAMIC
    )


EXCHANGE = "own:energy-exchange"


def exchanged(**changed: float) -> dict[str, np.ndarray]:
    model = MODELS["rigid"]
    found = motion(
        with_term(
            model,
            EXCHANGE,
            **{"gravity": 1.0, "path": 0.0, "weight_share": 0.0, "induced": 0.4, **changed},
        ),
        25.0,
        0.005,
    )
    V0 = model.parameters["airspeed"].value
    found["V"] = np.sqrt(V0**2 + 2.0 * (found["state gained"] - 9.80665 * found["state climbed"]))
    found["gamma"] = changed.get("path", 0.0) + found["state turned"] - found["alpha"]
    return found


def test_without_drag_and_thrust_the_energy_stays_and_height_is_the_path_flown() -> None:
    found = exchanged(path=0.06)
    assert np.all(found["state gained"] == 0.0)
    climbed = np.concatenate(
        [
            [0.0],
            np.cumsum(
                0.5
                * 0.02
                * (
                    (found["V"] * np.sin(found["gamma"]))[1:]
                    + (found["V"] * np.sin(found["gamma"]))[:-1]
                )
            ),
        ]
    )
    assert np.max(np.abs(found["state climbed"] - climbed)) < 1e-3 * np.ptp(climbed)


def test_speed_and_path_obey_newtons_law_along_and_across_the_path() -> None:
    """V_dot = (T - D)/m - g sin(gamma) and V gamma_dot = g (nz + 1 - cos(gamma)), by differences of
    the flown motion.
    """
    share, induced = 0.09, 0.4
    found = exchanged(path=0.05, weight_share=share, induced=induced)
    p = {name: MODELS["rigid"].parameters[name].value for name in MODELS["rigid"].parameters.names}
    g, quiet = 9.80665, found["time"] > 3.0  # the control is at rest: no jumps between samples
    level = p["mass"] * g / (0.5 * p["air_density"] * p["wing_area"] * p["airspeed"] ** 2)
    ratio, CL = (found["V"] / p["airspeed"]) ** 2, p["CL_alpha"] * found["alpha"]
    drag = share * ratio * (1.0 - induced + induced * (1.0 + CL / level) ** 2)
    along = np.gradient(found["V"], 0.02, edge_order=2) - g * (
        share - drag - np.sin(found["gamma"])
    )
    across = found["V"] * np.gradient(found["gamma"], 0.02, edge_order=2) - g * (
        found["nz"] + 1.0 - np.cos(found["gamma"])
    )
    assert np.max(np.abs(along[quiet][1:-1])) < 1e-3 and np.max(np.abs(across[quiet][1:-1])) < 0.02
    assert np.ptp(found["V"]) > 2.0
