"""Search beside a model discrepancy: effects that act all along, and show it all along.

Where no set of effects leaves noise, the forces of the model are wrong in ways that no library
holds. They get a random history (the discrepancy) [1]_, and an effect is added only where the
evidence for it is spread over the records: Vuong's test on blocks of time, which holds where
neither of two models is true [2]_.

References
----------
.. [1] M. C. Kennedy and A. O'Hagan, "Bayesian calibration of computer models", J. R. Statist. Soc.
   B 63, 2001.
.. [2] Q. H. Vuong, "Likelihood ratio tests for model selection and non-nested hypotheses",
   Econometrica 57, 1989.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ident.tracing.evidence import ColouredNoise, WeighedSet
from ident.tracing.fitted_model import FittedModel, belongs_to_record
from ident.tracing.priors import ABSENT_LIMIT, set_prior
from ident.tracing.search import CLEAR_GAIN, Search
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.proposal import SearchContext, Traceable

VUONG_BLOCK_TIME = 1.0  # s, of a block of Vuong's test
NAMED_EFFECT_Z = 3.5  # z of an effect that may be named beside a discrepancy
# z below which two sets are not told apart; asked where kinematics name it as well
CONFUSABLE_SETS_Z = 2.0
MOST_EFFECTS = 4  # effects beside a discrepancy, at most


def is_steady(effect: Traceable) -> bool:
    """Return whether an effect acts all along and alike in all records.

    Of a channel that is held between updates each record has its own phase, which is tried.
    """
    alike = not belongs_to_record(effect) or bool(effect.traits.tried)
    return alike and not (effect.traits.onset or effect.traits.background)


def log_densities(fitted: FittedModel) -> list[np.ndarray]:
    """Log density of each sample given those before it, all outputs together, ``(N,)`` a record."""
    noise = ColouredNoise(fitted.fit)
    out = [
        -0.5 * np.sum(noise.in_time(r) ** 2, axis=0) for r in range(len(fitted.fit.layout.problems))
    ]
    total = sum(float(each.sum()) for each in out)
    # The rest (log determinants) is spread evenly: a filter settles within seconds.
    rest = (noise.log_likelihood - total) / sum(len(each) for each in out)
    return [each + rest for each in out]


def vuong(one: WeighedSet, other: WeighedSet, interval: float) -> float:
    """Return the difference of log evidence over the scatter of its parts in blocks of time.

    Parameters
    ----------
    one, other : two fitted sets on the same records. interval : between samples, s.
    """
    pairs = zip(log_densities(one.fitted), log_densities(other.fitted), strict=True)
    changes = [_in_blocks(a - b, interval) for a, b in pairs]
    return _over_scatter(one.evidence - other.evidence, np.concatenate(changes))


def quiet_vuong(
    one: FittedModel, other: FittedModel, declared: FittedModel, interval: float
) -> float:
    """Vuong's test in the half of the blocks in which the declared model moves least.

    Rough air acts whether or not the aircraft is maneuvered. What else is missing and resembles
    it follows the maneuver. The noise of both sets is estimated anew there: what a maneuver leaves
    makes it larger.

    Parameters
    ----------
    one, other : two fitted sets on the same records. declared : the declared model there, without
        process noise. interval : between samples, s.
    """
    noise = np.sqrt(declared.fit.variance)[:, None]
    moved = [
        _in_blocks(
            np.sum(np.abs(np.diff(line.y, axis=1, prepend=line.y[:, :1])) / noise, axis=0), interval
        )
        for line in declared.fit.lines
    ]
    blocks = np.concatenate(moved)
    order = np.argsort(blocks, kind="stable")
    inside = np.zeros(len(blocks), dtype=bool)
    inside[order[: len(blocks) // 2]] = True
    size = max(2, round(VUONG_BLOCK_TIME / interval))
    records = np.split(inside, np.cumsum([len(each) for each in moved])[:-1])
    quiet = [
        np.repeat(mine, size)[: line.y.shape[1]]
        for mine, line in zip(records, declared.fit.lines, strict=True)
    ]
    pairs = zip(_densities_within(one, quiet), _densities_within(other, quiet), strict=True)
    gains = np.concatenate([_in_blocks(a - b, interval) for a, b in pairs])[inside]
    return _over_scatter(float(gains.sum()), gains)


def _densities_within(fitted: FittedModel, inside: Sequence[np.ndarray]) -> list[np.ndarray]:
    """``log_densities`` with the noise of each output estimated anew from some of the samples."""
    fit = fitted.fit
    standard = [
        np.where(problem.valid, residual / np.sqrt(fit.variance)[:, None], 0.0)
        for problem, residual in zip(fit.layout.problems, fit.residuals, strict=True)
    ]
    squared = sum(np.sum(e[:, mine] ** 2, axis=1) for e, mine in zip(standard, inside, strict=True))
    count = sum(
        np.count_nonzero(problem.valid[:, mine], axis=1)
        for problem, mine in zip(fit.layout.problems, inside, strict=True)
    )
    level = np.maximum(squared, 1e-12) / np.maximum(count, 1)
    out = []
    for problem, e, plain in zip(fit.layout.problems, standard, log_densities(fitted), strict=True):
        anew = np.where(problem.valid, (e**2) / level[:, None] + np.log(level)[:, None], 0.0)
        out.append(plain + 0.5 * np.sum(e**2 - anew, axis=0))
    return out


def _in_blocks(row: np.ndarray, interval: float) -> np.ndarray:
    """Return the sums of a row over blocks of time."""
    block = max(2, round(VUONG_BLOCK_TIME / interval))
    return np.add.reduceat(row, np.arange(0, len(row), block))


def _over_scatter(gain: float, changes: np.ndarray) -> float:
    """Return a gain over its scatter, from its parts by block."""
    # Half a noncentral chi-square of mean g has at least the standard deviation sqrt(2 g).
    scatter = float(np.sqrt(len(changes)) * np.std(changes))
    return float(gain / max(scatter, math.sqrt(2.0 * abs(gain)), 1e-12))


def is_surely_needed(one: WeighedSet, name: str, context: SearchContext, bar: float) -> bool:
    """Return whether leaving an effect out would cost so much that no fit is needed to say so.

    One Gauss-Newton step from the fit puts the effect at its absence, all else at its optimum
    beside that, under noise estimated anew. Its z of Vuong's test is smaller than that of a fit:
    a quadratic exaggerates the blocks that lose most. False where a step tells nothing: an effect
    that is not absent at a finite value, or acts through the noise.

    Parameters
    ----------
    one : a fitted set. name : of the effect. bar : z that is asked for.
    """
    fit, layout = one.fitted.fit, one.fitted.fit.layout
    (effect,) = [each for each in one.fitted.effects if each.name == name]
    absent = {full_name(effect, local): value for local, value in effect.absent.items()}
    plain = [each.partition(", record")[0] for each in layout.names]
    at = np.array(
        [i for i, each in enumerate(plain) if abs(absent.get(each, math.inf)) < ABSENT_LIMIT],
        dtype=int,
    )
    if not at.size or isinstance(effect, NoiseEffect):
        return False
    normal, gradient = fit.normal_equations()
    prior = set_prior(one.fitted, context)
    step = np.zeros(len(fit.theta))
    step[at] = [absent[plain[i]] - fit.theta[i] for i in at]
    rest = np.setdiff1d(np.arange(len(step)), at)
    inside = normal[np.ix_(rest, rest)] + np.diag(prior.precision[rest])
    scale = 1.0 / np.sqrt(np.maximum(np.diag(inside), 1e-300))
    right = gradient[rest] - normal[np.ix_(rest, at)] @ step[at]
    turned = np.linalg.lstsq(inside * np.outer(scale, scale), scale * right, rcond=1e-10)[0]
    step[rest] = scale * turned
    changes, lost, samples = [], 0.0, 0.0
    for r, problem in enumerate(layout.problems):
        mine = np.arange(len(fit.theta))[layout.columns(r)]
        weight = np.where(problem.valid, 1.0 / np.sqrt(fit.variance)[:, None], 0.0)
        before = fit.residuals[r] * weight
        after = before - np.einsum("mnc,c->mn", fit.jacobians[r], step[mine]) * weight
        change = 0.5 * np.sum(after**2 - before**2, axis=0)
        lost += float(change.sum())
        samples += float(np.count_nonzero(problem.valid))
        changes.append(change)
    if not lost > 0.0:
        return False
    # Under noise estimated anew a large loss is smaller, and so is that of each block.
    gain = 0.5 * samples * math.log1p(2.0 * lost / samples)
    parts = np.concatenate([_in_blocks(each, context.interval) for each in changes])
    z = _over_scatter(gain, gain / lost * parts)
    return gain > CLEAR_GAIN and z > bar


def required_z(search: Search, name: str) -> float:
    """z that an effect needs beside a discrepancy."""
    return CONFUSABLE_SETS_Z if name in search.problem.named_by_kinematics else NAMED_EFFECT_Z


def search_spread_evidence(search: Search) -> WeighedSet:
    """Return the set reached by additions of which each is spread over the records.

    After each addition those before it are left out, one at a time, and stay out where they are
    no longer needed.
    """
    leader, interval = search.root, search.context.interval
    named = search.set_named_by_kinematics()
    if named is not None:
        leader = _needed(search, named)
    for _ in range(MOST_EFFECTS):
        if leader.names not in search.expanded:
            search.expand(leader, deepest=1)
        good = [
            one
            for key, one in search.visited.items()
            if leader.names < key
            and len(key) == len(leader.names) + 1
            and one.weight > leader.weight
            and vuong(one, leader, interval) > NAMED_EFFECT_Z
        ]
        if not good:
            break
        # Rough air takes in what has a cause: it is added where no cause can be.
        causes = [one for one in good if not _adds_noise(one, leader)]
        leader = max(causes or good, key=lambda one: one.weight)
        leader = _needed(search, leader) if len(search.added(leader)) > 1 else leader
    return leader


def _needed(search: Search, leader: WeighedSet) -> WeighedSet:
    """A set without the members whose evidence is not spread over the records, one at a time."""
    for name in sorted(search.added(leader)):
        bar = required_z(search, name)
        if is_surely_needed(leader, name, search.context, bar):
            continue
        smaller = search.fit_without(leader, name)
        if smaller is None:
            continue
        z = vuong(leader, smaller, search.context.interval)
        if smaller.weight > leader.weight or z < bar:
            leader = smaller
    return leader


def _adds_noise(larger: WeighedSet, smaller: WeighedSet) -> bool:
    """Return whether what one set has more than another is process noise."""
    fresh = [each for each in larger.fitted.effects if each.name not in smaller.names]
    return any(isinstance(each, NoiseEffect) for each in fresh)
