"""Flights that are linear in everything, so that what all of them together say can be computed a
second way: from their samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

DECLARED = ("CL_alpha", "Cm_alpha")
UNITS = {"CL_alpha": "1/rad", "Cm_alpha": "1/rad"}
TRUE = np.array([5.0, -0.6])


@dataclass(frozen=True, eq=False)
class Flown:
    """One flight: samples ``y (m,)`` of unit noise, the derivatives' regressors ``(m, 2)``, and
    those ``(m, k)`` of each effect.
    """

    y: np.ndarray
    design: np.ndarray
    effects: Mapping[str, np.ndarray]

    def least_cost(self, held: np.ndarray | None = None) -> float:
        """Half the sum of squares that no value of the derivatives takes away from ``y - held``."""
        left = self.y if held is None else self.y - held
        return 0.5 * float(
            np.sum((left - self.design @ np.linalg.lstsq(self.design, left, rcond=None)[0]) ** 2)
        )

    def fits(self) -> dict[str, Any]:
        """What ``fitted_sets`` keeps of a flight: with every set of effects the likelihood,
        estimates and covariance.
        """
        sets = {}
        for size in range(len(self.effects) + 1):
            for names in combinations(sorted(self.effects), size):
                whole = np.column_stack([self.design, *(self.effects[name] for name in names)])
                if np.linalg.matrix_rank(whole) < whole.shape[1]:
                    continue  # a fit that fails
                inverse = np.linalg.inv(whole.T @ whole)
                estimate = inverse @ whole.T @ self.y
                told = [*DECLARED, *(full for name in names for full in self.full(name))]
                cost = 0.5 * float(np.sum((self.y - whole @ estimate) ** 2))
                sets["+".join(names)] = {
                    "log_likelihood": -cost,
                    "names": told,
                    "estimate": estimate.tolist(),
                    "covariance": inverse.tolist(),
                }
        effects = {
            name: {
                "parameters": self.local(name),
                "units": dict.fromkeys(self.local(name), "s"),
                "full": self.full(name),
            }
            for name in self.effects
        }
        return {
            "declared": list(DECLARED),
            "units": UNITS,
            "effects": effects,
            "independent": 1.0,
            "sets": sets,
        }

    def local(self, name: str) -> list[str]:
        return [f"value{number}" for number in range(self.effects[name].shape[1])]

    def full(self, name: str) -> list[str]:
        return [f"{name}.{local}" for local in self.local(name)]


def flown(
    rng: np.random.Generator,
    effects: Mapping[str, np.ndarray],
    acts: Mapping[str, Sequence[float]],
    alike: float = 0.0,
    samples: int = 60,
) -> Flown:
    """A flight on which the effects ``acts`` have these values; each effect's regressor has
    ``alike`` times the first derivative's in it.
    """
    design = rng.standard_normal((samples, len(TRUE)))
    mixed = {name: columns + alike * design[:, :1] for name, columns in effects.items()}
    y = design @ TRUE + rng.standard_normal(samples)
    for name, value in acts.items():
        y = y + mixed[name] @ np.asarray(value)
    return Flown(y, design, mixed)


def kept(claims: Sequence[Mapping[str, Sequence[str]]]) -> dict[str, dict[str, Any]]:
    """Diagnoses of flights ``F000``, ...: each claims these effects, with their alternatives."""
    return {
        f"F{number:03d}": {
            "verdict": "traced" if each else "consistent",
            "headline": "made up",
            "effects": [
                {"name": name, "claimed": True, "alternatives": list(also), "parameters": {}}
                for name, also in each.items()
            ],
            "check": {"done": True, "sentences": [], "findings": []},
        }
        for number, each in enumerate(claims)
    }
