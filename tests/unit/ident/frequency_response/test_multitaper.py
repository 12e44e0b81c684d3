"""Frequency response of known systems: gain, phase, coherence, and the fit of the model that made
the record.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.frequency_response.model_fit import estimate_response, fit_response, model_response
from sim.declaration.compile import compile_model
from sim.errors import ModelError, RecordError
from sim.record import Channel, Hold, Record
from tests.bases import LOES_CONSTANTS, LOES_VALUES, fly, loes_flight, loes_model

FREE = ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau", "delay")


def loes_record(noise: float = 0.0, hold: Hold = Hold.PREVIOUS) -> Record:
    flight = loes_flight(20.0)
    rows = fly(compile_model(loes_model()), replace(flight, hold=hold))
    rng = np.random.default_rng(2)
    outputs = tuple(
        Channel.of(name, unit, row + noise * np.ptp(row) * rng.standard_normal(row.size))
        for name, unit, row in zip(("alpha", "q", "nz"), ("rad", "rad/s", "g"), rows, strict=True)
    )
    return Record(flight.time, (Channel.of("stick", "in", flight.u[0]),), outputs, hold)


@pytest.mark.parametrize("hold", list(Hold))
def test_response_of_a_known_system(hold: Hold) -> None:
    found = estimate_response(loes_record(hold=hold), tapers=3)
    exact = model_response(compile_model(loes_model()), {}, found.omega, found.outputs)
    error = np.abs(found.response / exact - 1.0)
    strong = found.omega < 7.0
    assert np.median(error[:, strong]) < 0.03
    assert found.coherence[:, strong].min() > 0.9


@pytest.mark.parametrize("hold", list(Hold))
def test_the_hold_is_taken_out(hold: Hold) -> None:
    """y_dot = u - y at five samples a second: its z-transform over the transfer function of the
    hold, which is a sinc or its square.
    """
    step, count, rng = 0.2, 6000, np.random.default_rng(4)
    u, y = rng.standard_normal(count), np.zeros(count)
    decay = np.exp(-step)
    ramp = 1.0 - (1.0 - decay) / step  # what an input that rises from 0 to 1 over a step makes
    for k in range(count - 1):
        later = u[k + 1] if hold is Hold.LINEAR else u[k]
        y[k + 1] = decay * y[k] + (1.0 - decay) * u[k] + ramp * (later - u[k])
    channels = (Channel.of("stick", "1", u),), (Channel.of("q", "rad/s", y),)
    found = estimate_response(
        Record(step * np.arange(count), *channels, hold), low=0.5, high=14.0, tapers=9
    )
    x, z = 0.5 * found.omega * step, np.exp(1j * found.omega * step)
    if hold is Hold.PREVIOUS:
        expected = (1.0 - decay) / (z - decay) / (np.sin(x) / x * np.exp(-1j * x))
    else:
        expected = (1.0 - decay + ramp * (z - 1.0)) / (z - decay) / (np.sin(x) / x) ** 2
    ratio = found.response[0] / expected
    for low, high in ((0.5, 2.0), (4.0, 6.0), (9.0, 11.0), (13.0, 14.0)):
        near = (found.omega > low) & (found.omega < high)
        assert abs(np.mean(ratio[near]) - 1.0) < 0.02, (low, high)
    # Below a third of the folding frequency it is the motion's own response.
    slow = found.omega < 5.0
    own = found.response[0, slow] * (1.0 + 1j * found.omega[slow])
    assert abs(np.mean(own) - 1.0) < (0.02 if hold is Hold.LINEAR else 0.05)


def test_model_response_is_the_closed_form() -> None:
    w, v = np.array([0.5, 3.0, 9.0]), LOES_VALUES
    s = 1j * w
    lag = v["inv_tau"] / (s + v["inv_tau"]) * np.exp(-s * v["delay"])
    determinant = (s - v["L_alpha"]) * (s - v["M_q"]) - v["L_q"] * v["M_alpha"]
    q = ((s - v["L_alpha"]) * v["M_delta"] + v["M_alpha"] * v["L_delta"]) / determinant * lag
    alpha = ((s - v["M_q"]) * v["L_delta"] + v["L_q"] * v["M_delta"]) / determinant * lag
    nz = LOES_CONSTANTS["airspeed"] / LOES_CONSTANTS["gravity"] * (q - s * alpha)
    got = model_response(compile_model(loes_model()), {}, w, ("q", "nz"))
    np.testing.assert_allclose(got, [q, nz], rtol=1e-10)


def test_fit_finds_delay_and_damping() -> None:
    wrong = {name: 1.25 * LOES_VALUES[name] for name in FREE}
    model = loes_model().with_values(wrong)
    system = compile_model(model.with_parameters(model.parameters.release(["delay"])))
    fit = fit_response(estimate_response(loes_record(noise=0.002)), system, FREE)
    assert fit.converged and fit.mismatch < 1.0
    w2 = fit.values["L_alpha"] * fit.values["M_q"] - LOES_VALUES["L_q"] * fit.values["M_alpha"]
    true = LOES_VALUES["L_alpha"] * LOES_VALUES["M_q"] - LOES_VALUES["L_q"] * LOES_VALUES["M_alpha"]
    assert np.sqrt(w2) == pytest.approx(np.sqrt(true), rel=0.06)
    assert -(fit.values["L_alpha"] + fit.values["M_q"]) / 2 / np.sqrt(w2) == pytest.approx(
        0.5 * 4.9 / np.sqrt(true), abs=0.05
    )
    assert fit.values["delay"] == pytest.approx(LOES_VALUES["delay"], abs=0.012)


def test_coherence_falls_with_noise_that_is_not_the_inputs() -> None:
    low, high = (estimate_response(loes_record(noise)).coherence.mean() for noise in (0.0, 0.1))
    assert high < 0.8 * low


def test_refuses_what_it_cannot_use() -> None:
    record = loes_record()
    time = record.time.copy()
    time[5] += 0.004
    with pytest.raises(RecordError, match="uneven"):
        estimate_response(Record(time, record.inputs, record.outputs))
    gap = Channel.of(
        "q", "rad/s", np.where(np.arange(len(record)) == 9, np.nan, record["q"].values)
    )
    with pytest.raises(RecordError, match="missing"):
        estimate_response(Record(record.time, record.inputs, (gap,)))
    still = Channel.of("stick", "in", np.zeros(len(record)))
    with pytest.raises(RecordError, match="does not move"):
        estimate_response(Record(record.time, (still,), record.outputs))
    with pytest.raises(ModelError, match="1 tapers"):
        estimate_response(record, tapers=1)
    with pytest.raises(RecordError, match="no frequency"):
        estimate_response(record, low=500.0, high=600.0)
