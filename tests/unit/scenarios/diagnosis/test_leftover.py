"""Residuals described: made-up residuals whose colour, frequency, moment and correlated signal are
known.
"""

from __future__ import annotations

import numpy as np
import pytest

from ident.tracing.diagnosis import FittedRecord
from ident.tracing.loop import fit_declared
from ident.tracing.whiteness import noise_shown
from scenarios.diagnosis.evidence import (
    SMALLEST_CORRELATION,
    ChannelResidual,
    channel_residual,
)
from sim.record import Channel, Hold, Record
from tests.tracing_problem import planted, problem_of, with_output

RATE = 40.0


def fitted_record(
    residual: np.ndarray,
    elevator: np.ndarray,
    output: np.ndarray | None = None,
    used: np.ndarray | None = None,
) -> FittedRecord:
    """One record with the channel q, the residual in it, and what the fit had of it beneath."""
    time = np.arange(len(residual)) / RATE
    simulated = np.zeros(len(residual)) if output is None else output
    record = Record(
        time,
        (Channel.of("elevator", "rad", elevator),),
        (Channel.of("q", "rad/s", simulated + residual),),
        Hold.LINEAR,
        "a.csv",
    )
    mask = np.ones(len(residual), dtype=bool) if used is None else used
    return FittedRecord(record, ("q",), residual[None], residual[None], mask[None])


def described(*items: FittedRecord) -> ChannelResidual:
    found = channel_residual(items, "q")
    assert found is not None
    return found


def stepping(rng: np.random.Generator, count: int) -> np.ndarray:
    return np.repeat(rng.choice([-1.0, 1.0], count // 20 + 1), 20)[:count]


def test_a_sine_is_found_at_its_frequency_with_its_size() -> None:
    time = np.arange(1000) / RATE
    left = described(fitted_record(0.02 * np.sin(2.0 * np.pi * 1.3 * time), np.ones(1000)))
    assert left.peak == pytest.approx(1.3, abs=2.0 / 25.0) and left.frequency_below_80_percent < 1.6
    assert left.rms == pytest.approx(0.02 / np.sqrt(2.0), rel=1e-3)
    assert left.correlation == pytest.approx(np.cos(2.0 * np.pi * 1.3 / RATE), abs=5e-3)
    assert left.window_ratio < 1.05 and left.correlated_signal is None


def test_the_record_and_the_moment_of_a_burst_are_named() -> None:
    rng = np.random.default_rng(4)
    quiet, loud = (0.001 * rng.standard_normal(1000) for _ in range(2))
    loud[400:480] += 0.02 * rng.standard_normal(80)
    left = described(fitted_record(quiet, np.ones(1000)), fitted_record(loud, np.ones(1000)))
    assert (
        left.record == 1
        and left.begin == pytest.approx(10.0, abs=0.3)
        and left.end == pytest.approx(12.0, abs=0.3)
    )
    assert left.window_ratio > 3.0


@pytest.mark.parametrize(
    ("form", "delay"), [("itself", 0.2), ("itself", -0.1), ("rate", 0.1), ("square", 0.0)]
)
def test_what_the_input_drives_goes_with_it(form: str, delay: float) -> None:
    rng = np.random.default_rng(5)
    items = []
    for _ in range(3):
        moves = np.convolve(rng.standard_normal(1000), np.hanning(25), mode="same")
        shape = {"itself": moves, "rate": np.gradient(moves) * RATE, "square": moves**2}[form]
        later = np.roll(shape, round(delay * RATE))
        items.append(
            fitted_record(0.1 * later / later.std() + 0.1 * rng.standard_normal(1000), 0.05 * moves)
        )
    correlated = described(*items).correlated_signal
    assert correlated is not None and (correlated.name, correlated.form) == ("elevator", form)
    assert correlated.lag == pytest.approx(delay, abs=0.06)
    assert correlated.correlation == pytest.approx(np.sqrt(0.5), abs=0.1)


def test_a_simulated_output_is_a_correlate_but_its_noise_is_none() -> None:
    rng = np.random.default_rng(6)
    beneath = np.convolve(rng.standard_normal(1200), np.hanning(30), mode="same")
    alone = 0.3 * rng.standard_normal(1200)
    assert described(fitted_record(alone, np.ones(1200), beneath)).correlated_signal is None
    correlated = described(
        fitted_record(0.1 * beneath + alone, np.ones(1200), beneath)
    ).correlated_signal
    assert correlated is not None and (correlated.name, correlated.form, correlated.lag) == (
        "q",
        "itself",
        0.0,
    )


def test_a_product_with_the_input_is_a_correlated_signal() -> None:
    rng = np.random.default_rng(11)
    moves, beneath = (
        np.convolve(rng.standard_normal(2000), np.hanning(25), mode="same") for _ in range(2)
    )
    both = moves * beneath
    correlated = described(
        fitted_record(both / both.std() + rng.standard_normal(2000), moves, 5.0 * beneath)
    ).correlated_signal
    assert correlated is not None and (correlated.name, correlated.form) == ("q", "product")
    assert correlated.lag == pytest.approx(0.0, abs=0.06)


def test_coloured_chance_is_hardly_ever_a_correlated_signal() -> None:
    rng = np.random.default_rng(7)
    accused = 0
    for _ in range(60):
        wander = [
            np.convolve(rng.standard_normal(1060), np.exp(-np.arange(60) / 15.0), mode="valid")[
                :1000
            ]
            for _ in range(3)
        ]
        accused += (
            described(fitted_record(wander[0], stepping(rng, 1000), wander[1])).correlated_signal
            is not None
        )
    assert accused <= 4


@pytest.mark.parametrize("size", [SMALLEST_CORRELATION / 3.0, 0.0])
def test_a_small_correlation_is_not_worth_a_word(size: float) -> None:
    rng = np.random.default_rng(8)
    items = []
    for _ in range(5):
        moves = np.convolve(rng.standard_normal(2000), np.hanning(9), mode="same")
        items.append(fitted_record(size * moves / moves.std() + rng.standard_normal(2000), moves))
    assert described(*items).correlated_signal is None


def test_samples_that_were_set_aside_are_left_out() -> None:
    rng = np.random.default_rng(9)
    residual = 0.01 * rng.standard_normal(500)
    used = np.ones(500, dtype=bool)
    used[100:110] = False
    wild = np.where(used, residual, 1e3)
    assert described(fitted_record(wild, np.ones(500), used=used)).rms == pytest.approx(
        float(residual[used].std()), rel=1e-9
    )


def test_noise_is_shown_under_a_slow_residual() -> None:
    """A drift of the pitch rate that the model lacks, twenty times its noise: what samples in a row
    scatter by is still the noise.
    """
    records = [
        with_output(record, "q", record["q"].values + 0.04 * np.sin(0.4 * record.time))
        for record in (planted([], None, 1), planted([], None, 2))
    ]
    root = fit_declared(problem_of(records, [])).fitted
    shown = noise_shown(root.fit, "q")
    assert shown is not None and np.sqrt(root.fit.variance[1]) > 5.0 * shown
    assert shown == pytest.approx(0.002, rel=0.3)  # as the model declares it


def test_nothing_is_said_of_too_little() -> None:
    assert channel_residual((fitted_record(np.ones(15), np.ones(15)),), "q") is None
    assert channel_residual((fitted_record(np.ones(500), np.ones(500)),), "q") is None
    assert channel_residual((fitted_record(np.ones(500), np.ones(500)),), "alpha") is None
    assert channel_residual((), "q") is None
