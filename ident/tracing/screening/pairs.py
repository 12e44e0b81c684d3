"""Pairs of effects that hide each other: each alone explains little, or a third replaces both, and together they explain much."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from ident.tracing import thresholds
from ident.tracing.screening.score_test import Finding, collinear


def likely_pairs(
    findings: Sequence[Finding], found: Sequence[str], samples: float, most: int = thresholds.PAIRS_FITTED
) -> list[tuple[Finding, Finding]]:
    """Pairs of a fitted model's findings that promise a larger fall of ln(error) than what was ``found`` did there.

    A few at most, the most promising first.

    Guards, two forms of one effect, a lag with the delay of the same channel, and signatures that are one and the same make no pair.
    ``samples`` of the fitted model's fit.
    """
    usable = [finding for finding in findings if not finding.effect.traits.guard]
    taken = [finding for finding in usable if finding.effect.name in found]
    least = joint_fall(taken[0], taken[-1], samples) if taken else 0.0
    falls = [
        (fall, one, other)
        for one, other in combinations(usable, 2)
        if other.effect.name not in (one.effect.name, *one.effect.traits.twins)
        and collinear(one, other) < thresholds.COLLINEAR
        and (fall := joint_fall(one, other, samples)) > least + thresholds.PAIR_MARGIN
    ]
    return [(one, other) for _, one, other in sorted(falls, key=lambda item: -item[0])[:most]]


def joint_fall(one: Finding, other: Finding, samples: float) -> float:
    """Fall of ln(error) that two findings promise together, by the projection of the residual on the plane of what each would add alone.

    Each contribution is itself a projection of the residual, so that its product with the residual is its own square.
    """
    a, b = one.contribution, other.contribution
    own = np.array([a @ a, b @ b])
    gram = np.array([[own[0], a @ b], [a @ b, own[1]]])
    total = own[0] / max(-np.expm1(-2.0 * one.gain / samples), 1e-12)
    explained = float(own @ np.linalg.lstsq(gram, own, rcond=1e-9)[0])
    return -0.5 * float(np.log1p(-min(explained / total, 0.999999)))
