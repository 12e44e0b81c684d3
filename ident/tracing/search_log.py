"""Log of a search for the report: candidates tried at each set, steps, and fitted sets."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping

from ident.tracing.diagnosis import Candidate, FittedSet, Step
from ident.tracing.evidence import WeighedSet
from ident.tracing.fitted_model import quantities
from ident.tracing.linear_sets import LinearSet

ConfusableNames = Callable[[str], tuple[str, ...]]


def scanned_candidates(
    number: int,
    parent: WeighedSet,
    singles: Mapping[str, LinearSet],
    confusable_names: ConfusableNames,
) -> list[Candidate]:
    """Return a log entry for each effect that was scanned at a set, with its linearised gain.

    Parameters
    ----------
    number : of the round.
    parent : the set at which the effects were scanned.
    singles : best single lead of each effect, by name.
    confusable_names : function that returns the names confusable with a name.
    """
    within = tuple(sorted(parent.names))
    return [
        Candidate(number, within, name, one.gain, one.weight, False, {}, confusable_names(name))
        for name, one in singles.items()
    ]


def fitted_candidates(
    number: int,
    parent: WeighedSet,
    children: Iterable[WeighedSet],
    confusable_names: ConfusableNames,
) -> list[Candidate]:
    """Return a log entry for each effect that was fitted alone in addition to a set.

    Excluded sets are omitted. ``children`` : the fitted sets; for the other parameters see
    ``scanned_candidates``.
    """
    within = tuple(sorted(parent.names))
    return [
        Candidate(
            number,
            within,
            effect.name,
            child.evidence - parent.evidence,
            child.weight - parent.weight,
            True,
            quantities(child.fitted, effect),
            confusable_names(effect.name),
        )
        for child in children
        if child.weight > float("-inf")
        for effect in child.fitted.effects
        if child.names - parent.names == {effect.name}
    ]


def logged_step(what: str, best: WeighedSet, added: Collection[str], log_odds: float) -> Step:
    """Return the log entry of a step.

    Parameters
    ----------
    what : what was done.
    best : the most probable set after the step. added : names of its effects without the base.
    log_odds : log posterior odds of ``best`` against the declared model.
    """
    names = " + ".join(sorted(added)) or "nothing"
    sentence = (
        f"{what}; most probable so far is {names}, log posterior odds {log_odds:+.1f} against the "
        "declared model"
    )
    log_likelihood = best.fitted.fit.log_likelihood
    return Step(tuple(sorted(best.names)), best.evidence, log_likelihood, sentence)


def fitted_sets(title: str, sets: Iterable[WeighedSet]) -> list[FittedSet]:
    """Return the log entries of fitted sets, the most probable first; excluded sets are omitted.

    ``title`` : of the search.
    """
    return [
        FittedSet(
            title,
            tuple(sorted(one.names)),
            one.fitted.fit.log_likelihood,
            one.evidence,
            one.weight - one.evidence,
        )
        for one in sorted(sets, key=lambda one: -one.weight)
        if one.weight > float("-inf")
    ]
