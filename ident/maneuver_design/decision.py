"""How likely a flight tells which of two effects acts, under the rule by which the tracing loop calls two names ambiguous.

With the noise of a flight the difference D of twice the log likelihoods of the two best fits, the true one less the other, is nearly normal. Let
s_i be the weighted squares of output i that the other leaves of the flight without noise, N_i its samples:

    mean D = sum_i N_i ln(1 + s_i / N_i) + n - n'      variance D = sum_i (4 s_i + 2 s_i^2 / N_i) / (1 + s_i / N_i)^2 + 4 s / f

where n and n' count the parameters of the true effect and of the other, s = sum s_i, and f is what the declared model alone leaves. For s much
smaller than N this is mean s and variance 4 s, of the log likelihood itself s/2 and s; the logarithm is there because noise levels are estimated,
the last term is what the noise along the two signatures adds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ident.tracing.evidence.decision import CERTAIN

CLEAR = 2.0 * math.log(CERTAIN / (1.0 - CERTAIN))  # of twice the log likelihood: one name is then certain


@dataclass(frozen=True)
class Decision:
    """What a flight under one effect says against another.

    ``mean`` and ``std`` of twice the difference of the log likelihoods; ``price``: by how much more the loop charges for the other's parameters.
    """

    mean: float
    std: float
    price: float = 0.0

    @property
    def log_likelihood(self) -> float:
        """Expected difference of the log likelihoods."""
        return 0.5 * self.mean

    @property
    def right(self) -> float:
        """Probability that the loop prefers the effect that acts, by more than what it calls ambiguous."""
        return self._above(CLEAR)

    @property
    def wrong(self) -> float:
        """Probability that it prefers the other by more than that."""
        return 1.0 - self._above(-CLEAR)

    def _above(self, limit: float) -> float:
        return normal_above(self.mean + self.price - limit, self.std)


def decision_of(squares: np.ndarray, counts: np.ndarray, found: float, own: int, other: int, price: float = 0.0) -> Decision:
    """The decision between two effects.

    Parameters
    ----------
    squares, counts : ``(m,)`` weighted squares that the rival leaves, and samples, by output.
    found : weighted squares that the declared model alone leaves. own, other : free parameters of the true effect and of the rival.
    price : what the loop charges for the rival less what it charges for the true one, in twice the log likelihood.
    """
    samples = np.maximum(counts, 1)
    share = squares / samples
    total = float(squares.sum())
    mean = float(np.sum(samples * np.log1p(share))) + own - other
    variance = float(np.sum((4.0 * squares + 2.0 * squares * share) / (1.0 + share) ** 2))
    along = min(1.0, total / found) if found > 0.0 else 1.0
    return Decision(mean, math.sqrt(variance + 4.0 * along), price)


def chance_found(gain: float, own: int, price: float, accept: float) -> float:
    """Probability that an effect raises twice the log likelihood by what its prior odds cost.

    ``gain`` : expected, of the log likelihood over the declared model. ``own``, ``price`` : its free parameters and what is charged for them.
    """
    mean = 2.0 * gain + own
    return normal_above(mean - price - accept, math.sqrt(8.0 * gain + 2.0 * own))


def normal_above(mean: float, std: float) -> float:
    """Probability that a normal number is above zero."""
    return 0.5 * math.erfc(-mean / (std * math.sqrt(2.0))) if std > 0.0 else float(mean > 0.0)
