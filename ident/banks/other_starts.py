"""What an estimate on line owes to its start: the same bank run beside it from other starts, and how far they end apart.

An extended Kalman filter is linearised on its way, so that its covariance shrinks before its estimate is right, and where the way
ends hangs on where it began. A linear filter forgets its start as its covariance says. Here the starts of the factors are moved
by one sigma of their prior, up or down by the columns of a Hadamard matrix: each factor is moved in half of the starts one way
and in half the other, free of the rest (Plackett and Burman, Biometrika 33(4), 1946), so that the mean square of the differences from
the declared start is, to first order, the variance which a start drawn from that prior causes. By the law of total variance it adds to
the filter's own. The median stands for the mean: a start from which the filter fails outright says nothing of the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ident.banks.online import BankState, OnlineBank, with_delays
from sim.errors import ModelError

MEDIAN_SQUARE = 0.454936  # of a standard normal variable: the median of chi-square with one degree of freedom


class Ends(NamedTuple):
    """Where K starts have come to after each of N rows: ``mean (N, K, n)`` and ``delay (N, K)`` (s) of the most likely filter of each;
    ``sound (N, K)``."""

    mean: np.ndarray
    delay: np.ndarray
    sound: np.ndarray


class Spread(NamedTuple):
    """Of each of N rows: standard deviations ``std (N, n)`` that the start and the grid of delays add to those of the most likely filter, and
    ``delay (N,)`` (s) to the delay's; infinite where half of the starts broke down. ``differences (N, K, n)`` from the declared start."""

    std: np.ndarray
    delay: np.ndarray
    differences: np.ndarray


def moved_starts(bank: OnlineBank, factors: Sequence[str]) -> np.ndarray:
    """Starts ``(n, K)`` with the factors moved by one sigma of their prior; K is the smallest power of two above their number.

    Raises ModelError for a factor that the bank does not have.
    """
    missing = [name for name in factors if name not in bank.names]
    if missing:
        raise ModelError("it is no state and no free parameter", where=f"other starts, {missing[0]}", remedy=f"name some of {', '.join(bank.names)}")
    signs: np.ndarray = np.ones((1, 1))
    while signs.shape[1] <= len(factors):
        signs = np.kron([[1.0, 1.0], [1.0, -1.0]], signs)
    at = [bank.names.index(name) for name in factors]
    starts = np.repeat(bank.start[:, None], len(signs), axis=1)
    starts[at] += signs[:, 1 : 1 + len(at)].T * np.sqrt(np.diagonal(bank.covariance))[at, None]
    return starts


def bank_of_starts(bank: OnlineBank, starts: np.ndarray) -> OnlineBank:
    """All delays of a bank from each start ``(n, K)``, start by start. It looks for no spikes: they are taken out by the bank beside it."""
    count = starts.shape[1]
    return replace(with_delays(bank, np.tile(bank.delays, count), np.repeat(starts, len(bank.delays), axis=1)), gate=np.inf)


def ends_of(bank: OnlineBank, states: Sequence[BankState], delays: int) -> Ends:
    """The most likely filter of each start in states of a ``bank_of_starts`` with so many delays a start."""
    K, n = len(bank.delays) // delays, len(bank.names)
    likely = np.array([np.where(state.sound, state.log_likelihood, -np.inf) for state in states]).reshape(-1, K, delays)
    best = likely.argmax(axis=2)
    means = np.array([state.mean for state in states]).reshape(-1, n, K, delays)
    mean = np.take_along_axis(means, best[:, None, :, None], axis=3)[:, :, :, 0].transpose(0, 2, 1)
    return Ends(mean, bank.delays[best], np.isfinite(likely.max(axis=2)))


def spread_of(bank: OnlineBank, states: Sequence[BankState], ends: Ends) -> Spread:
    """How far the starts end from the declared one, whose bank has these ``states``, with what lies between the points of its grid of delays."""
    likely = np.array([np.where(state.sound, state.log_likelihood, -np.inf) for state in states])
    best, each = likely.argmax(axis=1), np.arange(len(states))
    low, high = np.maximum(best - 1, 0), np.minimum(best + 1, len(bank.delays) - 1)
    means = np.array([state.mean for state in states])
    slope = (means[each, :, high] - means[each, :, low]) / (bank.delays[high] - bank.delays[low])[:, None]
    # A delay is known to a step of the grid, within which any is as likely.
    step = float(np.diff(bank.delays).mean())
    differences = ends.mean - means[each, :, best][:, None]
    typical = _typical(differences, ends.sound[:, :, None])
    return Spread(
        np.sqrt(typical + np.square(slope) * step**2 / 12.0),
        np.sqrt(_typical(ends.delay - bank.delays[best][:, None], ends.sound)),
        np.where(ends.sound[:, :, None], differences, 0.0),
    )


def spread_covariance(std: np.ndarray, differences: np.ndarray) -> np.ndarray:
    """The covariance ``(n, n)`` with the deviations ``std (n,)`` and the correlations of the differences ``(K, n)`` of one row."""
    products = differences.T @ differences
    scale = np.sqrt(np.diagonal(products))
    share = np.divide(std, scale, out=np.zeros_like(std), where=scale > 0)
    out = share[:, None] * products * share
    np.fill_diagonal(out, np.square(std))
    return out


def _typical(differences: np.ndarray, sound: np.ndarray) -> np.ndarray:
    """Variances by the median square over the starts, the second axis; a start that broke down is infinitely far."""
    return np.median(np.where(sound, np.square(differences), np.inf), axis=1) / MEDIAN_SQUARE
