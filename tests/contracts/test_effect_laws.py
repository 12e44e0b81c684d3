"""Laws that every effect of the library obeys when it is flown. A new effect is covered as soon as
its file is there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, NoiseEffect, Regularity, full_name
from sim.declaration.model import Model
from sim.declaration.proposal import SearchContext, Traceable
from sim.effects.dynamics.structural_mode import StructuralMode
from sim.effects.sensor_path.sensor_calibration import SensorCurve
from sim.maths import COMPLEX_STEP
from sim.propagation import drive_from_record, make_grid, outputs_at_samples, rk4_step
from sim.record import Hold
from sim.truth.flight import propagate_with_process_noise
from tests.bases import Flight, base_for, fly, fly_model
from tests.effect_cases import CASES, HOLDS, absent, every_case, typical


def fly_roughly(model: Model, flight: Flight) -> list[np.ndarray]:
    """Outputs of a model with its process noise acting, one draw."""
    system, grid = compile_model(model), make_grid(flight.time, flight.max_step)
    p = system.parameters.values().tolist()
    drive = drive_from_record(system, p, flight.u, flight.time, flight.hold, grid)
    densities = {
        name: value
        for name, value in zip(system.state_names, system.noise(p)[0], strict=True)
        if value > 0
    }
    states, _ = propagate_with_process_noise(
        system, p, drive, grid, rk4_step, densities, {}, np.random.default_rng(1)
    )
    return outputs_at_samples(system, p, states, drive, grid)


STEP = 1e-8  # one-sided: less than a play is from the turns of a slow motion


@every_case
@HOLDS
def test_absent_is_the_base_model_bit_for_bit(effect: Effect, base: str, hold: Hold) -> None:
    model, flight = base_for(base)
    # Uneven sampling and a rich input: sums over cells must not round either.
    generator = np.random.default_rng(1)
    time = np.sort(
        flight.time
        + generator.uniform(0.0, 0.3, flight.time.size)
        * np.diff(flight.time, append=flight.time[-1] + 0.02)
    )
    flight = replace(
        flight, time=time, u=0.1 * generator.standard_normal(flight.u.shape), hold=hold
    )
    for expected, got in zip(
        fly_model(model, flight), fly_model(absent(model, effect), flight), strict=True
    ):
        np.testing.assert_array_equal(got, expected)


@every_case
def test_is_visible_at_its_typical_value(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    without = fly_model(model, flight)
    # what a bent reading is believed to be depends on how far the channel goes
    if isinstance(effect, SensorCurve):
        flown = {
            signal.name: (float(y.min()), float(y.max()))
            for signal, y in zip(model.equations.outputs, without, strict=True)
        }
        effect = effect.fitted_to(SearchContext(0.0, 9.0, 0.02, flown=flown))
    present = (
        fly_roughly(typical(model, effect), flight)
        if isinstance(effect, NoiseEffect)
        else fly_model(typical(model, effect), flight)
    )
    pairs = zip(model.equations.outputs, without, present, strict=True)
    shares = [
        np.max(np.abs(b - a)) / model.noise.measurement_std[signal.name] for signal, a, b in pairs
    ]
    assert max(shares) > 1.0, "at a typical value an effect stands out of the noise in some output"


@pytest.mark.parametrize(
    ("effect", "base"), [case for case in CASES if isinstance(case.values[0], NoiseEffect)]
)
def test_process_noise_leaves_the_simulation_alone_and_ends_where_absent(
    effect: Effect, base: str
) -> None:
    model, flight = base_for(base)
    for expected, got in zip(
        fly_model(model, flight), fly_model(typical(model, effect), flight), strict=True
    ):
        np.testing.assert_array_equal(got, expected)
    assert effect.regularity is Regularity.PROCESS_NOISE
    present, gone = (
        compile_model(chosen) for chosen in (typical(model, effect), absent(model, effect))
    )
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
            np.testing.assert_allclose(
                got,
                expected,
                rtol=1e-5,
                atol=1e-6 * np.max(np.abs(expected)) + 10.0 * noise,
                err_msg=item.name,
            )


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
        p[index] = values[index] + STEP
        for got, low, high in zip(exact, before, fly(system, flight, p), strict=True):
            scale = np.max(np.abs(got)) + 1e-11 * np.max(np.abs(low)) / STEP
            np.testing.assert_allclose(
                got, (high - low) / STEP, rtol=0.0, atol=1e-3 * scale, err_msg=local
            )


@every_case
def test_batch_is_one_by_one(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    system = compile_model(typical(model, effect))
    factors = np.array([1.0, 0.7, 1.3])
    batch = [
        value * factors if system.parameters.items[i].name != "gravity" else value
        for i, value in enumerate(system.parameters.values())
    ]
    together = fly(system, flight, batch)
    for run in range(factors.size):
        alone = fly(
            system,
            flight,
            [float(value[run]) if np.ndim(value) else float(value) for value in batch],
        )
        for got, expected in zip(together, alone, strict=True):
            np.testing.assert_allclose(
                got[:, run], expected, rtol=1e-11, atol=1e-12 * np.max(np.abs(expected))
            )


@every_case
def test_only_the_effect_in_batch_is_one_by_one(effect: Effect, base: str) -> None:
    model, flight = base_for(base)
    system = compile_model(typical(model, effect))
    own = {full_name(effect, item.name) for item in effect.parameters}
    free = {item.name for item in system.parameters if item.free} & own
    factors = np.array([1.0, 0.9])
    values = system.parameters.values()
    batch = [
        value * factors if name in free else value
        for name, value in zip(system.parameters.names, values, strict=True)
    ]
    together = fly(system, flight, batch)
    for run in range(factors.size):
        alone = fly(
            system,
            flight,
            [float(value[run]) if np.ndim(value) else float(value) for value in batch],
        )
        for got, expected in zip(together, alone, strict=True):
            np.testing.assert_allclose(
                np.broadcast_to(got.T, (2, len(expected)))[run],
                expected,
                rtol=1e-11,
                atol=1e-12 * np.max(np.abs(expected)),
            )


@every_case
def test_probes_are_complete_and_within_bounds(effect: Effect, base: str) -> None:
    if isinstance(effect, StructuralMode):
        return  # a part of a flexible vehicle, declared with it: no search proposes it
    assert isinstance(effect, Traceable)
    model, flight = base_for(base)
    peak = {
        signal.name: float(np.max(np.abs(row)))
        for signal, row in zip(model.equations.inputs, flight.u, strict=True)
    }
    rate = {signal: 50.0 * value for signal, value in peak.items()}
    states = {"alpha": 0.2, "q": 0.3, "nz": 2.0}
    context = SearchContext(
        3.0,
        9.0,
        0.02,
        input_peak=peak,
        input_rate=rate,
        state_peak=states,
        residual_peaks=(9.0, 14.0),
        airspeed=150.0,
    )
    items = {item.name: item for item in effect.parameters}
    assert effect.traits.onset in ("", *items) and set(effect.traits.plausible) <= set(items)
    for name, (low, high) in effect.traits.plausible.items():
        assert items[name].bounds[0] <= low <= items[name].value <= high <= items[name].bounds[1]
    for probe in effect.probes(context):
        assert set(probe.values) == set(items) and set(probe.slopes) <= {
            item.name for item in effect.parameters if item.free
        }
        for name, value in probe.values.items():
            assert items[name].bounds[0] <= value <= items[name].bounds[1]
        if not probe.slopes:
            assert any(probe.values[name] != value for name, value in effect.absent.items()), (
                "a whole change needs a place where the effect acts"
            )
