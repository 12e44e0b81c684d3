"""Compiling a model: the bus, the order of effects, biases, noise, and the on-line form."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim.declaration.compile import compile_model, parts_of
from sim.declaration.effect import (
    Effect,
    OnlineForm,
    Parameter,
    ReadingEffect,
    Regularity,
    Signal,
    Station,
    full_name,
)
from sim.declaration.model import Model, Noise, System
from sim.effects.disturbance.gusts import GustDiscrete
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.effects.input_path.actuator import ActuatorLag, ActuatorRateLimit, ActuatorSaturation
from sim.effects.input_path.input_delay import InputDelay
from sim.effects.input_path.input_play import InputBacklash, InputDeadband
from sim.effects.sensor_path.sensor_timing import SensorLag
from sim.errors import ModelError
from sim.maths import complex_step_jacobian
from sim.propagation import drive_from_record, make_grid, simulate
from sim.record import Hold
from tests.bases import RIGID_VALUES, ballistic_model, rigid_model


@dataclass(frozen=True)
class Scale:
    """A reading without memory, for these tests."""

    channel_read: str = "q"
    name: ClassVar[str] = "reading-scale"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = "y -> 3 y"

    def read(self, s: Any, y: Mapping[str, Any], vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {self.channel_read: 3.0 * y[self.channel_read]}


@dataclass(frozen=True)
class Squaring:
    """A sensor on the grid of sub-steps that is not linear, for these tests."""

    channel: str = "q"
    name: ClassVar[str] = "sensor-squaring"
    station: ClassVar[Station] = Station.SENSOR_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({})
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = "y -> y^2"

    def act(self, steps: Any, begin: Any, end: Any, p: Any) -> tuple[Any, Any]:
        return begin**2, end**2


@dataclass(frozen=True)
class Lag:
    """An input lag with a state form, for these tests."""

    number: int = 1
    signal: str = "elevator"
    station: ClassVar[Station] = Station.INPUT_PATH
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("T", 0.1),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"T": 0.0})
    regularity: ClassVar[Regularity] = Regularity.BOUNDARY
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = "T y_dot = u - y"

    @property
    def name(self) -> str:
        return f"input-lag:{self.number}"

    @property
    def online_states(self) -> tuple[Signal, ...]:
        return (Signal(f"lagged{self.number}", "rad"),)

    def act(self, edges: Any, u: Any, p: Any) -> Any:
        raise AssertionError("the state form is asked for")

    def rates(self, v: Any, x: Sequence[Any], p: Any) -> Sequence[Any]:
        return ((v - x[0]) / p.T,)

    def pass_on(self, v: Any, x: Sequence[Any], p: Any) -> Any:
        return x[0]


@dataclass(frozen=True)
class Wind:
    """A disturbance with one state driven by white noise, for these tests."""

    name: ClassVar[str] = "wind"
    station: ClassVar[Station] = Station.DISTURBANCE
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("sigma", 2.0), Parameter("rate", 0.5))
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"sigma": 0.0})
    regularity: ClassVar[Regularity] = Regularity.PROCESS_NOISE
    aliases: ClassVar[tuple[str, ...]] = ()
    explanation: ClassVar[str] = "w_dot = -rate w + noise"
    states: ClassVar[tuple[Signal, ...]] = (Signal("w", "m/s"),)

    def increments(self, s: Any, vehicle: Any, p: Any) -> Mapping[str, Any]:
        return {"gust": s.w / vehicle.airspeed}

    def derivatives(self, s: Any, vehicle: Any, p: Any) -> Sequence[Any]:
        return (-p.rate * s.w,)

    def density(self, vehicle: Any, p: Any) -> Sequence[Any]:
        return (2.0 * p.sigma**2 * p.rate,)


def at(system: System, **changes: float) -> list[Any]:
    return [changes.get(item.name, item.value) for item in system.parameters]


def test_rigid_equations_are_those_of_the_textbook() -> None:
    system = compile_model(rigid_model())
    alpha, q, de = 0.03, -0.02, 0.05
    r = RIGID_VALUES
    V, S, c, rho = r["airspeed"], r["wing_area"], r["chord"], r["air_density"]
    CL = r["CL_alpha"] * alpha + r["CL_q"] * q * c / (2 * V) + r["CL_de"] * de
    Cm = r["Cm_alpha"] * alpha + r["Cm_q"] * q * c / (2 * V) + r["Cm_de"] * de
    expected = [
        q - rho * V * S / (2 * r["mass"]) * CL,
        rho * V**2 * S * c / (2 * r["pitch_inertia"]) * Cm,
    ]
    assert system.f(0.0, [alpha, q], [de], at(system)) == pytest.approx(expected, rel=1e-13)
    nz = rho * V**2 * S * CL / (2 * r["mass"] * 9.80665)
    assert system.h(0.0, [alpha, q], [de], at(system)) == pytest.approx([alpha, q, nz], rel=1e-13)


def test_ballistic_equations_brake_against_the_motion() -> None:
    system = compile_model(ballistic_model())
    p = at(system, air_density_reference=1.2, density_scale_height=8000.0, gravity=9.8, beta=500.0)
    rho = 1.2 * np.exp(-4000.0 / 8000.0)
    for velocity, sign in ((-300.0, 1.0), (300.0, -1.0)):
        rates = system.f(0.0, [4000.0, velocity], [], p)
        assert rates == pytest.approx(
            [velocity, sign * 0.5 * rho * velocity**2 / 500.0 - 9.8], rel=1e-13
        )


def test_outputs_come_in_the_order_asked_for() -> None:
    system = compile_model(rigid_model(), ["nz", "alpha"])
    full = compile_model(rigid_model())
    x, u = [0.03, -0.02], [0.05]
    alpha, _, nz = full.h(0.0, x, u, at(full))
    assert system.h(0.0, x, u, at(system)) == [nz, alpha] and system.output_names == ("nz", "alpha")
    with pytest.raises(ModelError, match="there is no output 'nx'; its outputs are alpha, q, nz"):
        compile_model(rigid_model(), ["nx"])


def test_a_sensor_of_an_output_that_is_not_wanted_is_left_out() -> None:
    model = rigid_model().with_effects(SensorLag("q"), SensorLag("nz"))
    assert compile_model(model).sensor_stages == ("sensor-lag:q", "sensor-lag:nz")
    assert compile_model(model, ["alpha", "q"]).sensor_stages == ("sensor-lag:q",)
    assert compile_model(model, ["alpha"], online=True).state_names == ("alpha", "q")


def test_biases_add_to_what_the_sensors_pass_on() -> None:
    system = compile_model(rigid_model().with_biases(["q"]).with_effects(Scale(), Squaring()))
    p = at(system, bias_q=0.5)
    (_, q, _) = system.h(0.0, [0.0, 0.2], [0.0], p)
    assert q == pytest.approx(3.0 * 0.2 + 0.5)
    begin, end = system.sensor_path(
        p,
        [np.zeros(4), np.full(4, q), np.zeros(4)],
        [np.zeros(3), np.full(3, q), np.zeros(3)],
        np.full(3, 0.01),
    )
    np.testing.assert_allclose(begin[1], (3.0 * 0.2) ** 2 + 0.5, rtol=1e-14)
    np.testing.assert_allclose(end[1], (3.0 * 0.2) ** 2 + 0.5, rtol=1e-14)


def test_readings_and_modes_and_gusts_meet_on_the_bus() -> None:
    model = rigid_model().with_effects(Wind(), StructuralMode(1, (1, 2)), StructuralMode(2, (1, 2)))
    system = compile_model(model)
    assert system.state_names == ("alpha", "q", "w", "eta1", "etadot1", "eta2", "etadot2")
    assert [item.free for item in system.initial] == [True, True, False, False, False, False, False]
    x = [0.01, 0.0, 4.0, 0.3, 0.0, -0.2, 0.0]
    p = at(system, CL_eta1=0.02, CL_eta2=0.05)
    # The gust acts as alpha in the loads, the modes through CL, and the vane sees the gust alone.
    CL = RIGID_VALUES["CL_alpha"] * (0.01 + 4.0 / 200.6) + 0.02 * 0.3 - 0.05 * 0.2
    weight = RIGID_VALUES["mass"] * 9.80665
    pressure_area = 0.5 * RIGID_VALUES["air_density"] * 200.6**2 * RIGID_VALUES["wing_area"]
    assert system.h(0.0, x, [0.0], p) == pytest.approx(
        [0.01 + 4.0 / 200.6, 0.0, pressure_area * CL / weight]
    )
    assert system.f(0.0, x, [0.0], p)[2] == pytest.approx(-0.5 * 4.0)


def test_noise_carries_each_density_to_its_state_and_each_variance_to_its_output() -> None:
    model = (
        rigid_model()
        .with_effects(StructuralMode(1, (1,)), Wind())
        .with_noise(Noise({"alpha": 0.1, "nz": 0.2}, {"q": 0.03, "etadot1": 0.7}))
    )
    system = compile_model(model, ["nz", "q"])
    density, variance = system.noise(at(system, **{"wind.sigma": 3.0}))
    assert dict(zip(system.state_names, density, strict=True)) == {
        "alpha": 0.0,
        "q": 0.03,
        "eta1": 0.0,
        "etadot1": 0.7,
        "w": 2.0 * 9.0 * 0.5,
    }
    assert variance[0] == pytest.approx(0.04) and np.isnan(variance[1])


def test_online_input_lags_stand_in_a_chain() -> None:
    model = rigid_model().with_effects(Lag(1), Lag(2))
    system = compile_model(model, online=True)
    assert (
        isinstance(Lag(), OnlineForm)
        and system.input_stages == ()
        and system.state_names[2:] == ("lagged1", "lagged2")
    )
    p = at(system, **{"input-lag:1.T": 0.1, "input-lag:2.T": 0.5})
    rates = system.f(0.0, [0.0, 0.0, 0.04, 0.03], [0.06], p)
    assert rates[2:] == pytest.approx([(0.06 - 0.04) / 0.1, (0.04 - 0.03) / 0.5])
    plain = compile_model(rigid_model())
    assert rates[:2] == plain.f(0.0, [0.0, 0.0], [0.03], at(plain)), (
        "the vehicle feels what the last one passes on"
    )
    assert system.h(0.0, [0.0, 0.0, 0.04, 0.03], [0.06], p) == plain.h(
        0.0, [0.0, 0.0], [0.03], at(plain)
    )


def test_online_sensor_lag_reads_its_state_and_adds_the_bias_after() -> None:
    system = compile_model(
        rigid_model().with_biases(["q"]).with_effects(Scale(), SensorLag("q")), online=True
    )
    p = at(system, bias_q=0.5, **{"sensor-lag:q.time_constant": 0.2})
    x = [0.0, 0.1, 0.25]
    assert system.h(0.0, x, [0.0], p)[1] == pytest.approx(0.25 + 0.5)
    assert system.f(0.0, x, [0.0], p)[2] == pytest.approx((3.0 * 0.1 - 0.25) / 0.2)


def test_what_cannot_run_online_is_named() -> None:
    model = rigid_model().with_effects(InputDelay())
    with pytest.raises(
        ModelError, match=r"model rigid: effect input-delay has no state form.*hold its parameters"
    ):
        compile_model(model, online=True)
    held = model.with_parameters(model.parameters.hold(["input-delay.delay"]))
    assert compile_model(held, online=True).input_stages == ("input-delay",)
    # A delay may act on the recorded input ahead of a lag that is a state, whichever was added
    # first; an effect that does not commute may not.
    for effects in ((InputDelay(), Lag()), (Lag(), InputDelay())):
        both = rigid_model().with_effects(*effects)
        both = both.with_parameters(both.parameters.hold(["input-delay.delay"]))
        assert compile_model(both, online=True).input_stages == ("input-delay",)
    limited = rigid_model().with_effects(ActuatorRateLimit(), Lag())
    limited = limited.with_parameters(limited.parameters.hold(["actuator-rate-limit.rate"]))
    with pytest.raises(ModelError, match="actuator-rate-limit"):
        compile_model(limited, online=True)


def test_effects_stand_on_the_path_in_their_own_order() -> None:
    effects = (
        InputDelay(),
        ActuatorSaturation(),
        ActuatorRateLimit(),
        ActuatorLag(),
        InputBacklash(),
        InputDeadband(),
    )
    stages = (
        "input-deadband",
        "input-backlash",
        "actuator-lag",
        "actuator-rate-limit",
        "actuator-saturation",
        "input-delay",
    )
    for order in (effects, effects[::-1]):
        assert compile_model(rigid_model().with_effects(*order)).input_stages == stages


def test_declared_starts_of_added_states_are_kept() -> None:
    model = rigid_model().with_effects(Wind())
    started = model.with_initial(model.initial.joined([Parameter("w", 1.5, "m/s")]))
    assert list(compile_model(started).initial.values()) == [0.0, 0.0, 1.5]
    assert compile_model(model).initial["w"].value == 0.0


EVERYTHING: tuple[Effect, ...] = (GustDiscrete(), StructuralMode(1, (1,)), SensorLag("q"))


def everything() -> tuple[Model, System]:
    model = rigid_model().with_biases(["alpha"]).with_effects(*EVERYTHING)
    return model, compile_model(model, online=True)


@settings(max_examples=20)
@given(
    st.lists(st.floats(-0.2, 0.2), min_size=5, max_size=5),
    st.floats(-0.1, 0.1),
    st.floats(2.1, 2.9),
)
def test_jacobians_of_f_and_h_are_central_differences(x: list[float], u: float, t: float) -> None:
    _, system = everything()
    p = at(system)
    n, m = len(x), len(p)
    for function in (system.f, system.h):
        jacobian = complex_step_jacobian(
            lambda z, function=function: function(t, z[:n], [u], z[n:]),  # type: ignore[misc]
            [*x, *p],
        )
        assert np.all(np.isfinite(jacobian))
        for j, value in enumerate([*x, *p]):
            size = 1e-5 * max(1.0, abs(value))
            sides = []
            for sign in (1.0, -1.0):
                z = [*x, *p]
                z[j] += sign * size
                sides.append(np.array(function(t, z[:n], [u], z[n:]), dtype=float))
            expected = (sides[0] - sides[1]) / (2.0 * size)
            np.testing.assert_allclose(
                jacobian[:, j],
                expected,
                rtol=1e-5,
                atol=1e-8 * (1.0 + np.max(np.abs(sides)) / size * 1e-3),
            )
    assert len(system.state_names) == n and m == len(system.parameters)


def test_one_call_serves_floats_arrays_and_complex_numbers() -> None:
    _, system = everything()
    p = at(system)
    x = [0.01, 0.02, 0.1, -0.2, 0.03]
    once = system.f(2.4, x, [0.05], p), system.h(2.4, x, [0.05], p)
    many = [np.full(4, value) for value in x]
    for got, wanted in zip(
        (system.f(2.4, many, [0.05], p), system.h(2.4, many, [0.05], p)), once, strict=True
    ):
        for row, value in zip(got, wanted, strict=True):
            np.testing.assert_allclose(np.broadcast_to(row, 4), value, rtol=1e-14)
    stepped = system.f(2.4, [complex(value) for value in x], [0.05], p)
    assert [complex(value).real for value in stepped] == pytest.approx(once[0], rel=1e-14)


def test_full_names_of_parameters_decide_where_values_go() -> None:
    model, system = everything()
    for effect in EVERYTHING:
        for item in effect.parameters:
            assert full_name(effect, item.name) in system.parameters.names
    time = np.arange(51) * 0.02
    grid = make_grid(time, 0.02)
    plain = compile_model(model)
    p, u = at(plain), np.full((1, 51), 0.02)
    drive = drive_from_record(plain, p, u, time, Hold.PREVIOUS, grid)
    x0 = [0.0] * 4
    shifted = simulate(plain, at(plain, bias_alpha=0.1), x0, drive, grid)
    base = simulate(plain, p, x0, drive, grid)
    np.testing.assert_allclose(shifted[0], base[0] + 0.1, rtol=1e-13)
    np.testing.assert_array_equal(shifted[1], base[1])
    assert isinstance(Scale(), ReadingEffect)


@dataclass(frozen=True)
class Assembled:
    """An effect whose methods are given to each instance."""

    name: str
    station: ClassVar[Station] = Station.SENSOR_PATH
    regularity: ClassVar[Regularity] = Regularity.REGULAR
    aliases: ClassVar[tuple[str, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = (Parameter("size", 2.0, "1"),)
    absent: ClassVar[Mapping[str, float]] = MappingProxyType({"size": 1.0})
    explanation: ClassVar[str] = "For this test."


def test_effects_of_one_class_may_have_methods_of_their_own() -> None:
    """What the first of a class lacks the second may have."""
    model, idle, scaled = rigid_model(), Assembled("idle"), Assembled("scaled")
    object.__setattr__(scaled, "read", lambda s, y, vehicle, p: {"alpha": p.size * y["alpha"]})
    plain, first, second = (
        parts_of(model.with_effects(*effects), None, False).readings
        for effects in ((), (idle,), (scaled,))
    )
    assert plain == first == () and [each.name for each in second] == [scaled.name]
