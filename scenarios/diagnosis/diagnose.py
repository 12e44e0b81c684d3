"""The tracing loop on files: records, vehicle and candidates together, a part held out if there is
one, and a maneuver designed that would separate effects that these records cannot.

Types of a diagnosis of files, its model as the study folder keeps it, and overflows counted
during a search.
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
    right_clock,
)
from scenarios.diagnosis.opening import (
    InputReading,
    Opened,
    Posed,
    at_bounds,
    can_act,
    candidates_for,
    opened_files,
    own_effects,
    posed_for,
    settings_of,
    vehicle_path_of,
)
from scenarios.files.declarations import STICK
from scenarios.files.measured.columns import all_simulated, refuse_twice
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
from scenarios.kept import DIAGNOSE, KeptModel, KeptReading
from scenarios.maneuver_design.design import DesignResult, design
from scenarios.maneuver_design.limits import PILOT
from scenarios.maneuver_design.setting import DesignRequest
from scenarios.preparation.declared_model import step_for
from scenarios.preparation.filtering import PartedRecord, parts_of, put_together
from scenarios.preparation.plan import ATTITUDE, LIFT, SPEED, WHOLE, Plan, Request
from scenarios.preparation.recording import NOTHING_SEEN, RecordCheck
from sim.declaration.model import Model
from sim.declaration.proposal import RangedCurve, Traceable, Traits
from sim.effects.library import effects_for
from sim.errors import FlightidError
from sim.record import Record


@dataclass(frozen=True)
class Inputs:
    """All files that a diagnosis rests on; ``validation`` is empty if only a part of a file was
    held out, ``effects`` where none was named.

    ``model`` is the file of a user's own model, None if it is built in.
    """

    records: tuple[InputFile, ...]
    validation: tuple[InputFile, ...]
    vehicle: InputFile
    effects: tuple[InputFile, ...] = ()
    model: InputFile | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Tracing:
    """A diagnosis with what it was made from.

    Attributes
    ----------
    records, validation : fitted and predicted records.
    held_out_from : time (s) at which the last record was cut; None for whole predicted records.
    explanations, traits : of the candidates, by name.
    notes : on the preparation of the records.
    doubts : likely faults of the files.
    kinematics : results without aerodynamics, None if not computed.
    look : check of the raw columns.
    overflows : computations that overflowed and were skipped.
    plan : preparation of the records.
    effort : of the search.
    flown : aircraft class and flight phase for levels of flying qualities.
    decides : for an ambiguous diagnosis, the maneuver that would decide it.
    simulated : all records are simulated, according to their JSON files.
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


SPIKES = "sensor-spikes:"


def kept_diagnosis(tracing: Tracing) -> KeptModel | None:
    """Return the final model of a diagnosis; None if its trained values are unknown."""
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
    """Counter of overflowed computations, which the loop skips."""

    count: int = 0

    def __call__(self, kind: str, flag: int) -> None:
        """Handle an overflow or invalid result, as NumPy's error callback."""
        self.count += 1

    def counted(self, trace: Trace) -> Trace:
        """Return the same loop, its overflows counted instead of warned of; a share below the
        smallest number is none.
        """

        def counting(*arguments: Any, **named: Any) -> Diagnosis:
            with np.errstate(over="call", invalid="call", divide="call", under="ignore", call=self):
                return trace(*arguments, **named)

        return counting


DESIGN_DIGITS = 4  # digits of a design's inputs, so that printed numbers repeat it
# s, shortest and longest flight of a design
SHORTEST, LONGEST = 10.0, 20.0
# a hand is quicker, in peaks a second, where it does not go to the full deflection
SMALLER_DEFLECTION_RATE = 2.0


def deciding_maneuver(
    d: Diagnosis, request: Request, vehicle: VehicleFile, model: Model, records: Sequence[Record]
) -> DesignResult | None:
    """Return the design of a deciding maneuver for an ambiguous diagnosis; None if not possible.

    Peak deflections, sampling and noise are those of the records; derivatives and effects have
    their estimated values.
    """
    asked = _asked(d, request, vehicle, model, records) if d.verdict is Verdict.AMBIGUOUS else None
    if asked is None:
        return None
    try:
        return design(asked)
    except FlightidError:
        return None  # as a law of the user's own, or a model without an input


