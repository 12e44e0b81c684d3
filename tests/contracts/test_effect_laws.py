"""Laws that every effect of the library obeys. A new effect is covered as soon as its file is there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import sim.effects.input_path
from sim.declaration.compile import compile_model
from sim.declaration.effect import (
    Anticipating,
    ClockEffect,
    DynamicsEffect,
    Effect,
    InputEffect,
    NoiseEffect,
    OnlineForm,
    ParameterEffect,
    ReadingEffect,
    Regularity,
    SensorEffect,
    Station,
    full_name,
)
from sim.declaration.model import Model, Multiplying
from sim.declaration.proposal import SearchContext, Traceable
from sim.declaration.system import System
from sim.declaration.traits import GUARD
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.effects.library import applies, effect_modules, effect_names, effects_for, find_effect, guards_for, library
from sim.effects.sensor_path.sensor_curve import SensorCurve
from sim.errors import ModelError
from sim.maths.elementary import COMPLEX_STEP
from sim.propagation.grid import drive_from_record, make_grid
from sim.propagation.integrate import outputs_at_samples, rk4_step
from sim.record import Hold
from sim.truth.random_forcing import propagate_with_process_noise
from sim.vehicles.ballistic import Ballistic
from sim.vehicles.short_period import ShortPeriod
from tests.bases import Flight, base_for, fly, fly_model
from tests.offered import ALL_VEHICLES, VARYING, VEHICLES, first_of_each_kind, guards_of_whole_axes, held_to_all_laws, made, representatives

ROOT = Path(__file__).parents[2]
OFFERED = [(effect, vehicle.name) for vehicle in VEHICLES for effect in held_to_all_laws(vehicle)] + representatives()
CASES = [pytest.param(effect, base, id=f"{effect.name} on {base}") for effect, base in OFFERED]
EFFECTS = [pytest.param(effect, id=effect.name) for effect in (*library(), *made())]
HOLDS = pytest.mark.parametrize("hold", list(Hold), ids=lambda hold: hold.value)
OFFERED_GUARDS = [(guard, vehicle.name) for vehicle in VEHICLES for guard in guards_for(vehicle)] + guards_of_whole_axes()
FLOWN_GUARDS = [each for each in OFFERED_GUARDS if each not in guards_of_whole_axes()] + first_of_each_kind(guards_of_whole_axes())
GUARDS = [pytest.param(guard, base, id=f"{guard.name} on {base}") for guard, base in FLOWN_GUARDS]
every_case = pytest.mark.parametrize(("effect", "base"), CASES + GUARDS)
every_effect = pytest.mark.parametrize("effect", EFFECTS)

# Names that other programs read; where a colon follows, an output channel (spikes: also an input), an input, a port or a number.
FIXED_NAMES = {
    Station.INPUT_PATH: "input-delay actuator-lag actuator-second-order actuator-rate-limit actuator-saturation input-deadband input-backlash "
    "input-recorded-late",
    Station.DYNAMICS: "moment-nonlinearity lift-nonlinearity control-nonlinearity derivative-jump elastic-mode flow-separation "
    "density-scale-height drag-mach drag-jump yaw-nonlinearity roll-nonlinearity side-force-nonlinearity drag-nonlinearity varies",
    Station.DISTURBANCE: "gust-turbulence gust-discrete gust-horizontal speed-variation unmeasured-input phugoid",
    Station.SENSOR_PATH: "vane-offset sensor-scale sensor-lag sensor-delay sensor-drift sensor-spikes time-base accelerometer-offset "
    "sensor-coupling sensor-curve sensor-step sensor-hold",
    Station.NOISE: "",
}


def typical(model: Model, effect: Effect) -> Model:
    """The model with the effect at its starting values, nudged off the edges of cells and samples."""
    nudged = {full_name(effect, item.name): item.value * 1.0137 for item in effect.parameters}
    return model.with_effects(effect).with_values(nudged)


def absent(model: Model, effect: Effect) -> Model:
    """The model with the effect present, at the values at which it vanishes."""
    return typical(model, effect).with_values({full_name(effect, local): value for local, value in effect.absent.items()})


def fly_roughly(model: Model, flight: Flight) -> list[np.ndarray]:
    """Outputs of a model with its process noise acting, one draw."""
    system, grid = compile_model(model), make_grid(flight.time, flight.max_step)
    p = system.parameters.values().tolist()
    drive = drive_from_record(system, p, flight.u, flight.time, flight.hold, grid)
    densities = {name: value for name, value in zip(system.state_names, system.noise(p)[0], strict=True) if value > 0}
    states, _ = propagate_with_process_noise(system, p, drive, grid, rk4_step, densities, {}, np.random.default_rng(1))
    return outputs_at_samples(system, p, states, drive, grid)


@every_effect
def test_declares_what_the_protocol_wants(effect: Effect) -> None:
    assert isinstance(effect, Effect)
    form = {
        Station.INPUT_PATH: (InputEffect,),
        Station.DYNAMICS: (DynamicsEffect, ParameterEffect),
        Station.DISTURBANCE: (DynamicsEffect,),
        Station.SENSOR_PATH: (SensorEffect, ReadingEffect, InputEffect, ClockEffect),  # recorded inputs have sensors, too
        Station.NOISE: (NoiseEffect,),
    }[effect.station]
    assert isinstance(effect, form)
    assert isinstance(effect.regularity, Regularity)
    assert hash(effect) == hash(replace(effect))  # type: ignore[type-var]
    assert len(effect.explanation) > 150 and "=" in effect.explanation and "\n" not in effect.explanation
    local = [item.name for item in effect.parameters]
    assert local and len(set(local)) == len(local) and all(name.isidentifier() for name in local)
    assert all(item.unit for item in effect.parameters)
    assert any(item.free for item in effect.parameters)
    full = [full_name(effect, name) for name in local]
    assert len(set(full)) == len(full)
    assert effect.absent and set(effect.absent) <= set(local)
    values = {item.name: item for item in effect.parameters}
    for name, value in effect.absent.items():
        low, high = values[name].bounds
        assert low <= value <= high
        assert values[name].value != value, "a starting value is where the effect acts"
    assert effect.name not in effect.aliases
    assert any(applies(effect, vehicle) for vehicle in ALL_VEHICLES), "no vehicle here can carry it: extend tests/offered.py and tests/bases.py"


def names(*fields: str) -> set[str]:
    """Names of the signals in these fields of all equations."""
    return {signal.name for vehicle in ALL_VEHICLES for field in fields for signal in getattr(vehicle, field)}


FACTORS = {name for vehicle in ALL_VEHICLES if isinstance(vehicle, Multiplying) for name in vehicle.factors}
LABELS = {
    Station.INPUT_PATH: names("inputs"),
    Station.DYNAMICS: names("inputs", "ports"),
    Station.DISTURBANCE: names("ports"),
    Station.SENSOR_PATH: names("outputs", "inputs"),
}


@every_effect
def test_name_follows_the_design(effect: Effect) -> None:
    stem, colon, suffix = effect.name.partition(":")
    assert re.fullmatch(r"[a-z]+(-[a-z]+)*", stem)
    for station, fixed in FIXED_NAMES.items():
        if stem in fixed.split():
            assert station is effect.station
    if stem == VARYING:
        of, over = re.fullmatch(r"(\w+)\((\w+)\)", suffix).groups()  # type: ignore[union-attr]
        assert of in FACTORS and over in names("states", "inputs")
    elif colon:
        assert suffix in LABELS[effect.station] or (effect.station is Station.DYNAMICS and suffix.isdigit())
    assert not stem.startswith("sensor-") or (effect.station is Station.SENSOR_PATH and colon)
    for item in effect.parameters:
        full = full_name(effect, item.name)
        assert full.startswith(f"{effect.name}.") or (hasattr(effect, "rename") and full.isidentifier())
    for alias in effect.aliases:
        assert any(alias.partition(":")[0] in fixed.split() for fixed in FIXED_NAMES.values())


@every_case
@HOLDS
def test_absent_is_the_base_model_bit_for_bit(effect: Effect, base: str, hold: Hold) -> None:
    model, flight = base_for(base)
    # Uneven sampling and a rich input: sums over cells must not round either.
    generator = np.random.default_rng(1)
    time = np.sort(flight.time + generator.uniform(0.0, 0.3, flight.time.size) * np.diff(flight.time, append=flight.time[-1] + 0.02))
    flight = replace(flight, time=time, u=0.1 * generator.standard_normal(flight.u.shape), hold=hold)
    for expected, got in zip(fly_model(model, flight), fly_model(absent(model, effect), flight), strict=True):
        np.testing.assert_array_equal(got, expected)


@every_case
def test_is_visible_at_its_typical_value(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    without = fly_model(model, flight)
    if isinstance(effect, SensorCurve):  # what a bent reading is believed to be depends on how far the channel goes
        flown = {signal.name: (float(y.min()), float(y.max())) for signal, y in zip(model.equations.outputs, without, strict=True)}
        effect = effect.fitted_to(SearchContext(0.0, 9.0, 0.02, flown=flown))
    present = fly_roughly(typical(model, effect), flight) if isinstance(effect, NoiseEffect) else fly_model(typical(model, effect), flight)
    pairs = zip(model.equations.outputs, without, present, strict=True)
    shares = [np.max(np.abs(b - a)) / model.noise.measurement_std[signal.name] for signal, a, b in pairs]
    assert max(shares) > 1.0, "at a typical value an effect stands out of the noise in some output"


@pytest.mark.parametrize(("effect", "base"), [case for case in CASES if isinstance(case.values[0], NoiseEffect)])
def test_process_noise_leaves_the_simulation_alone_and_ends_where_absent(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    for expected, got in zip(fly_model(model, flight), fly_model(typical(model, effect), flight), strict=True):
        np.testing.assert_array_equal(got, expected)
    assert effect.regularity is Regularity.PROCESS_NOISE
    present, gone = (compile_model(chosen) for chosen in (typical(model, effect), absent(model, effect)))
    assert max(present.noise(present.parameters.values().tolist())[0]) > 0
    assert max(gone.noise(gone.parameters.values().tolist())[0]) == 0


@every_case
def test_complex_step_is_the_central_difference(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    system = compile_model(typical(model, effect))
    values = system.parameters.values()
    for item in effect.parameters:
        index = system.parameters.index(full_name(effect, item.name))
        p = list(values)
        p[index] = complex(values[index], COMPLEX_STEP)
        exact = [row.imag / COMPLEX_STEP for row in fly(system, flight, p)]
        size = 1e-5 * max(abs(values[index]), 1e-2)
        sides = []
        for sign in (1.0, -1.0):
            p[index] = values[index] + sign * size
            sides.append(fly(system, flight, p))
        for got, plus, minus in zip(exact, *sides, strict=True):
            expected = (plus - minus) / (2.0 * size)
            noise = 1e-15 * np.max(np.abs(plus)) / size
            np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-6 * np.max(np.abs(expected)) + 10.0 * noise, err_msg=item.name)


@every_case
def test_derivative_at_absence_is_the_one_sided_difference(effect: Effect, base: str) -> None:
    if effect.regularity not in (Regularity.REGULAR, Regularity.BOUNDARY):
        return
    model, flight = base_for(base)
    # A linear hold: the outputs then do not jump, and the derivative exists.
    flight = replace(flight, hold=Hold.LINEAR, max_step=0.02)
    system = compile_model(absent(model, effect))
    values = system.parameters.values()
    before = fly(system, flight)
    for local in effect.absent:
        index = system.parameters.index(full_name(effect, local))
        p = list(values)
        p[index] = complex(values[index], COMPLEX_STEP)
        exact = [row.imag / COMPLEX_STEP for row in fly(system, flight, p)]
        p[index] = values[index] + 1e-6
        for got, low, high in zip(exact, before, fly(system, flight, p), strict=True):
            scale = np.max(np.abs(got)) + 1e-9 * np.max(np.abs(low)) / 1e-6
            np.testing.assert_allclose(got, (high - low) / 1e-6, rtol=0.0, atol=1e-3 * scale, err_msg=local)


@every_case
def test_batch_is_one_by_one(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    system = compile_model(typical(model, effect))
    factors = np.array([1.0, 0.7, 1.3])
    batch = [value * factors if system.parameters.items[i].name != "gravity" else value for i, value in enumerate(system.parameters.values())]
    together = fly(system, flight, batch)
    for run in range(factors.size):
        alone = fly(system, flight, [float(value[run]) if np.ndim(value) else float(value) for value in batch])
        for got, expected in zip(together, alone, strict=True):
            np.testing.assert_allclose(got[:, run], expected, rtol=1e-11, atol=1e-12 * np.max(np.abs(expected)))


@every_case
def test_only_the_effect_in_batch_is_one_by_one(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    system = compile_model(typical(model, effect))
    own = {full_name(effect, item.name) for item in effect.parameters}
    free = {item.name for item in system.parameters if item.free} & own
    factors = np.array([1.0, 0.9])
    values = system.parameters.values()
    batch = [value * factors if name in free else value for name, value in zip(system.parameters.names, values, strict=True)]
    together = fly(system, flight, batch)
    for run in range(factors.size):
        alone = fly(system, flight, [float(value[run]) if np.ndim(value) else float(value) for value in batch])
        for got, expected in zip(together, alone, strict=True):
            np.testing.assert_allclose(np.broadcast_to(got.T, (2, len(expected)))[run], expected, rtol=1e-11, atol=1e-12 * np.max(np.abs(expected)))


@every_case
def test_probes_are_complete_and_within_bounds(effect: Effect, base: str) -> None:
    if isinstance(effect, StructuralMode):
        return  # a part of a flexible vehicle, declared with it: no search proposes it
    assert isinstance(effect, Traceable)
    model, flight = base_for(base)
    peak = {signal.name: float(np.max(np.abs(row))) for signal, row in zip(model.equations.inputs, flight.u, strict=True)}
    rate = {signal: 50.0 * value for signal, value in peak.items()}
    states = {"alpha": 0.2, "q": 0.3, "nz": 2.0}
    context = SearchContext(3.0, 9.0, 0.02, input_peak=peak, input_rate=rate, state_peak=states, residual_peaks=(9.0, 14.0), airspeed=150.0)
    items = {item.name: item for item in effect.parameters}
    assert effect.traits.onset in ("", *items) and set(effect.traits.plausible) <= set(items)
    for name, (low, high) in effect.traits.plausible.items():
        assert items[name].bounds[0] <= low <= items[name].value <= high <= items[name].bounds[1]
    for probe in effect.probes(context):
        assert set(probe.values) == set(items) and set(probe.slopes) <= {item.name for item in effect.parameters if item.free}
        for name, value in probe.values.items():
            assert items[name].bounds[0] <= value <= items[name].bounds[1]
        if not probe.slopes:
            assert any(probe.values[name] != value for name, value in effect.absent.items()), "a whole change needs a place where the effect acts"


ONLINE = [case for case in CASES if isinstance(case.values[0], OnlineForm)]
NO_STATE_FORM = [case for case in CASES if isinstance(case.values[0], (InputEffect, SensorEffect)) and not isinstance(case.values[0], OnlineForm)]


def online_start(system: System, effect: Effect, flight: Flight, first_reading: float) -> list[float]:
    """Initial state with the effect's own states settled at the signal that enters first."""
    signals = dict(zip(system.input_names, flight.u[:, 0], strict=True))
    entering = signals[effect.signal] if isinstance(effect, InputEffect) else first_reading
    own = {signal.name for signal in effect.online_states} if isinstance(effect, OnlineForm) else set()
    return [entering if name in own else value for name, value in zip(system.state_names, system.initial.values(), strict=True)]


