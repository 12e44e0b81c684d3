"""The standard record of the sampled closed loop: bank, refined delay and spectral check against
the loop's own equivalent system.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from ident.banks.delays import DelayBank, run_delay_bank
from ident.flying_qualities.levels import qualities
from ident.frequency_response.model_fit import estimate_response, fit_response
from ident.statistics.noise_levels import noise_envelope
from ident.statistics.residuals import compare_estimates
from scenarios.identification.low_order import PAPER_START, SIMULATION_SHARE, loes_filter_system
from sim.closed_loop.airframe import X29, load_x29
from sim.closed_loop.linear import EquivalentSystem, equivalent_system
from sim.closed_loop.nonlinear import fly_closed_loop, three_two_one_one
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.record import Record
from sim.vehicles.factory import model_from_constants
from tests.density_choice import choose_density

DENSITY = {"q": 1e-6}  # what the rule finds on the simulation's record, see below
# s: the loop's own response is taken from frame to frame, the record's stick is held in between
HALF_HOLD = 0.006


@dataclass(frozen=True, eq=False)
class Case:
    """An airframe, its standard record, what the filter found, and the loop's own equivalent."""

    x29: X29
    record: Record
    found: DelayBank
    expected: EquivalentSystem


def model(x29: X29, start: dict[str, float]) -> Model:
    constants = {
        "airspeed": x29.airframe.airspeed,
        "gravity": x29.airframe.gravity,
        "vane_arm": x29.telemetry.vane_arm,
    }
    return model_from_constants("loes", constants, start)


def fly(x29: X29, rng: np.random.Generator | None) -> Record:
    return fly_closed_loop(x29, three_two_one_one(1.0, 0.5, 1.0), 20.0, rng)[0]


def flight_noise(x29: X29) -> dict[str, float]:
    return {
        "alpha": x29.telemetry.alpha_noise,
        "q": x29.telemetry.q_noise,
        "nz": x29.telemetry.nz_noise,
    }


@pytest.fixture(scope="module")
def simulation() -> Case:
    x29 = load_x29("S")
    record = fly(x29, None)
    noise = {name: SIMULATION_SHARE * std for name, std in flight_noise(x29).items()}
    found = run_delay_bank(
        record, loes_filter_system(model(x29, PAPER_START), record, noise, DENSITY)
    )
    return Case(x29, record, found, equivalent_system(x29))


@pytest.fixture(scope="module")
def flight(simulation: Case) -> Case:
    x29 = load_x29("F")
    record = fly(x29, np.random.default_rng(1))
    start = {name: simulation.found.estimate.value(name) for name in PAPER_START}
    found = run_delay_bank(
        record, loes_filter_system(model(x29, start), record, noise_envelope(record), DENSITY)
    )
    return Case(x29, record, found, equivalent_system(x29))


@pytest.fixture(params=[("simulation", 0.10), ("flight", 0.20)], ids=["S", "F"])
def case(request: pytest.FixtureRequest) -> tuple[Case, float]:
    name, share = request.param
    return request.getfixturevalue(name), share


@pytest.mark.long
def test_filter_agrees_with_the_loops_own_equivalent(case: tuple[Case, float]) -> None:
    flown, share = case
    estimate = flown.found.estimate
    for name in ("L_alpha", "M_alpha", "M_delta", "M_q"):
        assert estimate.value(name) == pytest.approx(getattr(flown.expected, name), rel=share), name
    found = {
        quality.name: quality.value
        for quality in qualities(estimate, flown.x29.airframe.airspeed, flown.x29.airframe.gravity)
    }
    assert found["natural_frequency"] == pytest.approx(flown.expected.natural_frequency, rel=0.05)
    assert found["damping_ratio"] == pytest.approx(flown.expected.damping_ratio, abs=0.05)
    assert flown.found.refined == pytest.approx(flown.expected.delay, abs=0.015)
    assert flown.found.refined + HALF_HOLD == pytest.approx(flown.expected.delay, abs=0.004)


@pytest.mark.long
def test_the_control_lift_is_not_identifiable_and_shows_it(flight: Case) -> None:
    estimate = flight.found.estimate
    i, j = estimate.names.index("L_delta"), estimate.names.index("L_q")
    assert abs(estimate.values[i]) < 2.0 * estimate.std[i]
    assert abs(estimate.correlation[i, j]) > 0.8


def test_spectral_estimate_agrees_on_delay_and_damping(flight: Case) -> None:
    x29 = flight.x29
    system = compile_model(
        model(x29, {**PAPER_START, "delay": 0.1}).with_noise(Noise(flight_noise(x29)))
    )
    fit = fit_response(
        estimate_response(flight.record),
        system,
        ("L_alpha", "M_alpha", "L_delta", "M_delta", "M_q", "inv_tau", "delay"),
    )
    v = {**fit.values, "L_q": PAPER_START["L_q"]}
    frequency = np.sqrt(v["L_alpha"] * v["M_q"] - v["L_q"] * v["M_alpha"])
    assert fit.converged
    assert v["delay"] == pytest.approx(flight.expected.delay, abs=0.015)
    assert -(v["L_alpha"] + v["M_q"]) / (2.0 * frequency) == pytest.approx(
        flight.expected.damping_ratio, abs=0.06
    )


def test_simulation_and_flight_differ_where_the_airframes_do(
    simulation: Case, flight: Case
) -> None:
    beyond = {
        item.name
        for item in compare_estimates(simulation.found.estimate, flight.found.estimate).beyond
    }
    assert {"L_alpha", "M_alpha", "M_q", "delay"} <= beyond
    assert not beyond & {"L_delta", "L_q", "nz_0"}


def test_the_rule_for_process_noise_finds_what_is_used(simulation: Case) -> None:
    noise = {name: SIMULATION_SHARE * std for name, std in flight_noise(simulation.x29).items()}
    declared = model(simulation.x29, PAPER_START)
    found = choose_density(
        simulation.record,
        lambda d: loes_filter_system(declared, simulation.record, noise, {"q": d}),
        (1e-7, 1e-6, 1e-5),
        delays=(0.1125, 0.125),
    )
    assert found.chosen == DENSITY["q"]
