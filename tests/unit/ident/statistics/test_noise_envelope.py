"""The noise envelope finds the level of noise under motion, gaps and spikes."""

from __future__ import annotations

import numpy as np
import pytest

from ident.statistics.noise_levels import noise_envelope
from sim.errors import RecordError
from sim.record import Channel, Record

TIME = np.arange(4001) * 0.025


def record(values: np.ndarray) -> Record:
    return Record(TIME[: len(values)], (), (Channel.of("q", "rad/s", values),))


def noise(size: int = 4001) -> np.ndarray:
    return 0.002 * np.random.default_rng(4).standard_normal(size)


def test_finds_the_level_under_motion_gaps_and_spikes() -> None:
    values = 0.2 * np.sin(3.0 * TIME) + noise()
    values[::97] = np.nan
    values[[300, 2000]] += 1.0
    assert noise_envelope(record(values))["q"] == pytest.approx(0.002, rel=0.06)


def test_a_quiet_stretch_serves_alone() -> None:
    values = noise()
    values[2000:] += 0.3 * np.sin(30.0 * TIME[2000:])
    assert noise_envelope(record(values), stop=50.0)["q"] == pytest.approx(0.002, rel=0.06)
    assert noise_envelope(record(values))["q"] > 0.004


def test_refuses_what_has_no_noise_or_is_too_short() -> None:
    with pytest.raises(RecordError, match="has no noise"):
        noise_envelope(record(np.ones(400)))
    with pytest.raises(RecordError, match="too few"):
        noise_envelope(record(noise(15)))
