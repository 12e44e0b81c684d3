"""Does what belongs to each record by itself (a drift, a change of speed) stand, where there is no common value that could replicate?

Its values on a record that was left out have to be learnt from that record. What it brings there is asked of one-step predictions: any
colour of each channel is allowed for, and the values pay for having been learnt (Rissanen's price, the half of a logarithm of the samples
for each). A free simulation would let a slow cause take in whatever else is slow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, local_names
from ident.tracing.replication.by_record import Replication, by_record
from ident.tracing.replication.coloured_null import coloured_gain
from ident.tracing.replication.error_reduction import Reduction
from ident.whole_record.gauss_newton import Fit
from sim.declaration.proposal import Traceable


def predicted_gains(before: Sequence[Fit], after: Sequence[Fit], effect: Traceable) -> np.ndarray:
    """Gain of log likelihood of one-step predictions on each record left out, ``(records,)``, less what its own values cost."""
    count = len(local_names(effect))
    prices = [0.5 * count * float(np.log(max(float(fit.counts.sum()), math.e))) for fit in after]
    return np.array([coloured_gain([one], [two]) - price for one, two, price in zip(before, after, prices, strict=True)])


def own_values(fitted: FittedModel, effect: Traceable) -> Replication:
    """Its values in each record; ``agrees`` where they stand off its absence in more than half of them, or no value of theirs is one."""
    each = by_record(fitted, effect)
    absent = {name: zero for name, zero in effect.absent.items() if name in each[0]}
    off = [not absent or any(abs(found[n].value - zero) > thresholds.OFF_ABSENCE * found[n].std for n, zero in absent.items()) for found in each]
    return Replication(each, 2 * sum(off) > len(off))


def stands_by_prediction(gains: np.ndarray, lowered: Reduction, copies: Replication) -> tuple[bool, str]:
    """Whether it passes, and why not; ``gains`` from ``predicted_gains``."""
    if lowered.total > -thresholds.BEYOND_ITS_SCATTER * lowered.scatter:
        return False, "the fall of the error on records left out is within its scatter"
    if 2 * int(np.sum(gains > 0.0)) <= len(gains):
        return False, "a colour of the residual does as well on too many records"
    if not copies.agrees:
        return False, "it stands off its absence on too few records"
    return True, "cross-validated by one-step predictions, its values each record's own"
