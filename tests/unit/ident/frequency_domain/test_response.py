"""The response at a record's harmonics against transforms of a simulation, and its slopes against
differences.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.frequency_domain.transform import (
    Delay,
    default_band,
    first_nonlinear,
    linear_model,
    response,
    step_of,
    transformed,
)
from sim.declaration.compile import compile_model
from sim.effects.library import find_effect
from sim.errors import RecordError
from sim.record import Channel, Hold, Record
from tests.bases import longitudinal_model, rigid_model
from tests.linear_problem import oscillator, record_of
from tests.rigid_problem import rigid_record

STEP, COUNT, FINE = 0.05, 60, 20


def marched(
    hold: Hold, late: dict[str, float], start: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, inputs and outputs at the samples of the oscillator, by Runge-Kutta steps of a
    twentieth of a sample, inputs late.
    """
    time = STEP * np.arange(COUNT)
    inputs = np.array([np.sin(1.7 * time) + 0.3, np.sign(np.cos(2.3 * time))])
    h = STEP / FINE

    def at(i: int, t: float) -> float:
        t = t - late.get(("pull", "push")[i], 0.0)
        if hold is Hold.LINEAR:
            return float(np.interp(t, time, inputs[i]))
        return float(inputs[i, int(np.clip(np.floor(t / STEP + 1e-9), 0, COUNT - 1))])

    def rates(x: np.ndarray, t: float) -> np.ndarray:
        return np.array([x[1] + 0.3 * at(1, t), -3.0 * x[0] - 0.4 * x[1] + at(0, t) + 0.1])

    x, rows = np.array(start), []
    for k in range(COUNT):
        t = time[k]
        rows.append([x[0], x[0] + 0.5 * x[1] + 0.2 * at(0, t), x[1]])
        for s in range(FINE):
            # a jump stands between two steps: the middle one is on the right side of it
            middle = t + (s + 0.5) * h
            a, b = (t + s * h, t + (s + 1) * h) if hold is Hold.LINEAR else (middle, middle)
            k1 = rates(x, a)
            k2 = rates(x + 0.5 * h * k1, middle)
            k3 = rates(x + 0.5 * h * k2, middle)
            x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + rates(x + h * k3, b))
    return time, inputs, np.array(rows).T


@pytest.mark.parametrize(
    ("hold", "late"),
    [
        (Hold.PREVIOUS, {}),
        (Hold.PREVIOUS, {"pull": 0.1, "push": 0.1725}),
        (Hold.PREVIOUS, {"pull": 0.0725}),  # acts on an output at once, from within an interval
        (Hold.LINEAR, {"pull": 0.0625}),
    ],
)
def test_transforms_of_a_motion_off_trim(hold: Hold, late: dict[str, float]) -> None:
    """Beginning and end are anywhere, and one vector tells them: with it nothing of the
    simulation's transforms is left.
    """
    time, inputs, outputs = marched(hold, late, (0.7, -1.1))
    system = compile_model(oscillator())
    channels = tuple(
        Channel.of(name, "m", row) for name, row in zip(system.output_names, outputs, strict=True)
    )
    record = Record(
        time,
        tuple(
            Channel.of(name, "m", row) for name, row in zip(system.input_names, inputs, strict=True)
        ),
        channels,
        hold,
    )
    found = transformed(record, system, (0.0, 10.0))
    model = linear_model(system, system.parameters.values(), ())
    delays = {system.input_names.index(name): Delay(seconds) for name, seconds in late.items()}
    rest = response(model, found, delays, np.zeros(2))
    left = found.outputs - rest.y
    rows = rest.by_ends.reshape(-1, 2)
    ends = np.linalg.lstsq(
        np.concatenate([rows.real, rows.imag]),
        np.concatenate([left.ravel().real, left.ravel().imag]),
        rcond=None,
    )[0]
    assert np.max(np.abs(left)) > 0.1, "the record does not begin and end in trim"
    assert np.max(np.abs(left - rest.by_ends @ ends)) < 2e-8 * np.max(np.abs(found.outputs))


