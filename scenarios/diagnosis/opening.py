"""Everything that was read for a diagnosis, and what the loop is given of it: prepared, with
biases, something held out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.diagnosis.candidates import checked_effects, read_effects
from scenarios.files.channels import CHANNEL_UNITS
from scenarios.files.measured.columns import (
    RecordFile,
    identities,
    path_of,
    read_with_validation,
)
from scenarios.files.sources import InputFile, Source, read_source
from scenarios.files.user_models import channel_units, is_model_file
from scenarios.files.vehicles import BESIDE, VehicleFile, read_vehicle, vehicle_next_to
from scenarios.preparation.declared_model import outputs_with_bias
from scenarios.preparation.plan import Plan, Request, column_choices, flown_of
from scenarios.preparation.plausibility import split_off
from scenarios.preparation.reading import Parted
from scenarios.preparation.recording import RecordCheck
from sim.declaration.model import Model, Noise
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError
from sim.record import Record

if TYPE_CHECKING:
    from ident.flying_qualities.levels import Flown
    from scenarios.files.channels import ColumnChoice
    from scenarios.preparation.reading import Prepared


@dataclass(frozen=True, eq=False)
class Opened:
    """Everything that was read for a request, each file once."""

    vehicle: VehicleFile
    choices: Mapping[str, ColumnChoice] | None
    records: tuple[RecordFile, ...]
    validation: tuple[RecordFile, ...]
    flown: Flown


@dataclass(frozen=True, eq=False)
class Posed:
    """What the loop is given of the records, and which files that is: ``fitted`` and ``validation``
    hold their names and hashes.

    ``parted``: records that are predicted, each with the number of its parts in ``predicted``; none
    where something is held out of ``records``.
    """

    model: Model
    records: tuple[Record, ...]
    predicted: tuple[Record, ...]
    fitted: tuple[InputFile, ...]
    validation: tuple[InputFile, ...]
    held_out_from: float | None
    notes: tuple[str, ...]
    doubts: tuple[str, ...]
    look: RecordCheck
    parted: tuple[Parted, ...] = ()


def opened_files(request: Request, vehicle: Path | Source | None) -> Opened:
    """Vehicle, class and category, channel map and records, in this order; a fault of the first is
    told first.
    """
    declared = read_vehicle(vehicle, request.model)
    flown = flown_of(request, declared)
    choices = column_choices(
        request, channel_units(declared.own) if declared.own is not None else CHANNEL_UNITS
    )
    return Opened(
        declared, choices, *read_with_validation(request.records, request.validate), flown
    )


def posed_for(opened: Opened, plan: Plan) -> Posed:
    """Records prepared for the declared model with its biases, something held out; refused where
    they cannot tell anything.
    """
    from scenarios.preparation.aircraft_records import refuse_unfit_records
    from scenarios.preparation.declared_model import model_of_file
    from scenarios.preparation.plausibility import refuse_still, refuse_unpredictable

    ready = _ready(opened, model_of_file(opened.vehicle).with_noise(Noise()), plan)
    whole, predicted, notes, held_out_from = ready.fitted, ready.validation, ready.notes, None
    model = ready.model.with_biases(_biased(ready.model, whole))
    fitted, files = whole, (opened.records, opened.validation)
    if not opened.validation:
        split = split_off(whole, model)
        fitted, predicted, held_out_from, notes = (
            split.fitted,
            (split.held,),
            split.cut,
            (split.sentence, *notes),
        )
        if held_out_from is None and len(plan.segments) == 1 and len(whole) == len(opened.records):
            files = (opened.records[:-1], opened.records[-1:])
    refuse_still(whole, model)
    refuse_unfit_records(whole, model)
    refuse_unpredictable(ready.predicted, model)
    return Posed(
        model,
        fitted,
        predicted,
        identities(files[0]),
        identities(files[1]),
        held_out_from,
        notes,
        ready.doubts,
        ready.look,
        ready.parted,
    )


def _ready(opened: Opened, model: Model, plan: Plan) -> Prepared:
    from scenarios.preparation.plausibility import refuse_unrelated_records
    from scenarios.preparation.reading import prepare

    ready = prepare(opened.records, model, plan, opened.choices, opened.validation, attitude=True)
    refuse_unrelated_records(ready.fitted, ready.validation)
    return ready


def own_effects(
    given: Path | Sequence[Traceable] | None, model: Model
) -> tuple[tuple[Traceable, ...], tuple[InputFile, ...]]:
    """A user's effects that can act on the model, and the file that they came from, if they came
    from one.
    """
    if given is None:
        return (), ()
    if not isinstance(given, Path):
        return checked_effects(given, model, "effects"), ()
    source = read_source(given, DeclarationError, "a Python file")
    return read_effects(source, model), (source.identity,)


def _biased(model: Model, records: Sequence[Record]) -> list[str]:
    """The measured outputs whose sensors have a free bias."""
    measured = {name for record in records for name in record.output_names}
    return outputs_with_bias(
        model, [signal.name for signal in model.equations.outputs if signal.name in measured]
    )


def vehicle_path_of(request: Request) -> Path | Source | None:
    """The vehicle file, None where an own model goes without one."""
    first = request.records[0]
    chosen = request.vehicle if request.vehicle is not None else vehicle_next_to(first)
    if chosen is None and not is_model_file(request.model):
        what = f"the {request.model} model needs constants and starting values"
        raise DeclarationError(
            what,
            where="--vehicle",
            remedy=(
                f"name a vehicle file, or put {BESIDE} beside "
                f"{path.name if (path := path_of(first)) else 'the record'}"
            ),
        )
    return chosen


def _name_of(record: Path | RecordFile) -> str:
    path = path_of(record)
    return path.name if path is not None else "a record file"
