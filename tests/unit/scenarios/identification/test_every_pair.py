"""A law: each method estimates each model within four sigmas of the truth, or refuses it in one
line that says what to use instead.
"""

from __future__ import annotations

import pytest

from ident.estimate import Outcome
from scenarios.identification.identify import identify
from scenarios.identification.methods import METHODS
from sim.errors import FlightidError
from tests.every_model import MODELS, case_of

REFUSED = {
    (
        "flexible",
        "equation-error",
    ): "state eta1 is neither recorded nor the rate of a recorded state; .* use output-error",
    ("loes", "ukf"): "a pure delay has no unscented filter here; use ekf",
    ("loes", "equation-error"): "output alpha is not state alpha plus a bias; .* use output-error",
    (
        "ballistic",
        "frequency-domain",
    ): "it has no input, and therefore no frequency response; use output-error",
    (
        "multirotor",
        "frequency-domain",
    ): "actuator-lag:roll_command, .* act on the input or sensor path; use output-error",
    (
        "longitudinal",
        "frequency-domain",
    ): "the rate of airspeed is no linear function of states and inputs: .*; use output-error",
}
# Still air has no process noise: its size ends at nothing, which no record determines; the rest of
# the estimate is sound and the caution says so.
NOTHING_TO_FIND = {("ballistic", "filter-error"), ("own", "filter-error")}
QUICK = ("output-error", "frequency-domain")
QUICK_PAIRS = [("multirotor", "equation-error")]
# by tests/unit/scenarios/identification/test_whole_axes.py, in the default suite
COVERED = ("lateral", "longitudinal")
DEAR = ("flexible",)
PAIRS = [(model, method) for model in MODELS for method in METHODS]
SERVED = [
    pytest.param(
        *pair,
        marks=()
        if pair in QUICK_PAIRS or (pair[1] in QUICK and pair[0] not in (*COVERED, *DEAR))
        else pytest.mark.slow,
    )
    for pair in PAIRS
    if pair not in REFUSED
]


@pytest.mark.sampled
@pytest.mark.parametrize(("model", "method"), SERVED)
def test_a_method_that_serves_finds_the_truth(model: str, method: str) -> None:
    case = case_of(model)
    found = identify(case.record, case.vehicle, method)
    if (model, method) in NOTHING_TO_FIND:
        assert (
            found.estimate.outcome in (Outcome.NOT_IDENTIFIABLE, Outcome.MAX_ITERATIONS)
            and found.cautions
        )
    else:
        assert found.estimate.outcome is Outcome.CONVERGED, found.estimate.outcome
    off = {
        row.name: (row.estimate - case.true[row.name]) / row.std
        for row in found.rows
        if row.name in case.true
    }
    assert set(off) == set(case.true) and max(map(abs, off.values())) < 4.0, off
    figures = found.fits[0].figures
    assert figures is not None and min(map(figures.fit_percent, figures.rmse)) > 50.0


def test_filter_error_serves_a_model_without_inputs() -> None:
    case = case_of("ballistic")
    found = identify(case.record, case.vehicle, "filter-error")
    assert found.estimate.outcome is Outcome.NOT_IDENTIFIABLE and found.cautions
    for row in found.rows:
        if row.name in case.true:
            assert abs(row.estimate - case.true[row.name]) < 4.0 * row.std


@pytest.mark.sampled
@pytest.mark.parametrize(("model", "method"), list(REFUSED))
def test_a_method_that_does_not_serve_says_so_in_one_line(model: str, method: str) -> None:
    case = case_of(model)
    with pytest.raises(FlightidError, match=REFUSED[model, method]) as refusal:
        identify(case.record, case.vehicle, method)
    assert "\n" not in str(refusal.value)
