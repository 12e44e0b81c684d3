"""Diagnosis of files: read records, vehicle and candidate effects, hold a part of the records out,
run the tracing loop, and design the maneuver that would decide an ambiguous diagnosis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from ident.flying_qualities.levels import FlightPhase
from ident.tracing.diagnosis import (
    NORMAL,
    Claim,
    Data,
    Diagnosis,
    Prediction,
    TraceSettings,
    Verdict,
)
from scenarios.diagnosis.kinematics import (
    CLOCK,
    OF_MODEL,
    Kinematics,
    kinematics_of_files,
    named_by,
    right_clock,
)
from scenarios.diagnosis.opening import (
    InputReading,
    LoopInput,
    OpenedFiles,
    at_bounds,
    can_act,
    candidates_for,
    loop_input_for,
    opened_files,
    own_effects,
    settings_of,
    vehicle_path_of,
)
from scenarios.files.declarations import STICK
from scenarios.files.measured.columns import all_simulated, refuse_duplicates
from scenarios.files.sources import InputFile, Source
from scenarios.files.user_models import (
    OwnModel,
    constraint_sentences,
    is_of_aircraft,
    moves_about_rest,
)
from scenarios.files.vehicles import (
    VehicleFile,
    files_read_unnamed,
    refuse_unknown_model,
    vehicle_next_to,
)
from scenarios.maneuver_design.design import DesignResult, design
from scenarios.maneuver_design.limits import PILOT
from scenarios.maneuver_design.setting import DesignRequest
from scenarios.preparation.declared_model import sub_step
from scenarios.preparation.filtering import PartedRecord, parts_of, put_together
from scenarios.preparation.plan import ATTITUDE, LIFT, SPEED, WHOLE, Plan, Request
from scenarios.preparation.recording import NOTHING_SEEN, RecordCheck
from scenarios.stored_study import DIAGNOSE, StoredModel, StoredReading
from sim.declaration.model import Model
from sim.declaration.proposal import RangedCurve, Traceable, Traits
from sim.effects.library import effects_for
from sim.errors import FlightidError
from sim.record import Record


@dataclass(frozen=True)
class Inputs:
    """All files of a diagnosis.

    Attributes
    ----------
    records : files of the fitted records.
    validation : files of the predicted records; empty if a part of a fitted file was held out.
    vehicle : the vehicle file.
    effects : files of the user's own effects.
    model : file of a user's own model; None for a built-in model.
    """

    records: tuple[InputFile, ...]
    validation: tuple[InputFile, ...]
    vehicle: InputFile
    effects: tuple[InputFile, ...] = ()
    model: InputFile | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Tracing:
    """A diagnosis with its files, records, model and settings.

    Attributes
    ----------
    records, validation : fitted and predicted records.
    held_out_from : time (s) at which the last record was cut; None for whole predicted records.
    explanations, traits : explanation and traits of each candidate, by name.
    notes : sentences on the preparation of the records.
    doubts : sentences on likely faults of the files.
    kinematics : kinematic check of the sensors; None if not computed.
    look : check of the raw columns.
    overflows : number of computations that overflowed and were skipped.
    plan : preparation of the records.
    effort : effort of the search.
    flown : aircraft class and flight phase for levels of flying qualities.
    decides : for an ambiguous diagnosis, the maneuver that would decide it.
    simulated : whether all records are simulated, according to their JSON files.
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
        """The stick's label, empty if there is no stick."""
        return next(
            (channel.unit for channel in self.records[0].inputs if channel.name == STICK), ""
        )


SPIKES = "sensor-spikes:"  # an effect's name up to the channel