def _asked(
    d: Diagnosis, request: Request, vehicle: VehicleFile, model: Model, records: Sequence[Record]
) -> DesignRequest | None:
    doubtful = [claim for claim in d.effects if claim.claimed and claim.alternatives]
    known = {
        effect.name: effect
        for effect in effects_for(model.equations)
        if isinstance(effect, Traceable)
    }
    if not doubtful or not model.equations.inputs:
        return None
    claim = doubtful[0]
    # Equivalent effects cannot be separated by any flight. Use one rival, the simplest form.
    rivals = (
        [
            name
            for name in claim.alternatives
            if name in known and name not in known[claim.name].traits.equivalents
        ]
        if claim.name in known
        else []
    )
    if not rivals:
        return None
    names = (claim.name, min(rivals, key=lambda name: len(known[name].parameters)))
    values = [
        _text(name, q.value) for name, q in d.after.items() if name in model.parameters.free_names
    ]
    noise = [_text(name, std) for name, std in d.residual_std.items() if std > 0.0]
    interval = float(np.median(np.diff(records[0].time)))
    span = min(
        LONGEST, max(SHORTEST, float(max(record.time[-1] - record.time[0] for record in records)))
    )
    return DesignRequest(
        model=request.model,
        vehicle=_source(request, vehicle),
        tell=names,
        size=",".join(_size(claim, d)),
        values=tuple(values),
        noise=tuple(noise),
        amplitude=tuple(
            _text(name, size) for name, size in _peaks(model, records).items() if size > 0.0
        ),
        duration=float(f"{span:.{DESIGN_DIGITS}g}"),
        rate=float(f"{1.0 / interval:.{DESIGN_DIGITS}g}"),
        computer=not by_hand(model, records),
        command_names=_names(request, vehicle),
    )


def by_hand(model: Model, records: Sequence[Record]) -> bool:
    """Return whether no input of the records changes faster than a pilot's hand can; faster inputs
    are from a flight computer, which can fly the next maneuver as well.
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


def _size(claim: Claim, d: Diagnosis) -> list[str]:
    """The claimed effect's own parameters, and of a curve the range that it was fitted over."""
    effects: Sequence[Traceable] = d.trained_after.effects if d.trained_after is not None else ()
    form = next((effect for effect in effects if effect.name == claim.name), None)
    own = {item.name for item in form.parameters} if form is not None else set()
    texts = [_text(name, q.value) for name, q in claim.parameters.items() if name in own]
    return texts + (
        [_text("low", form.low), _text("high", form.high)] if isinstance(form, RangedCurve) else []
    )


def _peaks(model: Model, records: Sequence[Record]) -> dict[str, float]:
    """Return the largest deflection of each input from where its record begins."""
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
    """Return the vehicle file as it was read; None if an own model went without one."""
    from scenarios.diagnosis.opening import vehicle_path_of

    path = vehicle_path_of(request)
    if path is None or isinstance(path, Source):
        return path
    assert vehicle.identity is not None
    return Source(path, vehicle.text.encode(), vehicle.identity)


def _names(request: Request, vehicle: VehicleFile) -> Mapping[str, str]:
    """Return the names of model and vehicle file for a command line."""
    from scenarios.diagnosis.opening import vehicle_path_of

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
    """Read everything, run the loop, and return its result with what went in.

    Parameters
    ----------
    request : the files and how they are read. With none to validate on, the last of several
        records, or the last part of one, is held out.
    progress : called with the stage and the share done, 0 to 1.
    trace : the loop; None takes ``ident.tracing.loop.diagnose``.

    Raises
    ------
    FlightidError : anything in the files that keeps them from being used.
    """
    refuse_unknown_model(request.model, "--model")
    usual = settings_of(request.effort)
    refuse_twice(
        [*request.records, *request.validate],
        "name each record once, for the fit or for --validate",
    )
    progress("reading", 0.0)
    opened = opened_files(request, vehicle_path_of(request))
    posed = posed_for(opened, request.plan)
    settings = replace(usual, max_step=step_for(posed.model, posed.records, usual.max_step))
    own, of_effects = own_effects(request.effects, posed.model)
    candidates, guards = candidates_for(posed.model, own), _guards(posed.model)
    measured = {name for record in posed.records for name in record.output_names}
    absent = {signal.name for signal in posed.model.equations.outputs} - measured
    candidates = tuple(  # a sensor that is not recorded cannot be what is missing
        each for each in candidates if each in own or getattr(each, "channel", "") not in absent
    )
    if note := right_clock(posed.measured):
        candidates = tuple(each for each in candidates if each.name != CLOCK)
        posed = replace(posed, notes=(*posed.notes, note))
    run = (overflows := Overflows()).counted(trace or _loop(posed.model))
    study = _Study(request, opened, of_effects, candidates, settings, overflows)

    # The check costs as much as some candidates: it is made where the declared model is not enough.
    checks: list[Kinematics | None] = []

    def checked() -> Kinematics | None:
        if not checks:
            checks.append(_kinematics(opened, posed, request.plan))
        return checks[0]

    def looped(posed: Posed, reread: Callable[[], Data] | None = None) -> Diagnosis:
        given = (
            posed.records,
            posed.model,
            candidates,
            guards,
            posed.predicted,
            settings,
            progress,
        )
        return run(*given, kinematics=lambda: _named_by_kinematics(checked()), reread=reread)

    reading = InputReading(opened, request.plan)
    diagnosis = looped(posed, reading.offered(posed))
    posed, diagnosis = reading.settled(posed, diagnosis, looped)
    kinematics = checked() if diagnosis.verdict is not Verdict.CONSISTENT else None
    return study.told(posed, diagnosis, kinematics, _decides(diagnosis, request, opened, posed))


