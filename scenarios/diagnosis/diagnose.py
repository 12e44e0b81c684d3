"""The tracing loop on files: records, vehicle and candidates put together, something held out where
no record is named for it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ident.tracing.diagnosis import Data, Diagnosis, Prediction, Verdict
from scenarios.diagnosis.candidates import can_act, candidates_for
from scenarios.diagnosis.effort import settings_of
from scenarios.diagnosis.input_reading import InputReading
from scenarios.diagnosis.kinematic_records import OF_MODEL, kinematics_of_files
from scenarios.diagnosis.laid_down import at_bounds, said_of
from scenarios.diagnosis.opening import (
    Opened,
    Posed,
    opened_files,
    own_effects,
    posed_for,
    vehicle_path_of,
)
from scenarios.diagnosis.overflows import Overflows, Trace
from scenarios.diagnosis.tracing import Inputs, Tracing
from scenarios.files.measured.columns import all_simulated, refuse_twice
from scenarios.files.user_models import is_of_aircraft, moves_about_rest
from scenarios.files.vehicles import files_read_unnamed, refuse_unknown_model, vehicle_next_to
from scenarios.preparation.declared_model import step_for
from scenarios.preparation.plan import WHOLE, Plan, Request
from scenarios.preparation.reading import Parted, parts_of, put_together
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable

if TYPE_CHECKING:
    from ident.tracing.settings import TraceSettings
    from scenarios.diagnosis.kinematics import Kinematics
    from scenarios.files.sources import InputFile
    from scenarios.maneuver_design.design import DesignResult


def diagnose_files(
    request: Request,
    progress: Callable[[str, float], None] = lambda stage, share: None,
    trace: Trace | None = None,
) -> Tracing:
    """Read everything, run the loop, and return its result with what went in.

    Parameters
    ----------
    request : the files and how they are read. With none to validate on, the last of several
    records, or the last part of one, is held out. progress : told the stage and the share done, 0
    to 1. trace : the loop; None takes ``ident.tracing.loop.diagnose``.

    Raises
    ------
    FlightidError : anything in the files that keeps them from being used, in one line.
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
    """What a result is told with: the files, how they were read, and what could be claimed."""

    request: Request
    opened: Opened
    of_effects: tuple[InputFile, ...]
    candidates: Sequence[Traceable]
    settings: TraceSettings
    overflows: Overflows

    def _read_beside(self) -> tuple[str, ...]:
        """The files that were read without being named."""
        beside = vehicle_next_to(self.request.records[0]) if self.request.vehicle is None else None
        return files_read_unnamed([*self.opened.records, *self.opened.validation], beside)

    def told(
        self,
        posed: Posed,
        diagnosis: Diagnosis,
        kinematics: Kinematics | None = None,
        decides: DesignResult | None = None,
    ) -> Tracing:
        """The result with what went in."""
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
                *said_of(opened.vehicle.constraints, posed.model),
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


def _whole(predictions: Sequence[Prediction], parted: Sequence[Parted]) -> tuple[Prediction, ...]:
    """The predictions with the parts of each record that was named for it put together."""
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
    """The maneuver that would decide; only an ambiguous verdict costs its time."""
    if diagnosis.verdict is not Verdict.AMBIGUOUS:
        return None
    from scenarios.diagnosis.deciding import deciding_maneuver

    return deciding_maneuver(
        diagnosis, request, opened.vehicle, posed.model, (*posed.records, *posed.predicted)
    )


def _guards(model: Model) -> Sequence[Traceable]:
    from sim.effects.library import catch_all_terms_for

    return can_act(catch_all_terms_for(model.equations), model)


def _loop(model: Model) -> Trace:
    """The tracing loop, with what stands for errors of this model's forces."""
    from functools import partial

    from ident.tracing.loop import diagnose
    from sim.effects.library import effects_for
    from sim.effects.model_discrepancy import discrepancy_for

    return partial(diagnose, discrepancy=discrepancy_for(effects_for(model.equations)))


def _named_by_kinematics(kinematics: Kinematics | None) -> list[tuple[str, ...]]:
    """Names of the effects that the kinematics alone name."""
    from scenarios.diagnosis.kinematics import named_by

    return named_by(kinematics)


def _kinematics(opened: Opened, posed: Posed, plan: Plan) -> Kinematics | None:
    """The check of the kinematics alone: on all that was read where one record is fitted, else on
    the fitted records; None where there is none.
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
    return kinematics_of_files(parts, opened.vehicle, opened.choices, plan)
