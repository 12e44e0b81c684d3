"""Identification on files: records and vehicle put together, a model's parameters found, the other reading of the inputs tried."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from scenarios.files.channel_names import CHANNEL_UNITS
from scenarios.files.measured.record_file import RecordFile, path_of, read_with_validation, refuse_twice
from scenarios.files.own_models import channel_units
from scenarios.files.vehicles import VehicleFile, read_beside, read_vehicle, refuse_unknown_model, vehicle_beside
from scenarios.identification.assessment.intervals import SETTLED
from scenarios.identification.frequency import METHOD as FREQUENCY
from scenarios.identification.identify import identify
from scenarios.identification.input_reading import opposite, other_reading
from scenarios.identification.methods import FILTERS, METHODS, forced, uses_attitude
from scenarios.identification.result import PLAIN, Identification, Options
from scenarios.identification.sigma_cautions import slow_residuals
from scenarios.preparation.cruise import cruise_caution
from scenarios.preparation.plausibility import refuse_still, refuse_strangers, refuse_unpredictable
from scenarios.preparation.reading import prepare
from scenarios.preparation.request import Request, column_choices, flown_of
from scenarios.preparation.vehicle_model import model_of_file
from sim.errors import DeclarationError
from sim.record import Hold, Record

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ident.flying_qualities.mode_levels import Flown
    from scenarios.files.channels import ColumnChoice
    from scenarios.preparation.plan import Plan
    from scenarios.preparation.reading import Prepared


@dataclass(frozen=True, eq=False, repr=False)
class Identified:
    """An identification with what it was made from.

    ``flown``: by which class and category levels of flying qualities are told. ``measured``: the fitted records as they would be written.
    ``files`` are those of the fit, ``validation`` those that were predicted; ``plan``: how all were read.
    """

    found: Identification
    flown: Flown
    measured: tuple[Record, ...]
    files: tuple[RecordFile, ...]
    validation: tuple[RecordFile, ...]
    plan: Plan

    def __repr__(self) -> str:
        return f"<Identified: {self.found!r}>"


def identify_files(request: Request, method: str, options: Options = PLAIN) -> Identified:
    """Read everything, fit, and say what the other reading of the inputs between samples would change where nobody said how to read them.

    Raises
    ------
    FlightidError : anything asked or in the files that keeps them from being used, in one line.
    """
    refuse_unknown_model(request.model, "--model")
    if method not in METHODS:
        raise DeclarationError(f"there is no method {method!r}", where="--method", remedy=f"use one of {', '.join(METHODS)}")
    refuse_twice([*request.records, *request.validate], "name each record once, for the fit or for --validate")
    beside = vehicle_beside(request.records[0]) if request.vehicle is None else None
    vehicle = read_vehicle(request.vehicle or beside, request.model)
    flown = flown_of(request, vehicle)
    choices = column_choices(request, channel_units(vehicle.own) if vehicle.own is not None else CHANNEL_UNITS)
    files, validation = read_with_validation(request.records, request.validate)

    def identified(plan: Plan, asked: Options) -> tuple[Prepared, Identification]:
        return _identified(vehicle, method, (files, validation), choices, plan, asked)

    ready, found = identified(request.plan, options)
    if method not in FILTERS and found.record.inputs and request.plan.hold is None and not any(file.sidecar.says_hold for file in files):
        found = _read_otherwise(found, lambda hold: identified(replace(request.plan, hold=hold), replace(options, profile=None))[1])
    proposed = _filter_error_proposed(request, vehicle, found)
    found = replace(found, notes=(*read_beside([*files, *validation], beside), *found.notes, *proposed))
    return Identified(found, flown, ready.measured, files, validation, request.plan)


def _identified(
    vehicle: VehicleFile,
    method: str,
    files: tuple[tuple[RecordFile, ...], tuple[RecordFile, ...]],
    choices: Mapping[str, ColumnChoice] | None,
    plan: Plan,
    asked: Options,
) -> tuple[Prepared, Identification]:
    """Records prepared by ``plan``, and what a fit to them finds."""
    # The filter of the low-order system has equations of its own, at one speed, and finds the trim itself.
    own = vehicle.model == "loes" and method == "ekf"
    flow, attitude = not own and method != FREQUENCY, uses_attitude(vehicle, method)
    ready = prepare(files[0], model_of_file(vehicle), plan, choices, files[1], flow=flow, attitude=attitude)
    refuse_strangers(ready.fitted, ready.validation)
    refuse_still(ready.fitted, ready.model)
    refuse_unpredictable(ready.validation, ready.model)
    first, *others = ready.measured if own else ready.fitted
    notes = ready.notes
    if method in FILTERS and others and len(files[0]) * len(plan.segments) == 1:
        first, others = max((first, *others), key=len), []
        notes = (*notes, f"a filter runs along one part of a record: the longest, {first.name}, is used")
    found = identify(first, vehicle, method, others, ready.model, ready.validation, asked)
    cruise = cruise_caution(ready.measured, files[0][0].identity.name)
    doubts = (*ready.doubts, *([cruise] if cruise else []))
    return ready, replace(found, notes=(*notes, *found.notes), doubts=doubts, look=ready.look)


def _filter_error_proposed(request: Request, vehicle: VehicleFile, found: Identification) -> tuple[str, ...]:
    """The command for filter error, where residuals are as process noise makes them and the model has a place for it."""
    slow = slow_residuals([found.record, *found.others], found.estimate, found.tests)
    if not slow:
        return ()
    try:
        forced(model_of_file(vehicle), [found.record])
    except DeclarationError:
        return ()
    paths = [path_of(record) for record in request.records]
    words = [str(path) if path is not None else "RECORD" for path in paths]
    model = request.model if isinstance(request.model, str) else "MODEL"
    given = {"--model": model, "--vehicle": request.vehicle, "--channels": request.channels}
    options = [word for option, value in given.items() if isinstance(value, str | Path) for word in (option, str(value))]
    command = " ".join(["flightid identify", *words, *options, "--method filter-error"])
    listed = f"{', '.join(slow[:-1])} and {slow[-1]}"
    return (f"the residuals of {listed} change slowly, as turbulence makes them; {command} estimates such noise together with the parameters",)


def _read_otherwise(found: Identification, again: Callable[[Hold], Identification]) -> Identification:
    """The identification with what the other reading of its inputs changes, where it says anything."""
    used = found.record.hold
    other = again(opposite(used))
    if any(each.estimate.outcome not in SETTLED for each in (found, other)):
        return found
    gain = 2.0 * (other.estimate.log_likelihood - found.estimate.log_likelihood)
    return replace(found, reading=other_reading(used, found.rows, other.rows, gain))
