"""Dutch roll, roll, spiral, short period and phugoid against equations written again; their sigmas
against drawn parameters.
"""

from __future__ import annotations

import math

import numpy as np
import pytest

from ident.estimate import Estimate, Outcome
from ident.flying_qualities.modes import (
    MODAL_UNITS,
    lateral_modes,
    level_flight,
    longitudinal_modes,
    modal_estimate,
)
from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.vehicles.factory import model_from_constants, model_of
from sim.vehicles.library import read_parameter_set
from tests.oracles.whole_axis_modes import lateral_roots, longitudinal_roots
from tests.whole_axes import CONSTANTS, TRUE, trim, true_model


def system_of(model: str, **changed: float) -> System:
    return compile_model(model_from_constants(model, CONSTANTS[model], {**TRUE[model], **changed}))


def test_lateral_modes() -> None:
    system = system_of("lateral")
    found = lateral_modes(system, system.parameters.values())
    roots = lateral_roots(CONSTANTS["lateral"], TRUE["lateral"])
    dutch = next(root for root in roots if root.imag > 0.0)
    spiral, roll = sorted((root.real for root in roots if abs(root.imag) < 1e-9), key=abs)
    assert found["dutch_roll_frequency"] == pytest.approx(abs(dutch), rel=1e-9)
    assert found["dutch_roll_damping"] == pytest.approx(-dutch.real / abs(dutch), rel=1e-9)
    assert (
        found["roll_time_constant"] == pytest.approx(-1.0 / roll, rel=1e-9)
        and 0.1 < found["roll_time_constant"] < 1.0
    )
    assert found["spiral_time_constant"] == pytest.approx(-1.0 / spiral, rel=1e-6)


# Roots printed by Etkin and Reid for the Boeing 747 (tables 6.2 and 6.7), whose constants have
# three to four digits.
OSCILLATIONS = {
    "boeing747_lateral": {"dutch_roll": complex(-0.033011, 0.94655)},
    "boeing747_longitudinal": {
        "phugoid": complex(-0.003289, 0.06723),
        "short_period": complex(-0.3719, 0.8875),
    },
}
REAL = {"roll_time_constant": -0.56248, "spiral_time_constant": -0.0072973}


@pytest.mark.parametrize("name", list(OSCILLATIONS))
def test_a_textbook_aircraft_has_the_printed_modes(name: str) -> None:
    system = compile_model(model_of(read_parameter_set(name)))
    found = (lateral_modes if "lateral" in name else longitudinal_modes)(
        system, system.parameters.values()
    )
    for mode, root in OSCILLATIONS[name].items():
        assert found[f"{mode}_frequency"] == pytest.approx(abs(root), rel=0.005)
        assert found[f"{mode}_damping"] == pytest.approx(-root.real / abs(root), rel=0.01)
    for mode, real in REAL.items() if "lateral" in name else ():
        assert found[mode] == pytest.approx(-1.0 / real, rel=0.01)


def test_a_spiral_that_grows_has_a_negative_time_constant() -> None:
    """Stable if and only if Cl_beta Cn_r > Cn_beta Cl_r in level flight; what is at stake is the
    sign of the determinant.
    """
    for rolling in (-0.3, -0.01):
        system = system_of("lateral", Cl_beta=rolling)
        c, d = CONSTANTS["lateral"], {**TRUE["lateral"], "Cl_beta": rolling}
        stable = np.prod(lateral_roots(c, d)).real > 0.0
        assert stable == (rolling == -0.3)
        assert (
            lateral_modes(system, system.parameters.values())["spiral_time_constant"] > 0.0
        ) == stable


