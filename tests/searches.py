"""Searches of the tracing loop over a few candidates, cheap enough for a test."""

from __future__ import annotations

from collections.abc import Sequence

from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.selection.backward import backward_elimination, refined
from ident.tracing.selection.forward import first_round, forward_selection
from ident.tracing.selection.ledger import Ledger
from sim.declaration.proposal import Traceable
from sim.effects.disturbance.unmeasured_input import UnmeasuredInput
from sim.effects.sensor_path.sensor_lag import SensorLag
from sim.effects.sensor_path.sensor_scale import SensorScale
from sim.record import Record
from tests.tracing_problem import fit_of, problem_of

LAG = {"sensor-lag:q.time_constant": 0.06}
FEW: tuple[Traceable, ...] = (SensorScale("q"), SensorScale("nz"), SensorLag("alpha"), SensorLag("q"), UnmeasuredInput())


def searched(problem: TraceProblem, root: FittedModel) -> tuple[Ledger, FittedModel]:
    """Forward selection from the declared model."""
    ledger, first = first_round(Ledger(problem), root)
    return forward_selection(ledger, root, first)


def found_by(records: Sequence[Record], candidates: Sequence[Traceable] = FEW) -> tuple[Ledger, FittedModel, FittedModel]:
    """A ledger, the declared model and the set that a search ends with."""
    problem = problem_of(records, candidates)
    root = fit_of(problem)
    ledger, best = refined(*backward_elimination(*searched(problem, root)))
    return ledger, root, best
