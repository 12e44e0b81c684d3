"""Small real results that the figures' tests share: a rigid aircraft and a falling body, flown and
identified.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from ident.estimate import Estimate, FilterHistory
from ident.filters.ekf import FilterSettings, run_ekf
from ident.filters.one_record import Taylor
from sim.declaration.compile import compile_model
from sim.declaration.effect import ParameterSet
from sim.declaration.model import Model
from sim.maneuvers import three_two_one_one
from sim.propagation import euler_step
from sim.record import Record
from sim.truth.flight import Truth, fly, sample_times
from sim.truth.measurement import Measurement
from tests.bases import ballistic_model, rigid_model


@dataclass(frozen=True, eq=False)
class Study:
    """A flight and what a filter made of it."""

    record: Record
    truth: Truth
    estimate: Estimate

    @property
    def history(self) -> FilterHistory:
        assert self.estimate.history is not None
        return self.estimate.history


def started(model: Model, factor: float, prior: float, state_std: tuple[float, float]) -> Model:
    """The model with its free parameters off by a factor, priors in proportion and an uncertain
    initial state.
    """
    free = [item for item in model.parameters if item.free]
    parameters = model.parameters.with_values({item.name: factor * item.value for item in free})
    initial = ParameterSet(
        tuple(
            replace(item, prior_std=std) for item, std in zip(model.initial, state_std, strict=True)
        )
    )
    return model.with_parameters(
        parameters.with_prior({item.name: prior * abs(item.value) for item in free})
    ).with_initial(initial)


@pytest.fixture(scope="package")
def rigid() -> Study:
    """A 3-2-1-1 of 6 s at 25 Hz; a tenth of the samples of alpha is missing."""
    model = rigid_model()
    maneuver = three_two_one_one(0.1, 0.5, 1.0)
    record, truth = fly(
        model,
        maneuver,
        sample_times(25.0, 6.0),
        np.random.default_rng(3),
        outputs=("alpha", "q"),
        step=0.01,
        measurement=Measurement(missing={"alpha": 0.1}),
    )
    system = compile_model(started(model, 1.2, 0.5, (0.01, 0.01)), ("alpha", "q"), online=True)
    return Study(record, truth, run_ekf(record, system))


@pytest.fixture(scope="package")
def broken(rigid: Study) -> Study:
    """The same record and a filter that breaks down at once: its start is absurd."""
    model = started(rigid_model({**rigid_values(), "Cm_alpha": 1e12}), 1.0, 0.5, (0.01, 0.01))
    return Study(
        rigid.record,
        rigid.truth,
        run_ekf(rigid.record, compile_model(model, ("alpha", "q"), online=True)),
    )


@pytest.fixture(scope="package")
def falls() -> dict[str, Study]:
    """A fall of 15 s at 10 Hz, filtered with each Taylor order."""
    model = ballistic_model()
    record, truth = fly(model, None, sample_times(10.0, 15.0), np.random.default_rng(4), step=0.02)
    system = compile_model(started(model, 1.3, 0.4, (7.6, 45.0)), online=True)
    settings = {
        f"{terms} Taylor terms": FilterSettings(step=euler_step, transition=Taylor(terms))
        for terms in (2, 3)
    }
    return {
        label: Study(record, truth, run_ekf(record, system, setting))
        for label, setting in settings.items()
    }


def rigid_values() -> dict[str, float]:
    return {item.name: item.value for item in rigid_model().parameters}
