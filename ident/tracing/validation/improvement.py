"""Do data that were not fitted bear a claim out: is their error lower, by as much as they have room for, or do they contradict it?"""

from __future__ import annotations

import numpy as np

from ident.tracing import thresholds
from ident.tracing.validation.held_out import HeldOut
from ident.tracing.validation.scatter_of_change import scatter_of_change
from ident.whole_record.gauss_newton import Fit


def no_better(before: HeldOut, after: HeldOut) -> bool:
    """Whether a free simulation of held-out data is no better, in likelihood, than that of the declared model."""
    return before.frozen is not None and after.frozen is not None and after.frozen.cost >= before.frozen.cost


def hardly_better(before: HeldOut, after: HeldOut, *, weak: bool = False) -> bool:
    """Whether a free simulation of held-out data, all channels at their own scale, is better than the declared model's by too little to say.

    Mean over the channels of ln(rms after / rms before), for what is printed: claims that were cross-validated one by one need not help together.
    ``weak`` : whether less will do where the data have room for less (``room_for``): they may hardly move, but what is claimed has to show in
    them, else chance alone decides.
    """
    if no_better(before, after) or before.frozen is None or after.frozen is None:
        return True
    change = changes(before.frozen, after.frozen)
    less = weak and np.sum(_lacking(before.frozen, after.frozen, mean=False)) >= thresholds.SHOWS
    least = min(thresholds.WORTH, room_for(before.frozen, after.frozen)) if less else thresholds.WORTH
    return not change.size or float(np.mean(change)) >= -thresholds.HALF_OF_IT * least


def changes(before: Fit, after: Fit) -> np.ndarray:
    """ln(rms after / rms before) of each channel used by both fits."""
    used = before.layout.used & after.layout.used
    return np.asarray(0.5 * np.log(after.variance[used] / before.variance[used]))


def room_for(before: Fit, after: Fit) -> float:
    """By how much ln(rms) would fall from one frozen fit to another, mean over the channels, if the second were the truth.

    What the first then lacks is the difference of the two simulations: its variance is that of the second and the square of that difference.
    """
    lacking = _lacking(before, after, mean=True)
    return float(np.mean(0.5 * np.log1p(lacking))) if lacking.size else 0.0


def _lacking(before: Fit, after: Fit, *, mean: bool) -> np.ndarray:
    """Squared difference of two simulations over what the second leaves, summed over the samples or its mean, of each channel used by both."""
    apart = np.concatenate([two.y - one.y for one, two in zip(before.lines, after.lines, strict=True)], axis=1)
    valid = np.concatenate([problem.valid for problem in after.layout.problems], axis=1)
    used = before.layout.used & after.layout.used
    counts = np.maximum(np.count_nonzero(valid, axis=1)[used], 1) if mean else 1
    return np.asarray(np.sum(np.where(valid, apart, 0.0) ** 2, axis=1)[used] / counts / after.variance[used])


def contradicted(before: HeldOut, after: HeldOut) -> bool:
    """Whether a free simulation of held-out data misses what a set would bring there by more than chance moves that figure.

    Asked in the place of ``hardly_better`` where other records, left out in turn, show each effect of the set strongly: one more record may say
    little, but no claim stands against it.
    """
    if before.frozen is None or after.frozen is None:
        return True
    change = changes(before.frozen, after.frozen)
    asked = thresholds.HALF_OF_IT * min(thresholds.WORTH, room_for(before.frozen, after.frozen))
    chance = thresholds.BEYOND_ITS_SCATTER * scatter_of_change(before.frozen, after.frozen)
    return not change.size or float(np.mean(change)) > chance - asked
