"""The linear closed loop against the reference and against transfer functions written a second
way.
"""

from __future__ import annotations

import numpy as np
import pytest

from sim.closed_loop.airframe import load_x29
from sim.closed_loop.equations import OUTPUT_NAMES, mixing, plant
from sim.closed_loop.linear import (
    RESPONSE_NAMES,
    closed_loop,
    continuous_plant,
    frequency_response,
    margins,
    open_loop,
    respond,
)
from tests.oracles.x29_frequency import returned, signals, stick_response
from tests.oracles.x29_linear import airframe_roots, closed_loop_poles, step_response

NAMES = ("P", "S", "F")
OMEGA = np.array([0.35, 1.0, 3.0, 9.0, 14.0, 27.0, 60.0, 120.0, 200.0])


@pytest.mark.parametrize(
    ("name", "unstable", "stable"), [("P", 2.86, -4.10), ("S", 3.66, -6.29), ("F", 2.46, -5.32)]
)
def test_bare_airframe_has_the_reference_roots(name: str, unstable: float, stable: float) -> None:
    # The stable root of P is -4.0948; the reference prints -4.10.
    assert airframe_roots(load_x29(name)) == pytest.approx([unstable, stable], abs=0.0055)


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("name", "decrease", "increase", "phase"),
    [("P", -8.7, 6.1, 38.9), ("S", -6.8, 6.3, 37.6), ("F", -12.5, 4.7, 33.1)],
)
def test_margins_are_those_of_the_reference(
    name: str, decrease: float, increase: float, phase: float
) -> None:
    # Half of the last printed digit: closer than the 0.3 dB and 1 deg that are asked.
    found = margins(load_x29(name))
    assert found.gain_decrease == pytest.approx(decrease, abs=0.05)
    assert found.gain_increase == pytest.approx(increase, abs=0.05)
    assert found.phase == pytest.approx(phase, abs=0.05)


