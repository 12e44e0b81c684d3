"""Whether the records by themselves agree on a fault."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.compatibility.faults import SensorFault
from ident.compatibility.fitting import Fit, fit
from ident.compatibility.trials import Trial, tried

_REPLICATION = 1e-3
_DEMANDED = 3.0  # standard deviations


def beside(base: Fit, faults: Sequence[SensorFault], sizes: np.ndarray) -> Fit:
    """The fit of one record with faults that stand in all."""
    return fit(base.signals, faults, base, sizes) if faults else base


def replicates(bases: Sequence[Fit], current: Fit, trial: Trial) -> bool:
    """Whether the records by themselves agree on a fault, beside those that stand, and demand it together with the sign that it has in all."""
    from scipy.special import chdtrc

    if len(bases) < 2:
        return True
    alone = [tried(beside(base, current.faults, current.sizes), [trial.fault])[0] for base in bases]
    v, w = np.array([t.size for t in alone if t.told]), np.array([1.0 / t.variance for t in alone if t.told])
    if len(v) < 2:
        return False
    mean = float(np.sum(w * v) / np.sum(w))
    agree = float(chdtrc(len(v) - 1.0, float(np.sum(w * (v - mean) ** 2)))) > _REPLICATION
    return agree and mean * math.copysign(1.0, trial.size) > _DEMANDED / math.sqrt(float(np.sum(w)))
