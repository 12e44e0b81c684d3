"""What a set of effects does to the derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from ident.tracing.belief.derivatives import contradicts, declared_derivatives, derivatives_of, wild, wrecked
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity
from ident.whole_record.output_error import estimate_of
from tests.tracing_problem import fit_of, planted, problem_of


@pytest.fixture(scope="module")
def root() -> FittedModel:
    return fit_of(problem_of([planted()]))


def moved(fitted: FittedModel, values: Mapping[str, float], blur: float = 1.0) -> FittedModel:
    """The same fit with other values, and its sensitivities to these ``blur`` times smaller: sigmas grow by that."""
    theta, at = fitted.fit.theta.copy(), [fitted.fit.layout.names.index(name) for name in values]
    theta[at] = list(values.values())
    jacobians = []
    for jacobian in fitted.fit.jacobians:
        changed = jacobian.copy()
        changed[:, :, at] /= blur
        jacobians.append(changed)
    weighted = replace(fitted.fit.weighted, jacobians=tuple(jacobians))
    return replace(fitted, fit=replace(fitted.fit, theta=theta, weighted=weighted))


@pytest.mark.parametrize(
    ("value", "std", "against"),
    [(0.4, 0.1, False), (-0.1, 0.1, False), (-0.3, 0.1, True), (1.4, 0.15, False), (1.6, 0.15, True), (0.0, 1e-9, False)],
)
def test_two_sigmas_have_to_leave_the_declared_sign_and_three_times_the_value(value: float, std: float, against: bool) -> None:
    for sign in (1.0, -1.0):
        assert contradicts(Quantity(sign * value, std, "1/rad"), sign * 0.4) is against


def test_values_and_sigmas_are_those_that_are_reported(root: FittedModel) -> None:
    estimate = estimate_of(root.fit)
    found = derivatives_of(root)
    for name in ("CL_alpha", "Cm_q", "Cm_de"):
        assert (found[name].value, found[name].std) == pytest.approx((estimate.value(name), estimate.sigma(name)))
    assert not any(name.startswith("bias_") for name in declared_derivatives(root))


def test_nothing_is_ruined_by_small_changes(root: FittedModel) -> None:
    assert wrecked(root, root) == [] and wild(root) == []
    declared = declared_derivatives(root)
    assert wrecked(root, moved(root, {"Cm_alpha": 1.5 * declared["Cm_alpha"]})) == []


@pytest.mark.parametrize(
    ("share", "why"), [(-1.0, "turns its sign"), (3.5, "grows more than threefold"), (-5.0, "is far from"), (9.0, "is far from")]
)
def test_a_derivative_that_turns_or_grows_is_ruined(root: FittedModel, share: float, why: str) -> None:
    best = moved(root, {"Cm_alpha": share * declared_derivatives(root)["Cm_alpha"]})
    (found,) = wrecked(root, best)
    assert found.name == "Cm_alpha" and found.why.startswith(why)
    assert (wild(best) == ["Cm_alpha"]) is (why == "is far from")


def test_what_contradicted_the_file_already_is_not_laid_to_the_effects(root: FittedModel) -> None:
    turned = -1.2 * declared_derivatives(root)["Cm_alpha"]
    assert wrecked(moved(root, {"Cm_alpha": turned}), moved(root, {"Cm_alpha": turned})) == []


def test_what_comes_nearer_to_the_file_is_not_laid_to_the_effects(root: FittedModel) -> None:
    """It had the wrong sign before, within its sigma; what explains the records leaves less of that, and less sigma."""
    value = declared_derivatives(root)["CL_q"]
    before = moved(root, {"CL_q": -3.0 * value}, blur=100.0)
    assert not contradicts(derivatives_of(before)["CL_q"], value)
    assert contradicts(derivatives_of(moved(root, {"CL_q": -1.5 * value}))["CL_q"], value)
    assert [wreck.name for wreck in wrecked(before, moved(root, {"CL_q": -1.5 * value}))] == []
    assert [wreck.name for wreck in wrecked(before, moved(root, {"CL_q": -3.5 * value}))] == ["CL_q"]
    above = moved(root, {"CL_q": 3.4 * value}, blur=100.0)
    assert [wreck.name for wreck in wrecked(above, moved(root, {"CL_q": -0.9 * value}))] == ["CL_q"]


def test_a_derivative_of_which_nothing_is_known_any_more_is_ruined(root: FittedModel) -> None:
    value = derivatives_of(root)["Cm_de"].value
    blurred = moved(root, {"Cm_de": value}, blur=1e5)
    assert np.isfinite(derivatives_of(blurred)["Cm_de"].std)
    (found,) = wrecked(root, blurred)
    assert (found.name, found.why) == ("Cm_de", "is no longer known")
