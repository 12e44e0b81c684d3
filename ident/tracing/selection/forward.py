"""Forward selection with a beam: which set of effects explains the records best.

An addition counts only if it lowers the score by more than the best of all candidates does on noise.
"""

from __future__ import annotations

from collections.abc import Sequence

from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FitData, FittedModel, Start, Values, fit_set
from ident.tracing.selection.backward import freer_form
from ident.tracing.selection.criterion import gain, is_coloured_throughout, is_white
from ident.tracing.selection.crossed_pairs import crossed_pairs
from ident.tracing.selection.expansion import expand, with_process_noise
from ident.tracing.selection.ledger import Ledger
from ident.tracing.selection.pairs_at_once import pairs_at_once
from sim.declaration.effect import NoiseEffect

Beam = list[FittedModel]


def first_round(ledger: Ledger, root: FittedModel) -> tuple[Ledger, Beam]:
    """The best sets of one effect, and of one beside what any record may have; a beam of them."""
    ledger, children = expand(ledger.kept(root, root.criterion), root, 1)
    return _freer_forms(ledger, _best(ledger, children))


def defies(base: FittedModel, first: Sequence[FittedModel]) -> bool:
    """Whether neither the declared model nor any single effect comes anywhere near noise in any channel of any record."""
    return all(is_coloured_throughout(fitted, thresholds.GROSSLY_COLOURED) for fitted in (base, *first))


def forward_selection(ledger: Ledger, base: FittedModel, first: Sequence[FittedModel]) -> tuple[Ledger, FittedModel]:
    """Add effects round by round to the sets of the first one; the best set found.

    The best set is extended first. Where nothing can be added to it and its residual is white the search is over: a
    second-best set is looked at only as long as something is missing from the best. Process noise takes in whatever has
    a cause, so it is offered only where no single cause leaves noise.
    """
    # A first round with many events may have spent all: what two causes leave of each other shows in the rounds after it only.
    ledger, beam = ledger.renewed(thresholds.LEFT_FOR_ROUND), list(first)
    moving: Beam = []
    if not any(is_white(fitted) for fitted in beam):
        ledger, moving = with_process_noise(ledger, base, 1)
        if not moving and base.effects:
            # A slow gust looks like a phugoid to a search that knows no gusts.
            ledger, moving = with_process_noise(ledger, ledger.models[frozenset()], 1)
        beam = _best(ledger, [*beam, *_no_stand_in(ledger, base, beam, moving)])
    for number in range(2, ledger.problem.settings.depth + 1):
        if number == 2:
            ledger = ledger.renewed(thresholds.LEFT_FOR_ROUND)
        ledger, children = _expand_beam(ledger, beam, number)
        ledger, beam = _freer_forms(ledger, _best(ledger, children))
        if number == 2 and not any(is_white(fitted) for fitted in (*first, *beam)):
            # Rounds that went astray leave means for what has not been tried.
            # Where nothing comes near noise in any of several records, pairs are cross-validated.
            pairs: Beam = []
            if len(ledger.problem.records) == 1 or not defies(base, beam):
                ledger, pairs = pairs_at_once(ledger.renewed(thresholds.LEFT_FOR_PAIRS), base)
                if not any(is_white(fitted) for fitted in pairs):
                    ledger, crossed = crossed_pairs(ledger.renewed(thresholds.LEFT_FOR_PAIRS), base)
                    pairs = [*pairs, *crossed]
            ledger, beam = _freer_forms(ledger, _best(ledger, [*beam, *pairs]))
        if number == 2 and not any(is_white(fitted) for fitted in (*first, *beam)):
            # Process noise with one cause: only where no pair of causes does better. A cause that it hides shows once it is there.
            ledger, together = _white_with_process_noise(ledger.renewed(thresholds.LEFT_FOR_ROUND), first, 2)
            if not together:
                ledger, together = _expand_all(ledger, moving, 2)
            beam = _best(ledger, [*beam, *together])
        if not beam:
            break
    return ledger, _best_found(ledger)


