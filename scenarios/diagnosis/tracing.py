"""The nouns of a diagnosis of files: what it rests on, and its result with what that was made
from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ident.flying_qualities.levels import Flown
from ident.tracing.diagnosis import Diagnosis
from ident.tracing.settings import NORMAL
from scenarios.diagnosis.kinematics import Kinematics
from scenarios.files.channels import STICK
from scenarios.files.sources import InputFile
from scenarios.files.vehicles import VehicleFile
from scenarios.preparation.plan import Plan
from scenarios.preparation.recording import NOTHING_SEEN, RecordCheck
from sim.declaration.model import Model
from sim.declaration.proposal import Traits
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
    flown: Flown = field(default_factory=Flown)
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
