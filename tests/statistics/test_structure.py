"""Structure over many maneuvers: an envelope flown by JSBSim, and how often sigmas are right."""

from __future__ import annotations

import time as clock

import numpy as np
import pytest

from ident.structure.coefficients import Airframe, histories_of
from ident.structure.selection import select
from scenarios.structure.study import StructureOptions, coefficients_of, structure_of
from sim.aerodynamics.terms import Term
from sim.record import Channel, Hold, Record
from sim.vehicles.aircraft import DEFAULTS, Aircraft
from tests.unit.ident.structure import test_selection as known

SURFACES = ("elevator", "aileron", "rudder")
NOISE = {
    "airspeed": ("m/s", 0.1),
    **dict.fromkeys(("alpha", "beta"), ("rad", 1e-3)),
    **dict.fromkeys(("p", "q", "r"), ("rad/s", 1e-3)),
    **dict.fromkeys(("ax", "ay"), ("m/s2", 0.02)),
    "az": ("m/s2", 0.05),
}


def _wave(time: np.ndarray, size: float, rng: np.random.Generator) -> np.ndarray:
    frequency = np.array([0.1, 0.2, 0.35, 0.55, 0.8, 1.1]) * rng.uniform(0.85, 1.15, 6)
    phase = rng.uniform(0.0, 2.0 * np.pi, 6)
    sines = np.sin(2.0 * np.pi * np.outer(time, frequency) + phase)
    return np.asarray(size * np.minimum(time / 2.0, 1.0) * sines.sum(axis=1) / np.sqrt(3.0))


def _maneuver(number: int) -> tuple[Record, Aircraft]:
    """An airliner between 170 and 215 m/s and 0.5 and 3 km, surfaces moved at once."""
    machine = pytest.importorskip("scenarios.trials.jsbsim.machine")
    rng = np.random.default_rng(number)
    speed = 170.0 + 45.0 * ((7 * number) % 30) / 29.0
    height = 500.0 + 2500.0 * ((11 * number) % 30) / 29.0
    time = 0.01 * np.arange(2401)
    sizes = dict(zip(SURFACES, (0.035, 0.05, 0.06), strict=True))
    wanted = {name: _wave(time, size, rng) for name, size in sizes.items()}
    flown = machine.fly(machine.Condition("A320", height, speed, 0.01), wanted, 0.3)
    noise = np.random.default_rng(1000 + number)
    outputs = []
    for name, (unit, std) in NOISE.items():
        row = flown[f"force_{name[1]}"] / flown["mass"] if unit == "m/s2" else flown[name]
        rough = row[::4] + std * noise.standard_normal(len(time[::4]))
        outputs.append(Channel.of(name, unit, rough))
    inputs = [Channel.of(name, "rad", flown[name][::4]) for name in SURFACES]
    inputs.append(Channel.of("thrust", "N", flown["thrust"][::4]))
    inputs.append(Channel.of("air_density", "kg/m3", flown["air_density"][::4]))
    record = Record(time[::4], tuple(inputs), tuple(outputs), Hold.LINEAR, f"m{number}")
    body = {**DEFAULTS, **vars(flown.body), "air_density": 1.0}
    axes = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
    plain = {axis: {Term(): 0.0} for axis in axes}
    surfaces = dict.fromkeys(SURFACES, "rad")
    return record, Aircraft("A320", body, surfaces, plain, varying=("air_density",))


@pytest.mark.slow
def test_thirty_maneuvers_of_an_envelope_in_one_model() -> None:
    flown = [_maneuver(number) for number in range(30)]
    records, aircraft = [record for record, _ in flown], flown[0][1]
    begun = clock.process_time()
    found = structure_of(records[:20], aircraft, StructureOptions())
    assert clock.process_time() - begun < 60.0
    assert "abs(elevator)" in {term.text for term in found.aircraft.coefficients["CX"]}
    for axis, table in found.aircraft.coefficients.items():
        error = noise = 0.0
        for record in records[20:]:
            history = coefficients_of(record, aircraft)
            model = sum(value * history.column(term, axis) for term, value in table.items())
            error += float(np.sum((history.coefficients[axis] - model) ** 2))
            through = history.noise_through(table, axis)
            noise += float(np.sum(history.sigma[axis] ** 2 + through))
        assert np.sqrt(error / noise) < 1.3, axis


def test_two_sigma_intervals_of_coefficients_hold_the_truth() -> None:
    held = []
    airframe = Airframe(known.CURVED.constants, known.CURVED.sensors, wind_axes=True)
    for run in range(20):
        histories = []
        for seed in (1, 2, 3):
            time, u, rows = known.clean(seed)
            rng = np.random.default_rng(1000 * run + seed)
            channels = {
                name: rows[name] + std * rng.standard_normal(len(time))
                for name, std in known.NOISE.items()
            }
            surfaces = dict(zip(known.CURVED.surfaces, u[:3], strict=True))
            histories.append(
                histories_of(f"m{seed}", time, channels, airframe, surfaces, u[3], held=True)
            )
        for axis, table in known.CURVED.coefficients.items():
            found = select(histories, axis, (Term(), *(term for term in table if term.factors)))
            for term, value, sigma in zip(found.terms, found.values, found.sigma, strict=True):
                held.append(abs(value - table.get(term, 0.0)) < 2.0 * sigma)
    assert len(held) > 500 and 0.93 < np.mean(held) < 0.975
