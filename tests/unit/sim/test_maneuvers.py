"""Maneuvers: switches at their own time, exact means, bad declarations refused."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from sim.errors import ModelError
from sim.maneuvers import (
    Delayed,
    Maneuver,
    Multisine,
    MultiStep,
    Spacing,
    Sum,
    Sweep,
    doublet,
    orthogonal_multisines,
    pulse,
    schroeder_multisine,
    sequence,
    step,
    three_two_one_one,
)
from sim.record import Hold

SMOOTH: dict[str, Maneuver] = {
    "linear sweep": Sweep(0.1, 0.5, 12.0, 9.3, start=0.4, taper=1.1),
    "falling logarithmic sweep": Sweep(
        0.1, 12.0, 0.5, 9.3, start=0.4, taper=0.7, spacing=Spacing.LOGARITHMIC
    ),
    "constant logarithmic sweep": Sweep(0.2, 3.0, 3.0, 5.0, spacing=Spacing.LOGARITHMIC),
    "multisine": schroeder_multisine(0.05, 8.0, [2, 3, 5, 7], start=1.0, cycles=2),
}
STEPS: dict[str, Maneuver] = {
    "3-2-1-1": three_two_one_one(0.1, 0.3, 1.05),
    "doublet": doublet(-0.2, 0.7, 0.1),
    "pulse": pulse(1.0, 0.25, 2.0),
    "step": step(0.5, 1.3),
}
SUMS: dict[str, Maneuver] = {
    "sum": Sum((STEPS["doublet"], SMOOTH["multisine"])),
    "delayed": Delayed(STEPS["3-2-1-1"], 0.77),
    "sequence": sequence([STEPS["3-2-1-1"], STEPS["doublet"]], gap=2.0, start=0.5),
}
ALL: dict[str, Maneuver] = {**SMOOTH, **STEPS, **SUMS}


@pytest.mark.parametrize("name", ALL)
def test_mean_equals_quadrature_of_the_value(name: str) -> None:
    maneuver = ALL[name]
    edges = np.linspace(-0.5, 20.0, 60)
    means = maneuver.mean(edges[:-1], edges[1:])
    for a, b, mean in zip(edges[:-1], edges[1:], means, strict=True):
        cuts = [a, *(t for t in maneuver.breakpoints if a < t < b), b]
        total = sum(
            quad(lambda t: float(maneuver(t)), c, d, epsabs=1e-13)[0] for c, d in pairwise(cuts)
        )
        assert mean == pytest.approx(total / (b - a), abs=1e-10)


@pytest.mark.sampled
@pytest.mark.parametrize("name", ALL)
@given(data=st.data())
def test_means_of_two_halves_make_the_mean_of_the_whole(name: str, data: st.DataObject) -> None:
    maneuver = ALL[name]
    a, width, share = (
        data.draw(st.floats(-1.0, 20.0)),
        data.draw(st.floats(1e-3, 5.0)),
        data.draw(st.floats(0.01, 0.99)),
    )
    c, b = a + width, a + share * width
    whole = float(maneuver.mean(a, c)) * (c - a)
    halves = float(maneuver.mean(a, b)) * (b - a) + float(maneuver.mean(b, c)) * (c - b)
    assert whole == pytest.approx(halves, abs=1e-12)


@pytest.mark.parametrize("name", ALL)
def test_breakpoints_are_in_order_and_hold_fits(name: str) -> None:
    maneuver = ALL[name]
    assert list(maneuver.breakpoints) == sorted(set(maneuver.breakpoints))
    assert maneuver.hold is (Hold.LINEAR if name in SMOOTH or name == "sum" else Hold.PREVIOUS)


@pytest.mark.parametrize("name", ALL)
def test_before_is_the_limit_from_the_left_everywhere(name: str) -> None:
    """At a switch the old value, elsewhere the value itself."""
    maneuver = ALL[name]
    for t in (*maneuver.breakpoints, *np.linspace(-0.5, 15.0, 63)):
        # Smooth ones move by less than 0.3 a second; the difference of a switch is at least 0.05.
        assert float(maneuver.before(t)) == pytest.approx(float(maneuver(t - 1e-6)), abs=1e-5)
    steps = [
        t
        for t in maneuver.breakpoints
        if abs(float(maneuver(t)) - float(maneuver.before(t))) > 0.04
    ]
    assert steps or name in SMOOTH


def test_three_two_one_one_has_its_levels_and_times() -> None:
    maneuver = three_two_one_one(0.1, 0.5, 1.0)
    assert maneuver.times == (1.0, 2.5, 3.5, 4.0, 4.5)
    assert maneuver.levels == (0.1, -0.1, 0.1, -0.1)
    assert maneuver([0.99, 1.0, 2.49, 2.5, 3.5, 4.0, 4.5, 9.0]).tolist() == [
        0.0,
        0.1,
        0.1,
        -0.1,
        0.1,
        -0.1,
        0.0,
        0.0,
    ]


def test_value_at_a_switch_is_the_new_one_also_after_rounding() -> None:
    maneuver = three_two_one_one(1.0, 0.3, 1.0)
    samples = np.arange(400) * 0.01
    by_count = np.select(
        [samples < 0.995, samples < 1.895, samples < 2.495, samples < 2.795, samples < 3.095],
        [0, 1, -1, 1, -1],
        0,
    )
    assert np.array_equal(maneuver(samples), by_count)
    assert [float(maneuver.before(t)) for t in maneuver.times] == [0.0, 1.0, -1.0, 1.0, -1.0]


def test_level_without_a_switch_inside_is_the_mean_bit_for_bit() -> None:
    maneuver = three_two_one_one(0.10471, 0.5, 1.0)
    edges = 1.0 + np.arange(1500) * 0.001
    assert np.all(maneuver.mean(edges[:-1], edges[1:])[:1499] == 0.10471)


def test_mean_across_a_switch_is_weighed() -> None:
    assert float(step(2.0, 1.00025).mean(1.0, 1.001)) == pytest.approx(1.5, abs=1e-12)


def test_step_lasts_and_rest_is_zero() -> None:
    assert float(step(0.3, 1.0)(1e6)) == 0.3
    assert np.array_equal(Sum()(np.arange(3.0)), np.zeros(3))
    assert Sum().hold is Hold.PREVIOUS


def test_sequence_places_parts_one_after_another() -> None:
    both = sequence([pulse(1.0, 0.5, 9.0), pulse(2.0, 0.25)], gap=1.0, start=2.0)
    assert both.breakpoints == (2.0, 2.5, 3.5, 3.75)
    assert both([2.1, 2.6, 3.6]).tolist() == [1.0, 0.0, 2.0]


@pytest.mark.parametrize(
    ("spacing", "phase_at_half", "phase_at_end"),
    [
        (Spacing.LINEAR, 200.0 + 0.5 * 11.0 / 400.0 * 200.0**2, 6.5 * 400.0),
        (
            Spacing.LOGARITHMIC,
            (math.sqrt(12.0) - 1.0) * 400.0 / math.log(12.0),
            11.0 * 400.0 / math.log(12.0),
        ),
    ],
)
def test_sweep_crosses_zero_as_often_as_its_phase_says(
    spacing: Spacing, phase_at_half: float, phase_at_end: float
) -> None:
    sweep = Sweep(1.0, 1.0, 12.0, 400.0, spacing=spacing)
    for end, phase in ((200.0, phase_at_half), (400.0, phase_at_end)):
        u = sweep(np.linspace(0.0, end, 400001)[1:-1])
        assert np.count_nonzero(u[1:] * u[:-1] < 0) == math.floor(phase / math.pi)


def test_taper_is_a_raised_cosine() -> None:
    tapered, plain = Sweep(1.0, 2.0, 9.0, 10.0, taper=2.0), Sweep(1.0, 2.0, 9.0, 10.0)
    t = np.array([0.5, 1.0, 5.0, 9.0])
    window = np.array([0.5 * (1 - math.cos(math.pi / 4)), 0.5, 1.0, 0.5])
    assert tapered(t) == pytest.approx(window * plain(t), abs=1e-14)


def test_multisine_has_its_rms_and_begins_and_ends_at_zero() -> None:
    multisine = schroeder_multisine(0.05, 10.0, list(range(2, 20, 3)), start=3.0)
    t = 3.0 + np.arange(4000) * 10.0 / 4000
    assert np.sqrt(np.mean(multisine(t) ** 2)) == pytest.approx(0.05, rel=1e-12)
    assert float(multisine(3.0)) == pytest.approx(0.0, abs=1e-12)
    assert float(multisine.before(13.0)) == pytest.approx(0.0, abs=1e-12)


def test_schroeder_phases_keep_the_peak_low() -> None:
    flat = schroeder_multisine(1.0, 10.0, list(range(1, 21)))
    spiky = Multisine(10.0, flat.harmonics, flat.amplitudes, (0.0,) * 20)
    t = np.linspace(0.0, 10.0, 4000)
    assert np.max(np.abs(flat(t))) < 2.0
    assert np.max(np.abs(spiky(t))) > 6.0


def test_orthogonal_multisines_do_not_correlate() -> None:
    first, second, third = orthogonal_multisines([0.1, 0.2, 0.1], 12.0, 2, 25)
    t = np.arange(1200) * 0.01
    u = np.array([first(t), second(t), third(t)])
    products = u @ u.T / 1200
    assert products == pytest.approx(np.diag([0.01, 0.04, 0.01]), abs=1e-14)


@pytest.mark.parametrize(
    "make",
    [
        lambda: MultiStep((1.0,), (0.0,)),
        lambda: MultiStep((), (0.0,)),
        lambda: MultiStep((1.0, 2.0), (0.0, 1.0, 1.0)),
        lambda: MultiStep((math.nan,), (0.0, 1.0)),
        lambda: MultiStep((1.0,), (math.inf, math.inf)),
        lambda: three_two_one_one(0.1, 0.0),
        lambda: three_two_one_one(0.1, -1.0),
        lambda: pulse(0.1, math.nan),
        lambda: sequence([pulse(1.0, 1.0)], gap=-1.0),
        lambda: sequence([Sum()], gap=1.0),
        lambda: Delayed(pulse(1.0, 1.0), math.nan),
        lambda: Sweep(0.1, 0.0, 5.0, 3.0),
        lambda: Sweep(0.1, 1.0, 5.0, 0.0),
        lambda: Sweep(0.1, 1.0, 5.0, 3.0, taper=2.0),
        lambda: Sweep(math.nan, 1.0, 5.0, 3.0),
        lambda: Multisine(0.0, (1,), (1.0,), (0.0,)),
        lambda: Multisine(1.0, (1, 1), (1.0, 1.0), (0.0, 0.0)),
        lambda: Multisine(1.0, (0,), (1.0,), (0.0,)),
        lambda: Multisine(1.0, (1,), (1.0,), ()),
        lambda: Multisine(1.0, (1,), (1.0,), (0.0,), cycles=0),
        lambda: schroeder_multisine(1.0, 1.0, []),
        lambda: orthogonal_multisines([1.0, 1.0], 1.0, 3, 3),
    ],
)
def test_bad_declarations_are_refused(make) -> None:
    with pytest.raises(ModelError, match=r"maneuver|sweep|multisine"):
        make()
