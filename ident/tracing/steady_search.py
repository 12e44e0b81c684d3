"""Search with a model discrepancy, for effects whose evidence is spread over the records.

If no set of effects leaves noise, the forces of the model have errors outside the library. A random
load (the discrepancy) [1]_ represents them. An effect is then added only if its evidence is spread
over the records, by Vuong's test on blocks of time; the test is valid even if both models are wrong
[2]_.

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
from scipy.special import ndtri, stdtr

from ident.tracing.evidence import ABSENT_LIMIT, WeighedSet, set_prior
from ident.tracing.fitted_model import FittedModel, absent_values, belongs_to_record
from ident.tracing.search import CLEAR_GAIN, Search
from ident.whole_record.coloured_noise import ColouredNoise
from sim.declaration.effect import NoiseEffect
from sim.declaration.proposal import SearchContext, Traceable

VUONG_BLOCK_TIME = 1.0  # s, length of a block of Vuong's test
NAMED_EFFECT_Z = 3.5  # smallest z of a claim with a discrepancy
# z below which two sets are confusable; also required of effects with kinematic evidence
CONFUSABLE_SETS_Z = 2.0
SUPPORTED_Z = 3.0  # z below which an effect is weak; also for contradictions by held-out data
MOST_EFFECTS = 4  # most effects that are added to a discrepancy


def is_steady(effect: Traceable) -> bool:
    """Return whether an effect acts throughout and equally in all records.

    A channel held between updates counts: the phase of each record is tried.
    """
    equal_in_records = not belongs_to_record(effect) or bool(effect.traits.tried)
    return equal_in_records and not (effect.traits.onset or effect.traits.background)


def log_densities(fitted: FittedModel) -> list[np.ndarray]:
    """Return for each record the log density ``(N,)`` of each sample given the earlier samples, all
    outputs together.
    """
    noise = ColouredNoise(fitted.fit)
    densities = [
        -0.5 * np.sum(noise.in_time(r) ** 2, axis=0) for r in range(len(fitted.fit.layout.problems))
    ]
    total = sum(float(each.sum()) for each in densities)
    # Log determinants are spread evenly: a filter is steady within seconds.
    rest = (noise.log_likelihood - total) / sum(len(each) for each in densities)
    return [each + rest for each in densities]


def vuong(one: WeighedSet, other: WeighedSet, interval: float) -> float:
    """Return z of Vuong's test: the difference of log evidence over its scatter between blocks of
    time.

    Parameters
    ----------
    one, other : two fitted sets on the same records. interval : between samples, s.
    """
    pairs = zip(log_densities(one.fitted), log_densities(other.fitted), strict=True)
    changes = [_in_blocks(a - b, interval) for a, b in pairs]
    return gain_over_scatter(one.evidence - other.evidence, np.concatenate(changes))


def quiet_vuong(
    one: FittedModel, other: FittedModel, declared: FittedModel, interval: float
) -> float:
    """Return z of Vuong's test in the half of the blocks with the least motion of the declared
    model.

    Rough air also acts between maneuvers; other errors that resemble it follow the maneuver. The
    noise of both sets is estimated again in these blocks, since maneuvers enlarge it.

    Parameters
    ----------
    one, other : two fitted sets on the same records. declared : the declared model there, without
        process noise. interval : between samples, s.
    """
    noise = np.sqrt(declared.fit.variance)[:, None]
    motion_by_block = [
        _in_blocks(
            np.sum(np.abs(np.diff(line.y, axis=1, prepend=line.y[:, :1])) / noise, axis=0), interval
        )
        for line in declared.fit.linearisations
    ]
    blocks = np.concatenate(motion_by_block)
    order = np.argsort(blocks, kind="stable")
    inside = np.zeros(len(blocks), dtype=bool)
    inside[order[: len(blocks) // 2]] = True
    size = max(2, round(VUONG_BLOCK_TIME / interval))
    records = np.split(inside, np.cumsum([len(each) for each in motion_by_block])[:-1])
    quiet = [
        np.repeat(quiet_samples, size)[: line.y.shape[1]]
        for quiet_samples, line in zip(records, declared.fit.linearisations, strict=True)
    ]
    pairs = zip(_densities_within(one, quiet), _densities_within(other, quiet), strict=True)
    gains = np.concatenate([_in_blocks(a - b, interval) for a, b in pairs])[inside]
    return gain_over_scatter(float(gains.sum()), gains)


def _densities_within(fitted: FittedModel, inside: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return ``log_densities`` with the noise of each output estimated again from some samples.

    ``inside`` : mask ``(N,)`` of these samples in each record.
    """
    fit = fitted.fit
    standardised_residuals = [
        np.where(problem.valid, residual / np.sqrt(fit.variance)[:, None], 0.0)
        for problem, residual in zip(fit.layout.problems, fit.residuals, strict=True)
    ]
    squared = sum(
        np.sum(standardised[:, quiet_samples] ** 2, axis=1)
        for standardised, quiet_samples in zip(standardised_residuals, inside, strict=True)
    )
    count = sum(
        np.count_nonzero(problem.valid[:, quiet_samples], axis=1)
        for problem, quiet_samples in zip(fit.layout.problems, inside, strict=True)
    )
    level = np.maximum(squared, 1e-12) / np.maximum(count, 1)
    densities = []
    for problem, standardised, plain in zip(
        fit.layout.problems, standardised_residuals, log_densities(fitted), strict=True
    ):
        terms_with_new_level = np.where(
            problem.valid, (standardised**2) / level[:, None] + np.log(level)[:, None], 0.0
        )
        densities.append(plain + 0.5 * np.sum(standardised**2 - terms_with_new_level, axis=0))
    return densities


