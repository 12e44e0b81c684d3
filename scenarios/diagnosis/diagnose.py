"""The tracing loop on files: records, vehicle and candidates put together, something held out where no record is named for it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from ident.flying_qualities.mode_levels import Flown
from ident.tracing.diagnosis import Diagnosis, Verdict
from ident.tracing.settings import NORMAL
from scenarios.diagnosis.candidates import can_act, candidates_for, read_effects
from scenarios.diagnosis.effort import settings_of
from scenarios.diagnosis.input_reading import better, left_open, moves_between_samples, no_worse, read_again, tells_times
from scenarios.diagnosis.kinematics import Kinematics, kinematics_of_files
from scenarios.diagnosis.laid_down import at_bounds, said_of
from scenarios.diagnosis.overflows import Overflows, Trace
from scenarios.diagnosis.witness import KinematicWitness
from scenarios.files.channel_names import CHANNEL_UNITS, STICK
from scenarios.files.measured.record_file import RecordFile, identities, read_record_files, refuse_twice
from scenarios.files.own_models import channel_units, is_model_file, is_of_aircraft, moves_about_rest
from scenarios.files.sources import InputFile, read_source
from scenarios.files.vehicles import BESIDE, VehicleFile, read_vehicle, refuse_unknown_model, vehicle_beside
from scenarios.preparation.holding_out import split_off
from scenarios.preparation.plan import WHOLE, Plan
from scenarios.preparation.recording import NOTHING_SEEN, RawLook
from scenarios.preparation.request import Request, column_choices, flown_of
from scenarios.preparation.vehicle_model import outputs_with_bias, step_for
from sim.declaration.model import Model, Noise
from sim.declaration.proposal import Traceable
from sim.declaration.traits import Traits
from sim.errors import DeclarationError
from sim.record import Hold, Record

if TYPE_CHECKING:
    from scenarios.files.channels import ColumnChoice
    from scenarios.preparation.reading import Prepared

KINEMATIC = ("rigid", "flexible")  # models of records that are checked without aerodynamics beside the diagnosis


@dataclass(frozen=True)
class Inputs:
    """All files that a diagnosis rests on; ``validation`` is empty where only a part of a file was held out, ``effects`` where none was named.

    ``model`` is the file of a user's own model, None where it is built in.
    """

    records: tuple[InputFile, ...]
    validation: tuple[InputFile, ...]
    vehicle: InputFile
    effects: tuple[InputFile, ...] = ()
    model: InputFile | None = None


@dataclass(frozen=True, eq=False)
class Tracing:
    """A diagnosis with what it was made from.

    ``records`` and ``validation`` are what was fitted and what was predicted; ``held_out_from`` is the time (s) at which the last
    record was cut, None where whole records were predicted. ``explanations`` and ``traits`` of the
    candidates by name. ``notes`` say how the records were prepared, one sentence each; ``doubts`` what in
    the files is likely to be wrong. ``kinematics``: what the records say without any aerodynamics, None where it was not asked.
    ``look``: what their raw columns show. ``overflows``: computations of the loop that left the range of numbers, and were left out.
    ``effort``: how far the search looked. ``flown``: by which class and category levels of flying qualities are told.
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
    look: RawLook = NOTHING_SEEN
    overflows: int = 0
    effort: str = NORMAL.effort
    flown: Flown = field(default_factory=Flown)

    @property
    def stick_unit(self) -> str:
        """The stick's label, empty where there is no stick."""
        return next((channel.unit for channel in self.records[0].inputs if channel.name == STICK), "")


@dataclass(frozen=True, eq=False)
class _Opened:
    """Everything that was read for a request, each file once."""

    vehicle: VehicleFile
    choices: Mapping[str, ColumnChoice] | None
    records: tuple[RecordFile, ...]
    validation: tuple[RecordFile, ...]


