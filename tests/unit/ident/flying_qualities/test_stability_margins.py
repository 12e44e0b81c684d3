"""Stability margins against python-control, against definitions, and on flights of a known loop."""

from __future__ import annotations

import math

import control
import numpy as np
import pytest
from scipy import signal

from ident.flying_qualities.stability_margins import (
    StabilityMargins,
    stability_margins,
    turned,
    worst_margins,
)
from ident.frequency_response import EvenSignals, Spectra, estimate_responses
from ident.frequency_response.estimate import frequencies, window_lengths
from ident.frequency_response.transfer_function import ResponseTarget, neighbour_correlation
from scenarios.responses.fitting import target_of
from sim.closed_loop.airframe import load_x29
from sim.closed_loop.linear import loop_test, margins, open_loop

OMEGA = np.geomspace(0.3, 100.0, 200)
# An integrator with a lag, a resonance and a delay: one gain and two phase crossings up to 20
# rad/s.
LOOP = (
    control.tf([6.0], [1.0, 0.0])
    * control.tf([8.0], [1.0, 8.0])
    * control.tf([144.0], [1.0, 4.0, 144.0])
)
DELAY = 0.02


def loop(omega: np.ndarray) -> np.ndarray:
    return np.asarray(LOOP(1j * omega)) * np.exp(-1j * omega * DELAY)


def target(response: np.ndarray, share: float = 1e-3, omega: np.ndarray = OMEGA) -> ResponseTarget:
    one = np.ones(omega.size)
    return ResponseTarget("returned/command", omega, response, one, share * np.abs(response), 60.0)


def sampled(airframe: str) -> np.ndarray:
    x29 = load_x29(airframe)
    return np.asarray(open_loop(x29)(np.exp(1j * OMEGA * x29.frame))).ravel()


@pytest.mark.long
@pytest.mark.parametrize("airframe", ["P", "S", "F", "D", "R"])
def test_margins_of_the_x29_loop_are_those_of_python_control(airframe: str) -> None:
    x29 = load_x29(airframe)
    exact, found = margins(x29), stability_margins(target(sampled(airframe)))
    assert (
        found.gain_increase is not None
        and found.gain_decrease is not None
        and found.phase is not None
    )
    assert found.gain_increase.size.value == pytest.approx(exact.gain_increase, abs=0.02)
    assert found.gain_decrease.size.value == pytest.approx(exact.gain_decrease, abs=0.05)
    assert abs(found.phase.size.value) == pytest.approx(abs(exact.phase), abs=0.1)
    assert found.phase.frequency.value == pytest.approx(exact.crossover, rel=2e-3)
    fine = np.geomspace(0.3, 100.0, 20000)
    away = np.abs(1.0 + np.asarray(open_loop(x29)(np.exp(1j * fine * x29.frame))).ravel())
    assert found.distance is not None
    # The response is a parabola over 20 % to both sides, the distance is none.
    assert found.distance.size.value == pytest.approx(away.min(), rel=1e-3)
    assert found.distance.frequency.value == pytest.approx(fine[away.argmin()], rel=0.01)


def test_every_crossing_is_found_and_the_delay_margin_is_the_delay_to_the_border() -> None:
    found = stability_margins(target(loop(OMEGA)))
    data = control.frd(
        loop(np.geomspace(0.3, 100.0, 5000)), np.geomspace(0.3, 100.0, 5000), smooth=True
    )
    gains, phases, _, at_phase, at_gain, _ = control.stability_margins(data, returnall=True)
    assert len(found.gains) == len(gains) and len(found.phases) == len(phases)
    np.testing.assert_allclose(
        [each.size.value for each in found.gains], 20.0 * np.log10(gains), atol=0.05
    )
    np.testing.assert_allclose([each.size.value for each in found.phases], phases, atol=0.2)
    np.testing.assert_allclose([each.frequency.value for each in found.gains], at_phase, rtol=3e-3)
    np.testing.assert_allclose([each.frequency.value for each in found.phases], at_gain, rtol=3e-3)
    assert found.delay is not None
    omega, late = found.delay.frequency.value, found.delay.size.value
    border = loop(np.array([omega]))[0] * np.exp(-1j * omega * late)
    assert abs(border + 1.0) < 0.01