def stored_diagnosis(tracing: Tracing) -> StoredModel | None:
    """Return the final model of a diagnosis; None if its fitted values are unknown."""
    diagnosis, plan, vehicle = tracing.diagnosis, tracing.plan, tracing.vehicle
    if diagnosis.trained_before is None or diagnosis.trained_after is None:
        return None
    inputs = {signal.name for signal in tracing.model.equations.inputs}
    reading = StoredReading(
        tracing.records[0].hold.value,
        plan.hold is not None,
        weight=SPEED not in inputs or LIFT in inputs,
        attitude=ATTITUDE in inputs,
        rate=plan.rate or 0.0,
        lowpass=plan.lowpass or 0.0,
        trusted=plan.trusted,
    )
    claimed = tuple(claim.name for claim in diagnosis.effects if claim.claimed)
    spiked_inputs = tuple(
        name.removeprefix(SPIKES)
        for name in claimed
        if name.startswith(SPIKES) and name.removeprefix(SPIKES) in inputs
    )
    return StoredModel(
        DIAGNOSE,
        vehicle.model,
        vehicle.identity if vehicle.text else None,
        vehicle.text,
        vehicle.own_file,
        reading,
        tracing.model.biases,
        diagnosis.trained_after,
        diagnosis.trained_before,
        tracing.inputs.effects[0] if tracing.inputs.effects else None,
        spiked_inputs,
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
    """Counter of computations that overflow in the tracing loop, which skips them."""

    count: int = 0

    def __call__(self, kind: str, flag: int) -> None:
        """Handle an overflow or invalid result, as NumPy's error callback."""
        self.count += 1

    def counted(self, trace: Trace) -> Trace:
        """Return the same loop with its overflows counted instead of printed as warnings.

        Underflow is ignored: a probability below the smallest number is zero.
        """

        def counting(*arguments: Any, **named: Any) -> Diagnosis:
            with np.errstate(over="call", invalid="call", divide="call", under="ignore", call=self):
                return trace(*arguments, **named)

        return counting


DESIGN_DIGITS = 4  # digits of numbers in a design request: the printed request repeats the design
SHORTEST, LONGEST = 10.0, 20.0  # s, duration of a designed flight
# A pilot moves the stick faster at small deflections than at full deflection: by this factor.
SMALLER_DEFLECTION_RATE = 2.0


def deciding_maneuver(
    diagnosis: Diagnosis,
    request: Request,
    vehicle: VehicleFile,
    model: Model,
    records: Sequence[Record],
) -> DesignResult | None:
    """Return the design of a deciding maneuver for an ambiguous diagnosis; None if not possible.

    Peak deflections, sampling and noise are those of the records; derivatives and effects have
    their estimated values.
    """
    if diagnosis.verdict is not Verdict.AMBIGUOUS:
        return None
    design_request = _design_request(diagnosis, request, vehicle, model, records)
    if design_request is None:
        return None
    try:
        return design(design_request)
    except FlightidError:
        return None  # no design exists, as for a user's own control law


def _design_request(
    diagnosis: Diagnosis,
    request: Request,
    vehicle: VehicleFile,
    model: Model,
    records: Sequence[Record],
) -> DesignRequest | None:
    """Return the request for a maneuver that separates the first claim with alternatives from one
    of them; None if there is no pair that a flight can separate.
    """
    doubtful = [claim for claim in diagnosis.effects if claim.claimed and claim.alternatives]
    library = {
        effect.name: effect
        for effect in effects_for(model.equations)
        if isinstance(effect, Traceable)
    }
    if not doubtful or not model.equations.inputs:
        return None
    claim = doubtful[0]
    if claim.name not in library:
        return None
    # No flight can separate equivalent effects.
    equivalents = library[claim.name].traits.equivalents
    rivals = [name for name in claim.alternatives if name in library and name not in equivalents]
    if not rivals:
        return None
    simplest = min(rivals, key=lambda name: len(library[name].parameters))
    names = (claim.name, simplest)
    values = [
        _text(name, quantity.value)
        for name, quantity in diagnosis.after.items()
        if name in model.parameters.free_names
    ]
    noise = [_text(name, std) for name, std in diagnosis.residual_std.items() if std > 0.0]
    interval = float(np.median(np.diff(records[0].time)))
    longest_record = float(max(record.time[-1] - record.time[0] for record in records))
    duration = min(LONGEST, max(SHORTEST, longest_record))
    return DesignRequest(
        model=request.model,
        vehicle=_source(request, vehicle),
        tell=names,
        size=",".join(_effect_values(claim, diagnosis)),
        values=tuple(values),
        noise=tuple(noise),
        amplitude=tuple(
            _text(name, size) for name, size in _peaks(model, records).items() if size > 0.0
        ),
        duration=float(f"{duration:.{DESIGN_DIGITS}g}"),
        rate=float(f"{1.0 / interval:.{DESIGN_DIGITS}g}"),
        computer=not by_hand(model, records),
        command_names=_command_names(request, vehicle),
    )


def by_hand(model: Model, records: Sequence[Record]) -> bool:
    """Return whether a pilot can move the stick as fast as all inputs of the records.

    Faster inputs come from a flight computer, which can also fly the designed maneuver.
    """
    peaks = _peaks(model, records)
    return all(
        float(np.max(np.abs(np.diff(record[name].values)) / np.diff(record.time)))
        <= SMALLER_DEFLECTION_RATE * peak / PILOT.rise
        for record in records
        for name, peak in peaks.items()
        if name in record.input_names and len(record.time) > 1
    )


def _text(name: str, value: float) -> str:
    return f"{name}={value:.{DESIGN_DIGITS}g}"


def _effect_values(claim: Claim, diagnosis: Diagnosis) -> list[str]:
    """Return ``name=value`` of each parameter of the claimed effect, and for a curve the limits of
    the range over which it was fitted.
    """
    fitted = diagnosis.trained_after
    effects: Sequence[Traceable] = fitted.effects if fitted is not None else ()
    effect = next((effect for effect in effects if effect.name == claim.name), None)
    own = {item.name for item in effect.parameters} if effect is not None else set()
    texts = [
        _text(name, quantity.value) for name, quantity in claim.parameters.items() if name in own
    ]
    limits: list[str] = (
        [_text("low", effect.low), _text("high", effect.high)]
        if isinstance(effect, RangedCurve)
        else []
    )
    return texts + limits


def _peaks(model: Model, records: Sequence[Record]) -> dict[str, float]:
    """Return the largest deflection of each input from its value at the start of a record."""
    names = [signal.name for signal in model.equations.inputs]
    return {
        name: max(
            float(np.max(np.abs(record[name].values - record[name].values[0])))
            for record in records
            if name in record.input_names
        )
        for name in names
        if any(name in record.input_names for record in records)
    }


def _source(request: Request, vehicle: VehicleFile) -> Source | None:
    """Return the vehicle file as it was read; None if a user's own model has none."""
    path = vehicle_path_of(request)
    if path is None or isinstance(path, Source):
        return path
    assert vehicle.identity is not None
    return Source(path, vehicle.text.encode(), vehicle.identity)


def _command_names(request: Request, vehicle: VehicleFile) -> Mapping[str, str]:
    """Return the names of model and vehicle file for the printed design command."""
    path = vehicle_path_of(request)
    shown = "" if path is None else str(path.path if isinstance(path, Source) else path)
    own = (
        vehicle.own_file.name
        if isinstance(request.model, OwnModel) and vehicle.own_file is not None
        else str(request.model)
    )
    return {"model": own, "vehicle": shown}


def diagnose_files(
    request: Request,
    progress: Callable[[str, float], None] = lambda stage, share: None,
    trace: Trace | None = None,
) -> Tracing:
    """Read the files of a request, run the tracing loop, and return the diagnosis with its inputs.

    Parameters
    ----------
    request : the files and how they are read. If it names no record for validation, the last of
        several records, or the last part of a single record, is held out.
    progress : called with the stage and the share done, 0 to 1.
    trace : the tracing loop; None takes ``ident.tracing.loop.diagnose``.

    Raises
    ------
    FlightidError : anything in the files that keeps them from being used.
    """
    refuse_unknown_model(request.model, "--model")
    effort_settings = settings_of(request.effort)
    refuse_duplicates(
        [*request.records, *request.validate],
        "name each record once, for the fit or for --validate",
    )
    progress("reading", 0.0)
    opened = opened_files(request, vehicle_path_of(request))
    loop_input = loop_input_for(opened, request.plan)
    step = sub_step(loop_input.model, loop_input.records, effort_settings.max_step)
    settings = replace(effort_settings, max_step=step)
    own, effect_files = own_effects(request.effects, loop_input.model)
    candidates, guards = candidates_for(loop_input.model, own), _guards(loop_input.model)
    measured = {name for record in loop_input.records for name in record.output_names}
    absent = {signal.name for signal in loop_input.model.equations.outputs} - measured
    # The fault of a sensor that is not recorded cannot explain the records.
    candidates = tuple(
        effect
        for effect in candidates
        if effect in own or getattr(effect, "channel", "") not in absent
    )
    if note := right_clock(loop_input.measured):
        candidates = tuple(effect for effect in candidates if effect.name != CLOCK)
        loop_input = replace(loop_input, notes=(*loop_input.notes, note))
    overflows = Overflows()
    counted_trace = overflows.counted(trace or _loop(loop_input.model))
    context = _Context(request, opened, effect_files, candidates, settings, overflows)

    # The kinematic check takes as long as several candidates: it is computed once, and only if
    # the loop or the verdict asks for it.
    checks: list[Kinematics | None] = []

    def kinematic_check() -> Kinematics | None:
        if not checks:
            checks.append(_kinematics(opened, loop_input, request.plan))
        return checks[0]

    def run_loop(loop_input: LoopInput, reread: Callable[[], Data] | None = None) -> Diagnosis:
        return counted_trace(
            loop_input.records,
            loop_input.model,
            candidates,
            guards,
            loop_input.predicted,
            settings,
            progress,
            kinematics=lambda: named_by(kinematic_check()),
            reread=reread,
        )

    reading = InputReading(opened, request.plan)
    diagnosis = run_loop(loop_input, reading.linear_data(loop_input))
    loop_input, diagnosis = reading.with_better_reading(loop_input, diagnosis, run_loop)
    kinematics = kinematic_check() if diagnosis.verdict is not Verdict.CONSISTENT else None
    decides = deciding_maneuver(
        diagnosis,
        request,
        opened.vehicle,
        loop_input.model,
        (*loop_input.records, *loop_input.predicted),
    )
    return context.tracing(loop_input, diagnosis, kinematics, decides)


@dataclass(frozen=True, eq=False)
class _Context:
    """Files, settings and candidate effects of one diagnosis.

    ``effect_files`` : files of the user's own effects.
    """

    request: Request
    opened: OpenedFiles
    effect_files: tuple[InputFile, ...]
    candidates: Sequence[Traceable]
    settings: TraceSettings
    overflows: Overflows

    def _unnamed_files(self) -> tuple[str, ...]:
        beside = vehicle_next_to(self.request.records[0]) if self.request.vehicle is None else None
        return files_read_unnamed([*self.opened.records, *self.opened.validation], beside)

    def tracing(
        self,
        loop_input: LoopInput,
        diagnosis: Diagnosis,
        kinematics: Kinematics | None = None,
        decides: DesignResult | None = None,
    ) -> Tracing:
        """Return the diagnosis with its files, records, model and settings."""
        opened = self.opened
        diagnosis = replace(diagnosis, predictions=_whole(diagnosis.predictions, loop_input.parted))
        if not moves_about_rest(loop_input.model):
            diagnosis = replace(
                diagnosis, derived_before={}, derived_after={}, modes_before=None, modes_after=None
            )
        assert opened.vehicle.identity is not None
        diagnosis, bound_notes = at_bounds(diagnosis, opened.vehicle.constraints)
        return Tracing(
            diagnosis,
            opened.vehicle,
            loop_input.model,
            loop_input.records,
            loop_input.predicted,
            Inputs(
                loop_input.fitted,
                loop_input.validation,
                opened.vehicle.identity,
                self.effect_files,
                opened.vehicle.own_file,
            ),
            loop_input.held_out_from,
            {effect.name: " ".join(effect.explanation.split()) for effect in self.candidates},
            {effect.name: effect.traits for effect in reversed(self.candidates)},
            (
                *self._unnamed_files(),
                *loop_input.notes,
                *constraint_sentences(opened.vehicle.constraints, loop_input.model),
                *bound_notes,
            ),
            loop_input.doubts,
            kinematics,
            loop_input.look,
            self.overflows.count,
            self.settings.effort,
            opened.flown,
            self.request.plan,
            all_simulated([*opened.records, *opened.validation]),
            decides,
        )


def _whole(
    predictions: Sequence[Prediction], parted: Sequence[PartedRecord]
) -> tuple[Prediction, ...]:
    """Return one prediction for each predicted record, joined from those of its parts."""
    if not parted:
        return tuple(predictions)
    joined = []
    for parted_record, span in parts_of(parted, [part.record for part in predictions]):
        parts = predictions[span]
        rows = [[part.before for part in parts], [part.after for part in parts]]
        record, (before, after) = put_together(parted_record, [part.record for part in parts], rows)
        joined.append(Prediction(record, parts[0].channels, before, after))
    return tuple(joined)


def _guards(model: Model) -> Sequence[Traceable]:
    from sim.effects.library import catch_all_terms_for

    return can_act(catch_all_terms_for(model.equations), model)


def _loop(model: Model) -> Trace:
    """Return the tracing loop with the model discrepancy of these equations."""
    from functools import partial

    from ident.tracing.loop import diagnose
    from sim.effects.disturbance.unmeasured_input import discrepancy_for

    return partial(diagnose, discrepancy=discrepancy_for(effects_for(model.equations)))


def _kinematics(opened: OpenedFiles, loop_input: LoopInput, plan: Plan) -> Kinematics | None:
    """Return the kinematic check of the sensors; None if the model is not of an aircraft.

    The check takes the fitted records. If only one record is fitted, the held-out data are added.
    """
    own = opened.vehicle.own
    if not (is_of_aircraft(own) if own is not None else opened.vehicle.model in OF_MODEL):
        return None
    parts = [(file, segment) for file in opened.records for segment in plan.segments]
    one_record = len(loop_input.records) == 1
    if one_record:
        if plan.segments == WHOLE:
            parts += [(file, segment) for file in opened.validation for segment in WHOLE]
    elif not opened.validation:
        # The last part is held out, whole or from a time on.
        last, segment = parts.pop()
        if loop_input.held_out_from is not None:
            parts.append((last, replace(segment, stop=loop_input.held_out_from)))
    kinematics = kinematics_of_files(parts, opened.vehicle, opened.choices, plan)
    with_held_out = one_record and (not opened.validation or plan.segments == WHOLE)
    return replace(kinematics, held_out=with_held_out)
