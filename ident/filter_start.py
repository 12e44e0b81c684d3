"""Where a parameter-estimating filter starts: prior deviations as a share of the starting values."""

from __future__ import annotations

from collections.abc import Mapping

from sim.declaration.parameters import ParameterSet
from sim.errors import ModelError

QUARTER = 0.25


def proportional_priors(parameters: ParameterSet, engineering: Mapping[str, float], share: float = QUARTER) -> ParameterSet:
    """Free parameters with a prior standard deviation of ``share`` times the starting value, or the engineering value given.

    The rule of NASA TM-101722: P0 = (x0/4)^2, and for states that start at or near zero a bound by engineering judgement.

    Parameters
    ----------
    engineering : standard deviations by name; it overrides the share, and may name what is not free.

    Raises
    ------
    ModelError : a free parameter that starts at zero without an engineering value.
    """
    priors = {}
    for item in parameters:
        if not item.free:
            continue
        priors[item.name] = engineering.get(item.name, share * abs(item.value))
        if not priors[item.name] > 0:
            raise ModelError("it starts at zero, and has no share", where=f"parameter {item.name}", remedy="give its standard deviation")
    return parameters.with_prior(priors)
