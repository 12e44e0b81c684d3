"""What differs between two estimates by more than their uncertainty, e.g. between simulation and flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.estimate import Estimate
from sim.errors import ModelError

BEYOND = 2.0  # sigmas, as the bounds that NASA TM-101722 draws


@dataclass(frozen=True)
class Difference:
    """One parameter of two estimates.

    Attributes
    ----------
    first, second : values, in ``unit``; ``first_std``, ``second_std`` their standard deviations.
    z : second minus first over the root of both variances' sum; zero where both are without variance and equal.
    beyond : |z| exceeds the limit asked for.
    """

    name: str
    unit: str
    first: float
    first_std: float
    second: float
    second_std: float
    z: float
    beyond: bool


@dataclass(frozen=True, eq=False)
class Comparison:
    """Differences of the common parameters, largest |z| first, and the joint test: ``statistic`` is d^T (P1 + P2)^-1 d with
    ``degrees`` of freedom and ``p_value`` that the two estimates differ by chance only. Estimates from independent records."""

    differences: tuple[Difference, ...]
    statistic: float
    degrees: int
    p_value: float

    @property
    def beyond(self) -> tuple[Difference, ...]:
        """What differs beyond its uncertainty."""
        return tuple(item for item in self.differences if item.beyond)


def compare_estimates(first: Estimate, second: Estimate, limit: float = BEYOND) -> Comparison:
    """Compare two estimates parameter by parameter, and all together with both covariances.

    Raises
    ------
    ModelError : no parameter in common, or a common one in different units.
    """
    from scipy.special import chdtrc

    common = [name for name in first.names if name in second.names]
    if not common:
        raise ModelError("no parameter in common", where="comparison of two estimates", remedy="compare estimates of one model")
    a, b = [first.names.index(name) for name in common], [second.names.index(name) for name in common]
    for name, i, j in zip(common, a, b, strict=True):
        if first.units[i] != second.units[j]:
            what = f"one is in {first.units[i]}, the other in {second.units[j]}"
            raise ModelError(what, where=f"comparison, {name}", remedy="estimate both in one unit")
    d = second.values[b] - first.values[a]
    P = first.covariance[np.ix_(a, a)] + second.covariance[np.ix_(b, b)]
    scale = np.sqrt(np.maximum(np.diag(P), 0.0))
    rows = []
    for k, name in enumerate(common):
        z = float(d[k] / scale[k]) if scale[k] > 0 else (0.0 if d[k] == 0 else float(np.copysign(1e9, d[k])))
        values = (float(first.values[a[k]]), float(first.std[a[k]]), float(second.values[b[k]]), float(second.std[b[k]]))
        rows.append(Difference(name, first.units[a[k]], *values, z, abs(z) > limit))
    kept = scale > 0
    whole = P[np.ix_(kept, kept)] / np.outer(scale[kept], scale[kept])
    white = d[kept] / scale[kept]
    statistic, degrees = float(white @ np.linalg.pinv(whole, hermitian=True) @ white), int(np.linalg.matrix_rank(whole, hermitian=True))
    ordered = tuple(sorted(rows, key=lambda item: -abs(item.z)))
    return Comparison(ordered, statistic, degrees, float(chdtrc(degrees, statistic)) if degrees else 1.0)