@dataclass(frozen=True, eq=False)
class _Study:
    """Context of a result: files, their preparation, and candidate effects."""

    request: Request
    opened: Opened
    of_effects: tuple[InputFile, ...]
    candidates: Sequence[Traceable]
    settings: TraceSettings
    overflows: Overflows

    def _read_beside(self) -> tuple[str, ...]:
        """Return the files that were read without being named."""
        beside = vehicle_next_to(self.request.records[0]) if self.request.vehicle is None else None
        return files_read_unnamed([*self.opened.records, *self.opened.validation], beside)

    def told(
        self,
        posed: Posed,
        diagnosis: Diagnosis,
        kinematics: Kinematics | None = None,
        decides: DesignResult | None = None,
    ) -> Tracing:
        """Return the result with what went in."""
        opened = self.opened
        diagnosis = replace(diagnosis, predictions=_whole(diagnosis.predictions, posed.parted))
        if not moves_about_rest(posed.model):
            diagnosis = replace(
                diagnosis, derived_before={}, derived_after={}, modes_before=None, modes_after=None
            )
        assert opened.vehicle.identity is not None
        diagnosis, pressed = at_bounds(diagnosis, opened.vehicle.constraints)
        return Tracing(
            diagnosis,
            opened.vehicle,
            posed.model,
            posed.records,
            posed.predicted,
            Inputs(
                posed.fitted,
                posed.validation,
                opened.vehicle.identity,
                self.of_effects,
                opened.vehicle.own_file,
            ),
            posed.held_out_from,
            {effect.name: " ".join(effect.explanation.split()) for effect in self.candidates},
            {effect.name: effect.traits for effect in reversed(self.candidates)},
            (
                *self._read_beside(),
                *posed.notes,
                *constraint_sentences(opened.vehicle.constraints, posed.model),
                *pressed,
            ),
            posed.doubts,
            kinematics,
            posed.look,
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
    """Return the predictions with the parts of each record that was named for it put together."""
    if not parted:
        return tuple(predictions)
    out = []
    for one, span in parts_of(parted, [each.record for each in predictions]):
        some = predictions[span]
        rows = [[each.before for each in some], [each.after for each in some]]
        record, (before, after) = put_together(one, [each.record for each in some], rows)
        out.append(Prediction(record, some[0].channels, before, after))
    return tuple(out)


def _decides(
    diagnosis: Diagnosis, request: Request, opened: Opened, posed: Posed
) -> DesignResult | None:
    """Return the maneuver that would decide; only an ambiguous verdict costs its time."""
    if diagnosis.verdict is not Verdict.AMBIGUOUS:
        return None

    return deciding_maneuver(
        diagnosis, request, opened.vehicle, posed.model, (*posed.records, *posed.predicted)
    )


def _guards(model: Model) -> Sequence[Traceable]:
    from sim.effects.library import catch_all_terms_for

    return can_act(catch_all_terms_for(model.equations), model)


def _loop(model: Model) -> Trace:
    """Return the tracing loop, with terms for errors of this model's forces."""
    from functools import partial

    from ident.tracing.loop import diagnose
    from sim.effects.disturbance.unmeasured_input import discrepancy_for
    from sim.effects.library import effects_for

    return partial(diagnose, discrepancy=discrepancy_for(effects_for(model.equations)))


def _named_by_kinematics(kinematics: Kinematics | None) -> list[tuple[str, ...]]:
    """Return the names of the effects that the kinematics alone name."""
    from scenarios.diagnosis.kinematics import named_by

    return named_by(kinematics)


def _kinematics(opened: Opened, posed: Posed, plan: Plan) -> Kinematics | None:
    """Return the check of the kinematics alone: on all that was read where one record is fitted,
    else on the fitted records; None if there is none.
    """
    own = opened.vehicle.own
    if not (is_of_aircraft(own) if own is not None else opened.vehicle.model in OF_MODEL):
        return None
    parts = [(file, segment) for file in opened.records for segment in plan.segments]
    if len(posed.records) == 1:
        parts += (
            [(file, segment) for file in opened.validation for segment in WHOLE]
            if plan.segments == WHOLE
            else []
        )
    elif not opened.validation:
        (last, segment) = parts.pop()
        parts += (
            [(last, replace(segment, stop=posed.held_out_from))]
            if posed.held_out_from is not None
            else []
        )
    found = kinematics_of_files(parts, opened.vehicle, opened.choices, plan)
    alone = len(posed.records) == 1 and (not opened.validation or plan.segments == WHOLE)
    return replace(found, held_out=alone)
