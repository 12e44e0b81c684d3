"""The scatter of a held-out change against a second writing, block by block, and against the theory of white noise."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.validation.scatter_of_change import scatter_of_change

TIME = 0.02 * np.arange(1500)


def fit_of(*residuals: np.ndarray) -> Any:
    problems = [SimpleNamespace(record=SimpleNamespace(time=TIME)) for _ in residuals]
    return SimpleNamespace(layout=SimpleNamespace(problems=problems), residuals=residuals)


def test_scatter_is_that_of_resampled_blocks() -> None:
    rng = np.random.default_rng(5)
    before, after = ([scale * rng.standard_normal((2, 1500)) for _ in range(2)] for scale in (2.0, 1.0))
    blocks = [(record, start) for record in range(2) for start in range(0, 1500, 75)]
    draws = np.random.default_rng(0).integers(len(blocks), size=(thresholds.BOOTSTRAP_DRAWS, len(blocks)))
    changes = []
    for draw in draws:
        sums = np.zeros((2, 2))
        for record, start in (blocks[place] for place in draw):
            for when, residuals in enumerate((before, after)):
                sums[when] += (residuals[record][:, start : start + 75] ** 2).sum(axis=1)
        changes.append(np.mean(0.5 * np.log(sums[1] / sums[0])))
    assert scatter_of_change(fit_of(*before), fit_of(*after)) == pytest.approx(np.std(changes), rel=1e-9)


def test_scatter_of_white_noise_is_the_theory_and_of_no_change_none() -> None:
    """Of n white samples ln(rms) has the variance 1 / (2 n); of two independent residuals the sum of both."""
    rng = np.random.default_rng(6)
    one, other = (rng.standard_normal((1, 1500)) for _ in range(2))
    assert scatter_of_change(fit_of(one), fit_of(other)) == pytest.approx(np.sqrt(1.0 / 1500.0), rel=0.4)
    assert scatter_of_change(fit_of(one), fit_of(one)) == pytest.approx(0.0, abs=1e-12)


def test_a_channel_that_is_not_measured_does_not_count() -> None:
    rng = np.random.default_rng(7)
    one, other = (rng.standard_normal((1, 1500)) for _ in range(2))
    empty = np.zeros((1, 1500))
    both = scatter_of_change(fit_of(np.concatenate([one, empty])), fit_of(np.concatenate([other, empty])))
    assert both == pytest.approx(scatter_of_change(fit_of(one), fit_of(other)))
