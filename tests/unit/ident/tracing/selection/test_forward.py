"""How the rounds of a forward selection are provided for, with stubs for what they do."""

from __future__ import annotations

from collections.abc import Sequence

import pytest

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.selection import forward
from ident.tracing.selection.ledger import Ledger
from sim.effects.disturbance.phugoid import Phugoid
from sim.effects.sensor_path.sensor_lag import SensorLag
from tests.tracing_problem import fit_of, planted, problem_of

Asked = tuple[str, tuple[str, ...], float]


def asked_of(monkeypatch: pytest.MonkeyPatch, ledger: Ledger, base: FittedModel) -> list[Asked]:
    """What is asked of which set, with which share of the means spent, where nothing is found."""
    asked: list[Asked] = []

    def nothing(what: str) -> object:
        def answer(ledger: Ledger, fitted: FittedModel, *_: object) -> tuple[Ledger, Sequence[FittedModel]]:
            asked.append((what, fitted.names, ledger.spent / ledger.problem.settings.budget))
            return ledger.respent(ledger.problem.settings.budget), []

        return answer

    for name in ("with_process_noise", "expand", "pairs_at_once", "crossed_pairs"):
        monkeypatch.setattr(forward, name, nothing(name))
    forward.forward_selection(ledger, base, [base])
    return asked


def test_each_round_has_means_of_its_own_and_a_gust_is_asked_without_slow_motion_too(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = problem_of([planted([SensorLag("q")], {"sensor-lag:q.time_constant": 0.2})], (SensorLag("q"),))
    root = fit_of(problem)
    base = fit_of(problem, [Phugoid()], root)
    ledger = Ledger(problem).kept(root, root.criterion).kept(base, base.criterion).respent(problem.settings.budget)
    asked = asked_of(monkeypatch, ledger, base)
    slow = (Phugoid().name,)
    assert [each[:2] for each in asked[:3]] == [("with_process_noise", slow), ("with_process_noise", ()), ("expand", slow)]
    left = {what: 1.0 - spent for what, _, spent in reversed(asked)}  # the first of each
    assert left["with_process_noise"] == pytest.approx(thresholds.LEFT_FOR_ROUND) and left["expand"] == pytest.approx(thresholds.LEFT_FOR_ROUND)
    assert left["pairs_at_once"] == left["crossed_pairs"] == pytest.approx(thresholds.LEFT_FOR_PAIRS)
