"""How probable the name of a claimed effect is: the numbers for ``diagnosis.json`` and the line for
readers.
"""

from __future__ import annotations

import math

from ident.tracing.diagnosis import Claim

LEAST = 0.005  # half a per cent rounds to nothing


def shown_probability(claim: Claim) -> dict[str, float]:
    """The claimed name first, then what could take its place, the likeliest first; three digits,
    without what is below ``LEAST``.

    Empty of hints.
    """
    found = {name: p for name, p in claim.probability.items() if math.isfinite(p) and p >= LEAST}
    return {
        name: round(found[name], 3)
        for name in sorted(found, key=lambda name: (name != claim.name, -found[name], name))
    }


def probability_sentence(claim: Claim) -> str:
    """``"Probability of this cause: 93 %; sensor-lag:q 5 %"``; empty of hints."""
    mine = claim.probability.get(claim.name, math.nan)
    if not math.isfinite(mine):
        return ""
    rest = ", ".join(
        f"{name} {_percent(p)}"
        for name, p in shown_probability(claim).items()
        if name != claim.name
    )
    return f"Probability of this cause: {_percent(mine)}{f'; {rest}' if rest else ''}"


def _percent(p: float) -> str:
    """Whole per cents; neither none nor all of it, which is never known."""
    if p < LEAST:
        return "below 1 %"
    return f"{max(1.0, 100.0 * p):.0f} %" if p < 1.0 - LEAST else "above 99 %"
