"""Effects that stand by themselves although what remains is not noise: the usual good outcome on measured data.

Against white noise everything is significant where filters, a noisy input and a dozen small causes colour the residual. What a
cause does there, and chance does not: it lowers the error on records that were not fitted, on each of them, and comes out alike
from each record by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.colour import effective_share
from ident.fit import Fit
from ident.tracing.acceptance import held_out
from ident.tracing.coloured import coloured_gain
from ident.tracing.expansion import CLEARLY, COLLINEAR, implausible, near_absence, same_sensor_twins
from ident.tracing.node import Node, belongs_to_record, guards_among, is_event
from ident.tracing.occasion import occasion_at
from ident.tracing.reduction import Reduction, reduction
from ident.tracing.replication import Flight, Replication, own_quantities, replicate, stands_off
from ident.tracing.screening import Finding, collinear, screen
from sim.effect import Effect, NoiseEffect

WORTH = 0.1  # least fall of ln(error), a mean over the channels: less is what a dozen small causes make
SURE = 2.0  # of its scatter
WORSE = 0.05  # growth of ln(error) of one channel that is borne, beside twice its scatter
MOST, GUARDS = 6, 3  # candidates and guards fitted in full
HOPELESS = 0.1  # of the best projected gain, below which nothing is fitted
HALF = 0.5  # of that, on the fitted records, without which held-out ones are not asked
FEW = 3  # records, of which the others are fitted anew when one is left out
DEEPEST = 2


@dataclass(frozen=True, eq=False)
class Standing:
    """One candidate added to a set, weighed on records that were not fitted; ``gain`` of log likelihood there with any colour allowed for."""

    effect: Effect
    finding: Finding
    node: Node
    reduction: Reduction
    replication: Replication
    gain: float
    stands: bool
    why: str


@dataclass(frozen=True, eq=False)
class Stood:
    """An effect that stands, and those that would do as well in its place."""

    best: Standing
    others: tuple[Standing, ...]


def standing_effects(flight: Flight, candidates: Sequence[Effect], root: Node) -> tuple[list[Stood], list[Standing]]:
    """Effects that replicate and lower the error on records that were not fitted, one after the other, and all that was weighed.

    Parameters
    ----------
    flight : at least two records. candidates : library and guards; events and random motion are left out, since they need not replicate.
    root : the declared model fitted to the training records, for starting values.

    Each is first fitted to all records; those that might matter are fitted to all but one, and alone to each.
    """
    found: list[Stood] = []
    weighed: list[Standing] = []
    usable = [c for c in candidates if not (isinstance(c, NoiseEffect) or belongs_to_record(c) or is_event(c))]
    everything = range(len(flight.records))
    node = flight.fit((), everything, None, root.values.shared)
    while node is not None and len(found) < DEEPEST:
        before = _left_out(flight, node)
        if before is None:
            break
        tried = [_weigh(flight, node, finding, before) for finding in _promising(node, usable)]
        results = [item for item in tried if item is not None]
        weighed += results
        chosen = _choose(results)
        if chosen is None:
            break
        found.append(chosen)
        node = chosen.best.node
    return found, weighed


def _promising(node: Node, candidates: Sequence[Effect]) -> list[Finding]:
    """The candidates whose projected gain, in effective samples, pays for their parameters; the largest first."""
    share = _effective(node)
    twins = {twin for name in node.names for twin in same_sensor_twins(name)}
    samples = share * float(node.fit.counts.sum())
    findings = [finding for finding in screen(node, candidates, occasion_at(node)) if finding.effect.name not in twins]
    most = findings[0].gain if findings else 0.0
    worth = [
        finding
        for finding in findings
        if finding.gain > HOPELESS * most and 2.0 * share * finding.gain > finding.parameters * np.log(max(samples, np.e))
    ]
    guards = [finding for finding in worth if guards_among([finding.effect.name])]
    return [finding for finding in worth if finding not in guards][:MOST] + guards[:GUARDS]


def _left_out(flight: Flight, node: Node) -> list[Fit] | None:
    """Each record predicted by the set fitted to the others, only its own initial state and biases free; None where one fails."""
    fits = []
    for r, record in enumerate(flight.records):
        trained: Node | None = without_record(node, r)
        if len(flight.records) <= FEW:
            others = [other for other in range(len(flight.records)) if other != r]
            trained = flight.fit(node.effects, others, node.values)
        frozen = held_out(trained, [record], [flight.masks[r]], informed=False).frozen if trained is not None else None
        if frozen is None:
            return None
        fits.append(frozen)
    return fits


def without_record(node: Node, r: int) -> Node:
    """The set as fitted to all records but one: a Gauss-Newton step from the fit of all of them, which is near where there are many."""
    fit, layout = node.fit, node.fit.layout
    normal, gradient = (part.copy() for part in fit.normal_equations())
    at, problem = layout.columns(r), layout.problems[r]
    weight = np.where(problem.valid, 1.0 / fit.variance[:, None], 0.0).ravel()
    J = fit.jacobians[r].reshape(-1, len(at))
    normal[np.ix_(at, at)] -= J.T @ (weight[:, None] * J)
    gradient[at] -= J.T @ (weight * fit.residuals[r].ravel())
    scale = np.sqrt(np.maximum(np.diag(normal), 0.0))
    moving = np.flatnonzero(scale > 1e-9 * np.sqrt(np.maximum(np.diag(fit.normal_equations()[0]), 1e-300)))
    inside = normal[np.ix_(moving, moving)] / np.outer(scale[moving], scale[moving])
    step = np.zeros(len(fit.theta))
    step[moving] = np.linalg.lstsq(inside, gradient[moving] / scale[moving], rcond=1e-10)[0] / scale[moving]
    return replace(node, fit=replace(fit, theta=np.clip(fit.theta + step, layout.low, layout.high)))


def _weigh(flight: Flight, node: Node, finding: Finding, before: Sequence[Fit]) -> Standing | None:
    effects = (*node.effects, finding.effect)
    everything = range(len(flight.records))
    tries = [flight.fit(effects, everything, node.values, start) for start in finding.starts[:2]]
    child = min((t for t in tries if t is not None), key=lambda t: t.fit.cost, default=None)
    if child is None or child.fit.cost > node.fit.cost:
        child = flight.fit(effects, everything, node.values, near_absence(finding.effect, finding.starts[0]))
    if child is None:
        return None
    if _fitted_change(node, child) > -HALF * WORTH:
        return None
    after = _left_out(flight, child)
    if after is None:
        return None
    lowered, gain = reduction(before, after), coloured_gain(before, after)
    if lowered.total > -WORTH:
        return Standing(finding.effect, finding, child, lowered, Replication((), False), gain, False, "it does not lower the held-out error enough")
    copies = replicate(flight, child, finding.effect)
    stands, why = _judged(lowered, copies)
    if stands and stands_off(child, finding.effect) < CLEARLY:
        stands, why = False, "its parameters are not determined"
    if stands and gain < flight.settings.accept:
        stands, why = False, "a colour of the residual does as well"
    if stands and implausible(finding.effect, own_quantities(child, finding.effect)):
        stands, why = False, "its parameters are beyond belief"
    return Standing(finding.effect, finding, child, lowered, copies, gain, stands, why)


def _fitted_change(node: Node, child: Node) -> float:
    """Mean over the channels of ln(rms after / rms before) on the fitted records: what is not there will not be on others."""
    used = node.fit.layout.used & child.fit.layout.used
    return float(np.mean(0.5 * np.log(child.fit.variance[used] / node.fit.variance[used]))) if np.any(used) else 0.0


def _judged(lowered: Reduction, copies: Replication) -> tuple[bool, str]:
    """Whether it stands, and why not."""
    if lowered.total > -SURE * lowered.scatter:
        return False, "the fall of the held-out error is within its scatter"
    if np.any(lowered.by_channel > WORSE + 2.0 * lowered.channel_scatter):
        return False, "one channel gets worse"
    # A short record, or one that hardly moves what the effect needs, says little by its sign: it speaks against beyond its own scatter only.
    if any(total > SURE * scatter for total, scatter in zip(lowered.by_record, lowered.record_scatter, strict=True)):
        return False, "it makes a record worse"
    if 2 * sum(total < 0.0 for total in lowered.by_record) <= len(lowered.by_record):
        return False, "it helps on too few records"
    if not copies.agrees:
        return False, "the records give different values"
    return True, "stands"


def _choose(results: Sequence[Standing]) -> Stood | None:
    """The best of those that stand, with those as good; None where a guard, or what does not replicate, does better than all of them."""
    standing = [item for item in results if item.stands and not guards_among([item.effect.name])]
    if not standing:
        return None
    lowest = min(standing, key=lambda item: item.reduction.total)
    guards = [item for item in results if guards_among([item.effect.name])]
    if any(_better_guard(item, lowest) for item in guards):
        return None
    equals = [item for item in standing if _as_good(item, lowest)]
    # Among equals the one with fewest parameters, then the best.
    best = min(equals, key=lambda item: (item.finding.parameters, item.reduction.total))
    others = sorted((item for item in equals if item is not best), key=lambda item: item.reduction.total)
    return Stood(best, tuple(others))


def _better_guard(guard: Standing, best: Standing) -> bool:
    """Whether a guard does better than the best by more than scatter, or as well with no more parameters."""
    ahead = best.reduction.total - guard.reduction.total
    return ahead > best.reduction.scatter or (ahead > -best.reduction.scatter and guard.finding.parameters <= best.finding.parameters)


def _as_good(item: Standing, best: Standing) -> bool:
    """Whether an effect would do in the place of the best: as good on held-out data but for scatter, or nearly so and of like signature."""
    behind = item.reduction.total - best.reduction.total
    alike = collinear(item.finding, best.finding) > COLLINEAR
    return behind <= (3.0 if alike else 1.0) * max(best.reduction.scatter, 0.02)


def _effective(node: Node) -> float:
    return effective_share(node.fit.residuals, [problem.valid for problem in node.fit.layout.problems])
