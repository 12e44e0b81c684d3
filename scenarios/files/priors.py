"""How well starting values are known before a record: half of each, since files may be 30 % wrong."""

from __future__ import annotations

from collections.abc import Sequence

from sim.declaration.model import Model

RELATIVE_PRIOR = 0.5
OF_TYPICAL = 0.01  # of the largest start, where one is zero


def with_priors(model: Model, free: Sequence[str]) -> Model:
    """The model with exactly the named parameters free, each with a prior standard deviation of half its starting value."""
    parameters = model.parameters.only_free(free)
    typical = max((abs(parameters[name].value) for name in free), default=1.0)
    prior = {name: RELATIVE_PRIOR * (abs(parameters[name].value) or OF_TYPICAL * typical or 1.0) for name in free}
    return model.with_parameters(parameters.with_prior(prior))
