"""Collinearity of terms in the maneuvers, and the maneuver that would separate them.

Variance inflation factors, correlations of pairs, and condition indices of the columns with the
terms whose variances share one [1]_.

References
----------
.. [1] D. A. Belsley, E. Kuh and R. E. Welsch, Regression Diagnostics, Wiley 1980, chapter 3.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from sim.aerodynamics import Term, parents

HIGH_INFLATION = 10.0  # variance inflation factor: the references' usual limit
HIGH_CORRELATION = 0.9
HIGH_INDEX = 30.0  # condition index
_COLLINEAR_VARIANCE_SHARE = 0.5  # of a variance, that belongs to one index


@dataclass(frozen=True, eq=False)
class Collinearity:
    """Collinearity of the chosen terms of a coefficient.

    Attributes
    ----------
    axis : the coefficient.
    terms : without the constant.
    inflation : variance inflation factors, ``(n,)``.
    correlations : pairs of terms above ``HIGH_CORRELATION``.
    indices : condition indices of the columns at unit length, descending.
    groups : terms whose variances share a condition index above ``HIGH_INDEX``.
    advice : maneuvers that would separate them, a sentence each.
    multiples : chosen terms with offered products of them that were not chosen and are nearly their
        multiples, as ``alpha*beta`` of ``beta`` where alpha hardly moves.
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
    """Collinearity of terms in the maneuvers.

    Parameters
    ----------
    axis : the coefficient.
    terms : n of them.
    columns : ``(N, n)`` their values.
    surfaces : signals that the pilot moves.
    """
    places = [i for i, term in enumerate(terms) if term.factors]
    chosen = tuple(terms[i] for i in places)
    if not chosen:
        return Collinearity(axis, (), np.zeros(0), (), np.ones(1), (), ())
    X = columns[:, places]
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
    every = columns / np.sqrt(np.maximum(np.einsum("ij,ij->j", columns, columns), 1e-300))
    values, vectors = np.linalg.eigh(every.T @ every)
    values = np.maximum(values, 1e-16)
    indices = np.sqrt(values[-1] / values)
    shares = vectors**2 / values
    shares = shares / shares.sum(axis=1, keepdims=True)
    groups = [
        tuple(terms[i] for i in range(len(terms)) if shares[i, k] > _COLLINEAR_VARIANCE_SHARE)
        for k in range(len(values))
        if indices[k] > HIGH_INDEX
    ]
    groups = [group for group in groups if len(group) > 1]
    together = [{a, b} for a, b, _ in pairs] + [set(group) for group in groups]
    advice = [_advice(sorted(each, key=lambda term: term.text), surfaces) for each in together]
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
    """Return the chosen terms with products of them, not chosen, that are nearly their multiples.

    Parameters
    ----------
    terms : offered.
    columns : ``(N, k)`` their values.
    chosen : of the terms.
    """
    X = columns - columns.mean(axis=0)
    square = np.maximum(np.einsum("ij,ij->j", X, X), 1e-300)
    at = {term: i for i, term in enumerate(terms)}
    return tuple(
        (base, term)
        for term in terms
        for base in parents(term)
        if base in chosen
        and term not in chosen
        and base.signals < term.signals
        and (X[:, at[base]] @ X[:, at[term]]) ** 2
        > (1.0 - 1.0 / HIGH_INFLATION) * square[at[base]] * square[at[term]]
    )


def _advice(terms: Sequence[Term], surfaces: Collection[str]) -> str:
    """Return the maneuver that would separate the terms."""
    signals = sorted(set().union(*(term.signals for term in terms)))
    moved = [name for name in signals if name in surfaces]
    flown = [name for name in signals if name not in surfaces]
    told = ", ".join(term.text for term in terms)
    if len(moved) > 1:
        return (
            f"{told}: move {' and '.join(moved)} one after the other, or together by signals "
            "without correlation (orthogonal multisines)"
        )
    if moved and flown:
        follow = "follows" if len(flown) == 1 else "follow"
        return (
            f"{told}: move {moved[0]} faster than {' and '.join(flown)} {follow}, by short and "
            "long pulses in one maneuver (3-2-1-1) or by a sweep"
        )
    if len(flown) > 1 and "alpha" in flown and "q" in flown:
        return f"{told}: fly pull-ups and turns at several load factors"
    if {"beta", "p", "r"} & set(flown) and len(flown) > 1:
        return f"{told}: add steady sideslips and rolls (bank to bank) to the rudder doublets"
    if "mach" in flown:
        return f"{told}: repeat the maneuver at other airspeeds"
    if flown:
        return f"{told}: cover a larger range of {' and '.join(flown)}, as in a slow deceleration"
    return f"{told}: use larger deflections of {' and '.join(moved)}" if moved else ""
