"""Figures of frequency responses keep the laws of all figures."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

import flightid as fid
from scenarios.plots.flying_qualities import (
    figure_bandwidth,
    figure_margins,
    figure_mismatch,
    figure_response,
)
from sim.errors import DeclarationError
from tests.figure_laws import broken_laws, words

STEP = 0.02


@pytest.fixture(scope="module")
def flown() -> dict[str, np.ndarray]:
    """A stick with feedback of the pitch rate, a sweep that is added to it, a second input."""
    rng = np.random.default_rng(3)
    count = 10000
    top, bottom, _ = signal.cont2discrete(([6.0, 7.2], [1.0, 3.2, 16.0]), STEP, "zoh")
    top = np.concatenate([np.zeros(4), np.ravel(top)[1:]])
    bottom = np.concatenate([bottom, np.zeros(3)])
    sweep, other = (
        signal.lfilter(*signal.butter(2, 0.3), rng.standard_normal(count)) for _ in "ab"
    )
    noise = 0.05 * rng.standard_normal(count)
    closed = np.polyadd(bottom, 0.3 * top)
    q = signal.lfilter(top, closed, sweep) + signal.lfilter(bottom, closed, noise)
    time = STEP * np.arange(count)
    return {"time": time, "stick": sweep - 0.3 * q, "sweep": sweep, "other": other, "q": q}


@pytest.mark.parametrize("case", ["one", "two", "joint"])
def test_laws(flown: dict[str, np.ndarray], case: str) -> None:
    inputs = ["stick", "other"] if case == "two" else ["stick"]
    reference = ["sweep"] if case == "joint" else []
    details = fid.frequency_response(
        flown,
        inputs,
        "q",
        reference=reference,
        band=(0.1, 5.0),
        fit="pitch" if case != "two" else (),
        bandwidth="rate",
        margins="minus" if case != "two" else None,
    ).details
    drawn = [figure_response(details)]
    drawn += [figure_bandwidth(details)]
    drawn += [figure_margins(details)] if case != "two" else []
    drawn += [figure_mismatch(details)] if case != "two" else [figure_response(details, 0, 1)]
    for figure in drawn:
        assert not broken_laws(figure)
    assert ("partial coherence" in words(drawn[0])) == (case == "two")
    assert ("direct" in words(drawn[0])) == (case == "joint")
    assert "phase bandwidth" in words(drawn[1]) and "-180 deg" in words(drawn[1])
    if case == "two":
        with pytest.raises(DeclarationError, match="no margins to draw"):
            figure_margins(details)
        with pytest.raises(DeclarationError, match="no transfer function is fitted"):
            figure_mismatch(details)
