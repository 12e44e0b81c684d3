"""Levels of the modes against printed roots, limits written a second time, Gaussian tails and drawn
aircraft.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pytest
from scipy.stats import norm

from ident.estimate import Estimate, Outcome
from ident.flying_qualities.levels import (
    CATEGORIES,
    CLASSES,
    DETERMINED_PROBABILITY,
    LEVEL_DRAWS,
    FlightPhase,
    ModeLevel,
    flight_phase_of,
    mode_levels,
    qualities,
)
from ident.flying_qualities.modes import Characteristics, characteristics, characteristics_at
from sim.declaration.compile import compile_model
from sim.declaration.model import System
from sim.errors import DeclarationError
from sim.vehicles.factory import model_of
from sim.vehicles.library import read_parameter_set
from tests.whole_axes import TRUE, true_model

SURE = 1e-9  # a standard deviation that decides nothing


def of(values: Mapping[str, float], std: float | Mapping[str, float] = SURE) -> Characteristics:
    spread = np.array([std if isinstance(std, float) else std.get(name, SURE) for name in values])
    return Characteristics(tuple(values), np.array([*values.values()]), np.diag(spread**2))


def by_mode(
    found: Characteristics, aircraft_class: str = "III", category: str = "B"
) -> dict[str, ModeLevel]:
    return {
        level.mode: level for level in mode_levels(found, FlightPhase(aircraft_class, category, ()))
    }


def dutch_roll(damping: float, frequency: float, ratio: float = 1.0) -> dict[str, float]:
    return {
        "dutch_roll_rate": 2.0 * damping * frequency,
        "dutch_roll_stiffness": frequency**2,
        "bank_ratio": ratio,
    }


def lateral(spiral: float, roll: float = -3.0) -> dict[str, float]:
    return {**dutch_roll(0.3, 2.0), "roll_root": roll, "spiral_root": spiral}


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # Dutch roll -0.0330 +- 0.947i: 0.033 rad/s where level 2 asks 0.05; roll mode 1.78 s where
        # level 1 asks 1.4; spiral stable.
        ("boeing747_lateral", {"Dutch roll": 3, "roll mode": 2, "spiral": 1}),
        # Phugoid -0.0033 +- 0.067i: damping ratio 0.049. Short period -0.37 +- 0.89i: 0.387.
        ("boeing747_longitudinal", {"short period": 1, "phugoid": 1}),
    ],
)
def test_a_textbook_aircraft_has_the_levels_of_its_printed_roots(
    name: str, expected: dict[str, int]
) -> None:
    system = compile_model(model_of(read_parameter_set(name)))
    found = by_mode(of(characteristics_at(system, system.parameters.values())))
    assert {mode: level.level for mode, level in found.items()} == expected
    assert all(level.probability > 0.999 and level.determined for level in found.values())


# Damping ratio, damping rate and frequency of level 1 by class and category, as table VI of
# MIL-F-8785C is reprinted.
FIRST = {
    **{(c, "A"): (0.19, 0.35, 1.0 if c in ("I", "IV") else 0.4) for c in CLASSES},
    **{(c, "B"): (0.08, 0.15, 0.4) for c in CLASSES},
    **{
        (c, "C"): (0.08, 0.15, 1.0) if c in ("I", "II-C", "IV") else (0.08, 0.10, 0.4)
        for c in CLASSES
    },
}


@pytest.mark.sampled
@pytest.mark.parametrize("aircraft_class", ["I", "II-C", "III"])
@pytest.mark.parametrize("category", CATEGORIES)
def test_limits_of_the_lateral_modes(aircraft_class: str, category: str) -> None:
    def level(values: Mapping[str, float], mode: str) -> int:
        return by_mode(of(values), aircraft_class, category)[mode].level

    damping, rate, frequency = FIRST[aircraft_class, category]
    w = max(frequency, rate / damping) * 1.5
    for factor, expected in ((1.01, 1), (0.99, 2)):
        assert level(dutch_roll(factor * damping, w), "Dutch roll") == expected
        slow = 1.2 * frequency
        assert level(dutch_roll(factor * max(damping, rate / slow), slow), "Dutch roll") == expected
        assert level(
            dutch_roll(2.0 * max(damping, rate / frequency), factor * frequency), "Dutch roll"
        ) == (expected if frequency > 0.4 or expected == 1 else 4)
    assert [level(dutch_roll(z, 4.0), "Dutch roll") for z in (0.021, 0.019, 0.001, -0.001)] == [
        2,
        3,
        3,
        4,
    ]
    quick = (category in "AC" and aircraft_class in ("I", "IV")) or (
        category == "C" and aircraft_class == "II-C"
    )
    first, second = (1.0, 1.4) if quick else (1.4, 3.0)
    times = (0.99 * first, 1.01 * first, 0.99 * second, 1.01 * second, 9.9, 10.1, -5.0)
    assert [level(lateral(0.0, -1.0 / time), "roll mode") for time in times] == [
        1,
        2,
        2,
        3,
        3,
        4,
        4,
    ]
    spiral = 20.0 if category == "B" else 12.0
    doubling = (1.01 * spiral, 0.99 * spiral, 8.1, 7.9, 4.1, 3.9, -1.0)
    assert [level(lateral(math.log(2.0) / time), "spiral") for time in doubling] == [
        1,
        2,
        2,
        3,
        3,
        4,
        1,
    ]


def test_a_dutch_roll_that_banks_much_is_asked_for_more_damping() -> None:
    """Frequency^2 |phi/beta| of 70 (rad/s)^2: 50 beyond 20, so 0.15 + 0.014 50 rad/s for level 1
    and 0.05 + 0.009 50 for level 2.
    """
    levels = [
        by_mode(of(dutch_roll(rate / 2.0, 2.0, 17.5)))["Dutch roll"]
        for rate in (0.86, 0.84, 0.51, 0.49)
    ]
    assert [level.level for level in levels] == [1, 2, 2, 3]
    assert levels[1].decided_by == "dutch_roll_damping_rate" and levels[1].limit == pytest.approx(
        0.85
    )
    assert by_mode(of(dutch_roll(0.084 / 2.0, 4.0, 1.2)))["Dutch roll"].level == 2, (
        "below 20 the table stands as it is"
    )


def test_limits_of_the_longitudinal_modes() -> None:
    def level(
        values: Mapping[str, float], mode: str, category: str = "A", aircraft_class: str = "III"
    ) -> int:
        return by_mode(of(values), aircraft_class, category)[mode].level

    def short(damping: float, frequency: float, slope: float) -> dict[str, float]:
        return {
            "short_period_rate": 2.0 * damping * frequency,
            "short_period_stiffness": frequency**2,
            "load_factor_slope": slope,
        }

    assert [
        level(short(z, 3.0, 10.0), "short period")
        for z in (0.36, 0.34, 0.24, 0.14, 1.29, 1.31, 2.1)
    ] == [1, 2, 3, 4, 1, 2, 3]
    assert [
        level(short(0.5, math.sqrt(10.0 * cap), 10.0), "short period")
        for cap in (0.29, 0.27, 3.5, 3.7, 10.1)
    ] == [1, 2, 1, 2, 3]
    assert [
        level(short(0.5, math.sqrt(2.2), 2.2), "short period", "C", c)
        for c in ("II-L", "III", "I", "IV", "II-C")
    ] == [1, 1, 2, 2, 2]
    slow = {"phugoid_stiffness": 0.01}
    assert [
        level({"phugoid_rate": 0.2 * z, **slow}, "phugoid") for z in (0.041, 0.039, 0.001, -0.001)
    ] == [1, 2, 2, 3]
    assert [
        level({"phugoid_rate": -2.0 * math.log(2.0) / time, **slow}, "phugoid")
        for time in (56.0, 54.0)
    ] == [3, 4]
    assert level({"phugoid_rate": 0.02, "phugoid_stiffness": -0.001}, "phugoid") == 4, (
        "a divergence that is no oscillation"
    )


@pytest.mark.parametrize("sigma", [0.002, 0.01, 0.05])
def test_probabilities_are_gaussian_tails(sigma: float) -> None:
    """Of a spiral, whose limits are limits of its root."""
    root = 0.03
    found = by_mode(of(lateral(root), {"spiral_root": sigma}))["spiral"]
    edges = [math.log(2.0) / time for time in (20.0, 8.0, 4.0)]
    below = np.array([0.0, *norm.cdf(edges, root, sigma), 1.0])
    assert found.probabilities == pytest.approx(
        np.diff(below), abs=4.0 * 0.5 / math.sqrt(LEVEL_DRAWS)
    )
    assert sum(found.probabilities) == pytest.approx(1.0) and found.probability == max(
        found.probabilities
    )
    assert found.determined == (max(np.diff(below)) > DETERMINED_PROBABILITY)


def test_a_delay_that_may_be_none_at_all_is_no_fault() -> None:
    """Draws below zero are of level 1; above, the limit of 0.1 s is the one that counts."""
    assert by_mode(of({"delay": 0.01}, 0.02))["delay"].probabilities == (1.0, 0.0, 0.0, 0.0)
    found = by_mode(of({"delay": 0.05}, 0.05))["delay"]
    assert (
        found.probabilities[0]
        == pytest.approx(norm.cdf(1.0), abs=4.0 * 0.5 / math.sqrt(LEVEL_DRAWS))
        and found.probabilities[3] < 1e-3
    )


def test_probabilities_are_shares_of_drawn_aircraft() -> None:
    """Derivatives known to 10 %: the damping of the Dutch roll crosses its limit in some of the
    aircraft.
    """
    system, estimate = drawn_estimate("lateral", 0.1)
    found = characteristics(system, estimate)
    assert found is not None
    level = by_mode(found, "I", "A")["Dutch roll"]
    rng, reached = np.random.default_rng(3), 0
    index, root = (
        [system.parameters.index(name) for name in estimate.names],
        np.linalg.cholesky(estimate.covariance),
    )
    for _ in range(600):
        p = system.parameters.values()
        p[index] = estimate.values + root @ rng.standard_normal(len(index))
        at = characteristics_at(system, p)
        w = math.sqrt(at["dutch_roll_stiffness"])
        reached += (
            at["dutch_roll_rate"] / (2.0 * w) >= 0.19
            and at["dutch_roll_rate"] / 2.0 >= 0.35
            and w >= 1.0
        )
    assert 0.2 < reached / 600 < 0.8, "the case is one that the data leave open"
    assert level.probabilities[0] == pytest.approx(
        reached / 600, abs=3.0 * 0.5 / math.sqrt(600) + 0.02
    )
    assert not level.determined


def drawn_estimate(model: str, share: float) -> tuple[System, Estimate]:
    system, names = compile_model(true_model(model)), tuple(TRUE[model])
    values = np.array([*TRUE[model].values()])
    return system, Estimate(
        "",
        names,
        ("",) * len(names),
        values,
        np.diag((share * values) ** 2),
        Outcome.CONVERGED,
        0.0,
        (),
        np.zeros(0),
        (),
    )


def test_load_factor_slope_is_that_of_the_closed_form() -> None:
    """With the low-order system's derivatives by another way, L_alpha for lift that angle of attack
    makes (a negative number there).
    """
    from scenarios.preparation.declared_model import model_of_file
    from tests.diagnoses import LOES

    system = compile_model(model_of_file(LOES))
    names = tuple(LOES.derivatives)
    estimate = Estimate(
        "",
        names,
        ("",) * len(names),
        np.array([*LOES.derivatives.values()]),
        np.eye(len(names)) * 1e-6,
        Outcome.CONVERGED,
        0.0,
        (),
        np.zeros(0),
        (),
    )
    found = characteristics(system, estimate)
    assert found is not None
    at = dict(zip(found.names, found.values, strict=True))
    closed = {
        q.name: q
        for q in qualities(estimate, LOES.constants["airspeed"], LOES.constants["gravity"])
    }
    assert at["load_factor_slope"] == pytest.approx(closed["load_factor_slope"].value, rel=1e-9)
    assert math.sqrt(at["short_period_stiffness"]) == pytest.approx(
        closed["natural_frequency"].value, rel=1e-9
    )
    std = dict(zip(found.names, np.sqrt(np.diag(found.covariance)), strict=True))
    assert std["load_factor_slope"] == pytest.approx(closed["load_factor_slope"].std, rel=1e-6)
    assert at["delay"] == LOES.derivatives["delay"] and std["delay"] == pytest.approx(1e-3)


def test_what_the_data_leave_open_has_no_level() -> None:
    system, estimate = drawn_estimate("longitudinal", 0.01)
    assert characteristics(system, estimate) is not None
    open_one = Estimate(
        "",
        estimate.names,
        estimate.units,
        estimate.values,
        estimate.covariance,
        Outcome.NOT_IDENTIFIABLE,
        0.0,
        (),
        np.zeros(0),
        (),
    )
    assert characteristics(system, open_one) is None


def test_class_and_category() -> None:
    assert flight_phase_of("ii", "c") == FlightPhase("II-L", "C", ()) and flight_phase_of(
        None, "A"
    ).assumed == ("class",)
    assert flight_phase_of(None, None) == FlightPhase()
    with pytest.raises(DeclarationError, match="there is no class 'V'; use I, II, III or IV"):
        flight_phase_of("V", None)
    with pytest.raises(DeclarationError, match=r"there is no category 'D'; use A \(rapid"):
        flight_phase_of(None, "D")


def test_an_aircraft_too_light_for_a_crew_has_no_class_unless_it_is_declared() -> None:
    assert flight_phase_of(None, None, 3.2).uncrewed_mass == 3.2
    assert flight_phase_of("I", None, 3.2).uncrewed_mass is None
    assert flight_phase_of(None, None, 700.0) == FlightPhase()
