"""Pseudo-true values: what a model tends to on flights of one kind when no sensor noise is left, with all the small causes that it lacks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scenarios.preparation.airspeed import with_flow
from scenarios.standin.drawing import Drawn
from scenarios.standin.fitting import declared_model, estimated, fitted
from scenarios.standin.flying import fly_drawn
from sim.effect import Effect, Regularity
from sim.effects.library import find_effect

# Of random forcing, isolated samples and what belongs to one record, nothing carries over to other flights.
_OF_ONE_RECORD = (Regularity.PROCESS_NOISE, Regularity.OUTLIER)


@dataclass(frozen=True)
class PseudoTrue:
    """Values by parameter name (SI), with standard errors for the number of draws, and the nominal derivatives."""

    values: Mapping[str, float]
    std: Mapping[str, float]
    nominal: Mapping[str, float]

    def bias(self, name: str) -> float:
        """Pseudo-true minus nominal, as a share of the nominal value."""
        return (self.values[name] - self.nominal[name]) / abs(self.nominal[name])


def pseudo_true(
    drawn: Drawn, effects: Mapping[str, Mapping[str, float]], draws: int, rng: np.random.Generator, count: int | None = None
) -> PseudoTrue:
    """Fit the declared model with effects to many flights of the same plan.

    Each draw has its own gusts, thrust, masses, trims and noise of the elevator's record, and no sensor noise. Its records are
    fitted together; draws are joined by their information, which for the many that are wanted is the fit to all at once.

    Parameters
    ----------
    effects : what the model has beyond the derivatives, by name with local values to start from (empty for the hidden ones, which start
        from the truth). Effects that random forcing, isolated samples or one record make are left out.
    draws : at least two. count : how many of the plan's records are fitted, all when None.
    """
    added = [item for item in (_effect(drawn, name, values) for name, values in effects.items()) if item is not None]
    nominal = {name: drawn.declared.parameters[name].value for name in drawn.starts}
    model = declared_model(drawn.declared, nominal, added)
    estimates = []
    for generator in rng.spawn(max(2, draws)):
        # A speed that is recorded is used here as it is in a diagnosis.
        wider, records = with_flow(model, [flown.record for flown in fly_drawn(drawn, generator, noise=False, count=count)])
        estimates.append(estimated(fitted(records, wider)))
    values, weights = [e.values for e in estimates], [np.linalg.inv(e.covariance) for e in estimates]
    joined = np.linalg.solve(np.sum(weights, axis=0), np.sum([w @ v for w, v in zip(weights, values, strict=True)], axis=0))
    std = np.std(values, axis=0, ddof=1) / np.sqrt(len(values))
    names = estimates[0].names
    return PseudoTrue(dict(zip(names, joined.tolist(), strict=True)), dict(zip(names, std.tolist(), strict=True)), nominal)


def _effect(drawn: Drawn, name: str, values: Mapping[str, float]) -> tuple[Effect, Mapping[str, float]] | None:
    for dominant in drawn.hidden:
        if dominant.name == name:
            return (dominant.effect, dominant.values) if len(dominant.records) == len(drawn.maneuvers) and name != "speed-variation" else None
    effect = find_effect(name, drawn.declared.equations)
    if effect.regularity in _OF_ONE_RECORD or getattr(effect, "per_record", False):
        return None
    # Curves are declared over the range that a search saw; elsewhere their shapes are others, and start from none.
    return effect, (dict(effect.absent) if hasattr(effect, "low") else values)