@pytest.mark.parametrize(("effect", "base"), ONLINE)
def test_online_form_converges_to_the_grid_form(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    present = typical(model, effect)
    channel = getattr(effect, "channel", model.equations.outputs[0].name)
    row = [signal.name for signal in model.equations.outputs].index(channel)
    grid_form, state_form = compile_model(present), compile_model(present, online=True)
    added = effect.online_states if isinstance(effect, OnlineForm) else ()
    assert state_form.state_names == grid_form.state_names + tuple(signal.name for signal in added)
    start = online_start(state_form, effect, flight, float(fly_model(model, flight)[row][0]))
    differences = []
    for max_step in (0.02, 0.01, 0.005):
        finer = replace(flight, max_step=max_step)
        differences.append(np.max(np.abs(fly(grid_form, finer)[row] - fly(state_form, finer, x0=list(start))[row])))
    if not added:  # without memory the two are the same on a held input, whatever the step
        assert max(differences) < 1e-12 * np.max(np.abs(fly(grid_form, flight)[row]))
        return
    orders = np.log2(np.divide(differences[:-1], differences[1:]))
    assert differences[-1] < 1e-4 * np.max(np.abs(fly(grid_form, flight)[row]))
    assert np.all(orders > 1.8), f"order {orders}"


@pytest.mark.parametrize(("effect", "base"), ONLINE)
def test_online_form_is_the_identity_when_absent(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    for expected, got in zip(fly_model(model, flight), fly(compile_model(absent(model, effect), online=True), flight), strict=True):
        np.testing.assert_array_equal(got, expected)


@pytest.mark.parametrize(("effect", "base"), NO_STATE_FORM)
def test_running_online_without_a_state_form_names_the_effect(effect: Effect, base: str) -> None:
    model, _ = base_for(base)
    with pytest.raises(ModelError, match=re.escape(effect.name)):
        compile_model(model.with_effects(effect), online=True)


@pytest.mark.parametrize(("effect", "base"), [case for case in NO_STATE_FORM if isinstance(case.values[0], InputEffect)])
def test_a_held_input_effect_may_stay_online(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    present = typical(model, effect)
    held = present.with_parameters(present.parameters.hold([full_name(effect, item.name) for item in effect.parameters]))
    if isinstance(effect, Anticipating) and effect.anticipates:
        with pytest.raises(ModelError, match=f"{effect.name} needs the input's future"):
            compile_model(held, online=True)
        return
    for expected, got in zip(fly_model(present, flight), fly(compile_model(held, online=True), flight), strict=True):
        np.testing.assert_array_equal(got, expected)


def files() -> Iterator[str]:
    """Dotted names of the modules in the station folders and the folders in them, by file."""
    for path in sorted((ROOT / "sim" / "effects").glob("*/**/*.py")):
        if path.stem != "__init__" and path.parent.name != "guards":
            yield ".".join(path.relative_to(ROOT).with_suffix("").parts)


def test_every_file_of_the_station_folders_is_in_the_library() -> None:
    assert {module.__name__ for module in effect_modules()} == {*files()}


def test_every_effect_of_the_library_is_covered() -> None:
    covered = {effect for effect, _ in OFFERED}
    assert covered >= {*library()}, "a vehicle is missing from tests/offered.py and tests/bases.py"
    # Of what is made from a declaration one instance of every stem is flown.
    assert {effect.name.partition(":")[0] for effect in made()} <= {effect.name.partition(":")[0] for effect in covered - {*library()}}


@pytest.mark.parametrize("module", effect_modules(), ids=lambda module: module.__name__)
def test_lies_in_the_folder_of_its_station(module: ModuleType) -> None:
    """And each file has one effect, in whatever variants."""
    folder = module.__name__.split(".")[2]
    assert {effect.station.name.lower() for effect in module.VARIANTS} == {folder}
    assert len({effect.name.partition(":")[0] for effect in module.VARIANTS}) == 1


def test_a_new_file_is_a_new_effect(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sim.effects.input_path, "__path__", [*sim.effects.input_path.__path__, str(tmp_path)])
    (tmp_path / "input_twin.py").write_text("from sim.effects.input_path.input_delay import InputDelay\nVARIANTS = (InputDelay('twin'),)\n")
    assert any(getattr(effect, "signal", None) == "twin" for effect in library())
    (tmp_path / "input_void.py").write_text("")
    with pytest.raises(ModelError, match="input_void"):
        library()


def test_guards_stand_apart_from_the_library() -> None:
    names = {guard.name for guard, _ in OFFERED_GUARDS}
    products, loads = ("alpha-control", "control-squared", "alpha-q"), ("lagged-loads", "periodic-loads", "damping-curve", "drifting-derivatives")
    lateral = ("beta-rudder", "beta-aileron", "beta-p", "beta-r", "rudder-squared", "aileron-squared")
    labelled = ("damping-curve:p", "damping-curve:r", "drifting-derivatives:yaw", "drifting-derivatives:roll")
    assert names == {
        f"{GUARD}{label}" for label in (*products, *loads, *lateral, *labelled, "control-drag", "drag-drift", "hysteresis", "vane-behind")
    }
    assert names.isdisjoint(effect_names())
    assert all(case.values[0].traits.guard for case in GUARDS)  # type: ignore[union-attr]
    assert not any(effect.traits.guard or effect.name.startswith(GUARD) for effect in library() if isinstance(effect, Traceable))
    modules = {path.stem for path in (ROOT / "sim" / "effects" / "guards").glob("*.py")} - {"__init__"}
    assert {type(case.values[0]).__module__.rpartition(".")[2] for case in GUARDS} == modules
    with pytest.raises(ModelError):
        find_effect("guard:alpha-q")


def test_library_finds_by_name_and_by_vehicle() -> None:
    assert len(set(effect_names())) == len(effect_names())
    for name in effect_names():
        assert find_effect(name).name == name
    assert find_effect("elastic-mode").name == "elastic-mode"
    assert not applies(find_effect("gust-discrete"), Ballistic())
    assert find_effect("sensor-lag:altitude", Ballistic()) in effects_for(Ballistic())
    with pytest.raises(ModelError, match=r"sensor-lag:alpha, sensor-lag:q"):
        find_effect("sensor-lag", ShortPeriod())
    with pytest.raises(ModelError, match="did you mean 'input-delay'"):
        find_effect("input_dealy")
    with pytest.raises(ModelError, match="use one of"):
        find_effect("zzzz")


def test_an_effect_refuses_a_vehicle_without_its_port() -> None:
    model, _ = base_for("ballistic")
    with pytest.raises(ModelError, match=r"gust-discrete needs the port 'gust'.*log_density"):
        model.with_effects(find_effect("gust-discrete"))


def test_applies_reads_signal_channel_and_needs() -> None:
    vehicle = ShortPeriod()
    told = [({}, True), ({"signal": "stick"}, False), ({"channel": "nz"}, True), ({"needs": ("lift", "wind")}, False)]
    told += [({"rates_read": ("q",)}, True), ({"rates_read": ("r",)}, False)]
    for attributes, expected in told:
        assert applies(SimpleNamespace(**attributes), vehicle) is expected  # type: ignore[arg-type]