@dataclass(frozen=True, eq=False)
class _Posed:
    """What the loop is given of the records, and which files that is: ``fitted`` and ``validation`` hold their names and hashes."""

    model: Model
    records: tuple[Record, ...]
    predicted: tuple[Record, ...]
    fitted: tuple[InputFile, ...]
    validation: tuple[InputFile, ...]
    held_out_from: float | None
    notes: tuple[str, ...]
    doubts: tuple[str, ...]
    look: RawLook


def diagnose_files(request: Request, progress: Callable[[str, float], None] = lambda stage, share: None, trace: Trace | None = None) -> Tracing:
    """Read everything, run the loop, and return its result with what went in.

    Parameters
    ----------
    request : the files and how they are read. Without any to validate on, the last of several records is held out, and the last part of
        a single one (``split_off``).
    progress : told the stage and the share done, 0 to 1. trace : the loop; None takes ``ident.tracing.loop.diagnose``.

    Raises
    ------
    FlightidError : anything in the files that keeps them from being used, in one line.
    """
    from sim.effects.library import guards_for

    refuse_unknown_model(request.model, "--model")
    settings = settings_of(request.effort)
    refuse_twice([*request.records, *request.validate], "name each record once, for the fit or for --validate")
    vehicle_path = _vehicle_path(request)
    progress("reading", 0.0)
    opened = _open(request, vehicle_path)
    posed = _posed(opened, request.plan)
    settings = replace(settings, max_step=step_for(posed.model, posed.records, settings.max_step))
    own, of_effects = _own_effects(request.effects, posed.model)
    candidates = candidates_for(posed.model, own)
    overflows = Overflows()
    run = overflows.counted(trace or _loop())
    guards = can_act(guards_for(posed.model.equations), posed.model)
    with _witness(opened, posed, request.plan) as witness:
        diagnosis = run(posed.records, posed.model, candidates, guards, posed.predicted, settings, progress, witness)
        part = moves_between_samples(diagnosis, candidates, posed.records)
        if _may_read_again(opened, request.plan) and (part or tells_times(diagnosis, posed.records)):
            linear = _posed(opened, replace(request.plan, hold=Hold.LINEAR))
            again = run(linear.records, linear.model, candidates, guards, linear.predicted, settings, progress, witness)
            if no_worse(again, diagnosis) if part else better(again, diagnosis):
                posed, diagnosis = replace(linear, notes=read_again(linear.notes)), again
            elif not part:
                posed = replace(posed, notes=(*posed.notes, *left_open(again, diagnosis)))
        # Only a verdict that needs evidence is worth a check, which costs as much as some candidates.
        kinematics = witness.kinematics if diagnosis.verdict is not Verdict.CONSISTENT else None
    if not moves_about_rest(posed.model):
        diagnosis = replace(diagnosis, derived_before={}, derived_after={}, modes_before=None, modes_after=None)
    assert opened.vehicle.identity is not None
    diagnosis, pressed = at_bounds(diagnosis, opened.vehicle.constraints)
    return Tracing(
        diagnosis,
        opened.vehicle,
        posed.model,
        posed.records,
        posed.predicted,
        Inputs(posed.fitted, posed.validation, opened.vehicle.identity, of_effects, opened.vehicle.own_file),
        posed.held_out_from,
        {effect.name: " ".join(effect.explanation.split()) for effect in candidates},
        {effect.name: effect.traits for effect in reversed(candidates)},
        (*posed.notes, *said_of(opened.vehicle.constraints, posed.model), *pressed),
        posed.doubts,
        kinematics,
        posed.look,
        overflows.count,
        settings.effort,
        flown_of(request, opened.vehicle),
    )


def _may_read_again(opened: _Opened, plan: Plan) -> bool:
    """Whether nobody said how inputs are to be read between samples."""
    return plan.hold is None and not any(file.sidecar.says_hold for file in (*opened.records, *opened.validation))


def _loop() -> Trace:
    from ident.tracing.loop import diagnose

    return diagnose


