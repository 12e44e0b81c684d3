"""From the plan of a scenario to its inputs: kinds, sums, steps together with smooth maneuvers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scenarios.studies.catalogue import load_scenario
from scenarios.studies.declaration import (
    START_OF_REST,
    ManeuverPlan,
    maneuver_of,
    maneuvers_by_input,
    with_common_hold,
)
from scenarios.studies.estimating import fly_scenario, measured_again
from sim.maneuvers import Maneuver
from sim.record import Hold

TIME = np.arange(0.0, 8.0, 0.1)
DOUBLET = ManeuverPlan("elevator", "doublet", {"amplitude": 0.1, "unit": 0.5, "start": 1.0})
MULTISINE = ManeuverPlan(
    "rudder", "multisine", {"amplitude": 0.2, "duration": 4.0, "harmonics": [1, 3], "start": 2.0}
)
SWEEP = ManeuverPlan(
    "aileron",
    "sweep",
    {
        "amplitude": 0.3,
        "first_frequency": 1.0,
        "last_frequency": 9.0,
        "duration": 5.0,
        "start": 0.5,
    },
)
INPUTS = ("aileron", "elevator", "rudder")


def flown(*plans: ManeuverPlan) -> tuple[dict[str, Maneuver], dict[str, Maneuver]]:
    """Maneuvers by input as they are declared, and as a record can hold them."""
    declared = maneuvers_by_input(plans, INPUTS, "here")
    return declared, with_common_hold(declared, plans, TIME)


@pytest.mark.parametrize("plans", [(), (DOUBLET,), (DOUBLET, replace(DOUBLET, input="aileron"))])
def test_steps_alone_fly_as_they_are_declared(plans: tuple[ManeuverPlan, ...]) -> None:
    declared, held = flown(*plans)
    assert held == declared and all(maneuver.hold is Hold.PREVIOUS for maneuver in held.values())


@pytest.mark.parametrize("plans", [(MULTISINE,), (SWEEP,), (MULTISINE, SWEEP)])
def test_smooth_maneuvers_alone_fly_as_they_are_declared(plans: tuple[ManeuverPlan, ...]) -> None:
    declared, held = flown(*plans)
    assert held == declared and all(maneuver.hold is Hold.LINEAR for maneuver in held.values())


@pytest.mark.parametrize("smooth", [MULTISINE, SWEEP])
def test_beside_steps_a_smooth_maneuver_is_held_from_sample_to_sample(smooth: ManeuverPlan) -> None:
    declared, held = flown(DOUBLET, smooth)
    assert held["elevator"] is declared["elevator"]
    name, late = smooth.input, TIME + 0.05
    assert held[name].hold is Hold.PREVIOUS and np.ptp(declared[name](TIME)) > 0.1
    np.testing.assert_allclose(held[name](TIME), declared[name](TIME), atol=1e-12)
    np.testing.assert_allclose(held[name](late), declared[name](TIME), atol=1e-12)
    assert held[name].breakpoints[0] == START_OF_REST, "at its first value since before the record"


def test_a_smooth_maneuver_on_the_input_of_a_step_is_held_with_it() -> None:
    declared, held = flown(DOUBLET, replace(SWEEP, input="elevator"))
    np.testing.assert_allclose(
        held["elevator"](TIME + 0.05), declared["elevator"](TIME), atol=1e-12
    )


def test_maneuvers_of_one_input_add_up_about_its_rest() -> None:
    both = maneuvers_by_input(
        [DOUBLET, replace(DOUBLET, kind="pulse")], INPUTS, "here", {"elevator": 0.03}
    )["elevator"]
    at = np.array([-5.0, 0.9, 1.25, 1.75, 2.5])
    np.testing.assert_allclose(both(at), [0.03, 0.03, 0.23, -0.07, 0.03], atol=1e-12)


def test_each_kind_has_the_extent_that_its_numbers_say() -> None:
    """From start on, not beyond its end, at most its amplitude."""
    t = np.arange(0.0, 12.0, 0.001)
    for kind, numbers, end in (
        ("3-2-1-1", {"amplitude": 0.1, "unit": 0.5}, 1.0 + 7 * 0.5),
        ("doublet", {"amplitude": 0.1, "unit": 0.5}, 2.0),
        ("pulse", {"amplitude": 0.1, "unit": 0.5}, 1.5),
        (
            "sweep",
            {"amplitude": 0.1, "first_frequency": 1.0, "last_frequency": 9.0, "duration": 5.0},
            6.0,
        ),
        ("multisine", {"amplitude": 0.1, "duration": 4.0, "harmonics": [1, 3]}, 5.0),
    ):
        values = maneuver_of(ManeuverPlan("elevator", kind, {**numbers, "start": 1.0}), "here")(t)
        moved = t[np.abs(values) > 1e-9]
        assert moved[0] == pytest.approx(1.0, abs=0.02) and moved[-1] == pytest.approx(
            end, abs=0.02
        ), kind
        assert np.max(np.abs(values)) > 0.09, kind
    stepped = maneuver_of(
        ManeuverPlan("elevator", "step", {"amplitude": 0.1, "start": 1.0}), "here"
    )(t)
    np.testing.assert_array_equal(stepped, np.where(t > 1.0 - 1e-9, 0.1, 0.0))


def test_a_sweep_fades_in_and_out_over_a_tenth_of_its_length() -> None:
    numbers = {
        "amplitude": 1.0,
        "first_frequency": 40.0,
        "last_frequency": 40.0,
        "duration": 5.0,
        "start": 0.0,
    }
    values = np.abs(
        maneuver_of(ManeuverPlan("elevator", "sweep", numbers), "here")(np.arange(0.0, 5.0, 0.001))
    )
    assert (
        values[:200].max() < 0.45 and values[250:500].max() < 1.0 and values[500:1000].max() > 0.99
    )
    assert values[-200:].max() < 0.45 and values[-1000:-500].max() > 0.99


def test_measuring_again_changes_the_noise_alone() -> None:
    record, truth = fly_scenario(load_scenario("rigid"), 3)
    again = measured_again(record, truth, {name: 0.0 for name in record.output_names}, 4)
    for name in record.output_names:
        np.testing.assert_array_equal(again[name].values, truth.outputs[name])
    one = measured_again(record, truth, {"q": 3.0 * truth.noise_std["q"]}, 4)
    same = measured_again(record, truth, {}, 4)
    ratio = (one["q"].values - truth.outputs["q"]) / (same["q"].values - truth.outputs["q"])
    np.testing.assert_allclose(ratio, 3.0, rtol=1e-6)
    np.testing.assert_array_equal(one["alpha"].values, same["alpha"].values)
