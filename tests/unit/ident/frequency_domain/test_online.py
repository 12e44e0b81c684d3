"""Equation error on recursive transforms: exact without noise, unbiased with it, sigmas that
hold.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from ident.frequency_domain.online import (
    OnlineEquations,
    Sums,
    advance,
    empty_sums,
    frequencies,
    online_equations,
)
from ident.frequency_domain.online_regression import (
    OnlineEstimate,
    _sensor_levels,
    estimate,
    estimated,
    lag_stream,
    pseudo_control,
    with_rows,
)
from sim.declaration import own_model
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.errors import ModelError
from sim.record import Hold, Record
from tests import bases
from tests.rigid_problem import FREE, TRUE, noisy

OMEGA = frequencies()
OFFSETS = {"alpha": 0.02, "q": 0.005, "nz": 1.0}


def followed(
    model: Model, record: Record, block: int = 50, *, curved: bool = True
) -> tuple[OnlineEquations, Sums, OnlineEstimate | None]:
    """A record taken block by block, as a stream brings it."""
    system = compile_model(model)
    equations = online_equations(system, OMEGA, system.output_names)
    inputs = record.input_array(system.input_names)
    rows, valid = record.output_array(system.output_names)
    rows = np.where(valid, rows, np.nan)
    sums = empty_sums(equations)
    found: OnlineEstimate | None = None
    for first in range(0, len(record), block):
        part = slice(first, first + block)
        values = found.values if found is not None and curved else None
        sums = advance(equations, sums, record.time[part], inputs[:, part], rows[:, part], values)
        found = estimate(equations, sums)
    return equations, sums, found


def wrong(model: Model, share: float = 1.3) -> Model:
    free = model.parameters.free_names
    return model.with_values({name: share * model.parameters[name].value for name in free})


def truth(model: Model, names: tuple[str, ...]) -> np.ndarray:
    return np.array([model.parameters[name].value for name in names])


@pytest.mark.sampled
@pytest.mark.parametrize(
    ("make", "flight"),
    [
        (bases.rigid_model, lambda: bases.rigid_flight(10.0)),
        (bases.lateral_model, lambda: bases.lateral_flight(10.0, 50.0)),
        (bases.longitudinal_model, lambda: bases.longitudinal_flight(20.0, 50.0)),
    ],
)
def test_without_noise_the_truth_is_found(
    make: Callable[[], Model], flight: Callable[[], bases.Flight]
) -> None:
    model = make()
    record = noisy(model, flight(), np.random.default_rng(1), scale=1e-7)
    equations, _, found = followed(wrong(model), record)
    assert found is not None
    known = np.isfinite(found.std)
    error = np.abs(found.values - truth(model, equations.names))
    size = np.abs(truth(model, equations.names))
    # Integrals within a step are of fourth order: what is left is far below any sensor's noise.
    assert np.count_nonzero(known) >= 6
    assert np.all(error[known] <= 3e-3 * size[known] + 4.0 * found.std[known]), dict(
        zip(equations.names, error / size, strict=True)
    )


def test_a_users_model_and_one_pass_as_many() -> None:
    model = own_model(
        name="roll",
        states={"p": "rad/s", "phi": "rad"},
        inputs={"aileron": "rad"},
        outputs={"p": "rad/s", "phi": "rad"},
        parameters={"L_p": (-2.0, "1/s"), "L_da": (8.0, "1/s2")},
        rates=lambda s, p: {"p": p.L_p * s.p + p.L_da * s.aileron, "phi": s.p},
        readings=lambda s, p: {"p": s.p, "phi": s.phi},
    ).with_noise(bases.rigid_model().noise.__class__({"p": 0.01, "phi": 0.01}))
    time = np.arange(500) / 50.0
    flight = bases.Flight(time, bases.three_two_one_one(time)[None])
    record = noisy(model, flight, np.random.default_rng(2))
    _, whole, once = followed(model, record, block=500)
    equations, parts, often = followed(model, record, block=37, curved=False)
    np.testing.assert_allclose(parts.known_side, whole.known_side, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(parts.at_differences, whole.at_differences, atol=1e-9)
    assert once is not None and often is not None and parts.rows == whole.rows == 500
    # Noise levels are medians of the blocks.
    np.testing.assert_allclose(often.values, once.values, atol=0.2 * float(once.std.min()))
    assert np.all(np.abs(often.values - truth(model, equations.names)) < 4.0 * often.std)


def test_sums_are_the_transforms_of_increments() -> None:
    """A second writing, sample by sample, of what the sums hold for the rigid aircraft."""
    model = bases.rigid_model()
    record = noisy(model, bases.rigid_flight(2.0), np.random.default_rng(3))
    _, sums, _ = followed(model, record, block=7)
    time, q = record.time, record["q"].values
    alpha = record["alpha"].values
    left = np.zeros(OMEGA.size, dtype=complex)
    areas = np.zeros(OMEGA.size, dtype=complex)
    for k in range(len(record) - 1):
        turn = np.exp(-1j * OMEGA * time[k])
        left += (q[k + 1] - q[k]) * turn
        areas += 0.5 * (alpha[k] + alpha[k + 1]) * (time[k + 1] - time[k]) * turn
    np.testing.assert_allclose(sums.known_side[1], left, atol=1e-12)
    values = bases.RIGID_VALUES
    pressure = 0.5 * values["air_density"] * values["airspeed"] ** 2 * values["wing_area"]
    slope = pressure * values["chord"] / values["pitch_inertia"]
    np.testing.assert_allclose(
        sums.regressors[1, FREE.index("Cm_alpha")],
        slope * areas,
        rtol=0.01,
        atol=0.01 * slope * np.abs(areas).max(),
    )
    np.testing.assert_allclose(sums.at_differences[0], len(record) - 1)


def coverage(scale: float, duration: float, seeds: int) -> tuple[np.ndarray, np.ndarray]:
    """Errors in sigmas ``(seeds, 6)`` of the rigid aircraft's derivatives, and their shares within
    1.96.
    """
    model, flight = bases.rigid_model(), bases.rigid_flight(duration)
    out = []
    for seed in range(seeds):
        record = noisy(model, flight, np.random.default_rng(seed), offsets=OFFSETS, scale=scale)
        _, _, found = followed(wrong(model), record)
        assert found is not None
        out.append((found.values - TRUE) / found.std)
    errors = np.array(out)
    return errors, np.mean(np.abs(errors) < 1.96, axis=0)


@pytest.mark.long
def test_sigmas_hold() -> None:
    errors, shares = coverage(1.0, 6.0, 40)
    assert 0.93 <= np.mean(shares) <= 0.995 and np.all(shares >= 0.85)
    assert np.all(np.abs(errors.mean(axis=0)) < 0.6)


@pytest.mark.long
def test_the_residuals_are_as_large_as_the_noise_of_the_samples_says() -> None:
    """At the true parameters the power of the residuals is what the noise of the samples predicts;
    at the lowest frequencies nearly all of it comes from the two ends of the increments."""
    model, flight = bases.rigid_model(), bases.rigid_flight(6.0)
    left, told = [], []
    for seed in range(60):
        record = noisy(model, flight, np.random.default_rng(seed), offsets=OFFSETS)
        equations, sums, _ = followed(model, record)
        left.append(sums.known_side - np.einsum("eqf,q->ef", sums.regressors, TRUE))
        sensors = _sensor_levels(equations, sums, TRUE, float(np.abs(sums.at_differences[0])))
        told.append(sensors.within + sensors.ends)
    power = np.var(np.array(left), axis=0, ddof=1)
    ratio = power / np.mean(told, axis=0)
    # 60 seeds of some ten independent frequencies: 4 % an equation, 13 % a frequency. The median
    # over 50 correlated differences overestimates a variance by 5 %.
    assert np.all((ratio.mean(axis=1) > 0.8) & (ratio.mean(axis=1) < 1.1))
    assert np.all((ratio[:, 0] > 0.5) & (ratio[:, 0] < 1.5))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scale", "duration"), [(1.0, 6.0), (1.0, 10.0), (4.0, 20.0), (15.0, 10.0)]
)
def test_sigmas_hold_over_two_hundred_seeds(scale: float, duration: float) -> None:
    _, shares = coverage(scale, duration, 200)
    assert 0.935 <= np.mean(shares) <= 0.985 and np.all(shares >= 0.91)


@pytest.mark.long
def test_the_noise_of_regressors_is_taken_off() -> None:
    """With fifteen times the noise least squares are drawn towards zero; the estimate is not."""
    model, flight = bases.rigid_model(), bases.rigid_flight(10.0)
    taken_off, plain = [], []
    for seed in range(30):
        record = noisy(model, flight, np.random.default_rng(seed), scale=15.0)
        equations, sums, found = followed(wrong(model), record)
        simple = estimate(equations, replace(sums, noise=np.zeros_like(sums.noise)))
        assert found is not None and simple is not None
        taken_off.append((found.values[0] - TRUE[0]) / found.std[0])
        plain.append((simple.values[0] - TRUE[0]) / simple.std[0])
    assert np.mean(plain) < -0.3
    assert abs(np.mean(taken_off)) < abs(np.mean(plain)) and abs(np.mean(taken_off)) < 0.5


def test_samples_that_are_missing_are_bridged() -> None:
    model = bases.rigid_model()
    record = noisy(model, bases.rigid_flight(10.0), np.random.default_rng(5), scale=1e-6)
    lost = np.random.default_rng(6).random(len(record)) < 0.1
    rate = record["q"]
    gaps = replace(rate, values=np.where(lost, np.nan, rate.values), valid=rate.valid & ~lost)
    outputs = tuple(gaps if each.name == "q" else each for each in record.outputs)
    _, sums, found = followed(wrong(model), replace(record, outputs=outputs))
    assert found is not None and sums.rows == int(np.count_nonzero(~lost))
    np.testing.assert_allclose(found.values, TRUE, rtol=0.05)


def test_little_data_give_no_number() -> None:
    model = bases.rigid_model()
    record = noisy(model, bases.rigid_flight(0.6), np.random.default_rng(1))
    assert followed(model, record)[2] is None
    still = bases.Flight(np.arange(400) / 50.0, np.zeros((1, 400)))
    _, _, found = followed(model, noisy(model, still, np.random.default_rng(1)))
    assert found is None or np.all(np.isinf(found.std) | (found.std > 0.5 * np.abs(TRUE)))


@pytest.mark.parametrize("wrong_one", ["state", "bent", "nothing"])
def test_refusals(wrong_one: str) -> None:
    def rates(s: object, p: object) -> Mapping[str, object]:
        gain = p.a * p.b if wrong_one == "bent" else p.a + p.b  # type: ignore[attr-defined]
        return {"p": -gain * s.p + s.u}  # type: ignore[attr-defined]

    model = own_model(
        name="one",
        states={"p": "rad/s"},
        inputs={"u": "rad"},
        outputs={"p": "rad/s"},
        parameters={"a": (1.0, "1/s"), "b": (2.0, "1/s")},
        rates=rates,
        readings=lambda s, p: {"p": s.p},
    )
    system = compile_model(model)
    if wrong_one == "nothing":
        system = replace(system, parameters=system.parameters.hold(["a", "b"]))
    measured = () if wrong_one == "state" else ("p",)
    said = {"state": "state p is not measured", "nothing": "no parameter is free"}
    if wrong_one in said:
        with pytest.raises(ModelError, match=said[wrong_one]):
            online_equations(system, OMEGA, measured)
        return
    bent = own_model(
        name="two",
        states={"p": "rad/s"},
        inputs={"u": "rad"},
        outputs={"p": "rad/s"},
        parameters={"a": (1.0, "1/s")},
        rates=lambda s, p: {"p": -p.a * p.a * s.p + s.u},
        readings=lambda s, p: {"p": s.p},
    )
    system = compile_model(bent)
    equations = online_equations(system, OMEGA, ("p",))
    time = np.arange(10) / 50.0
    with pytest.raises(ModelError, match="not linear in a"):
        advance(equations, empty_sums(equations), time, np.ones((1, 10)), np.sin(time)[None])


# The low-order equivalent system ----------------------------------------------------------------

NAMES = ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau", "delay")


def low_order(seed: int, scale: float, lag: float = 0.8) -> tuple[np.ndarray, np.ndarray]:
    """Values and deviations of the low-order equivalent system, from starts that are a quarter off,
    that of the lag by a factor."""
    factors = dict(zip(NAMES, (0.8, 1.25) * 4, strict=True)) | {"inv_tau": lag}
    model = bases.loes_model(
        {name: value * factors.get(name, 1.0) for name, value in bases.LOES_VALUES.items()}
    )
    record = noisy(
        bases.loes_model(),
        bases.loes_flight(10.0),
        np.random.default_rng(seed),
        offsets=OFFSETS,
        scale=scale,
    )
    system = compile_model(model)
    rows, _ = record.output_array(system.output_names)
    stick = record["stick"].values
    stream, found = lag_stream(system, OMEGA, system.output_names), None
    assert set(stream.names) == set(NAMES)
    for first in range(0, len(record), 50):
        part = slice(first, first + 50)
        values = None if found is None else found.values
        stream = with_rows(stream, record.time[part], stick[part], rows[:, part], values)
        found, stream = estimated(stream)
    assert found is not None
    order = [stream.names.index(name) for name in NAMES]
    return found.values[order], found.std[order]


LOES_TRUE = np.array([bases.LOES_VALUES[name] for name in NAMES])


@pytest.mark.long
def test_a_low_order_equivalent_without_noise() -> None:
    values, _ = low_order(1, 1e-6)
    np.testing.assert_allclose(values, LOES_TRUE, rtol=3e-3)


@pytest.mark.long
@pytest.mark.parametrize("lag", [0.15, 8.0])
def test_a_start_of_the_lag_that_is_far_off_leads_to_the_same(lag: float) -> None:
    near, std = low_order(2, 1.0)
    far, _ = low_order(2, 1.0, lag)
    assert np.all(np.abs(far - near) < 0.2 * std)


@pytest.mark.long
def test_sigmas_of_a_low_order_equivalent_hold() -> None:
    errors = np.array(
        [(values - LOES_TRUE) / std for values, std in (low_order(seed, 1.0) for seed in range(12))]
    )
    assert np.mean(np.abs(errors) < 1.96) >= 0.85


@pytest.mark.slow
def test_sigmas_of_a_low_order_equivalent_hold_over_a_hundred_seeds() -> None:
    errors = np.array(
        [
            (values - LOES_TRUE) / std
            for values, std in (low_order(seed, 1.0) for seed in range(100))
        ]
    )
    assert 0.90 <= np.mean(np.abs(errors) < 1.96) <= 0.98


def test_the_pseudo_control_is_that_of_a_lag_and_a_delay() -> None:
    time = np.arange(400) / 40.0
    stick = 0.3 + np.repeat(np.random.default_rng(4).normal(size=40), 10)
    lag, late = 7.0, 0.137
    delta, area = pseudo_control(time, stick, lag, late)
    fine = np.arange(0.0, 10.0, 1e-4)
    held = stick[np.clip(np.floor((fine - late) * 40.0 + 1e-9).astype(int), 0, 399)]
    held[fine < late] = stick[0]
    _, exact, _ = signal.lsim(([lag], [1.0, lag]), held - stick[0], fine, interp=False)
    exact = exact + stick[0]
    at = np.round(time / 1e-4).astype(int)
    np.testing.assert_allclose(delta, exact[at], atol=2e-3)
    whole = np.concatenate([[0.0], np.cumsum(0.5 * (exact[1:] + exact[:-1]) * 1e-4)])
    np.testing.assert_allclose(area, whole[at], atol=2e-3)
    assert math.isclose(delta[0], stick[0])


@pytest.mark.parametrize("block", [7, 500])
def test_inputs_that_are_linear_between_rows(block: int) -> None:
    """Without noise the truth is found from linear inputs, also where rows are bridged; read as
    held they act half a sample late, which biases the control power.
    """
    model = bases.rigid_model()
    time = np.arange(400) / 20.0
    elevator = 0.05 * np.sin(1.5 * time) * np.sin(0.4 * time) + 0.02 * np.sin(5.0 * time)
    flight = bases.Flight(time, elevator[None], hold=Hold.LINEAR)
    system = compile_model(model)
    rows = np.array(bases.fly(system, flight))
    rows[:, 123:126] = np.nan
    found = {}
    for hold in Hold:
        equations = replace(online_equations(system, OMEGA, system.output_names), hold=hold)
        sums, last = empty_sums(equations), None
        for first in range(0, 400, block):
            part = slice(first, first + block)
            values = None if last is None else last.values
            given = (time[part], elevator[None, part], rows[:, part], values)
            sums = advance(equations, sums, *given)
            last = estimate(equations, sums) or last
        assert last is not None
        found[hold] = last
    true = truth(model, equations.names)
    at = equations.names.index("Cm_de")
    error = {hold: abs(each.values[at] / true[at] - 1.0) for hold, each in found.items()}
    assert error[Hold.LINEAR] < 3e-3
    assert error[Hold.PREVIOUS] > 0.02
    assert found[Hold.LINEAR].cost < found[Hold.PREVIOUS].cost - 5.0
