"""Everything that was read for a diagnosis, and what the loop is given of it: prepared, with
biases, something held out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ident.tracing.diagnosis import Diagnosis, Verdict
from scenarios.diagnosis.candidates import checked_effects, read_effects
from scenarios.files.channel_names import CHANNEL_UNITS
from scenarios.files.measured.record_file import (
    RecordFile,
    identities,
    path_of,
    read_with_validation,
)
from scenarios.files.sources import InputFile, Source, read_source
from scenarios.files.user_models import channel_units, is_model_file
from scenarios.files.vehicles import BESIDE, VehicleFile, read_vehicle, vehicle_next_to
from scenarios.preparation.declared_model import BETTER, held_by_computer, outputs_with_bias
from scenarios.preparation.plan import BY_HAND, Plan, Request, column_choices, flown_of
from scenarios.preparation.plausibility import split_off
from scenarios.preparation.reading import Parted
from scenarios.preparation.recording import RecordCheck
from sim.declaration.model import Model, Noise
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError
from sim.record import Hold, Record

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


# ---- Whether held inputs are read again as moving between samples

CHOOSE = "--hold linear or --hold previous says which"
TIMES = ("delay", "time_constant")  # parameters by which an output or an input is late
STRENGTH = (
    Verdict.CONSISTENT,
    Verdict.TRACED,
    Verdict.AMBIGUOUS,
    Verdict.PARTIAL,
    Verdict.UNEXPLAINED,
)
READ_AGAIN = (
    "held ones would run ahead of the aircraft by a part of a sample; --hold previous holds them"
)


def moves_between_samples(
    diagnosis: Diagnosis, candidates: Sequence[Traceable], records: Sequence[Record]
) -> bool:
    """Whether something that was found says no more than how held inputs are to be read between
    their samples.

    A held input stands half an interval behind the one that moves on: a time of that kind below one
    interval is no fault of a recorder. Where it is but an alternative of what was found, its size
    is not asked.
    """
    if any(record.hold is not Hold.PREVIOUS for record in records):
        return False
    interval = max(float(np.median(np.diff(record.time))) for record in records)
    times = {
        effect.name: effect.traits.within_interval
        for effect in candidates
        if effect.traits.within_interval
    }
    named = any(
        found.name in times and found.parameters[times[found.name]].value < interval
        for found in diagnosis.effects
    )
    return named or any(times.keys() & {*found.alternatives} for found in diagnosis.effects)


def tells_times(diagnosis: Diagnosis, records: Sequence[Record]) -> bool:
    """Whether times were found that held inputs would shift by half an interval, and an input
    passes through several samples as it moves.
    """
    if any(record.hold is not Hold.PREVIOUS or held_by_computer(record) for record in records):
        return False
    return any(name in TIMES for found in diagnosis.effects for name in found.parameters)


def no_worse(again: Diagnosis, first: Diagnosis) -> bool:
    """Whether the second reading of the inputs explains at least as much as the first."""
    return STRENGTH.index(again.verdict) <= STRENGTH.index(first.verdict)


@dataclass(frozen=True)
class Refit:
    """What was found, fitted again with inputs that move linearly between samples.

    ``rise`` : by how much twice the log likelihood rises; minus infinity where nothing fits.
    ``values`` : parameters of the effects and of the declared model, by full name.
    """

    rise: float
    values: Mapping[str, float]


def refitted(
    diagnosis: Diagnosis, model: Model, held: Sequence[Record], linear: Sequence[Record]
) -> Refit:
    """Fit what was found to both readings of the inputs."""
    from ident.tracing.candidate_model.fitted_model import FitData, Start, fit_set

    found = diagnosis.trained_after
    if found is None:
        return Refit(-math.inf, {})
    fits = []
    for records in (held, linear):
        masks = [record.output_array(found.outputs)[1] for record in records]
        data = FitData(records, masks, model, found.outputs)
        fits.append(fit_set(data, found.effects, found.settings, Start(added=found.shared)))
    first, second = fits
    if first is None or second is None or not math.isfinite(second.fit.cost):
        return Refit(-math.inf, {})
    return Refit(2.0 * (first.fit.cost - second.fit.cost), second.values.shared)


def left_open(again: Refit, first: Diagnosis) -> tuple[str, ...]:
    """What the second reading would change by more than a sigma, where it explains the records as
    well; nothing where it does not.
    """
    if abs(again.rise) > BETTER:
        return ()
    own = {
        f"{found.name}.{name}": q for found in first.effects for name, q in found.parameters.items()
    }
    moved = [
        f"{name} {again.values[name]:.4g} for {was.value:.4g}"
        for name, was in {**own, **first.after}.items()
        if name in again.values and abs(again.values[name] - was.value) > was.std
    ]
    if not moved:
        return ()
    return (
        "inputs were read as held; moving linearly between samples they explain the records as "
        f"well, with {', '.join(moved)}: {CHOOSE}",
    )


def read_again(notes: Sequence[str]) -> tuple[str, ...]:
    """The sentences on a second reading, which no one chose by hand."""
    return tuple(note.replace(BY_HAND, READ_AGAIN) for note in notes)
