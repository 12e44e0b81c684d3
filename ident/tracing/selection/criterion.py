"""How sets are compared: what an addition brings, how evenly, and whether anything is left."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.residuals import ljung_box
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel


def gain(parent: FittedModel, child: FittedModel, accept: float) -> float:
    """By how much an addition lowers the score: twice the log-likelihood gain over its unevenness, less its price.

    ``accept`` : what an addition has to bring; half of it is granted beyond what the samples bring that do not dominate.
    """
    charged = price(parent, child)
    brought = 2.0 * (parent.fit.cost - child.fit.cost)
    if has_process_noise(child.system):
        # Innovations are of variance one whatever the likelihood: there is no saying which samples brought the gain.
        return brought / (unevenness(parent, child) if has_process_noise(parent.system) else 1.0) - charged
    spread = brought * (1.0 - few_samples(parent, child)) + 0.5 * accept
    return min(brought / unevenness(parent, child), spread) - charged


def price(parent: FittedModel, child: FittedModel) -> float:
    """What the criterion charges for the parameters and events of an addition."""
    return (child.criterion - 2.0 * child.fit.cost) - (parent.criterion - 2.0 * parent.fit.cost)


def unevenness(parent: FittedModel, child: FittedModel) -> float:
    """sum(c^2 e^2)/sum(c^2), c the change of the fitted output and e the innovation, both in sigmas; at least 1.

    Noise that happens to be large just where an addition acts is no evidence for it.
    """
    top = bottom = 0.0
    for r in range(len(child.fit.layout.problems)):
        change = child.fit.lines[r].y - parent.fit.lines[r].y
        c = child.fit.whiten(r, change[:, :, None])[:, :, 0]
        e = _standard(child, r)
        top += float(np.sum(c**2 * e**2))
        bottom += float(np.sum(c**2))
    return max(1.0, top / bottom) if bottom > 0 else 1.0


def _standard(fitted: FittedModel, r: int) -> np.ndarray:
    """Independent residuals of variance one, ``(m, N)``."""
    return fitted.fit.residuals[r] / np.sqrt(fitted.fit.variance)[:, None]


def few_samples(parent: FittedModel, child: FittedModel) -> float:
    """Share of the improvement that the three most improved samples bring, 0 to 1: evidence must not depend on so few."""
    gained = np.concatenate(
        [
            np.sum((parent.fit.residuals[r] / np.sqrt(parent.fit.variance)[:, None]) ** 2 - _over_parent(parent, child, r) ** 2, axis=0)
            for r in range(len(child.fit.layout.problems))
        ]
    )
    total = float(gained.sum())
    return float(np.clip(np.sort(gained)[-thresholds.SAMPLES_THAT_MAY_DOMINATE :].sum() / total, 0.0, 1.0)) if total > 0 else 1.0


def _over_parent(parent: FittedModel, child: FittedModel, r: int) -> np.ndarray:
    """The child's residuals in the parent's standard deviations, ``(m, N)``; whitened ones have variance one in both."""
    return child.fit.residuals[r] / np.sqrt(parent.fit.variance)[:, None]


def is_white(fitted: FittedModel, least: float = thresholds.COLOURED) -> bool:
    """Whether no channel's residual shows correlation: no p-value below ``least``."""
    return all(p_value > least for p_value in _whiteness(fitted))


def is_coloured_throughout(fitted: FittedModel, least: float) -> bool:
    """Whether every channel of every record shows correlation, each with a p-value below ``least``."""
    told = list(_whiteness(fitted))
    return bool(told) and all(p_value < least for p_value in told)


def _whiteness(fitted: FittedModel) -> Iterator[float]:
    """P-values of every channel of every record that measures it."""
    for problem, residual in zip(fitted.fit.layout.problems, fitted.fit.residuals, strict=True):
        for i, name in enumerate(fitted.system.output_names):
            if np.count_nonzero(problem.valid[i]) >= thresholds.FEWEST_SAMPLES:
                yield ljung_box(residual[i], problem.valid[i], name).p_value
