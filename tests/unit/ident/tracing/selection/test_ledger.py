"""A ledger keeps the better of two fits, and only those of its own samples."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.diagnosis import Candidate
from ident.tracing.selection import refitting
from ident.tracing.selection.criterion import gain
from ident.tracing.selection.ledger import Ledger
from ident.tracing.selection.refitting import refitted
from sim.effects.sensor_path.sensor_lag import SensorLag
from tests.searches import FEW, LAG, found_by
from tests.tracing_problem import fit_of, planted, problem_of


def test_the_better_of_two_fits_of_a_set_is_kept() -> None:
    """By its criterion: scores charge each what it leaves uneven, so that the better fit may have the higher one."""
    problem = problem_of([planted()])
    root = fit_of(problem)
    better, worse = replace(root, criterion=root.criterion - 8.0), replace(root, criterion=root.criterion + 8.0)
    ledger = Ledger(problem).kept(root, 10.0)
    assert ledger.kept(worse, 5.0).known(root) is root and ledger.kept(worse, 5.0).score(root) == 10.0
    assert ledger.kept(better, 20.0).known(root) is better and ledger.kept(better, 20.0).score(root) == 10.0
    assert ledger.kept(better, 5.0).score(root) == 5.0
    # A stage returns a ledger; the one it was given is as it was.
    assert ledger.known(root) is root and ledger.score(root) == 10.0


def holed(problem: TraceProblem) -> list[np.ndarray]:
    """Masks without twenty samples of q."""
    masks = [mask.copy() for mask in problem.masks]
    masks[0][1, 100:120] = False
    return masks


def test_no_model_that_was_fitted_to_other_samples_enters_a_ledger() -> None:
    problem = problem_of([planted([SensorLag("q")], LAG)], FEW)
    root, other = fit_of(problem), problem.with_masks(holed(problem))
    with pytest.raises(ValueError, match="the declared model was fitted to other samples"):
        Ledger(other).kept(root, root.criterion)
    again = fit_of(other)
    assert Ledger(other).kept(again, again.criterion).known(again) is again
    with pytest.raises(ValueError, match="other samples"):
        Ledger(problem).kept(again, again.criterion)
    # Other records of the same masks are other samples, too.
    with pytest.raises(ValueError, match="other samples"):
        Ledger(replace(problem, records=[planted([SensorLag("q")], LAG, 2)])).kept(root, root.criterion)


def test_other_masks_leave_no_stale_candidate() -> None:
    """All sets of a search are there again, each fitted to the new samples, with scores that a search on them would have given."""
    ledger, _, best = found_by([planted([SensorLag("q")], LAG)])
    masks = holed(ledger.problem)
    fresh = refitted(ledger, masks, best)
    assert fresh is not None
    assert fresh.models.keys() == ledger.models.keys() and fresh.scores.keys() == fresh.models.keys()
    for fitted in fresh.models.values():
        np.testing.assert_array_equal(fitted.fit.layout.problems[0].valid, masks[0])
        assert int(fitted.fit.counts.sum()) == int(masks[0].sum())
    declared = fresh.models[frozenset()]
    assert fresh.score(declared) == declared.criterion
    one = fresh.known(best)
    assert fresh.score(one) == pytest.approx(declared.criterion - gain(declared, one, ledger.problem.settings.accept))
    # Against a search that never saw the other masks.
    alone = problem_of(ledger.problem.records, FEW).with_masks(masks)
    assert declared.fit.cost == pytest.approx(fit_of(alone).fit.cost, abs=0.05)
    assert one.fit.cost == pytest.approx(fit_of(alone, best.effects, fit_of(alone)).fit.cost, abs=0.05)
    # Nothing counts as extended yet.
    assert fresh.expanded == frozenset() and fresh.steps[:-1] == ledger.steps and "fitted anew" in fresh.steps[-1].sentence
    # Gains are those on the new samples, and refitting spends nothing of the search's means.
    told = next(candidate for candidate in fresh.evidence if candidate.name == "sensor-lag:q")
    assert told.gain == pytest.approx(declared.fit.cost - one.fit.cost) and fresh.spent == ledger.spent


def scored(sets: dict[str, float]) -> Any:
    """A ledger of sets by their effects' letters, each with its score; the score of a model is that of its letters."""
    return SimpleNamespace(
        models={frozenset(letters): letters for letters in sets},
        score=lambda letters: sets[letters],
        problem=SimpleNamespace(settings=SimpleNamespace(accept=0.0)),
    )


@pytest.mark.parametrize(
    ("others", "parent"),
    [
        ({"": 90.0, "A": 30.0, "B": 20.0, "C": 10.0}, "B"),  # the best of its parents, of which C is none
        ({"": 90.0, "B": 20.0, "A": 30.0}, "B"),  # in whatever order
        ({"": 10.0, "A": 30.0}, "A"),  # one effect smaller, not two
        ({"": 50.0, "AC": 10.0, "ABC": 5.0, "C": 7.0}, ""),  # none was fitted: the declared model
    ],
)
def test_a_refitted_set_is_scored_from_the_best_of_its_parents(others: dict[str, float], parent: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def gained(one: str, _child: object, _accept: float) -> float:
        asked.append(one)
        return 4.0

    monkeypatch.setattr(refitting, "gain", gained)
    fitted: Any = SimpleNamespace(criterion=77.0)
    assert refitting._score(scored(others), frozenset("AB"), fitted) == others[parent] - 4.0 and asked == [parent]


def test_a_declared_model_that_is_refitted_has_its_criterion_for_a_score() -> None:
    fitted: Any = SimpleNamespace(criterion=77.0)
    assert refitting._score(scored({}), frozenset(), fitted) == 77.0


def test_evidence_on_other_samples_is_twice_the_gain_against_chi_square(monkeypatch: pytest.MonkeyPatch) -> None:
    """One parameter and 2 x 1.9207 of twice the log-likelihood: the 5 % point of chi-square; 2 x 2.9957 with two parameters."""

    def model(cost: float, added: int) -> Any:
        return SimpleNamespace(fit=SimpleNamespace(cost=cost), added=added)

    for added, gained in ((1, 1.9207294103), (2, 2.9957322736)):
        models = {frozenset("A"): model(10.0, 1), frozenset("AB"): model(10.0 - gained, 1 + added)}
        candidate = Candidate(1, ("A",), "B", 99.0, 0.9, True, True, {})
        found = refitting._gained_now(candidate, models)
        assert found.gain == pytest.approx(gained) and found.p_value == pytest.approx(0.05, rel=1e-6)
        worse = {**models, frozenset("AB"): model(11.0, 1 + added)}
        assert refitting._gained_now(candidate, worse).p_value == 1.0
