"""Priors as a share of the start."""

from __future__ import annotations

import pytest

from ident.filters.problem import proportional_priors
from sim.declaration.effect import Parameter, ParameterSet
from sim.errors import ModelError

SET = ParameterSet((Parameter("a", -8.0), Parameter("b", 0.0), Parameter("c", 2.0, free=False)))


def test_a_quarter_and_engineering_values() -> None:
    out = proportional_priors(SET, {"b": 0.1})
    assert (out["a"].prior_std, out["b"].prior_std, out["c"].prior_std) == (2.0, 0.1, float("inf"))
    assert proportional_priors(SET, {"a": 1.0, "b": 0.1})["a"].prior_std == 1.0


def test_zero_start_without_engineering_value_is_named() -> None:
    with pytest.raises(ModelError, match="parameter b"):
        proportional_priors(SET, {})
