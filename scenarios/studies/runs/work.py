"""The runs of a campaign as tasks: each run flown and measured with its own seed, estimated by one method, a row of numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from scenarios.studies.declaration import Estimation, Scenario, seen_by
from scenarios.studies.estimating import assumed_noise, declared_model, flight_constants
from scenarios.studies.flying import fly_scenario, measured_again
from scenarios.studies.runs.batch import Estimates, batched, is_batched, one_by_one
from scenarios.studies.runs.identity import identity_of
from scenarios.studies.study import references
from scenarios.tasks.work import Row, Task
from sim.declaration.model import Model
from sim.record import Record
from sim.truth.flight import Truth, remeasure

ESTIMATE, SIGMA = "estimate:", "sigma:"  # what stands before a parameter's name in a column
SOUND = "converged"
CHUNK, FEW = 500, 4  # runs of one block: of a batch enough to fill the vector units, little enough for the cache; of other methods


class _Common(NamedTuple):
    """What all runs share."""

    model: Model
    record: Record
    truth: Truth
    reference: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class EstimatorRuns:
    """Runs of ``scenario`` by its method ``estimation``.

    ``again`` : makes the scenario anew from what can be sent to another process, where it holds functions of a user's own file, which cannot.
    """

    scenario: Scenario
    estimation: Estimation
    again: Rebuilt | None = None

    quick = True

    @property
    def name(self) -> str:
        return f"campaign of {self.scenario.name} by {self.estimation.name}"

    @cached_property
    def seen(self) -> Scenario:
        """The scenario with the flight that this method sees."""
        return seen_by(self.scenario, self.estimation)

    @cached_property
    def parameters(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return tuple(item.name for item in self.common.model.parameters if item.free)

    @property
    def columns(self) -> Mapping[str, str]:
        sizes = {f"{kind}{name}": "float" for name in self.parameters for kind in (ESTIMATE, SIGMA)}
        return {"outcome": "text", **sizes, "nees": "float", "nis": "float", "degrees": "int"}

    @property
    def block(self) -> int:
        return CHUNK if is_batched(self.estimation, bool(self.seen.flight.feedback)) else FEW

    def identity(self) -> Mapping[str, Any]:
        return identity_of(self.seen, self.estimation)

    @cached_property
    def common(self) -> _Common:
        """The truth flown once, the declared model, and what each parameter is compared with.

        Raises FlightidError where something is declared that cannot be flown or estimated.
        """
        record, truth = fly_scenario(self.seen, self.scenario.seed)
        model = self.declared(self.estimation)
        reference = {**{item.name: item.value for item in truth.parameters}, **references(self.seen, self.estimation)}
        return _Common(model, record, truth, reference)

    def run(self, tasks: Sequence[Task]) -> Sequence[Row | str]:
        """One row a run. Where process noise really acts or measured outputs are fed back every run is flown anew, else measured again."""
        found = self.estimated(self.estimation, [self.record_of(task.seed) for task in tasks])
        std = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2).T, 0.0))
        error = found.values - np.array([[self.common.reference[name]] for name in found.names])
        rows: list[Row | str] = []
        for at in range(len(tasks)):
            cells = {f"{ESTIMATE}{name}": float(found.values[i, at]) for i, name in enumerate(found.names)}
            cells |= {f"{SIGMA}{name}": float(std[i, at]) for i, name in enumerate(found.names)}
            finite = all(np.isfinite(list(cells.values())))
            outcome = found.outcomes[at] if finite else "diverged"
            sound = outcome == SOUND
            rows.append(
                {
                    "outcome": outcome,
                    **(cells if finite else dict.fromkeys(cells)),
                    "nees": _nees(error[:, at], found.covariance[at]) if sound else None,
                    "nis": float(found.nis[at]) if sound else None,
                    "degrees": int(found.degrees[at]) if sound else 0,
                }
            )
        return rows

    def estimated(self, estimation: Estimation, records: Sequence[Record]) -> Estimates:
        """Records of this work by its method or by a changed one."""
        model = self.common.model if estimation is self.estimation else self.declared(estimation)
        return batched(estimation, records, model) if self.block == CHUNK else one_by_one(estimation, records, model)

    def declared(self, estimation: Estimation) -> Model:
        """The model that a method starts from."""
        return declared_model(estimation, flight_constants(self.seen.flight, estimation), assumed_noise(self.seen, estimation))

    def record_of(self, seed: int) -> Record:
        """What a run measured, by its seed."""
        record, truth, noise = self.common.record, self.common.truth, self.estimation.flown_noise_std
        if self.seen.flight.process_noise or self.seen.flight.feedback:
            record, truth = fly_scenario(self.seen, seed)
            return measured_again(record, truth, noise, seed) if noise else record
        return measured_again(record, truth, noise, seed) if noise else remeasure(record, truth, np.random.default_rng(seed))

    def __reduce__(self) -> tuple[Callable[..., EstimatorRuns], tuple[Any, ...]]:
        if self.again is None:
            return EstimatorRuns, (self.scenario, self.estimation)
        return _rebuilt, (self.again, self.estimation.name)


@dataclass(frozen=True)
class Rebuilt:
    """A scenario by the content of its file: ``scenario_of`` makes it of these, and reads the user's model file that it names."""

    document: Mapping[str, Any]
    name: str
    where: str

    def scenario(self) -> Scenario:
        """Made anew. Raises DeclarationError."""
        from scenarios.studies.scenario_file.reading import scenario_of

        return scenario_of(self.document, self.name, self.where)


def _rebuilt(again: Rebuilt, method: str) -> EstimatorRuns:
    scenario = again.scenario()
    return EstimatorRuns(scenario, next(each for each in scenario.estimations if each.name == method), again)


def _nees(error: np.ndarray, covariance: np.ndarray) -> float | None:
    """Normalised estimation error squared; None where the covariance has no inverse."""
    scale = np.sqrt(np.diagonal(covariance))
    if not np.all(scale > 0.0):
        return None
    try:
        return float((error / scale) @ np.linalg.solve(covariance / np.outer(scale, scale), error / scale))
    except np.linalg.LinAlgError:
        return None
