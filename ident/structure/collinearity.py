"""Collinearity of terms in the maneuvers, and the maneuver that would separate them.

The measures are variance inflation factors, correlations of pairs of terms, and condition indices
with the variance proportions of the terms [1]_.

References
----------
.. [1] D. A. Belsley, E. Kuh and R. E. Welsch, Regression Diagnostics, Wiley 1980, chapter 3.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from sim.aerodynamics import Term, parents

HIGH_INFLATION = 10.0  # usual limit of a variance inflation factor
HIGH_CORRELATION = 0.9  # usual limit of the correlation of two terms
HIGH_INDEX = 30.0  # usual limit of a condition index
# smallest variance proportion at a high condition index of a term that is in the collinear group
_COLLINEAR_VARIANCE_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Collinearity:
    """Collinearity of the chosen terms of a coefficient.

    Attributes
    ----------
    axis : name of the coefficient.
    terms : the n chosen terms without the constant.
    inflation : ``(n,)`` variance inflation factors.
    correlations : pairs of terms and their correlation, above ``HIGH_CORRELATION`` in size.
    indices : condition indices of the columns at unit length, descending.
    groups : terms with high variance proportions at one condition index above ``HIGH_INDEX``.
    advice : sentences on the maneuvers that would separate the pairs and groups.
    multiples : pairs of a chosen term and a product that contains it. The product was offered but
        not chosen, and is nearly a multiple of the term: ``alpha*beta`` and ``beta`` if alpha
        hardly changes.
    """

    axis: str
    terms: tuple[Term, ...]
    inflation: np.ndarray
    correlations: tuple[tuple[Term, Term, float], ...]
    indices: np.ndarray
    groups: tuple[tuple[Term, ...], ...]
    advice: tuple[str, ...]
    multiples: tuple[tuple[Term, Term], ...] = ()


def collinearity_of(
    axis: str, terms: Sequence[Term], columns: np.ndarray, surfaces: Collection[str]
) -> Collinearity:
    """Return the collinearity of the terms of a coefficient in the maneuvers.

    Parameters
    ----------
    axis : name of the coefficient.
    terms : the n chosen terms, with the constant.
    columns : ``(N, n)`` values of the terms.
    surfaces : signals that the pilot moves.
    """
    varying = [i for i, term in enumerate(terms) if term.factors]
    chosen = tuple(terms[i] for i in varying)
    if not chosen:
        return Collinearity(axis, (), np.zeros(0), (), np.ones(1), (), ())
    X = columns[:, varying]
    X = X - X.mean(axis=0)
    length = np.sqrt(np.maximum(np.einsum("ij,ij->j", X, X), 1e-300))
    R = (X / length).T @ (X / length)
    inflation = np.diag(np.linalg.pinv(R, rcond=1e-12, hermitian=True)).copy()
    pairs = [
        (chosen[i], chosen[j], float(R[i, j]))
        for i in range(len(chosen))
        for j in range(i)
        if abs(R[i, j]) > HIGH_CORRELATION
    ]
    scaled = columns / np.sqrt(np.maximum(np.einsum("ij,ij->j", columns, columns), 1e-300))
    values, vectors = np.linalg.eigh(scaled.T @ scaled)
    values = np.maximum(values, 1e-16)
    indices = np.sqrt(values[-1] / values)
    proportions = vectors**2 / values
    proportions = proportions / proportions.sum(axis=1, keepdims=True)
    groups = [
        tuple(terms[i] for i in range(len(terms)) if proportions[i, k] > _COLLINEAR_VARIANCE_SHARE)
        for k in range(len(values))
        if indices[k] > HIGH_INDEX
    ]
    groups = [group for group in groups if len(group) > 1]
    collinear = [{a, b} for a, b, _ in pairs] + [set(group) for group in groups]
    advice = [_advice(sorted(group, key=lambda term: term.text), surfaces) for group in collinear]
    return Collinearity(
        axis,
        chosen,
        inflation,
        tuple(pairs),
        np.sort(indices)[::-1],
        tuple(groups),
        tuple(dict.fromkeys(filter(None, advice))),
    )


def multiples_of(
    terms: Sequence[Term], columns: np.ndarray, chosen: Collection[Term]
) -> tuple[tuple[Term, Term], ...]:
    """Return the pairs of `Collinearity.multiples`: a chosen term, and a product that is nearly a
    multiple of it.

    Parameters
    ----------
    terms : the k candidate terms.
    columns : ``(N, k)`` values of the terms.
    chosen : the chosen ones of these terms.
    """
    X = columns - columns.mean(axis=0)
    squares = np.maximum(np.einsum("ij,ij->j", X, X), 1e-300)
    column = {term: i for i, term in enumerate(terms)}
    least_square_correlation = 1.0 - 1.0 / HIGH_INFLATION
    return tuple(
        (base, term)
        for term in terms
        for base in parents(term)
        if base in chosen
        and term not in chosen
        and base.signals < term.signals
        and (X[:, column[base]] @ X[:, column[term]]) ** 2
        > least_square_correlation * squares[column[base]] * squares[column[term]]
    )


def _advice(terms: Sequence[Term], surfaces: Collection[str]) -> str:
    """Return a sentence on the maneuver that would separate the terms; empty for terms without
    signals.
    """
    signals = sorted(set().union(*(term.signals for term in terms)))
    controls = [name for name in signals if name in surfaces]
    states = [name for name in signals if name not in surfaces]
    names = ", ".join(term.text for term in terms)
    if len(controls) > 1:
        return (
            f"{names}: move {' and '.join(controls)} one after the other, or together by signals "
            "without correlation (orthogonal multisines)"
        )
    if controls and states:
        follow = "follows" if len(states) == 1 else "follow"
        return (
            f"{names}: move {controls[0]} faster than {' and '.join(states)} {follow}, by short "
            "and long pulses in one maneuver (3-2-1-1) or by a sweep"
        )
    if len(states) > 1 and "alpha" in states and "q" in states:
        return f"{names}: fly pull-ups and turns at several load factors"
    if {"beta", "p", "r"} & set(states) and len(states) > 1:
        return f"{names}: add steady sideslips and rolls (bank to bank) to the rudder doublets"
    if "mach" in states:
        return f"{names}: repeat the maneuver at other airspeeds"
    if states:
        return f"{names}: cover a larger range of {' and '.join(states)}, as in a slow deceleration"
    return f"{names}: use larger deflections of {' and '.join(controls)}" if controls else ""
