"""Confidence intervals of a share: exact for independent trials, by resampling of runs where the trials of one run are correlated."""

from __future__ import annotations

import numpy as np

LEVEL = 0.95
DRAWS = 2000  # of a bootstrap: the ends of a 95 % interval rest on its 50 outermost


def clopper_pearson(count: float, of: float, level: float = LEVEL) -> tuple[float, float]:
    """Exact binomial interval of a share seen ``count`` times in ``of`` independent trials (Clopper and Pearson, Biometrika 26, 1934).

    Both ends are the shares at which so few, or so many, would be seen with half of ``1 - level``. Without a trial it is 0 to 1.
    """
    from scipy.special import betaincinv

    if of == 0:
        return 0.0, 1.0
    tail = 0.5 * (1.0 - level)
    low = 0.0 if count == 0 else float(betaincinv(count, of - count + 1, tail))
    high = 1.0 if count == of else float(betaincinv(count + 1, of - count, 1.0 - tail))
    return low, high


def clustered_share(counts: np.ndarray, of: np.ndarray, rng: np.random.Generator, level: float = LEVEL) -> tuple[float, float]:
    """Interval of the share ``sum(counts) / sum(of)`` over runs ``(N,)``, each with ``counts`` hits in ``of`` trials that may be correlated.

    Percentiles of the share over runs drawn with replacement, a run always whole (cluster bootstrap; Efron and Tibshirani, An
    Introduction to the Bootstrap, 1993, section 8). Where each run has one trial the trials are independent, and where all runs have the
    same share there is nothing to resample: then the interval of Clopper and Pearson, a run as one trial. Runs without a trial are left out.
    """
    some = np.asarray(of) > 0
    counts, of = np.asarray(counts, dtype=float)[some], np.asarray(of, dtype=float)[some]
    runs, shares = len(of), counts / of
    if np.all(of == 1.0) or np.ptp(shares) == 0.0:
        return clopper_pearson(float(shares.sum()), runs, level)
    drawn = (rng.integers(runs, size=runs) for _ in range(DRAWS))
    resampled = [counts[rows].sum() / of[rows].sum() for rows in drawn]
    low, high = np.quantile(resampled, [0.5 * (1.0 - level), 0.5 * (1.0 + level)])
    return float(low), float(high)
