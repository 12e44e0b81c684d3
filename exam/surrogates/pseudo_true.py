"""Pseudo-true values: what a model tends to on flights of one kind when no sensor noise is left,
with all the small causes that it lacks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from exam.surrogates.fitting import declared_model
from exam.surrogates.flights.drawing import Drawn
from exam.surrogates.flights.flying import fly_draws
from exam.surrogates.joint_fit import Point, fit_together
from scenarios.preparation.measured_inputs import about_trim, with_flow
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, Regularity
from sim.declaration.proposal import RangedCurve, Traceable
from sim.effects.library import find_effect
from sim.errors import ModelError

SPEED = ("airspeed", "dynamic_pressure")
FEW = 2  # draws that a fit to many begins with
FOLD = 10  # as many again in the next one

# Of random forcing, isolated samples and what belongs to one record, nothing carries over to other
# flights.
_OF_ONE_RECORD = (Regularity.PROCESS_NOISE, Regularity.OUTLIER)


@dataclass(frozen=True)
class PseudoTrue:
    """Values by parameter name (SI), with standard errors for the number of draws, and the nominal
    derivatives.
    """

    values: Mapping[str, float]
    std: Mapping[str, float]
    nominal: Mapping[str, float]

    def bias(self, name: str) -> float:
        """Pseudo-true minus nominal, as a share of the nominal value."""
        return (self.values[name] - self.nominal[name]) / abs(self.nominal[name])


def pseudo_true(
    drawn: Drawn,
    effects: Mapping[str, Mapping[str, float]],
    draws: int,
    rng: np.random.Generator,
    count: int | None = None,
    starts: Mapping[str, float] | None = None,
) -> PseudoTrue:
    """The declared model with effects, fitted to many flights of the same plan together.

    Each draw has its own gusts, thrust, masses, trims and noise of the surfaces' records, and no
    sensor noise. Parameters are shared by all records of all draws, biases and initial states are
    each record's own; standard errors are those of the scores' scatter over draws.

    Parameters
    ----------
    effects : what the model has beyond the derivatives, by name with local values to start from
    (empty for the hidden ones, which start
        from the truth). Effects that random forcing, isolated samples or one record make are left
        out.
    draws : at least two. count : how many of the plan's records are fitted, all when None.
    starts : derivatives to start from, nominal where it has none: the nearer, the sooner done.

    Raises
    ------
    ModelError : no finite cost, or a fit that does not settle. numpy.linalg.LinAlgError : an
    unknown that nothing determines.
    """
    added = [
        item
        for item in (_effect(drawn, name, values) for name, values in effects.items())
        if item is not None
    ]
    nominal = {name: drawn.declared.parameters[name].value for name in drawn.starts}
    begun = {name: (starts or {}).get(name, value) for name, value in nominal.items()}
    model = declared_model(drawn.declared, begun, added)
    # Trims of the surfaces are taken off, and a speed that is recorded is used, as in a diagnosis.
    measured = drawn.axis.measured
    flown = fly_draws(drawn, rng.spawn(max(2, draws)), (*measured, *SPEED), count=count)
    wider = [with_flow(model, [about_trim(record)[0] for record in records]) for records in flown]
    system = compile_model(wider[0][0], measured)
    records = [[record.only(measured) for record in carrying] for _, carrying in wider]
    many = FEW
    joint = fit_together(records[:many], system)
    while many < len(records):
        many = min(FOLD * many, len(records))
        joint = fit_together(records[:many], system, _carried(joint.point, many, len(records[0])))
    if not joint.settled:
        raise ModelError(
            "the fit to all draws does not settle",
            where=", ".join(effects) or "no effect",
            remedy="start from other values",
        )
    std = np.sqrt(np.diag(joint.covariance))
    values = dict(zip(joint.names, joint.point.shared.tolist(), strict=True))
    return PseudoTrue(values, dict(zip(joint.names, std.tolist(), strict=True)), nominal)


def has_limit(drawn: Drawn, claimed: Iterable[str]) -> bool:
    """Whether what was claimed can be fitted to many flights: not where random forcing or what
    belongs to one record was fitted, too.

    Without it the same derivatives tend to other values. Isolated samples only set samples aside.
    """
    for name in claimed:
        effect = find_effect(name, drawn.declared.equations)
        if effect.regularity is Regularity.OUTLIER:
            continue
        if effect.regularity is Regularity.PROCESS_NOISE or _effect(drawn, name, {}) is None:
            return False
    return True


def _carried(point: Point, draws: int, records: int) -> Point:
    """A start for many draws: in each the biases, initial states and trajectories of the first
    one's ``records``, whose maneuvers they share.
    """
    return Point(
        point.shared, np.tile(point.own[:records], (draws, 1)), point.states[:records] * draws
    )


def _effect(
    drawn: Drawn, name: str, values: Mapping[str, float]
) -> tuple[Effect, Mapping[str, float]] | None:
    for dominant in drawn.hidden:
        if dominant.name == name:
            return (
                (dominant.effect, dominant.values)
                if len(dominant.records) == len(drawn.maneuvers) and name != "speed-variation"
                else None
            )
    effect = find_effect(name, drawn.declared.equations)
    if effect.regularity in _OF_ONE_RECORD or (
        isinstance(effect, Traceable) and effect.traits.per_record
    ):
        return None
    # Curves are declared over the range that a search saw; elsewhere their shapes are others, and
    # start from none.
    return effect, (dict(effect.absent) if isinstance(effect, RangedCurve) else values)
