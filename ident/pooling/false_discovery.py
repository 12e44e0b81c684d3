"""Many questions asked at once: p-values that bound the share of false answers among those given."""

from __future__ import annotations

import numpy as np


def adjusted(p_values: np.ndarray) -> np.ndarray:
    """The least rate of false discoveries ``(n,)`` at which each question is answered, from ``p_values (n,)`` in [0, 1].

    Benjamini and Hochberg, J. Royal Statistical Society B 57(1), 1995: of those below a level, the expected share of false ones is at most
    that level where the tests are independent or positively dependent.
    """
    p = np.asarray(p_values, dtype=float)
    n = len(p)
    if n == 0:
        return np.zeros(0)
    order = np.argsort(p, kind="stable")
    raised = p[order] * n / np.arange(1, n + 1)
    least = np.minimum.accumulate(raised[::-1])[::-1]
    out = np.empty(n)
    out[order] = np.minimum(least, 1.0)
    return out