def test_a_loop_that_adds_is_turned() -> None:
    one, other = (
        stability_margins(target(loop(OMEGA))),
        stability_margins(turned(target(-loop(OMEGA)))),
    )
    assert one == other


def noisy(rng: np.random.Generator, share: float) -> np.ndarray:
    apart = np.subtract.outer(OMEGA, OMEGA) / (2.0 * math.pi) * 60.0
    root = np.linalg.cholesky(neighbour_correlation(apart) + 1e-9 * np.eye(OMEGA.size))
    return loop(OMEGA) * (
        1.0 + share * root @ (rng.standard_normal((OMEGA.size, 2)) @ np.array([1.0, 1.0j]))
    )


@pytest.mark.long
def test_intervals_hold_the_truth_and_deviations_are_the_scatter() -> None:
    rng = np.random.default_rng(6)
    exact = stability_margins(target(loop(OMEGA))).named
    values: dict[str, list[float]] = {name: [] for name in exact}
    stds: dict[str, list[float]] = {name: [] for name in exact}
    inside: dict[str, list[bool]] = {name: [] for name in exact}
    for _ in range(200):
        for name, margin in stability_margins(target(noisy(rng, 0.02), 0.02)).named.items():
            values[name].append(margin.size.value)
            stds[name].append(margin.size.std)
            inside[name].append(margin.low <= exact[name].size.value <= margin.high)
    for name in ("gain_increase", "phase_margin", "delay_margin", "distance"):
        assert np.median(stds[name]) == pytest.approx(np.std(values[name]), rel=0.2), name
        # 200 of 95 %: three deviations are 4.6 %.
        assert 0.904 <= np.mean(inside[name]) <= 0.996, name


def test_the_least_distance_of_a_flat_response_is_low_and_its_interval_reaches_up() -> None:
    """A distance that hardly turns: the least of a noisy curve lies below that of the true one."""
    u, error = np.log(OMEGA / 5.0), 0.01
    exact = -1.0 + 0.5 * (1.0 + 0.01 * u**2) * np.exp(1j * u)
    root = np.linalg.cholesky(
        neighbour_correlation(np.subtract.outer(OMEGA, OMEGA) / (2.0 * math.pi) * 60.0)
        + 1e-9 * np.eye(OMEGA.size)
    )
    rng = np.random.default_rng(2)
    values, inside, above = [], [], []
    for _ in range(60):
        noise = error * root @ (rng.standard_normal((OMEGA.size, 2)) @ np.array([1.0, 1.0j]))
        one = np.ones(OMEGA.size)
        data = ResponseTarget("L", OMEGA, exact + noise, one, np.full(OMEGA.size, error), 60.0)
        margin = stability_margins(data).distance
        if margin is None:
            continue
        values.append(margin.size.value)
        inside.append(margin.low <= 0.5 <= margin.high)
        above.append(margin.high - margin.size.value > margin.size.value - margin.low)
    assert len(values) > 50
    assert np.mean(values) < 0.5 - 3.0 * np.std(values) / math.sqrt(len(values))
    # 60 of 95 %: three deviations are 8.4 %.
    assert np.mean(inside) > 0.86 and np.mean(above) > 0.7


def test_the_interval_of_small_errors_is_that_of_the_deviation() -> None:
    """Both are of one ellipse: 95 % of one degree of freedom are 1.96 deviations to each side."""
    for name, margin in stability_margins(target(loop(OMEGA))).named.items():
        half = 0.5 * (margin.high - margin.low)
        assert half == pytest.approx(1.96 * margin.size.std, rel=0.01), name


def test_an_interval_says_that_the_band_ends_before_it_does() -> None:
    exact = stability_margins(target(loop(OMEGA)))
    assert exact.gain_increase is not None and not exact.gain_increase.open
    there = exact.gain_increase.frequency.value * 1.02 >= OMEGA
    short = target(loop(OMEGA[there]), 0.2, OMEGA[there])
    cut = stability_margins(short).gain_increase
    assert cut is None or cut.open


