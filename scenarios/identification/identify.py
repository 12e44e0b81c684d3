"""Identification of measured records, from arrays and from files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.modes import characteristics, modal_estimate
from ident.statistics.profile_likelihood import ProfileInterval
from ident.statistics.residuals import ResidualTest, tests_of_records
from ident.whole_record.layout import FitSettings
from scenarios.files.declarations import CHANNEL_UNITS, closest
from scenarios.files.measured.columns import RecordFile, read_with_validation, refuse_duplicates
from scenarios.files.records import has_clock
from scenarios.files.user_models import channel_units, constraint_sentences, moves_about_rest
from scenarios.files.vehicles import (
    VehicleFile,
    files_read_unnamed,
    read_vehicle,
    refuse_unknown_model,
    vehicle_next_to,
)
from scenarios.identification.assessment import (
    DEFAULT_OPTIONS,
    SETTLED,
    WORDS,
    IdentificationResult,
    Options,
    OtherReading,
    RecordFit,
    fit_within_bounds,
    opposite,
    other_reading,
    pooled_fits,
    profiled,
    record_fits,
    tied_rows,
    values_for_prediction,
)
from scenarios.identification.cautions import (
    cautions_of,
    failed,
    filter_error_proposed,
    record_cautions,
    sigma_cautions,
    unusable_sigmas,
)
from scenarios.identification.conditions import METHOD as FREQUENCY
from scenarios.identification.conditions import (
    PATH,
    chosen_band,
    delays_of,
    with_weight_if_needed,
    without_theta,
)
from scenarios.identification.methods import (
    FILTERS,
    METHODS,
    engine_of,
    estimated_by,
    forced,
    refuse_method,
    uses_attitude,
)
from scenarios.identification.model_checks import consider, considered_sentences
from scenarios.preparation.declared_model import (
    DECISIVE_LOG_LIKELIHOOD_RATIO,
    held_by_computer,
    log_likelihood_gain,
    model_of_file,
    outputs_with_bias,
    sub_step,
    with_hold,
)
from scenarios.preparation.plan import (
    BY_HAND,
    Request,
    column_choices,
    declared_phase,
    reading_options,
)
from scenarios.preparation.plausibility import (
    cruise_caution,
    not_recorded,
    refuse_still,
    refuse_too_few,
    refuse_unpredictable,
    refuse_unrelated_records,
)
from scenarios.preparation.reading import prepare, refuse_unfit_records
from scenarios.preparation.recording import (
    left_out,
    repeated_without_outliers,
    with_outliers,
    without,
)
from scenarios.studies.declaration import rows_of
from scenarios.studies.estimating import FIT_STEP
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System, Tie
from sim.effects.disturbance.airspeed import ATTITUDE, SPEED
from sim.errors import DeclarationError
from sim.record import Hold, Record

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ident.flying_qualities.levels import FlightPhase
    from scenarios.files.declarations import ColumnChoice
    from scenarios.preparation.plan import Plan
    from scenarios.preparation.reading import PreparedData


# ---- Identification of a measured record, with noise levels from the data

# Methods that fit a free simulation.
SIMULATED = ("output-error", FREQUENCY)
PHUGOID_STATES = (SPEED, ATTITUDE)  # left out of the modes of the short period


def identify(
    record: Record,
    vehicle: VehicleFile,
    method: str,
    others: Sequence[Record] = (),
    model: Model | None = None,
    held_out: Sequence[Record] = (),
    options: Options = DEFAULT_OPTIONS,
    *,
    trusted: bool = False,
) -> IdentificationResult:
    """Estimate the parameters of a vehicle file's model from one record or several.

    Each output except an altitude has a bias; a user model names the outputs that have one. Each
    record has its own initial state. A filter takes its measurement noise and its start from an
    output-error fit and its initial state from the first samples, and is iterated. ``filter-error``
    models Dryden turbulence of unknown intensity for an aircraft, and white noise for a falling
    body.

    Parameters
    ----------
    record, others : the first and the further records that are fitted.
    vehicle : the vehicle file.
    method : one of ``METHODS``.
    model : the model of the vehicle file, possibly with the measured flow as further inputs; None:
        that of the file.
    held_out : records that are predicted.
    trusted : whether wild points of ``held_out`` are kept.

    Raises
    ------
    DeclarationError : the method is unknown.
    ModelError : the record has none of the model's outputs.
    RecordError : a number is too large.
    """
    records: Sequence[Record] = [record, *others]
    refuse_method([*records, *held_out], vehicle, method, options, len(records))
    if vehicle.model == "loes" and method == "ekf":
        from scenarios.identification.low_order import identify_low_order

        return identify_low_order(record, vehicle, held_out, options.engine, trusted=trusted)
    model = model or model_of_file(vehicle)
    model, records, held_out, weight_note = _declared(model, records, held_out, vehicle, method)
    outputs = _measured(model, records)
    sensors = outputs_with_bias(model, outputs) if vehicle.model != "ballistic" else []
    biased = model.with_biases(sensors)
    # Only a prior fixes the scale of an elastic coordinate. Filters have no bounds.
    settings = FitSettings(sub_step(model, records, FIT_STEP), use_priors=bool(vehicle.modes))
    if method == FREQUENCY:
        options = replace(options, band=chosen_band(records, biased, outputs, options.band))
    is_filter, is_simulated = method in FILTERS, method in SIMULATED
    estimated = partial(estimated_by, method=method, settings=settings, options=options)

    def fit(candidate: Model) -> tuple[System, Estimate]:
        return estimated(records, candidate, outputs)

    bounded, system, estimate, at_bounds = fit_within_bounds(biased, fit, respected=not is_filter)
    tests = tests_of_records(estimate, records)
    alone = partial(_best_alone, model=bounded, sensors=sensors, estimated=estimated)
    # Exact constants; their uncertainty widens the sigmas below.
    with_exact_constants = estimate
    start = _started_at(estimate, bounded, starts_are_priors=bool(vehicle.modes) or is_filter)
    estimate, considered = consider(
        start, vehicle.uncertainty, with_exact_constants, lambda candidate: fit(candidate)[1]
    )
    rows, bias_names = rows_of(estimate), [f"bias_{name}" for name in biased.biases]
    has_modes = _has_modes(vehicle, model, estimate)
    in_system, compiled = estimate.only(system.parameters.names), compile_model(bounded, outputs)
    return IdentificationResult(
        record,
        vehicle,
        method,
        estimate,
        tuple(row for row in rows if row.name not in bias_names),
        tuple(row for row in rows if row.name in bias_names),
        _derived(vehicle, system, estimate, in_system if has_modes else None),
        _fixed(biased, model.ties),
        tests,
        tuple(others),
        notes=(
            *filter(None, (weight_note, estimate.message)),
            *constraint_sentences(vehicle.constraints, model),
        ),
        cautions=(
            *(failed(records, estimate, rows, vehicle.derivatives) if is_simulated else ()),
            *(record_cautions(records, tests, alone) if is_simulated else ()),
            *cautions_of(vehicle, estimate, rows),
            *sigma_cautions(records, with_exact_constants, compiled, tests, [PATH]),
            *considered_sentences(considered),
        ),
        modes=characteristics(system, in_system, PHUGOID_STATES) if has_modes else None,
        system=system,
        tied=tied_rows(bounded, estimate),
        at_bounds=at_bounds,
        intervals=_intervals(records, bounded, outputs, with_exact_constants, settings, options),
        band=options.band,
        fits=_fits(records, held_out, compiled, estimate, settings, trusted=trusted),
        trained=values_for_prediction(compiled, estimate.as_dict(), settings),
        engine=engine_of(method, options),
        considered=considered,
    )


def _has_modes(vehicle: VehicleFile, model: Model, estimate: Estimate) -> bool:
    """Return whether modes of the estimated model have a meaning: about a rest, and finite."""
    if vehicle.model == "ballistic" or not moves_about_rest(model):
        return False
    return bool(np.all(np.isfinite(estimate.values)))


def _fixed(model: Model, ties: Sequence[Tie]) -> dict[str, tuple[float, str]]:
    """Return the value and unit of each fixed parameter that no tie determines."""
    tied = {tie.name for tie in ties}
    return {
        item.name: (item.value, item.unit)
        for item in model.parameters
        if not item.free and item.name not in tied
    }


def _started_at(estimate: Estimate, model: Model, *, starts_are_priors: bool) -> Model:
    """Return the model with its starts at the estimate, unless the starts are priors."""
    if starts_are_priors or not np.all(np.isfinite(estimate.values)):
        return model
    values = estimate.as_dict().items()
    return model.with_values({name: value for name, value in values if name in model.parameters})


def _declared(
    model: Model,
    records: Sequence[Record],
    held_out: Sequence[Record],
    vehicle: VehicleFile,
    method: str,
) -> tuple[Model, Sequence[Record], Sequence[Record], str]:
    """Return model, fitted and held-out records for the method, and a note on a measured attitude.

    If the method cannot use the attitude, it is taken out of the records. Otherwise the model gets
    the weight along the flight path, if the records prefer that.
    """
    if vehicle.own is not None:
        return model, records, held_out, ""
    if not uses_attitude(vehicle, method):
        model, without = without_theta(model, [*records, *held_out])
        records, held_out = without[: len(records)], without[len(records) :]
    model, weight_note = with_weight_if_needed(model, records, _measured(model, records))
    return model, records, held_out, weight_note


def _measured(model: Model, records: Sequence[Record]) -> list[str]:
    """Return the outputs of the model that at least one record has."""
    return [
        signal.name
        for signal in model.equations.outputs
        if any(signal.name in record.output_names for record in records)
    ]


def _derived(
    vehicle: VehicleFile, system: System, estimate: Estimate, modal: Estimate | None
) -> dict[str, tuple[float, float]]:
    """Return value and sigma of modal quantities, and of the delay of a low-order system.

    ``modal``: estimate of the parameters of ``system``; None if it has no modes.
    """
    derived = modal_estimate(system, modal, PHUGOID_STATES) if modal is not None else {}
    if vehicle.model == "loes" and "delay" in estimate.names:
        derived["delay"] = estimate.value("delay"), estimate.sigma("delay")
    return derived


def _fits(
    records: Sequence[Record],
    held_out: Sequence[Record],
    system: System,
    estimate: Estimate,
    settings: FitSettings,
    *,
    trusted: bool,
) -> tuple[RecordFit, ...]:
    """Return free simulations of all records; those that the estimate has are not repeated."""
    simulated = (
        estimate.fitted
        if estimate.method in SIMULATED and estimate.output_names == system.output_names
        else ()
    )
    return record_fits(
        records, held_out, system, estimate.as_dict(), settings, [PATH], simulated, trusted=trusted
    )


def _intervals(
    records: Sequence[Record],
    model: Model,
    outputs: list[str],
    estimate: Estimate,
    settings: FitSettings,
    options: Options,
) -> tuple[ProfileInterval, ...]:
    """Return profile-likelihood intervals if the options ask for them."""
    if options.profile is None:
        return ()
    without_noise = compile_model(model, outputs)
    system = without_noise
    if estimate.method == "filter-error":
        system = compile_model(forced(model, records), outputs)
    return profiled(
        estimate,
        records,
        system,
        settings,
        options.profile,
        without_noise=without_noise,
        local=[PATH],
        delays=delays_of(model),
        band=options.band,
    )


def _best_alone(
    record: Record,
    model: Model,
    sensors: Sequence[str],
    estimated: Callable[[Sequence[Record], Model, list[str]], tuple[System, Estimate]],
) -> tuple[Estimate, Sequence[ResidualTest]]:
    """Return the estimate from one record and its tests, with the hold that passes more tests.

    Records that contradict each other may have been read with the wrong hold. ``sensors``: outputs
    that have a bias.
    """
    outputs = _measured(model, [record])
    biased = model.with_biases([name for name in sensors if name in outputs])
    readings = [[record], *([with_hold([record], opposite(record.hold))] if record.inputs else [])]
    fits = [(estimated(read, biased, outputs)[1], read) for read in readings]
    results = [(estimate, tests_of_records(estimate, read)) for estimate, read in fits]
    return max(results, key=lambda result: sum(test.passed for test in result[1]))


# ---- Identification on files


@dataclass(frozen=True, eq=False, repr=False)
class Identified:
    """An identification and its inputs.

    Attributes
    ----------
    found : the result.
    flown : aircraft class and flight phase, for levels of flying qualities.
    measured : the fitted records, as they are written to files.
    files : record files that were fitted.
    validation : record files that were predicted.
    plan : preparation of the records.
    """

    found: IdentificationResult
    flown: FlightPhase
    measured: tuple[Record, ...]
    files: tuple[RecordFile, ...]
    validation: tuple[RecordFile, ...]
    plan: Plan

    def __repr__(self) -> str:
        return f"<Identified: {self.found!r}>"


def identify_files(request: Request, method: str, options: Options = DEFAULT_OPTIONS) -> Identified:
    """Read the files and fit them.

    If no file states the hold of the inputs, the fit is repeated with the other hold. The data
    choose between both, or the result reports what changes.

    Raises
    ------
    FlightidError : the request or a file cannot be used.
    """
    refuse_unknown_model(request.model, "--model")
    if method not in METHODS:
        raise DeclarationError(
            f"there is no method {method!r}", where="--method", remedy=closest(method, METHODS)
        )
    refuse_duplicates(
        [*request.records, *request.validate],
        "name each record once, for the fit or for --validate",
    )
    beside = vehicle_next_to(request.records[0]) if request.vehicle is None else None
    vehicle = read_vehicle(request.vehicle or beside, request.model)
    flown = declared_phase(request, vehicle)
    choices = column_choices(
        request, channel_units(vehicle.own) if vehicle.own is not None else CHANNEL_UNITS
    )
    files, validation = read_with_validation(request.records, request.validate)

    # The rate only serves files without a clock; nothing is resampled.
    opening = reading_options(request, opening=True, rate=not has_clock(files[0], choices))

    def identified(plan: Plan, plan_options: Options) -> tuple[PreparedData, IdentificationResult]:
        return _identified(
            vehicle, method, (files, validation), choices, plan, plan_options, opening
        )

    ready, found = identified(request.plan, options)
    if (
        method not in FILTERS
        and found.record.inputs
        and request.plan.hold is None
        and not any(file.sidecar.states_hold for file in files)
    ):
        ready, found = _with_other_hold(
            ready,
            found,
            lambda hold, hold_options: identified(replace(request.plan, hold=hold), hold_options),
            options,
        )
    found = replace(found, doubts=(*unusable_sigmas(request, vehicle, found), *found.doubts))
    proposed = filter_error_proposed(request, vehicle, found)
    found = replace(
        found, notes=(*files_read_unnamed([*files, *validation], beside), *found.notes, *proposed)
    )
    return Identified(found, flown, ready.measured, files, validation, request.plan)


def _identified(
    vehicle: VehicleFile,
    method: str,
    files: tuple[tuple[RecordFile, ...], tuple[RecordFile, ...]],
    choices: Mapping[str, ColumnChoice] | None,
    plan: Plan,
    options: Options,
    opening: Sequence[str] = (),
) -> tuple[PreparedData, IdentificationResult]:
    """Return the result of a fit to records prepared by ``plan``.

    ``opening``: command-line options that open the files.
    """
    # The filter of the low-order system has its own equations at constant speed, and estimates
    # the trim.
    is_filter_of_low_order = vehicle.model == "loes" and method == "ekf"
    ready = prepare(
        files[0],
        model_of_file(vehicle),
        plan,
        choices,
        files[1],
        use_measured_airspeed=not is_filter_of_low_order and method != FREQUENCY,
        attitude=uses_attitude(vehicle, method),
    )
    refuse_unrelated_records(ready.fitted, ready.validation)
    # A record of three samples shows no control moving either: its length is the better message.
    refuse_too_few(ready.fitted, ready.model)
    refuse_still(ready.fitted, ready.model)
    refuse_unfit_records(ready.fitted, ready.model)
    refuse_unpredictable(ready.predicted, ready.model)
    trusted = plan.trusted or method == FREQUENCY
    first, *others = ready.measured if is_filter_of_low_order else ready.fitted
    notes = ready.notes
    if method in FILTERS and others and len(files[0]) * len(plan.segments) == 1:
        first, others = max((first, *others), key=len), []
        notes = (
            *notes,
            f"a filter runs along one part of a record: the longest, {first.name}, is used",
        )

    def fitted(records: Sequence[Record]) -> IdentificationResult:
        return identify(
            records[0],
            vehicle,
            method,
            records[1:],
            ready.model,
            ready.validation,
            options,
            trusted=trusted,
        )

    found, masks = _without_outliers(fitted, (first, *others), trusted=trusted)
    look = with_outliers(ready.look, (first, *others), masks)
    held_out_records = [fit.record for fit in found.fits if fit.held_out]
    look = with_outliers(
        look,
        ready.validation,
        [left_out(*pair) for pair in zip(ready.validation, held_out_records, strict=True)],
    )
    found = replace(found, fits=pooled_fits(found.fits, ready.parted))
    outputs = tuple(name for fit in found.fits if not fit.held_out for name in fit.outputs)
    missing_outputs = not_recorded(tuple(dict.fromkeys(outputs)), ready.predicted)
    masks_by_name = {
        record.name: some for record, some in zip((first, *others), masks, strict=True)
    }
    measured = tuple(
        without(record, masks_by_name.get(record.name, {})) for record in ready.measured
    )
    cruise = cruise_caution(ready.measured, files[0][0].identity.name, opening)
    doubts = (*ready.doubts, *([cruise] if cruise else []))
    return replace(ready, measured=measured), replace(
        found, notes=(*notes, *missing_outputs, *found.notes), doubts=doubts, look=look
    )


def _without_outliers(
    fitted: Callable[[Sequence[Record]], IdentificationResult],
    records: Sequence[Record],
    *,
    trusted: bool,
) -> tuple[IdentificationResult, list[dict[str, np.ndarray]]]:
    """Return the fit without isolated wrong samples, and masks of these by record and channel.

    Wrong samples change the fit from which they are found. So they are looked for a second time, in
    the fit without them. ``trusted``: no sample is left out.
    """

    def simulated(found: IdentificationResult) -> tuple[Sequence[str], list[np.ndarray]]:
        fits = [fit for fit in found.fits if not fit.held_out]
        return fits[0].outputs if fits else (), [fit.simulated for fit in fits]

    found, _, masks = repeated_without_outliers(fitted, simulated, records, 0 if trusted else 2)
    return found, masks


def _with_other_hold(
    ready: PreparedData,
    found: IdentificationResult,
    identified: Callable[[Hold, Options], tuple[PreparedData, IdentificationResult]],
    options: Options,
) -> tuple[PreparedData, IdentificationResult]:
    """Return the identification with the hold of the inputs that the data prefer.

    If the data prefer none, the result is the first one and reports what the other hold changes.
    The first hold was chosen before wild points were set aside. Inputs that move in single steps
    stay held.
    """
    used = found.record.hold
    other_ready, other = identified(opposite(used), replace(options, profile=None))
    if any(result.estimate.outcome not in SETTLED for result in (found, other)):
        return ready, found
    gain = _gain(found, other)
    if gain >= DECISIVE_LOG_LIKELIHOOD_RATIO and not all(
        held_by_computer(record) for record in (found.record, *found.others)
    ):
        if options.profile is not None:
            other_ready, other = identified(opposite(used), options)
        decision = OtherReading(opposite(used), used, (), -gain).decision
        chosen = f"inputs {WORDS[opposite(used)]} between samples: {BY_HAND}"
        notes = tuple(decision if note == chosen else note for note in other.notes)
        return other_ready, replace(
            other, decided=other_reading(opposite(used), other.rows, found.rows, -gain), notes=notes
        )
    reading = other_reading(used, found.rows, other.rows, gain)
    if reading is not None and reading.decided:
        said = any(note.startswith(f"inputs {WORDS[used]} between samples") for note in found.notes)
        notes = found.notes if said else (*found.notes, reading.decision)
        return ready, replace(found, decided=reading, notes=notes)
    return ready, replace(found, reading=reading)


def _gain(found: IdentificationResult, other: IdentificationResult) -> float:
    """Return twice the log likelihood ratio of ``other`` to ``found``, both of the same records."""
    pairs = [pair for pair in zip(found.fits, other.fits, strict=True) if not pair[0].held_out]
    if not pairs or any(fit.figures is None for pair in pairs for fit in pair):
        return 2.0 * (other.estimate.log_likelihood - found.estimate.log_likelihood)
    before, after, masks = [], [], []
    for first, second in pairs:
        measured, valid = first.record.output_array(first.outputs)
        masks.append(valid & np.isfinite(first.simulated) & np.isfinite(second.simulated))
        before.append(np.where(masks[-1], measured - first.simulated, 0.0))
        after.append(np.where(masks[-1], measured - second.simulated, 0.0))
    return log_likelihood_gain(before, after, masks)
