"""Types of a diagnosis of files, its model as the study folder keeps it, and overflows counted
during a search.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ident.flying_qualities.levels import FlightPhase
from ident.tracing.diagnosis import Data, Diagnosis
from ident.tracing.settings import NORMAL, TraceSettings
from scenarios.diagnosis.kinematics import Kinematics
from scenarios.files.declarations import STICK
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import VehicleFile
from scenarios.kept import DIAGNOSE, KeptModel, KeptReading
from scenarios.preparation.plan import ATTITUDE, LIFT, SPEED, Plan
from scenarios.preparation.recording import NOTHING_SEEN, RecordCheck
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable, Traits
from sim.record import Record

if TYPE_CHECKING:
    from scenarios.maneuver_design.design import DesignResult


@dataclass(frozen=True)
class Inputs:
    """All files that a diagnosis rests on; ``validation`` is empty where only a part of a file was
    held out, ``effects`` where none was named.

    ``model`` is the file of a user's own model, None where it is built in.
    """

    records: tuple[InputFile, ...]
    validation: tuple[InputFile, ...]
    vehicle: InputFile
    effects: tuple[InputFile, ...] = ()
    model: InputFile | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Tracing:
    """A diagnosis with what it was made from.

    ``records`` and ``validation`` are what was fitted and what was predicted; ``held_out_from`` is
    the time (s) at which the last record was cut, None where whole records were predicted.
    ``explanations`` and ``traits`` of the candidates by name. ``notes`` say how the records were
    prepared, one sentence each; ``doubts`` what in the files is likely to be wrong. ``kinematics``:
    what the records say without any aerodynamics, None where it was not asked. ``look``: what their
    raw columns show. ``overflows``: computations of the loop that left the range of numbers, and
    were left out. ``plan``: how the records were to be read. ``effort``: how far the search looked.
    ``flown``: by which class and category levels of flying qualities are told. ``decides``: the
    maneuver that would tell what these records could not, of an ambiguous diagnosis. ``simulated``:
    whether a program made all records, as the JSON beside them says.
    """

    diagnosis: Diagnosis
    vehicle: VehicleFile
    model: Model
    records: tuple[Record, ...]
    validation: tuple[Record, ...]
    inputs: Inputs
    held_out_from: float | None = None
    explanations: dict[str, str] = field(default_factory=dict)
    traits: dict[str, Traits] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    kinematics: Kinematics | None = None
    look: RecordCheck = NOTHING_SEEN
    overflows: int = 0
    effort: str = NORMAL.effort
    flown: FlightPhase = field(default_factory=FlightPhase)
    plan: Plan = field(default_factory=Plan)
    simulated: bool = False
    decides: DesignResult | None = None

    def __repr__(self) -> str:
        return f"<Tracing: {self.vehicle.model} model of {self.vehicle.name}: {self.diagnosis!r}>"

    @property
    def stick_unit(self) -> str:
        """The stick's label, empty where there is no stick."""
        return next(
            (channel.unit for channel in self.records[0].inputs if channel.name == STICK), ""
        )


SPIKES = "sensor-spikes:"


def kept_diagnosis(tracing: Tracing) -> KeptModel | None:
    """The model that a diagnosis leaves; None where the loop did not say what it was fitted
    with.
    """
    d, plan, vehicle = tracing.diagnosis, tracing.plan, tracing.vehicle
    if d.trained_before is None or d.trained_after is None:
        return None
    inputs = {signal.name for signal in tracing.model.equations.inputs}
    reading = KeptReading(
        tracing.records[0].hold.value,
        plan.hold is not None,
        weight=SPEED not in inputs or LIFT in inputs,
        attitude=ATTITUDE in inputs,
        rate=plan.rate or 0.0,
        lowpass=plan.lowpass or 0.0,
        trusted=plan.trusted,
    )
    claimed = tuple(claim.name for claim in d.effects if claim.claimed)
    spiked = tuple(
        name.removeprefix(SPIKES)
        for name in claimed
        if name.startswith(SPIKES) and name.removeprefix(SPIKES) in inputs
    )
    return KeptModel(
        DIAGNOSE,
        vehicle.model,
        vehicle.identity if vehicle.text else None,
        vehicle.text,
        vehicle.own_file,
        reading,
        tracing.model.biases,
        d.trained_after,
        d.trained_before,
        tracing.inputs.effects[0] if tracing.inputs.effects else None,
        spiked,
        claimed=claimed,
    )


class Trace(Protocol):
    """The tracing loop, ``ident.tracing.loop.diagnose``."""

    def __call__(
        self,
        records: Sequence[Record],
        model: Model,
        candidates: Sequence[Traceable],
        guards: Sequence[Traceable],
        validation: Sequence[Record],
        settings: TraceSettings,
        progress: Callable[[str, float], None],
        *,
        kinematics: Callable[[], Sequence[tuple[str, ...]]] | None,
        reread: Callable[[], Data] | None,
    ) -> Diagnosis: ...


@dataclass
class Overflows:
    """How often a computation left the range of numbers; the loop leaves out what it would have
    shown.
    """

    count: int = 0

    def __call__(self, kind: str, flag: int) -> None:
        """NumPy's call where a result overflows or is no number."""
        self.count += 1

    def counted(self, trace: Trace) -> Trace:
        """The same loop, its overflows counted instead of warned of; a share below the smallest
        number is none.
        """

        def counting(*arguments: Any, **named: Any) -> Diagnosis:
            with np.errstate(over="call", invalid="call", divide="call", under="ignore", call=self):
                return trace(*arguments, **named)

        return counting


def overflow_sentence(count: int) -> str:
    """One line on what was left out; empty where nothing was."""
    if count == 0:
        return ""
    several = f"{count} computations" if count > 1 else "one computation"
    return (
        f"{several} of the search left the range of numbers: what they would have shown is left "
        "out; look for wild samples and wrong units"
    )