@pytest.mark.sampled
@pytest.mark.parametrize("name", NAMES)
def test_margins_describe_the_loop_of_the_oracle(name: str) -> None:
    x29 = load_x29(name)
    found = margins(x29)
    at_crossover = returned(x29, np.array([found.crossover]))[0]
    assert abs(at_crossover) == pytest.approx(1.0, abs=1e-5)
    assert np.degrees(np.angle(-at_crossover)) == pytest.approx(found.phase, abs=1e-3)
    loop = returned(x29, np.geomspace(1.0, 40.0, 3000), aliases=50)
    crossings = np.nonzero((np.diff(np.sign(loop.imag)) != 0) & (loop.real[:-1] < 0.0))[0]
    limits = [
        -20.0
        * np.log10(
            -loop.real[i]
            + loop.imag[i] * (loop.real[i + 1] - loop.real[i]) / (loop.imag[i + 1] - loop.imag[i])
        )
        for i in crossings
    ]
    assert sorted(limits) == pytest.approx([found.gain_decrease, found.gain_increase], abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_open_loop_is_that_of_the_oracle(name: str) -> None:
    x29 = load_x29(name)
    library = open_loop(x29)(np.exp(1j * OMEGA * x29.frame))
    np.testing.assert_allclose(library, returned(x29, OMEGA), rtol=1e-7)


@pytest.mark.parametrize("name", NAMES)
def test_response_to_the_stick_is_that_of_the_oracle(name: str) -> None:
    x29 = load_x29(name)
    expected = stick_response(x29, OMEGA)
    found = frequency_response(x29, OMEGA)
    # nz follows the strake's rate, so its sum of aliases converges slowly: good for 1e-6 up to 14
    # rad/s only.
    np.testing.assert_allclose(found[:2], expected[:2], rtol=1e-6)
    np.testing.assert_allclose(found[2, :5], expected[2, :5], rtol=1e-6)
    late = np.exp(-1j * OMEGA * x29.stick.recorded_skew)
    np.testing.assert_allclose(
        frequency_response(x29, OMEGA, recorded=True), found * late, rtol=1e-12
    )


def test_joined_blocks_equal_the_assembled_plant() -> None:
    x29 = load_x29("S")
    joined, assembled = continuous_plant(x29), plant(x29)
    by_hand = signals(x29, 1j * OMEGA)
    for i, omega in enumerate(OMEGA):
        solved = assembled.C @ np.linalg.solve(
            1j * omega * np.eye(13) - assembled.A, assembled.B @ mixing(x29)
        )
        np.testing.assert_allclose(joined(1j * omega)[:, 0], solved, rtol=1e-9)
        for name, values in by_hand.items():
            assert solved[OUTPUT_NAMES.index(name)] == pytest.approx(values[i], rel=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_closed_loop_is_stable_and_open_airframe_is_not(name: str) -> None:
    x29 = load_x29(name)
    assert np.max(np.abs(closed_loop_poles(x29))) < 0.98
    assert np.max(np.abs(open_loop(x29).poles())) > 1.02


@pytest.mark.sampled
@pytest.mark.parametrize("name", NAMES)
def test_gain_margins_are_where_the_loop_turns_unstable(name: str) -> None:
    x29 = load_x29(name)
    found = margins(x29)

    def growth(decibel: float) -> float:
        import control

        loop = open_loop(x29)
        closed = control.feedback(
            control.ss(loop.A, loop.B, 10.0 ** (decibel / 20.0) * loop.C, loop.D, x29.frame), 1
        )
        return float(np.max(np.abs(closed.poles())))

    for edge, outward in ((found.gain_decrease, -0.02), (found.gain_increase, 0.02)):
        assert growth(edge - outward) < 1.0 < growth(edge + outward)


def test_signals_carry_their_names() -> None:
    system = closed_loop(load_x29("P"))
    assert system.input_labels == ["stick"]
    assert tuple(system.output_labels) == RESPONSE_NAMES
    assert system.dt == 1.0 / 80.0


def test_step_settles_where_the_integrator_is_content() -> None:
    x29 = load_x29("S")
    time, response = step_response(x29, 15.0, size=0.5)
    nz, q = response[2, -1], response[1, -1]
    assert time[-1] == pytest.approx(15.0)
    assert nz + x29.law.Kqi * np.degrees(q) == pytest.approx(0.5 * x29.stick.gain, rel=1e-6)
    assert q == pytest.approx(nz * x29.airframe.gravity / x29.airframe.airspeed, rel=1e-6)


def test_nothing_moves_before_the_delays_have_passed() -> None:
    x29 = load_x29("F")
    _, response = respond(x29, np.concatenate([np.zeros(3), np.ones(10)]))
    # Three frames in the shaping, one in the law; the command then moves the surfaces within its
    # frame.
    assert np.flatnonzero(np.abs(response[6]) > 1e-12)[0] == 3 + 3 + 1
    assert np.flatnonzero(np.abs(response[3]) > 1e-12)[0] == 3 + 3 + 1 + 1


def test_a_test_of_the_loop_is_the_open_loop_behind_a_sum() -> None:
    """Without noise: the returned signal is python-control's response of the open loop to the
    command.
    """
    import control

    from sim.closed_loop.linear import LoopNoise, loop_test, open_loop

    x29 = load_x29("F")
    sweep = np.sin(0.02 * np.arange(800) ** 1.3)
    quiet = LoopNoise(0.0, 0.0, 0.0)
    given, command, returned, q, nz = loop_test(x29, sweep, np.random.default_rng(1), quiet)
    np.testing.assert_array_equal(given, sweep)
    np.testing.assert_allclose(command, sweep - returned, atol=1e-12)
    time = x29.frame * np.arange(800)
    expected = np.squeeze(
        control.forced_response(open_loop(x29), timepts=time, inputs=command).outputs
    )
    # The open loop grows without bounds, and rounding with it: over the first second it has not
    # yet.
    np.testing.assert_allclose(returned[:80], expected[:80], atol=1e-9)
    assert np.ptp(q) > 0.0 and np.ptp(nz) > 0.0


def test_noise_of_a_test_of_the_loop_is_as_large_as_declared() -> None:
    from sim.closed_loop.linear import LoopNoise, loop_test

    x29, still = load_x29("S"), np.zeros(4000)
    one = loop_test(x29, still, np.random.default_rng(2), LoopNoise(0.1, 0.0, 0.0))
    two = loop_test(x29, still, np.random.default_rng(2), LoopNoise(0.2, 0.0, 0.0))
    np.testing.assert_allclose(two, 2.0 * one, atol=1e-12)
    air = loop_test(x29, still, np.random.default_rng(2), LoopNoise(0.0, 0.0, 0.1))
    again = loop_test(x29, still, np.random.default_rng(2), LoopNoise(0.0, 0.0, 0.1))
    np.testing.assert_array_equal(air, again)
    assert air[1].std() > 0.0