def test_a_short_band_says_what_is_missing() -> None:
    there = OMEGA < 3.0
    found = stability_margins(target(loop(OMEGA[there]), omega=OMEGA[there]))
    assert found.named == {} and len(found.notes) == 3
    assert "no phase of -180 deg" in found.notes[0] and "no gain of 0 dB" in found.notes[1]


def test_the_worst_maneuver() -> None:
    rng = np.random.default_rng(3)
    share, loops = 0.02, []
    for _ in range(4):
        loops.append(stability_margins(target(noisy(rng, share), share)))
    alike = {each.name: each for each in worst_margins(loops)}
    phases = [each.named["phase_margin"].size.value for each in loops]
    worst = alike["phase_margin"]
    assert worst.margin.size.value == min(phases) and worst.maneuver == int(np.argmin(phases))
    # Four intervals that hold together: 1.25 % outside each, 2.4977 deviations.
    assert worst.half == pytest.approx(2.4977 * worst.margin.size.std, rel=1e-3)
    assert worst.p_value > 0.01
    raised = stability_margins(target(1.07 * noisy(rng, share), share))
    apart = {each.name: each for each in worst_margins([*loops, raised])}
    assert apart["gain_increase"].maneuver == 4 and apart["gain_increase"].p_value < 1e-3


# A flight of the known loop ---------------------------------------------------------------------

LENGTH, LOW, HIGH = 120.0, 0.1, 12.0


def flown(airframe: str, seed: int) -> StabilityMargins:
    """Margins from a sweep of the command under sensor noise and rough air."""
    x29 = load_x29(airframe)
    time = x29.frame * np.arange(int(LENGTH / x29.frame))
    sweep = 0.5 * signal.chirp(time, LOW, LENGTH, HIGH, method="logarithmic")
    rows = loop_test(x29, sweep, np.random.default_rng(seed))
    record = EvenSignals(x29.frame, rows[[1]], rows[[2]], rows[[0]])
    spectra = Spectra(window_lengths([LENGTH], LOW))
    found = estimate_responses([record], frequencies(LOW, HIGH), spectra)
    return stability_margins(target_of(found, (0, 0), "returned/command"))


def shares_inside(airframe: str, seeds: int) -> dict[str, float]:
    exact = stability_margins(target(sampled(airframe))).named
    inside: dict[str, list[bool]] = {name: [] for name in exact}
    for seed in range(seeds):
        for name, margin in flown(airframe, seed).named.items():
            if name in exact:
                inside[name].append(margin.low <= exact[name].size.value <= margin.high)
    return {name: float(np.mean(each)) for name, each in inside.items() if len(each) > 0.6 * seeds}


@pytest.mark.long
def test_flown_margins_hold_the_known_ones() -> None:
    shares = shares_inside("F", 20)
    assert set(shares) >= {"gain_increase", "phase_margin", "delay_margin", "distance"}
    # 20 of 95 %: 0.8 is three deviations
    assert all(share >= 0.8 for share in shares.values()), shares


@pytest.mark.slow
@pytest.mark.parametrize("airframe", ["F", "S"])
def test_flown_margins_hold_the_known_ones_in_ninety_five_of_a_hundred(airframe: str) -> None:
    shares = shares_inside(airframe, 100)
    assert all(0.90 <= share <= 1.0 for share in shares.values()), shares
    assert np.mean(list(shares.values())) >= 0.93


def test_a_crossing_that_is_not_determined_is_said_and_is_no_margin() -> None:
    """A gain that runs along 0 dB with errors of its own size."""
    flat = np.exp(-1j * (0.4 + 0.01 * OMEGA)) * (1.0 + 0.002 * np.log(OMEGA / 5.0))
    found = stability_margins(target(flat, share=0.2))
    assert found.phase is None and found.delay is None
    assert any("gain of 0 dB near" in note and "not determined" in note for note in found.notes)