def _in_blocks(row: np.ndarray, interval: float) -> np.ndarray:
    """Return the sums of a row over blocks of time."""
    block = max(2, round(VUONG_BLOCK_TIME / interval))
    return np.add.reduceat(row, np.arange(0, len(row), block))


def gain_over_scatter(gain: float, changes: np.ndarray) -> float:
    """Return a gain over its scatter, estimated from its parts by block, as a normal deviate.

    A ratio to a scatter that few blocks determine follows Student's t distribution: the normal
    deviate of the same probability is smaller.

    Parameters
    ----------
    gain : difference of log evidence. changes : ``(n,)`` differences of log likelihood by block.
    """
    blocks = len(changes)
    # The standard deviation of half a noncentral chi-square of mean g is at least sqrt(2 g).
    least = gain / max(math.sqrt(2.0 * abs(gain)), 1e-12)
    scatter = math.sqrt(blocks) * float(np.std(changes, ddof=1)) if blocks > 1 else 0.0
    if not scatter > 0.0:
        return least
    deviate = -float(ndtri(stdtr(blocks - 1, -abs(gain) / scatter)))
    return math.copysign(min(deviate, abs(least)), gain)


def is_surely_needed(one: WeighedSet, name: str, context: SearchContext, bar: float) -> bool:
    """Return whether an effect is needed so clearly that a fit without it can be omitted.

    One Gauss-Newton step sets the effect to its absence and all else to the optimum, with the noise
    estimated again. Its z is below that of a fit, as a quadratic exaggerates the largest losses.
    False where the step is not possible: an effect without a finite absent value, or of the noise.

    Parameters
    ----------
    one : a fitted set. name : of the effect. bar : smallest z that counts as clear.
    """
    fit, layout = one.fitted.fit, one.fitted.fit.layout
    (effect,) = [each for each in one.fitted.effects if each.name == name]
    absent = absent_values([effect])
    names = [each.partition(", record")[0] for each in layout.names]
    at = np.array(
        [i for i, each in enumerate(names) if abs(absent.get(each, math.inf)) < ABSENT_LIMIT],
        dtype=int,
    )
    if not at.size or isinstance(effect, NoiseEffect):
        return False
    normal, gradient = fit.normal_equations()
    prior = set_prior(one.fitted, context)
    step = np.zeros(len(fit.theta))
    step[at] = [absent[names[i]] - fit.theta[i] for i in at]
    rest = np.setdiff1d(np.arange(len(step)), at)
    inside = normal[np.ix_(rest, rest)] + np.diag(prior.precision[rest])
    scale = 1.0 / np.sqrt(np.maximum(np.diag(inside), 1e-300))
    right_side = gradient[rest] - normal[np.ix_(rest, at)] @ step[at]
    scaled_normal = inside * np.outer(scale, scale)
    scaled_step = np.linalg.lstsq(scaled_normal, scale * right_side, rcond=1e-10)[0]
    step[rest] = scale * scaled_step
    changes, loss, samples = [], 0.0, 0.0
    for r, problem in enumerate(layout.problems):
        own_columns = np.arange(len(fit.theta))[layout.columns(r)]
        weight = np.where(problem.valid, 1.0 / np.sqrt(fit.variance)[:, None], 0.0)
        before = fit.residuals[r] * weight
        after = before - np.einsum("mnc,c->mn", fit.jacobians[r], step[own_columns]) * weight
        change = 0.5 * np.sum(after**2 - before**2, axis=0)
        loss += float(change.sum())
        samples += float(np.count_nonzero(problem.valid))
        changes.append(change)
    if not loss > 0.0:
        return False
    # The new noise estimate reduces a large loss, in each block alike.
    gain = 0.5 * samples * math.log1p(2.0 * loss / samples)
    parts = np.concatenate([_in_blocks(each, context.interval) for each in changes])
    z = gain_over_scatter(gain, gain / loss * parts)
    return gain > CLEAR_GAIN and z > bar


def required_z(search: Search, name: str) -> float:
    """Return the smallest z of Vuong's test at which an effect is claimed with a discrepancy."""
    return CONFUSABLE_SETS_Z if name in search.problem.named_by_kinematics else NAMED_EFFECT_Z


def search_spread_evidence(search: Search) -> WeighedSet:
    """Return the set built from effects whose evidence is spread over the records.

    After each addition, earlier members that are no longer needed are removed, one at a time.
    """
    leader, interval = search.base_set, search.context.interval
    named = search.set_named_by_kinematics()
    if named is not None:
        leader = _without_unneeded_members(search, named)
    for _ in range(MOST_EFFECTS):
        if leader.names not in search.expanded:
            search.expand(leader, largest_addition=1)
        supported = [
            one
            for key, one in search.visited.items()
            if leader.names < key
            and len(key) == len(leader.names) + 1
            and one.weight > leader.weight
            and vuong(one, leader, interval) > NAMED_EFFECT_Z
        ]
        if not supported:
            break
        # Rough air can explain other effects, so it is added last.
        causes = [one for one in supported if not _adds_noise(one, leader)]
        leader = max(causes or supported, key=lambda one: one.weight)
        leader = (
            _without_unneeded_members(search, leader) if len(search.added(leader)) > 1 else leader
        )
    return leader


def _without_unneeded_members(search: Search, leader: WeighedSet) -> WeighedSet:
    """Return the set without the members whose evidence is local, removed one at a time."""
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
    """Return whether a set has a noise effect that the smaller set does not have."""
    added = [each for each in larger.fitted.effects if each.name not in smaller.names]
    return any(isinstance(each, NoiseEffect) for each in added)
