"""A ledger keeps the better of two fits, and only those of its own samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.candidate_model.problem import TraceProblem
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