def hopeless(ledger: Ledger, fitted: FittedModel) -> bool:
    """Whether a set leaves colour throughout several records, which process noise does not take in either.

    That is asked of the shortest record alone: what it does not explain there it does not explain anywhere.
    """
    problem = ledger.problem
    if len(problem.records) < 2 or has_process_noise(fitted.system) or not is_coloured_throughout(fitted, thresholds.GROSSLY_COLOURED):
        return False
    values = fitted.values
    shortest = min(range(len(problem.records)), key=lambda r: len(problem.records[r]))
    data = FitData([problem.records[shortest]], [problem.masks[shortest]], problem.model, problem.outputs)
    start = Start(Values(values.shared, (values.own[shortest],), (values.states[shortest],)))
    for effect in problem.candidates:
        if isinstance(effect, NoiseEffect):
            moved = fit_set(data, (*fitted.effects, effect), problem.roughly, start)
            if moved is not None and is_white(moved, thresholds.GROSSLY_COLOURED):
                return False
    return True


def extended(ledger: Ledger, root: FittedModel, fitted: FittedModel) -> tuple[Ledger, FittedModel]:
    """A set that was found by other means, extended like those of the search, with half of its means anew."""
    settings = ledger.problem.settings
    ledger = ledger.renewed(0.5)
    ledger = ledger.kept(fitted, ledger.score(root) - gain(root, fitted, settings.accept))
    ledger, best = freer_form(ledger, ledger.known(fitted))
    while len(best.foreground) < settings.depth and not is_white(best):
        number = len(best.foreground) + 1
        # Process noise first: one fit tells whether it is all that is missing.
        ledger, children = _white_with_process_noise(ledger, [best], number)
        if not children:
            ledger, children = expand(ledger, best, number)
        if not children:
            break
        ledger, best = freer_form(ledger, min(children, key=ledger.score))
    return ledger, best


def _no_stand_in(ledger: Ledger, base: FittedModel, beam: Sequence[FittedModel], moving: Sequence[FittedModel]) -> Beam:
    """Sets with process noise that leave noise, or bring so much more than the best cause that they are no substitute for one."""
    most = max((ledger.score(base) - ledger.score(fitted) for fitted in beam), default=0.0)
    return [moved for moved in moving if is_white(moved) or ledger.score(base) - ledger.score(moved) > thresholds.DOMINANT * most]


def _expand_beam(ledger: Ledger, beam: Sequence[FittedModel], number: int) -> tuple[Ledger, Beam]:
    """Children of the sets of a beam, those of the best alone where nothing is missing from it."""
    children: Beam = []
    for place, fitted in enumerate(beam):
        ledger, found = expand(ledger, fitted, number)
        children += found
        if place == 0 and (is_white(fitted) if not found else has_process_noise(fitted.system) and any(is_white(child) for child in found)):
            break
    return ledger, children


def _expand_all(ledger: Ledger, sets: Sequence[FittedModel], number: int) -> tuple[Ledger, Beam]:
    children: Beam = []
    for fitted in sets:
        ledger, found = expand(ledger, fitted, number)
        children += found
    return ledger, children


def _white_with_process_noise(ledger: Ledger, sets: Sequence[FittedModel], number: int) -> tuple[Ledger, Beam]:
    """The sets with process noise, as far as that leaves noise."""
    white: Beam = []
    for fitted in sets:
        ledger, moved = with_process_noise(ledger, fitted, number)
        white += [other for other in moved if is_white(other)]
    return ledger, white


def _freer_forms(ledger: Ledger, sets: Sequence[FittedModel]) -> tuple[Ledger, Beam]:
    """The sets of a beam, the best first, in freer forms; what is far behind one that leaves noise stays, since noise is all that is left to win."""
    out: Beam = []
    for fitted in sets:
        behind = ledger.score(fitted) - ledger.score(out[0]) if out else 0.0
        if out and behind > ledger.problem.settings.wide and is_white(out[0]):
            out.append(fitted)
            continue
        ledger, freer = freer_form(ledger, fitted)
        out.append(freer)
    return ledger, out


def _best(ledger: Ledger, sets: Sequence[FittedModel]) -> Beam:
    """The best different sets, as many as the beam is wide."""
    unique = {frozenset(fitted.names): fitted for fitted in sets}
    return sorted(unique.values(), key=ledger.score)[: ledger.problem.settings.beam]


def _best_found(ledger: Ledger) -> FittedModel:
    """The set of lowest score; where that leaves no noise, the best of those that do.

    Scores of events and of process noise do not compare: unevenness is charged to the one only.
    """
    least = ledger.problem.settings.white
    best = min(ledger.models.values(), key=ledger.score)
    if is_white(best, least):
        return best
    white = [fitted for fitted in ledger.models.values() if is_white(fitted, least) and not fitted.guards]
    return min(white, key=ledger.score, default=best)