def _open(request: Request, vehicle: Path | None) -> _Opened:
    """Vehicle, channel map and records, in this order; a fault of the first is told first."""
    declared = read_vehicle(vehicle, request.model)
    choices = column_choices(request, channel_units(declared.own) if declared.own is not None else CHANNEL_UNITS)
    return _Opened(declared, choices, read_record_files(request.records), read_record_files(request.validate))


def _posed(opened: _Opened, plan: Plan) -> _Posed:
    """Records prepared for the declared model with its biases, something held out; refused where they cannot tell anything."""
    from scenarios.preparation.plausibility import refuse_still, refuse_unpredictable
    from scenarios.preparation.vehicle_model import model_of_file

    ready = _ready(opened, model_of_file(opened.vehicle).with_noise(Noise()), plan)
    whole, predicted, notes, held_out_from = ready.fitted, ready.validation, ready.notes, None
    model = ready.model.with_biases(_biased(ready.model, whole))
    fitted, files = whole, (opened.records, opened.validation)
    if not opened.validation:
        split = split_off(whole, model)
        fitted, predicted, held_out_from, notes = split.fitted, (split.held,), split.cut, (split.sentence, *notes)
        if held_out_from is None and len(plan.segments) == 1:
            files = (opened.records[:-1], opened.records[-1:])
    refuse_still(whole, model)
    refuse_unpredictable(ready.validation, model)
    return _Posed(model, fitted, predicted, identities(files[0]), identities(files[1]), held_out_from, notes, ready.doubts, ready.look)


def _ready(opened: _Opened, model: Model, plan: Plan) -> Prepared:
    from scenarios.preparation.plausibility import refuse_strangers
    from scenarios.preparation.reading import prepare

    ready = prepare(opened.records, model, plan, opened.choices, opened.validation, attitude=True)
    refuse_strangers(ready.fitted, ready.validation)
    return ready


def _witness(opened: _Opened, posed: _Posed, plan: Plan) -> KinematicWitness:
    """The check of the kinematics as a witness: on all that was read where one record is fitted, else on the fitted records alone.

    Its word counts where causes are ranked, and what is held out takes no part in that.
    """
    own = opened.vehicle.own
    if not (is_of_aircraft(own) if own is not None else opened.vehicle.model in KINEMATIC):
        return KinematicWitness(None)
    parts = [(file, segment) for file in opened.records for segment in plan.segments]
    if len(posed.records) == 1:
        parts += [(file, segment) for file in opened.validation for segment in WHOLE] if plan.segments == WHOLE else []
    elif not opened.validation:
        (last, segment) = parts.pop()
        parts += [(last, replace(segment, stop=posed.held_out_from))] if posed.held_out_from is not None else []
    return KinematicWitness(lambda: kinematics_of_files(parts, opened.vehicle, opened.choices, plan))


def _own_effects(path: Path | None, model: Model) -> tuple[tuple[Traceable, ...], tuple[InputFile, ...]]:
    """A user's effects that can act on the model, and the file that they came from."""
    if path is None:
        return (), ()
    source = read_source(path, DeclarationError, "a Python file")
    return read_effects(source, model), (source.identity,)


def _biased(model: Model, records: Sequence[Record]) -> list[str]:
    """The measured outputs whose sensors have a free bias."""
    measured = {name for record in records for name in record.output_names}
    return outputs_with_bias(model, [signal.name for signal in model.equations.outputs if signal.name in measured])


def _vehicle_path(request: Request) -> Path | None:
    """The vehicle file, None where an own model goes without one."""
    first = request.records[0]
    chosen = request.vehicle if request.vehicle is not None else vehicle_beside(first)
    if chosen is None and not is_model_file(request.model):
        what = f"the {request.model} model needs constants and starting values"
        raise DeclarationError(what, where="--vehicle", remedy=f"name a vehicle file, or put {BESIDE} beside {first.name}")
    return chosen