@pytest.mark.parametrize("count", [60, 61])
def test_harmonics_lie_between_the_mean_and_the_folding_frequency(count: int) -> None:
    """At both ends a transform is real: its noise has half the numbers that the likelihood
    counts.
    """
    found = transformed(
        record_of(np.random.default_rng(1), count), compile_model(oscillator()), (0.0, 1e9)
    )
    assert found.bins.tolist() == [k for k in range(count) if 0.0 < k < 0.5 * count]
    assert found.omega == pytest.approx(2.0 * np.pi * found.bins / (count * STEP))


@pytest.mark.parametrize("hold", list(Hold))
def test_slopes_are_those_of_differences(hold: Hold) -> None:
    system = compile_model(oscillator())
    record = transformed(record_of(np.random.default_rng(0), 90, hold=hold), system, (0.0, 5.0))
    free = [system.parameters.index(name) for name in ("stiffness", "damping", "force")]
    ends, p = np.array([0.3, -0.2]), system.parameters.values()

    def at(values: np.ndarray, late: float) -> np.ndarray:
        return response(linear_model(system, values, ()), record, {0: Delay(late)}, ends).y

    # The delay takes the place of the third parameter, which moves no transform: a constant force
    # has none.
    found = response(linear_model(system, p, free), record, {0: Delay(0.083, 2)}, ends)
    for column, position in enumerate(free[:2]):
        moved = [p + sign * 1e-6 * (np.arange(len(p)) == position) for sign in (1.0, -1.0)]
        slope = (at(moved[0], 0.083) - at(moved[1], 0.083)) / 2e-6
        assert np.allclose(
            found.by_parameter[:, :, column], slope, atol=1e-7 * np.max(np.abs(slope))
        )
    late = (at(p, 0.083 + 1e-6) - at(p, 0.083 - 1e-6)) / 2e-6
    assert np.allclose(found.by_parameter[:, :, 2], late, atol=1e-6 * np.max(np.abs(late)))


def test_what_is_not_linear_is_named() -> None:
    rng = np.random.default_rng(1)
    assert (
        first_nonlinear(compile_model(rigid_model()), []) == ""
        and first_nonlinear(compile_model(oscillator()), [record_of(rng)]) == ""
    )
    assert first_nonlinear(compile_model(longitudinal_model()), []) == "the rate of airspeed"


@pytest.mark.parametrize("name", ["derivative-jump", "unmeasured-input", "gust-discrete"])
def test_what_changes_with_time_is_named(name: str) -> None:
    """Linear at each time, but with no response at a frequency: what happens at a time would
    otherwise be lost without a word.
    """
    model = rigid_model()
    system = compile_model(model.with_effects(find_effect(name, model.equations)))
    assert first_nonlinear(system, [rigid_record(np.random.default_rng(0))]) != ""


def test_records_that_have_no_transform() -> None:
    system, rng = compile_model(oscillator()), np.random.default_rng(2)
    with pytest.raises(RecordError, match=r"samples are uneven.*--rate"):
        transformed(record_of(rng, uneven=True), system, (0.0, 5.0))
    with pytest.raises(RecordError, match=r"samples of place are missing.*output-error"):
        transformed(record_of(rng, missing=True), system, (0.0, 5.0))
    with pytest.raises(
        RecordError, match=r"no harmonic of 3 s lies between 0\.34 and 0\.5 Hz; widen --band"
    ):
        transformed(record_of(rng, 60), system, (0.34, 0.5))


def test_the_usual_band_holds_the_power_of_the_inputs() -> None:
    time = 0.02 * np.arange(1000)
    inputs = (
        Channel.of("pull", "m/s2", np.sin(2 * np.pi * 0.5 * time)),
        Channel.of("push", "m/s", np.sin(2 * np.pi * 1.5 * time)),
    )
    record = Record(time, inputs, (Channel.of("place", "m", time),))
    assert step_of(record) == pytest.approx(0.02)
    assert default_band([record], ("pull", "push"), 1) == pytest.approx((0.05, 1.5))
    assert default_band([record], ("pull", "push"), 60)[1] == pytest.approx(61 / 20.0)
