"""Problems for the tracing loop: the rigid aircraft with planted effects, cheap to fit (10 s at 50
Hz).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.tracing.diagnosis import TraceSettings
from ident.tracing.fitted_model import FittedModel
from ident.tracing.problem import TraceProblem
from ident.tracing.wrong_samples import measured_masks
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.effects.library import effects_for
from sim.record import Channel, Record
from sim.truth.measurement import coloured_noise
from tests.bases import Flight, rigid_flight, rigid_model
from tests.rigid_problem import noisy

OUTPUTS = ("alpha", "q", "nz")
LATE, ARM = "sensor-delay:alpha", "vane-offset"
FEW = (
    LATE,
    ARM,
    "sensor-scale:q",
    "sensor-step:q",
    "input-deadband",
    "phugoid",
    "gust-turbulence",
)
SETTINGS = TraceSettings(max_step=0.02)


def declared() -> Model:
    """What the search knows: the rigid aircraft, its derivatives free, one bias an output."""
    return rigid_model().with_biases(OUTPUTS)


def doublets(duration: float = 10.0, rate: float = 50.0, size: float = 0.06) -> Flight:
    """A 3-2-1-1, then doublets of half its size: two amplitudes, and the motion never dies out."""
    flight = rigid_flight(duration, rate)
    extra = np.where(flight.time % 3.0 < 0.5, 1.0, np.where(flight.time % 3.0 < 1.0, -1.0, 0.0))
    return Flight(flight.time, size / 0.1 * (flight.u + 0.05 * extra), max_step=0.02)


def planted(
    effects: Sequence[Traceable] = (),
    values: Mapping[str, float] | None = None,
    seed: int = 1,
    *,
    flight: Flight | None = None,
    scale: float = 1.0,
) -> Record:
    """A record of the rigid aircraft with effects at given values (full names)."""
    model = rigid_model().with_effects(*effects).with_values(values or {})
    return noisy(model, flight or doublets(), np.random.default_rng(seed), scale=scale)


def problem_of(
    records: Sequence[Record],
    candidates: Sequence[Traceable] = (),
    settings: TraceSettings = SETTINGS,
    model: Model | None = None,
) -> TraceProblem:
    """What a search works on, every measured sample in it."""
    outputs = [name for name in OUTPUTS if any(name in record.output_names for record in records)]
    return TraceProblem(
        records,
        measured_masks(records, outputs),
        model or declared(),
        tuple(candidates),
        outputs,
        settings,
    )


def fit_of(
    problem: TraceProblem,
    effects: Sequence[Traceable] = (),
    start: FittedModel | None = None,
    added: Mapping[str, float] | None = None,
) -> FittedModel:
    """A fit that has to work."""
    fitted = problem.fit(effects, start, added)
    assert fitted is not None
    return fitted


def with_output(record: Record, name: str, values: np.ndarray) -> Record:
    """A record with one output replaced; NaN marks missing samples."""
    outputs = tuple(
        Channel.of(name, c.unit, values) if c.name == name else c for c in record.outputs
    )
    return replace(record, outputs=outputs)


def part(record: Record, rows: slice) -> Record:
    """Some rows of a record, under its name."""
    inputs, outputs = (
        tuple(replace(c, values=c.values[rows], valid=c.valid[rows]) for c in group)
        for group in (record.inputs, record.outputs)
    )
    return replace(record, time=record.time[rows], inputs=inputs, outputs=outputs)


def without_output(record: Record, name: str) -> Record:
    return replace(record, outputs=tuple(c for c in record.outputs if c.name != name))


def coloured(record: Record, seed: int, size: float = 1.0) -> Record:
    """The record with noise added that remembers itself for 0.3 s and is, at size one, one to three
    times as large as the white one.
    """
    rng = np.random.default_rng((seed, 7))
    for name, std in (("alpha", 0.002), ("q", 0.003), ("nz", 0.03)):
        record = with_output(
            record, name, record[name].values + coloured_noise(rng, record.time, size * std, 0.3)
        )
    return record


def offered(records: list[Record]) -> TraceProblem:
    """Records with the effects of `FEW` on offer."""
    model = declared()
    every = effects_for(model.equations)
    few = [each for each in every if each.name in FEW and isinstance(each, Traceable)]
    return problem_of(records, few, model=model)


def effect(name: str) -> Traceable:
    """The effect of this name."""
    (found,) = [each for each in effects_for(declared().equations) if each.name == name]
    assert isinstance(found, Traceable)
    return found
