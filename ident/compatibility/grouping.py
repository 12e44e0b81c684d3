"""Faults that the records do not tell apart."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.compatibility.faults import ARM, DELAY, LAG, SensorFault
from ident.compatibility.fitting import Fit, positions
from ident.compatibility.instruments import weigher
from ident.compatibility.trials import Trial
from ident.compatibility.unknowns import evaluate, unknowns_of
from ident.statistics.information import bounded_inverse

_NEAR = 6.0  # of log likelihood: a fault that gains as much as another within this is not told from it
_RIVAL = 0.5  # share of the best gain below which a collinear fault is ruled out all the same


def grouped(current: Fit, best: Trial, trials: Sequence[Trial], collinear: float) -> list[Trial]:
    """The best fault and those that explain nearly the same change of the reconstruction, or gain nearly as much."""
    rivals = [t for t in trials if t is not best and t.gain > 0 and not (t.fault.one_sided and t.size <= 0) and t.told]
    changes = {t.fault: _change(current, best, t) for t in (best, *rivals)}
    out = [best]
    for t in sorted(rivals, key=lambda t: -t.gain):
        cosine = abs(float(changes[t.fault] @ changes[best.fault]))
        alike = cosine >= collinear or same_lateness(t.fault, best.fault)
        if (alike and t.gain >= _RIVAL * best.gain) or t.gain >= best.gain - _NEAR:
            out.append(t)
    return out


def _change(current: Fit, best: Trial, trial: Trial) -> np.ndarray:
    """What a fault of its fitted size changes, as independent samples under the best fit's noise, less what the other unknowns can do."""
    parts, columns = [], []
    at = positions(current)
    for r, s in enumerate(current.signals):
        sizes = np.append(current.sizes, trial.size)[None]
        after = evaluate(s, unknowns_of(s), (*current.faults, trial.fault), current.own[r][None], sizes)[:, 0]
        before = evaluate(s, unknowns_of(s), current.faults, current.own[r][None], current.sizes[None])[:, 0]
        change = np.where(s.valid, after - before, 0.0)[:, :, None]
        white = weigher(s, best.found.noise)(np.concatenate([change, np.where(s.valid[:, :, None], current.jacobians[r], 0.0)], axis=2))
        wide = np.zeros((white.shape[0] * white.shape[1], int(at[-1].max()) + 1 if len(at[-1]) else 0))
        wide[:, at[r]] = white[:, :, 1:].reshape(len(wide), -1)
        parts.append(white[:, :, 0].ravel())
        columns.append(wide)
    y, J = np.concatenate(parts), np.concatenate(columns)
    y = y - J @ (bounded_inverse(J.T @ J) @ (J.T @ y))
    size = float(np.linalg.norm(y))
    return y / size if size > 0 else y


def same_lateness(one: SensorFault, other: SensorFault) -> bool:
    return one.channel == other.channel and {one.kind, other.kind} <= {DELAY, LAG, ARM}