def test_roll_and_spiral_as_one_oscillation_have_no_time_constants() -> None:
    system = system_of("lateral", Cl_p=-0.05, Cl_r=-0.3)
    roots = lateral_roots(CONSTANTS["lateral"], {**TRUE["lateral"], "Cl_p": -0.05, "Cl_r": -0.3})
    pairs = sorted((root for root in roots if root.imag > 1e-9), key=abs)
    assert len(pairs) == 2
    found = lateral_modes(system, system.parameters.values())
    assert set(found) == {"dutch_roll_frequency", "dutch_roll_damping"}
    assert found["dutch_roll_frequency"] == pytest.approx(abs(pairs[1]), rel=1e-9)


def test_longitudinal_modes() -> None:
    system = system_of("longitudinal")
    found = longitudinal_modes(system, system.parameters.values())
    roots = longitudinal_roots(CONSTANTS["longitudinal"], TRUE["longitudinal"], trim())
    slow, fast = sorted((root for root in roots if root.imag > 0.0), key=abs)
    for name, root in (("phugoid", slow), ("short_period", fast)):
        assert found[f"{name}_frequency"] == pytest.approx(abs(root), rel=1e-5)
        assert found[f"{name}_damping"] == pytest.approx(-root.real / abs(root), rel=1e-4)
    # Lanchester's phugoid; its damping by Bairstow is D/L over sqrt 2.
    assert found["phugoid_frequency"] == pytest.approx(math.sqrt(2.0) * 9.80665 / 62.0, rel=0.15)


def test_level_flight_is_that_of_another_solver() -> None:
    system = system_of("longitudinal")
    flight = level_flight(system, system.parameters.values())
    assert flight is not None
    x, u = flight
    alpha, elevator, thrust = trim()
    assert x == pytest.approx([62.0, alpha, alpha, 0.0], rel=1e-9) and u == pytest.approx(
        [elevator, thrust], rel=1e-9
    )


def test_without_an_elevator_that_turns_there_is_no_level_flight() -> None:
    system = system_of("longitudinal", Cm_de=0.0, CL_de=0.0)
    assert (
        level_flight(system, system.parameters.values()) is None
        and longitudinal_modes(system, system.parameters.values()) == {}
    )


def test_a_short_period_that_does_not_oscillate_is_left_out() -> None:
    system = system_of("longitudinal", Cm_alpha=-0.02, Cm_q=-40.0)
    assert set(longitudinal_modes(system, system.parameters.values())) == {
        "phugoid_frequency",
        "phugoid_damping",
    }


@pytest.mark.parametrize("model", list(TRUE))
def test_sigmas_are_the_scatter_of_drawn_parameters(model: str) -> None:
    rng = np.random.default_rng(5)
    system = compile_model(true_model(model))
    names = tuple(TRUE[model])
    values, std = np.array(list(TRUE[model].values())), 0.004 * np.abs(list(TRUE[model].values()))
    mixed = np.eye(len(names)) + 0.3 * rng.standard_normal((len(names), len(names)))
    root = std[:, None] * mixed / np.linalg.norm(mixed, axis=1)[:, None]
    estimate = Estimate(
        "",
        names,
        ("",) * len(names),
        values,
        root @ root.T,
        Outcome.CONVERGED,
        0.0,
        (),
        np.zeros(0),
        (),
    )
    found = modal_estimate(system, estimate)
    assert set(found) <= set(MODAL_UNITS) and len(found) == 4
    modes, index = (
        (lateral_modes if model == "lateral" else longitudinal_modes),
        [system.parameters.index(name) for name in names],
    )
    drawn: dict[str, list[float]] = {name: [] for name in found}
    for _ in range(400):
        p = system.parameters.values()
        p[index] = values + root @ rng.standard_normal(len(names))
        each = modes(system, p)
        for name, row in drawn.items():
            row.append(each[name])
    for name, (_, sigma) in found.items():
        # The root of a variance from 400 draws is known to 3.5 %; a spiral is far from linear in
        # its derivatives.
        expected = np.percentile(drawn[name], [16.0, 84.0]) @ [-0.5, 0.5]
        assert sigma == pytest.approx(expected, rel=0.2), name
