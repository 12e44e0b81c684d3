"""Responses of a stream against those of the whole record, sample by sample and block by block."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import signal

from ident.frequency_response import EvenSignals, Spectra, estimate_responses
from ident.frequency_response.estimate import frequencies
from ident.frequency_response.online import (
    OnlineResponses,
    add_samples,
    estimated,
    interrupt,
    online_responses,
)
from sim.errors import DeclarationError

STEP, LENGTHS = 0.02, (10.0, 5.0, 2.5)
FREQUENCY = frequencies(0.3, 5.0)


def rows(seed: int = 1, count: int = 3000) -> np.ndarray:
    """Output, input and reference of a loop with noise, ``(3, N)``."""
    rng = np.random.default_rng(seed)
    reference = signal.lfilter(*signal.butter(2, 0.2), rng.normal(size=count))
    late = np.zeros(count)
    out = np.zeros(count)
    for k in range(1, count):
        late[k] = reference[k] - 0.4 * out[k - 1]
        out[k] = 0.9 * out[k - 1] + 0.3 * late[k - 1] + 0.01 * rng.normal()
    return np.stack([out, late, reference])


def streamed(table: np.ndarray, block: int, **options: Any) -> OnlineResponses:
    stream = online_responses(STEP, FREQUENCY, LENGTHS, joint=True, **options)
    for first in range(0, table.shape[1], block):
        add_samples(stream, table[:, first : first + block])
    return stream


def test_a_stream_gives_what_the_record_gives() -> None:
    table = rows()
    found = estimated(streamed(table, 37))
    record = EvenSignals(STEP, table[[1]], table[[0]], table[[2]])
    whole = estimate_responses([record], FREQUENCY, Spectra(LENGTHS))
    assert found is not None and found.joint
    # The straight line is taken off each window instead of the record: a few thousandths.
    np.testing.assert_allclose(found.response, whole.response, rtol=0.02)
    np.testing.assert_allclose(found.std, whole.std, rtol=0.1)
    np.testing.assert_allclose(found.degrees, whole.degrees, rtol=0.05)


@pytest.mark.long
def test_how_samples_come_makes_no_difference() -> None:
    table = rows(2)
    one, many = estimated(streamed(table, 1)), estimated(streamed(table, 1000))
    assert one is not None and many is not None
    np.testing.assert_allclose(one.response, many.response, rtol=1e-9)
    np.testing.assert_allclose(one.std, many.std, rtol=1e-9)


def test_levels_and_drifts_change_nothing() -> None:
    table = rows(3)
    drift = table + np.array([[50.0], [-3.0], [7.0]]) + 0.01 * np.arange(table.shape[1])
    plain, moved = estimated(streamed(table, 500)), estimated(streamed(drift, 500))
    assert plain is not None and moved is not None
    np.testing.assert_allclose(moved.response, plain.response, rtol=1e-6)


def test_a_gap_is_bridged_by_no_window() -> None:
    """Behind a gap another system flows in; windows of both sides alone are used."""
    table = rows(4)
    stream = streamed(table[:, :1200], 100)
    before = [len(window.rows) for window in stream.windows]
    interrupt(stream, 50)
    for first in range(1200, 2400, 100):
        add_samples(stream, table[:, first : first + 100])
    for window, count in zip(stream.windows, before, strict=True):
        behind = np.array(window.starts[count:])
        assert np.all(behind >= 1250) and (behind.size == 0 or behind[0] == 1250)
    assert estimated(stream) is not None


def test_the_past_is_forgotten() -> None:
    table = rows(5)
    stream = streamed(table, 100, memory=20.0)
    assert estimated(stream) is not None
    assert min(min(window.starts) for window in stream.windows) >= 2000


def test_too_little_says_nothing() -> None:
    assert estimated(streamed(rows()[:, :100], 50)) is None
    with pytest.raises(DeclarationError, match=r"above 0\.45 of the rate"):
        online_responses(STEP, np.array([30.0]), LENGTHS)
