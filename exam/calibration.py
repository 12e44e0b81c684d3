"""The probability of a name held against the truth: what calibrates it, and how often what is said to be so likely is right.

A statement is one claim of a trial with all that it was weighed against, and which of those names are right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ident.statistics.shares import clopper_pearson
from ident.tracing.name_probability import SOMETHING_ELSE, Calibration, name_probabilities
from ident.tracing.weighed import ComparedSet, Ground, Weighed

EDGES = (0.05, 0.2, 0.5, 0.8, 0.95, 1.0)
LEAST, MOST = 0.002, 0.5  # of what is wrong whatever the sets say: no trial has enough claims for a smaller share


@dataclass(frozen=True)
class Statement:
    """A claim: its name, the effects beside it, the other descriptions of its fault, what it was weighed against, and the names that are right."""

    name: str
    others: tuple[str, ...]
    twins: tuple[str, ...]
    weighed: Weighed
    right: frozenset[str]

    def probabilities(self, calibration: Calibration | None = None) -> Mapping[str, float]:
        """By name, something else among them."""
        return name_probabilities(self.name, self.others, self.weighed, self.twins, calibration)


@dataclass(frozen=True)
class Bin:
    """Names said to be right with a probability from ``low`` to ``high``: how many, the mean of what was said, how many are right."""

    low: float
    high: float
    count: int
    said: float
    right: int

    @property
    def interval(self) -> tuple[float, float]:
        """Of the share that is right, at 95 %; names of one claim count as if each stood alone."""
        return clopper_pearson(self.right, self.count)


def reliability(statements: Sequence[Statement], calibration: Calibration | None = None) -> tuple[Bin, ...]:
    """How often names are right, by the probability that was said; one less likely than ``EDGES[0]`` and something else are left out."""
    pairs = [
        (p, name in statement.right)
        for statement in statements
        for name, p in statement.probabilities(calibration).items()
        if name != SOMETHING_ELSE and p > EDGES[0]
    ]
    return binned(pairs)


def binned(pairs: Sequence[tuple[float, bool]]) -> tuple[Bin, ...]:
    """Probabilities that were said, and whether what they were said of is right, counted between ``EDGES``."""
    bins = []
    for low, high in pairwise(EDGES):
        inside = [(p, right) for p, right in pairs if low < p <= high]
        said = float(np.mean([p for p, _ in inside])) if inside else 0.5 * (low + high)
        bins.append(Bin(low, high, len(inside), said, sum(right for _, right in inside)))
    return tuple(bins)


def loss(statements: Sequence[Statement], calibration: Calibration) -> float:
    """Mean of -ln(probability that was given to what is right), something else where no name is."""
    given = []
    for statement in statements:
        told = statement.probabilities(calibration)
        right = sum(p for name, p in told.items() if name in statement.right)
        given.append(max(right if statement.right & told.keys() else told[SOMETHING_ELSE], 1e-6))
    return float(-np.mean(np.log(given)))


def calibrated(statements: Sequence[Statement]) -> Calibration:
    """The calibration under which what is right was most probable.

    Shares of what is wrong have a prior of one claim in twenty, counted as ten claims: a ground with few claims has not been tried.
    """
    from scipy.optimize import minimize

    grounds = [ground.value for ground in Ground]
    n = len(grounds)

    def unpacked(x: np.ndarray) -> Calibration:
        shares = 1.0 / (1.0 + np.exp(-x[n + 2 :]))
        temperature = dict(zip(grounds, np.exp(x[:n]).tolist(), strict=True))
        return Calibration(temperature, float(1.0 / (1.0 + np.exp(-x[n]))), float(x[n + 1]), dict(zip(grounds, shares.tolist(), strict=True)))

    def cost(x: np.ndarray) -> float:
        found = unpacked(x)
        prior = sum(0.5 * np.log(share) + 9.5 * np.log1p(-share) for share in found.wrong.values())
        return len(statements) * loss(statements, found) - float(prior) + 0.5 * float(x[:n] @ x[:n] + (x[n] / 2.0) ** 2 + (x[n + 1] / 6.0) ** 2)

    begin = np.array([*np.zeros(n + 2), *([np.log(0.05 / 0.95)] * n)])
    least, most = (float(np.log(share / (1.0 - share))) for share in (LEAST, MOST))
    bounds = [*([(None, None)] * (n + 2)), *([(least, most)] * n)]
    return unpacked(minimize(cost, begin, method="L-BFGS-B", bounds=bounds).x)


def statement_of(line: Mapping[str, Any]) -> Statement:
    """A statement from the plain data that ``as_line`` made."""
    sets = tuple(ComparedSet(tuple(s["names"]), s["misfit"], s["price"], s["declared"], s["guard"]) for s in line["sets"])
    weighed = Weighed(Ground(line["ground"]), sets, tuple(line["same"]))
    return Statement(line["name"], tuple(line["others"]), tuple(line["twins"]), weighed, frozenset(line["right"]))


def as_line(statement: Statement) -> Mapping[str, Any]:
    """A statement as plain data."""
    sets = [
        {"names": list(s.names), "misfit": float(s.misfit), "price": float(s.price), "declared": float(s.declared), "guard": s.guard}
        for s in statement.weighed.sets
    ]
    return {
        **{"name": statement.name, "others": list(statement.others), "twins": list(statement.twins), "right": sorted(statement.right)},
        **{"ground": statement.weighed.ground.value, "same": list(statement.weighed.same), "sets": sets},
    }
