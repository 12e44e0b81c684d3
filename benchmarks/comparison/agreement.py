"""Checks that two answers to a job are the same."""

from __future__ import annotations

import numpy as np

from benchmarks.comparison.job import Agreement, Answer, Problem


def same_estimates(problem: Problem, ours: Answer, theirs: Answer, tolerance: float) -> Agreement:
    """Estimates ``(6,)`` or ``(6, runs)`` within ``tolerance`` of our sigmas, and how far both are
    from the truth in our sigmas.

    A contender that did the first runs only is held against those.
    """
    mine, sigma = (
        ours[name][..., : theirs["estimate"].shape[-1]] for name in ("estimate", "estimate_std")
    )
    true = problem["true"] if mine.ndim == 1 else problem["true"][:, None]
    apart = float(np.max(np.abs(theirs["estimate"] - mine) / sigma))
    error, own = (
        float(np.sqrt(np.mean(((each - true) / sigma) ** 2))) for each in (theirs["estimate"], mine)
    )
    said = f"{_size(apart)} sigma apart at most; rms error {error:.2f} sigma, flightid's {own:.2f}"
    return Agreement(said, apart <= tolerance)


def same_estimates_and_likelihood(
    problem: Problem, ours: Answer, theirs: Answer, tolerance: float
) -> Agreement:
    """As ``same_estimates``, and the log-likelihoods within ``tolerance`` thousandths of their
    size.
    """
    found = same_estimates(problem, ours, theirs, tolerance)
    total = np.atleast_1d(theirs["log_likelihood"])
    mine = np.atleast_1d(ours["log_likelihood"])[: total.size]
    apart, size = float(np.max(np.abs(total - mine))), float(np.median(np.abs(mine)))
    said = f"{found.said}; log-likelihoods {_size(apart)} of {size:.0f} apart"
    return Agreement(said, found.near and apart <= 1e-3 * tolerance * size)


def same_histories(problem: Problem, ours: Answer, theirs: Answer, tolerance: float) -> Agreement:
    """Means after every sample within ``tolerance`` of our sigmas then, and the estimates as
    ``same_estimates``.
    """
    found = same_estimates(problem, ours, theirs, tolerance)
    apart = float(np.max(np.abs(theirs["mean"] - ours["mean"]) / ours["std"]))
    return Agreement(
        f"{found.said}; histories {_size(apart)} sigma apart", found.near and apart <= tolerance
    )


def same_motion(problem: Problem, ours: Answer, theirs: Answer, tolerance: float) -> Agreement:
    """Motions ``clean (m, N)`` against the exact one of the problem; theirs within ``tolerance`` of
    the largest value.
    """
    size = np.max(np.abs(problem["clean"]), axis=1)
    mine, error = (
        float(np.max(np.max(np.abs(each["clean"] - problem["clean"]), axis=1) / size))
        for each in (ours, theirs)
    )
    return Agreement(
        f"error {_size(error)} of the largest value, flightid's {_size(mine)}", error <= tolerance
    )


def _size(value: float) -> str:
    return f"{value:.2g}"
