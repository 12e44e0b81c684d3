"""Does a cause still count where any colour of the residual is allowed for? The null that a named cause has to beat on measured data.

The residual of each channel is taken as an autoregression of whatever order it asks for: a general coloured disturbance, of which
nothing is known but that its future follows from its past. What a cause explains beyond that is its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.statistics.coloured_covariance import autocovariance
from ident.tracing import thresholds
from ident.whole_record.gauss_newton import Fit

SILENT = 1e-300  # variance of a residual that is exactly zero


def coloured_gain(before: Sequence[Fit], after: Sequence[Fit]) -> float:
    """Gain of log likelihood from one prediction to another of the same held-out records, the colour of each residual its own.

    Fits of one record each, pair by pair. Half the samples times the fall of the log variance of one-step innovations, over channels.
    """
    total = 0.0
    for one, two in zip(before, after, strict=True):
        valid = one.layout.problems[0].valid
        for i in np.flatnonzero(one.layout.used & two.layout.used):
            count = float(np.count_nonzero(valid[i]))
            if count > 4 * thresholds.AUTOREGRESSION:
                total += 0.5 * count * (innovation_level(one.residuals[0][i], valid[i]) - innovation_level(two.residuals[0][i], valid[i]))
    return total


def innovation_level(residual: np.ndarray, valid: np.ndarray) -> float:
    """ln of the one-step innovations' variance of a series ``(N,)``, the order of its autoregression by BIC, penalty included, per sample.

    Levinson and Durbin's recursion on the biased autocovariance, which is always stable; missing samples count as zero.
    """
    count = float(np.count_nonzero(valid))
    series = np.where(valid, residual - residual[valid].mean(), 0.0)
    covariance = autocovariance(series, thresholds.AUTOREGRESSION) * len(series) / count
    variance, coefficients = float(covariance[0]), np.zeros(0)
    if variance <= 0.0:
        return float(np.log(SILENT))
    best = np.log(variance)
    for order in range(1, thresholds.AUTOREGRESSION + 1):
        reflection = (covariance[order] - coefficients @ covariance[order - 1 : 0 : -1]) / variance if order > 1 else covariance[1] / variance
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        variance *= max(1.0 - reflection**2, 1e-12)
        best = min(best, np.log(variance) + order * np.log(count) / count)
    return float(best)


def explained_share(before: Sequence[Fit], after: Sequence[Fit]) -> float:
    """Share of what could be explained that one prediction explains of another, in ln(error), over the channels of held-out records.

    What could be explained reaches down to the one-step innovations of the better one: of what follows from its past, nothing is noise.
    One where nothing is left to explain.
    """
    explained = possible = 0.0
    for one, two in zip(before, after, strict=True):
        valid = one.layout.problems[0].valid
        for i in np.flatnonzero(one.layout.used & two.layout.used):
            if np.count_nonzero(valid[i]) <= 4 * thresholds.AUTOREGRESSION:
                continue
            level = 2.0 * np.log(max(float(np.std(one.residuals[0][i][valid[i]])), SILENT))
            noise = min(innovation_level(each.residuals[0][i], valid[i]) for each in (one, two))
            explained += level - 2.0 * float(np.log(max(float(np.std(two.residuals[0][i][valid[i]])), SILENT)))
            possible += level - noise
    return explained / possible if possible > 0.0 else 1.0
