"""A screening by two processes finds what one finds, in the same order, and tells what overflowed
in either.
"""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

from ident.tracing import thresholds
from ident.tracing.screening import score_test
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import Finding, screen
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for
from sim.effects.sensor_path.sensor_delay import SensorDelay
from tests.tracing_problem import fit_of, planted, problem_of

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="no fork that is safe beside threads"
)


@pytest.fixture(autouse=True)
def spare(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests may run in a worker, or on one processor, where no fork is made."""
    monkeypatch.setattr("ident.background_task.spare_processor", lambda: True)


def screened(monkeypatch: pytest.MonkeyPatch, worth: float) -> list[Finding]:
    monkeypatch.setattr(thresholds, "WORTH_A_FORK", worth)
    late = SensorDelay("q")
    problem = problem_of([planted([late], {f"{late.name}.delay": 0.06})])
    fitted = fit_of(problem, ())
    candidates = [
        effect for effect in effects_for(fitted.model.equations) if isinstance(effect, Traceable)
    ]
    return screen(fitted, [*candidates[::4], late], search_context(fitted))


def test_two_find_what_one_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    alone, both = screened(monkeypatch, np.inf), screened(monkeypatch, 0.0)
    assert [
        (one.effect.name, one.gain, one.gains, one.starts, one.parameters) for one in alone
    ] == [(one.effect.name, one.gain, one.gains, one.starts, one.parameters) for one in both]
    assert all(
        np.array_equal(one.contribution, other.contribution)
        for one, other in zip(alone, both, strict=True)
    )
    assert len(alone) > 5 and alone[0].effect.name in ("sensor-delay:q", "sensor-lag:q")


def test_what_overflows_in_the_fork_is_counted_here(monkeypatch: pytest.MonkeyPatch) -> None:
    found, counted = score_test._find, []

    def overflowing(*given: object) -> Finding | None:
        np.float64(1e308) * np.float64(10.0)
        return found(*given)  # type: ignore[arg-type]

    monkeypatch.setattr(score_test, "_find", overflowing)
    with np.errstate(over="call", call=lambda kind, flag: counted.append((kind, os.getpid()))):
        tried = len(screened(monkeypatch, 0.0))
    assert len([one for one in counted if one == ("overflow", os.getpid())]) >= tried
