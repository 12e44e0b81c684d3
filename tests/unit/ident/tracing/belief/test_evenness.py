"""Is as much left where the aircraft rests as where it moves? Residuals of known size, second by second."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.belief.evenness import behind_gaps, chance_that_even, is_even, is_uneven, loudest_fifth, seconds_of
from ident.whole_record.gauss_newton import Fit


def moving(seconds: int, share: float, seed: int = 1, rate: int = 25) -> Fit:
    """One output that swings, each second by another amount; what is left has a part that goes with it, ``share`` of the whole."""
    rng = np.random.default_rng(seed)
    time = np.arange(seconds * rate) / rate
    size = np.repeat(rng.permutation(seconds) / seconds, rate)
    y = 3.0 + size * np.sin(2.0 * np.pi * time)
    left = rng.standard_normal(len(time)) * (1.0 - share + share * 2.0 * size)
    problem, line = SimpleNamespace(record=SimpleNamespace(time=time)), SimpleNamespace(y=y[None])
    layout = SimpleNamespace(problems=(problem,))
    return cast("Fit", SimpleNamespace(layout=layout, lines=(line,), residuals=(0.1 * left[None],), variance=np.array([0.01])))


@pytest.mark.parametrize(("share", "even"), [(0.0, True), (0.8, False)])
def test_what_goes_with_the_motion_is_uneven(share: float, even: bool) -> None:
    fits = [moving(30, share)]
    assert is_even(fits) is even and is_uneven(fits) is not even
    chance = chance_that_even(seconds_of(fits))
    assert chance is not None and (chance > thresholds.EVEN) is even


def test_seconds_of_all_records_count_together_and_too_few_say_neither() -> None:
    few = thresholds.FEWEST_SECONDS - 1
    assert chance_that_even(seconds_of([moving(few, 0.8)])) is None and not is_even([moving(few, 0.0)]) and not is_uneven([moving(few, 0.8)])
    assert is_uneven([moving(few, 0.8), moving(few, 0.8, seed=2)])


def test_the_test_is_spearmans() -> None:
    """The same p-value, against scipy, of mean squares by second."""
    from scipy.stats import spearmanr

    fit = moving(30, 0.3)
    y, left = fit.lines[0].y[0].reshape(30, 25), fit.residuals[0][0].reshape(30, 25)
    moved = np.mean((y - np.median(y)) ** 2, axis=1)
    expected = spearmanr(moved, np.mean(left**2, axis=1), alternative="greater").pvalue
    assert chance_that_even(seconds_of([fit])) == pytest.approx(expected, rel=1e-9)


def test_an_episode_is_not_even() -> None:
    """Thirty seconds of the same noise, four of them ten times as loud: the wake of another aircraft."""
    calm = moving(30, 0.0)
    loud = np.where((np.arange(750) >= 250) & (np.arange(750) < 350), 10.0, 1.0)
    wake = cast("Fit", SimpleNamespace(layout=calm.layout, lines=calm.lines, residuals=(loud * calm.residuals[0],), variance=calm.variance))
    power = np.sort(np.sum((loud * calm.residuals[0])[0].reshape(30, 25) ** 2, axis=1))
    assert loudest_fifth(seconds_of([wake])) == pytest.approx(power[-6:].sum() / power.sum())
    assert loudest_fifth(seconds_of([calm])) < thresholds.EPISODE < loudest_fifth(seconds_of([wake]))
    assert loudest_fifth(seconds_of([calm, wake])) == pytest.approx(0.5 * (loudest_fifth(seconds_of([calm])) + loudest_fifth(seconds_of([wake]))))
    assert is_uneven([wake]) and not is_even([wake])


@pytest.mark.parametrize(
    ("lost", "loud_from", "behind"), [((250, 275), 275, True), ((250, 275), 500, False), ((250, 253), 253, False), ((), 275, False)]
)
def test_what_is_left_right_behind_missing_rows_is_told(lost: tuple[int, ...], loud_from: int, behind: bool) -> None:
    """A second ten times as loud as the rest: behind a gap of a second, ten seconds later, behind three lost rows, and without a gap."""
    calm = moving(30, 0.0)
    left = calm.residuals[0] * np.where((np.arange(750) >= loud_from) & (np.arange(750) < loud_from + 25), 10.0, 1.0)
    kept = np.delete(np.arange(750), np.arange(*lost) if lost else [])
    record = SimpleNamespace(time=calm.layout.problems[0].record.time[kept])
    line = SimpleNamespace(y=calm.lines[0].y[:, kept])
    layout = SimpleNamespace(problems=(SimpleNamespace(record=record),))
    fit = cast("Fit", SimpleNamespace(layout=layout, lines=(line,), residuals=(left[:, kept],), variance=calm.variance))
    assert behind_gaps([calm, fit]) is behind and not behind_gaps([])
