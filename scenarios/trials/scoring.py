"""How trials are scored: names that count as one, and intervals of a share."""

from __future__ import annotations

TWINS = {"sensor-lag": "sensor-delay", "sensor-delay": "sensor-lag"}


def interval(count: int, runs: int, level: float = 0.95) -> tuple[float, float]:
    """Exact binomial confidence interval (Clopper and Pearson, 1934) of a share seen ``count`` times in ``runs``."""
    from scipy.special import betaincinv

    tail = 0.5 * (1.0 - level)
    low = 0.0 if count == 0 else float(betaincinv(count, runs - count + 1, tail))
    high = 1.0 if count == runs else float(betaincinv(count + 1, runs - count, 1.0 - tail))
    return low, high
