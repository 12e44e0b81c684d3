"""What the paper leaves open of the margins: loops fitted to its equivalents, and what is said of
them.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from scenarios.x29.open_margins import (
    AIRFRAMES,
    CHI_SQUARE_95,
    EVERYTHING,
    MATCHED,
    OPEN,
    Beginning,
    MarginDesign,
    OpenMargins,
    PrintedTarget,
    beginning,
    changed,
    equivalent_of,
    has_equivalent,
    hypercube,
    loop_at_values,
    margins_content,
    margins_sentence,
    match,
    open_margins,
    simulated_loop,
    targets,
    values_at,
)
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import equivalent_system, margins
from tests.oracles.x29_frequency import returned


@cache
def start() -> tuple[dict[str, PrintedTarget], Beginning]:
    goal = targets("flight")
    return goal, beginning(load_x29("F"), goal)


@cache
def study() -> OpenMargins:
    return open_margins(load_x29("S"), load_x29("F"), 2, 1, -4.5)


def test_sigmas_are_the_scatter_of_the_papers_three_estimates_or_its_own() -> None:
    flight = targets("flight")
    printed = (-8.95, -8.42, -8.31)
    assert flight["M_alpha"].std == pytest.approx(
        np.std(printed, ddof=1) / abs(np.mean(printed)) * 8.95
    )
    assert flight["L_alpha"].std == pytest.approx(np.sqrt(0.725e-4)), (
        "three nearly equal estimates: the printed sigma is the larger"
    )
    assert tuple(flight) == MATCHED and targets("simulation")["M_q"].value == -2.99


def test_the_middle_of_all_ranges_is_the_aircraft_as_declared() -> None:
    values = values_at(np.zeros(len(OPEN)))
    for name, loop_of in (("S", simulated_loop), ("F", loop_at_values)):
        x29 = load_x29(name)
        same, late = loop_of(x29, values)
        assert late == pytest.approx(x29.frame)
        assert same.airframe.M_q == pytest.approx(
            x29.airframe.M_q
        ) and same.airframe.L_surface == pytest.approx(x29.airframe.L_surface)
        assert [each.ram for each in same.surfaces] == pytest.approx(
            [each.ram for each in x29.surfaces]
        )
    for item in OPEN:
        assert (item.at(-1.0), item.at(1.0)) == pytest.approx((item.low, item.high))
        assert item.at(0.0) == pytest.approx(
            np.sqrt(item.low * item.high) if item.ratio else 0.5 * (item.low + item.high)
        )


def test_the_hypercube_meets_each_range_evenly() -> None:
    places = hypercube(16, 3)
    for column in places.T:
        assert sorted(np.floor(8.0 * (column + 1.0)).astype(int)) == list(range(16))


@pytest.mark.long
def test_a_fitted_airframe_is_the_least_squares_one_and_has_the_equivalent() -> None:
    goal, begin = start()
    places = np.array([0.2, -0.2, 0.1, 0.0, 0.3, 0.2, 0.1, -0.1])
    x29, late = loop_at_values(load_x29("F"), values_at(places))
    found = match(x29, late, goal, begin)
    # Second search, begun beside it: nested, by SciPy with its own slopes. It finds the same sum of
    # squares and no better one.
    best = least_squares(
        lambda p: [
            (
                getattr(equivalent_of(changed(x29, p), late, found.equivalent), name)
                - goal[name].value
            )
            / goal[name].std
            for name in MATCHED
        ],
        found.parameters * np.array([1.002, 1.05, 0.98, 1.05]),
        x_scale=np.array([0.1, 3.0, 0.1, 0.01]),
        diff_step=1e-4,
        method="lm",
        max_nfev=60,
    )
    assert found.plausible and found.misfit == pytest.approx(2.0 * best.cost, abs=0.02)


def test_margins_of_a_fitted_loop_are_those_of_the_oracle() -> None:
    goal, begin = start()
    x29 = load_x29("F")
    found = match(replace(x29, airframe=replace(x29.airframe, M_q=-1.2)), x29.frame, goal, begin)
    loop = equivalent_system(found.x29)
    assert [getattr(loop, name) for name in MATCHED] == pytest.approx(
        [getattr(found.equivalent, name) for name in MATCHED], rel=1e-5
    )
    at = returned(found.x29, np.array([found.margins.crossover]))[0]
    assert abs(at) == pytest.approx(1.0, abs=1e-4) and np.degrees(np.angle(-at)) == pytest.approx(
        found.margins.phase, abs=0.01
    )
    assert found.margins.phase > margins(x29).phase, (
        "more damping of the airframe, and a larger margin"
    )


@pytest.mark.long
def test_airframe_d_has_the_papers_equivalent_and_its_sign() -> None:
    d, goal = load_x29("D"), targets("flight")
    loop = equivalent_system(d)
    assert (
        sum(
            ((getattr(loop, name) - target.value) / target.std) ** 2
            for name, target in goal.items()
        )
        < CHI_SQUARE_95
    )
    assert has_equivalent(d, goal) and not has_equivalent(load_x29("S"), goal)
    assert 0.84 < loop.damping_ratio < 0.92 and loop.natural_frequency == pytest.approx(
        4.6965, rel=0.02
    )
    assert loop.delay == pytest.approx(equivalent_system(load_x29("F")).delay, abs=0.001)
    phases = {name: margins(load_x29(name)).phase for name in ("S", "F", "D")}
    assert phases["F"] < phases["S"] < phases["D"]


def test_the_study_fits_both_aircraft_at_every_point() -> None:
    found = study()
    alone, everything = found.designs
    assert (alone.name, everything.name) == (AIRFRAMES, EVERYTHING)
    np.testing.assert_array_equal(alone.simulation, everything.simulation)
    np.testing.assert_array_equal(alone.places[:, :6], everything.places[:, :6])
    assert np.all(alone.places[:, 6:] == 0.0) and alone.plausible.any()
    assert found.effects == {}, "no straight line through so few"
    content = margins_content(found)
    assert content["designs"][0]["points"] == 2 and "effects_deg" not in content


def straight(middle: float, slope: float, samples: int = 40) -> OpenMargins:
    """A study whose differences are a straight line in the flight's damping, made by hand."""
    places = hypercube(samples, 5)
    simulation = np.full(samples, 37.0)
    flight = simulation + middle + slope * places[:, 4]
    design = MarginDesign(EVERYTHING, places, simulation, flight, np.ones(samples, dtype=bool))
    effects = {item.name: slope if item.name == "damping_flight" else 0.0 for item in OPEN}
    return OpenMargins(5, (design,), middle, middle, effects, 1.0)


def test_what_is_said_follows_the_points() -> None:
    mixed = straight(-2.0, 4.0)
    assert (
        mixed.turning("damping_flight") == pytest.approx(2.0**0.5)
        and mixed.turning("surfaces_flight") is None
    )
    said = margins_sentence(mixed)
    assert (
        f"in {mixed.designs[0].larger} of 40" in said
        and "do not decide the sign" in said
        and "pitch damping, flight, times 1.41" in said
    )
    never = margins_sentence(straight(-9.0, 4.0))
    assert (
        "none of these has the published sign" in never
        and "decide" not in never
        and "by itself" not in never
    )
    assert "all of these have the published sign" in margins_sentence(straight(9.0, 4.0))
    nothing = replace(mixed.designs[0], plausible=np.zeros(40, dtype=bool))
    assert "no point has the published equivalents" in margins_sentence(
        replace(mixed, designs=(nothing,), effects={})
    )
