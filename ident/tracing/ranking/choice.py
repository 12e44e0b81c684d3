"""The set that is judged, and what of those it was compared with explains as much."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Requirement
from ident.tracing.equivalents import are_equivalent
from ident.tracing.selection.ledger import Key
from ident.tracing.validation.held_out import HeldOut
from ident.tracing.weighed import ComparedSet


@dataclass(frozen=True, eq=False)
class Choice:
    """The set that is judged and what it does on data that were not fitted.

    ``totals`` : criterion, ``misfits`` : twice the cost, of each set that was compared, by the names of its effects; with the cost of the
    data that were not fitted where these take part. Empty where nothing was compared. ``sets`` : the same for the probability of names, with
    others that the search passed. ``uneven`` : its process noise stands for what goes with the motion, ``behind_gaps`` for what missing rows
    leave; ``unevenness``, ``gap_share`` : the number of each against its bar. ``idle`` : effects that predict nothing, with the log likelihood
    that each brings on data that were not fitted, of which ``least`` is asked. ``slight`` : events beside others that bring hardly anything,
    with their shares.
    """

    best: FittedModel
    out: HeldOut
    totals: Mapping[Key, float] = field(default_factory=dict)
    misfits: Mapping[Key, float] = field(default_factory=dict)
    sets: tuple[ComparedSet, ...] = ()
    uneven: bool = False
    behind_gaps: bool = False
    idle: Mapping[str, float] = field(default_factory=dict)
    slight: Mapping[str, float] = field(default_factory=dict)
    least: float = 0.0
    unevenness: Requirement | None = None
    gap_share: Requirement | None = None


def alternatives_of(choice: Choice, guards: frozenset[str]) -> dict[str, tuple[str, ...]]:
    """For each effect of a set the names that could stand in its place, two at most, the nearest first.

    They explain the data as well, however many parameters they need for it: that they are dearer is a reason to name the other,
    not to deny them.
    """
    mine = frozenset(choice.best.names)
    reference = choice.misfits.get(mine)
    found: dict[str, list[tuple[float, str]]] = {}
    if reference is None:
        return {}
    for key, misfit in choice.misfits.items():
        gone, come = mine - key, key - mine
        if len(gone) == len(come) == 1 and misfit - reference < thresholds.ALTERNATIVE and not come & guards:
            found.setdefault(next(iter(gone)), []).append((misfit - reference, next(iter(come))))
    return {name: tuple(other for _, other in sorted(entries)[: thresholds.ALTERNATIVES_NAMED]) for name, entries in found.items()}


def is_ambiguous(choice: Choice, guards: frozenset[str]) -> bool:
    """Whether a set of one other effect explains all data that take part as well as the one chosen."""
    mine = frozenset(choice.best.names)
    reference = choice.totals.get(mine, 0.0)
    return any(
        total - reference < thresholds.AMBIGUOUS
        and len(key) == len(mine)
        and len(key - mine) == 1
        and not key & guards
        and not _one_sensor(choice.best, mine - key, key - mine)
        for key, total in choice.totals.items()
        if key != mine
    )


def _one_sensor(best: FittedModel, gone: Key, come: Key) -> bool:
    """Whether two names are the lag and the delay of one sensor: one late sensor, described twice, under the same derivatives."""
    if are_equivalent(best, gone, come):
        return False
    return any(come.intersection(effect.traits.twins) for effect in best.effects if effect.name in gone)
