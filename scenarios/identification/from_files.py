"""Identification on files: records and vehicle put together, a model's parameters found, the other reading of the inputs tried."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from scenarios.files.channel_names import CHANNEL_UNITS
from scenarios.files.measured.record_file import RecordFile, path_of, read_with_validation, refuse_twice
from scenarios.files.own_models import channel_units
from scenarios.files.records import has_clock
from scenarios.files.vehicles import VehicleFile, read_beside, read_vehicle, refuse_unknown_model, vehicle_beside
from scenarios.identification.assessment.intervals import SETTLED
from scenarios.identification.assessment.prediction import pooled_fits
from scenarios.identification.frequency import METHOD as FREQUENCY
from scenarios.identification.identify import identify
from scenarios.identification.input_reading import WORDS, OtherReading, opposite, other_reading
from scenarios.identification.methods import FILTERS, METHODS, forced, uses_attitude
from scenarios.identification.result import PLAIN, Identification, Options
from scenarios.identification.sigma_cautions import disturbed_outputs
from scenarios.identification.wild_points import left_out, same_points, wild_points, with_wild_points, without
from scenarios.preparation.cruise import cruise_caution
from scenarios.preparation.interpreting import BETTER, held_by_computer, likelier_by
from scenarios.preparation.plan import BY_HAND
from scenarios.preparation.plausibility import refuse_still, refuse_strangers, refuse_unpredictable
from scenarios.preparation.reading import prepare
from scenarios.preparation.request import Request, column_choices, flown_of, reading_options
from scenarios.preparation.vehicle_model import model_of_file
from sim.errors import DeclarationError
from sim.record import Hold, Record

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ident.flying_qualities.levels import Flown
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

    # A search for maneuvers resamples nothing: a rate is for files that have no clock of their own.
    opening = reading_options(request, opening=True, rate=not has_clock(files[0], choices))

    def identified(plan: Plan, asked: Options) -> tuple[Prepared, Identification]:
        return _identified(vehicle, method, (files, validation), choices, plan, asked, opening)

    ready, found = identified(request.plan, options)
    if method not in FILTERS and found.record.inputs and request.plan.hold is None and not any(file.sidecar.says_hold for file in files):
        ready, found = _read_otherwise(ready, found, lambda hold, asked: identified(replace(request.plan, hold=hold), asked), options)
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
    opening: Sequence[str] = (),
) -> tuple[Prepared, Identification]:
    """Records prepared by ``plan``, and what a fit to them finds; ``opening``: options of the
    command line that open the files."""
    # The filter of the low-order system has equations of its own, at one speed, and finds the trim itself.
    own = vehicle.model == "loes" and method == "ekf"
    flow, attitude = not own and method != FREQUENCY, uses_attitude(vehicle, method)
    ready = prepare(files[0], model_of_file(vehicle), plan, choices, files[1], flow=flow, attitude=attitude)
    refuse_strangers(ready.fitted, ready.validation)
    refuse_still(ready.fitted, ready.model)
    refuse_unpredictable(ready.predicted, ready.model)
    trusted = plan.trusted or method == FREQUENCY
    first, *others = ready.measured if own else ready.fitted
    notes = ready.notes
    if method in FILTERS and others and len(files[0]) * len(plan.segments) == 1:
        first, others = max((first, *others), key=len), []
        notes = (*notes, f"a filter runs along one part of a record: the longest, {first.name}, is used")

    def fitted(records: Sequence[Record]) -> Identification:
        return identify(records[0], vehicle, method, records[1:], ready.model, ready.validation, asked, trusted=trusted)

    found, masks = _without_wild_points(fitted, (first, *others), trusted=trusted)
    look = with_wild_points(ready.look, (first, *others), masks)
    held = [fit.record for fit in found.fits if fit.held_out]
    look = with_wild_points(look, ready.validation, [left_out(*pair) for pair in zip(ready.validation, held, strict=True)])
    found = replace(found, fits=pooled_fits(found.fits, ready.parted))
    by_name = {record.name: some for record, some in zip((first, *others), masks, strict=True)}
    measured = tuple(without(record, by_name.get(record.name, {})) for record in ready.measured)
    cruise = cruise_caution(ready.measured, files[0][0].identity.name, opening)
    doubts = (*ready.doubts, *([cruise] if cruise else []))
    return replace(ready, measured=measured), replace(found, notes=(*notes, *found.notes), doubts=doubts, look=look)


def _filter_error_proposed(request: Request, vehicle: VehicleFile, found: Identification) -> tuple[str, ...]:
    """The command for filter error, where residuals are as process noise makes them and the model has a place for it."""
    moved = disturbed_outputs([found.record, *found.others], found.estimate, found.tests)
    if not moved:
        return ()
    try:
        forced(model_of_file(vehicle), [found.record])
    except DeclarationError:
        return ()
    paths = [path_of(record) for record in request.records]
    words = [str(path) if path is not None else "RECORD" for path in paths]
    model = request.model if isinstance(request.model, str) else "MODEL"
    given = {"--model": model, "--vehicle": request.vehicle}
    options = [word for option, value in given.items() if isinstance(value, str | Path) for word in (option, str(value))]
    validate = [str(path) for record in request.validate if (path := path_of(record)) is not None]
    options += [*(word for path in validate for word in ("--validate", path)), *reading_options(request)]
    command = shlex.join(["flightid", "identify", *words, *options, "--method", "filter-error"])
    listed = f"{', '.join(moved[:-1])} and {moved[-1]}" if len(moved) > 1 else moved[0]
    return (f"one cause moves the residuals of {listed}, as turbulence does; {command} estimates such noise together with the parameters",)


def _without_wild_points(
    fitted: Callable[[Sequence[Record]], Identification], records: Sequence[Record], *, trusted: bool
) -> tuple[Identification, list[dict[str, np.ndarray]]]:
    """A fit less isolated wrong samples, and these by record and channel; looked for again among all samples once they no longer bend the fit."""
    found = fitted(records)
    masks: list[dict[str, np.ndarray]] = [{} for _ in records]
    for _ in range(0 if trusted else 2):
        fits = [fit for fit in found.fits if not fit.held_out]
        again = wild_points(fits[0].outputs if fits else (), [fit.simulated for fit in fits], records)
        if same_points(again, masks):
            break
        masks = again
        found = fitted([without(record, some) for record, some in zip(records, masks, strict=True)])
    return found, masks


def _read_otherwise(
    ready: Prepared, found: Identification, again: Callable[[Hold, Options], tuple[Prepared, Identification]], options: Options
) -> tuple[Prepared, Identification]:
    """The identification under the reading of its inputs that the data choose, with what the other one changes where they do not choose.

    The first reading was chosen before wild points were set aside; inputs that a computer steps stay held.
    """
    used = found.record.hold
    other_ready, other = again(opposite(used), replace(options, profile=None))
    if any(each.estimate.outcome not in SETTLED for each in (found, other)):
        return ready, found
    gain = _gain(found, other)
    if gain >= BETTER and not all(held_by_computer(record) for record in (found.record, *found.others)):
        if options.profile is not None:
            other_ready, other = again(opposite(used), options)
        decision = OtherReading(opposite(used), used, (), -gain).decision
        chosen = f"inputs {WORDS[opposite(used)]} between samples: {BY_HAND}"
        notes = tuple(decision if note == chosen else note for note in other.notes)
        return other_ready, replace(other, decided=other_reading(opposite(used), other.rows, found.rows, -gain), notes=notes)
    reading = other_reading(used, found.rows, other.rows, gain)
    if reading is not None and reading.decided:
        said = [note for note in found.notes if note.startswith(f"inputs {WORDS[used]} between samples")]
        return ready, replace(found, decided=reading, notes=found.notes if said else (*found.notes, reading.decision))
    return ready, replace(found, reading=reading)


def _gain(found: Identification, other: Identification) -> float:
    """Twice the log likelihood by which the simulations of another identification of the same records fit them better."""
    pairs = [pair for pair in zip(found.fits, other.fits, strict=True) if not pair[0].held_out]
    if not pairs or any(fit.figures is None for pair in pairs for fit in pair):
        return 2.0 * (other.estimate.log_likelihood - found.estimate.log_likelihood)
    residuals: tuple[list[np.ndarray], list[np.ndarray]] = [], []
    known = []
    for pair in pairs:
        measured, valid = pair[0].record.output_array(pair[0].outputs)
        sound = valid & np.isfinite(pair[0].simulated) & np.isfinite(pair[1].simulated)
        known.append(sound)
        for some, fit in zip(residuals, pair, strict=True):
            some.append(np.where(sound, measured - fit.simulated, 0.0))
    return likelier_by(*residuals, known)
