"""Identification of a measured record: no truth, noise levels from the data themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.modes import characteristics, modal_estimate
from ident.statistics.intervals import ProfileInterval
from ident.statistics.residuals import ResidualTest, residual_tests
from ident.whole_record.layout import FitSettings
from scenarios.files.constraints import constraint_sentences
from scenarios.files.own_models import moves_about_rest
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.assessment.bounds import tied_rows, within_bounds
from scenarios.identification.assessment.intervals import profiled
from scenarios.identification.assessment.prediction import RecordFit, record_fits
from scenarios.identification.assessment.training import trained_by
from scenarios.identification.cautions import cautions_of, failed
from scenarios.identification.frequency import METHOD as FREQUENCY
from scenarios.identification.frequency import chosen_band, delays_of
from scenarios.identification.gravity import PATH, weighed, without_theta
from scenarios.identification.methods import FILTERS, engine_of, estimated_by, forced, refuse_method, uses_attitude
from scenarios.identification.result import PLAIN, Identification, Options
from scenarios.identification.sigma_cautions import sigma_cautions
from scenarios.preparation.vehicle_model import model_of_file, outputs_with_bias, step_for
from scenarios.studies.rows import rows_of
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, System
from sim.effects.disturbance.phugoid import ATTITUDE, SPEED
from sim.record import Record

SIMULATED = ("output-error", FREQUENCY)  # methods whose fitted outputs are those of a free simulation
FIT_STEP = 0.01
SLOW = (SPEED, ATTITUDE)  # states of a phugoid, which is no short-period mode


def identify(
    record: Record,
    vehicle: VehicleFile,
    method: str,
    others: Sequence[Record] = (),
    model: Model | None = None,
    held_out: Sequence[Record] = (),
    options: Options = PLAIN,
    *,
    trusted: bool = False,
) -> Identification:
    """Estimate a vehicle file's model from a record, or by a whole-record method from it and ``others`` together.

    ``model`` is the vehicle file's with a measured flow among its inputs; None: the file's own.
    Records ``held_out`` are predicted,
    less their wild points unless they are ``trusted``.

    Each output but an altitude (of an own model those that it names) gets a bias, each record its own initial state. A filter takes its measurement
    noise and its start from an output-error fit, its initial state from the first samples, and is iterated from its own result.
    ``filter-error`` puts an aircraft into Dryden turbulence, and forces a falling body by white noise, both of unknown size.

    Raises
    ------
    DeclarationError : an unknown method. ModelError : the record has none of the model's outputs. RecordError : a number beyond all measure.
    """
    records: Sequence[Record] = [record, *others]
    refuse_method([*records, *held_out], vehicle, method, options, len(records))
    if vehicle.model == "loes" and method == "ekf":
        return _low_order(record, vehicle, held_out, options.engine, trusted=trusted)
    model, records, held_out, said = _declared(model or model_of_file(vehicle), records, held_out, vehicle, method)
    outputs = _measured(model, records)
    biased = model.with_biases(outputs_with_bias(model, outputs) if vehicle.model != "ballistic" else [])
    # A common factor of an elastic coordinate is not in the data: only a prior fixes it. Filters know no bounds.
    settings = FitSettings(step_for(model, records, FIT_STEP), use_priors=bool(vehicle.modes))
    if method == FREQUENCY:
        options = replace(options, band=chosen_band(records, biased, outputs, options.band))
    bounded, system, estimate, at_bounds = within_bounds(
        biased, lambda each: estimated_by(records, each, outputs, method, settings, options), kept=method not in FILTERS
    )
    tests = _tests(records, estimate)
    rows, names = rows_of(estimate), [f"bias_{name}" for name in biased.biases]
    airborne = vehicle.model != "ballistic" and moves_about_rest(model) and bool(np.all(np.isfinite(estimate.values)))
    flown, compiled = estimate.only(system.parameters.names), compile_model(bounded, outputs)
    return Identification(
        record,
        vehicle,
        method,
        estimate,
        tuple(row for row in rows if row.name not in names),
        tuple(row for row in rows if row.name in names),
        _derived(vehicle, system, estimate, flown if airborne else None),
        {item.name: (item.value, item.unit) for item in biased.parameters if not item.free and item.name not in {tie.name for tie in model.ties}},
        tests,
        tuple(others),
        notes=(*(note for note in (said, estimate.message) if note), *_laid_down(vehicle, model)),
        cautions=(
            *(failed(records, estimate, rows, vehicle.derivatives) if method in SIMULATED else ()),
            *cautions_of(vehicle, estimate, rows),
            *sigma_cautions(records, estimate, compiled, tests, [PATH]),
        ),
        modes=characteristics(system, flown, SLOW) if airborne else None,
        system=system,
        tied=tied_rows(bounded, estimate),
        at_bounds=at_bounds,
        intervals=_intervals(records, bounded, outputs, estimate, settings, options),
        band=options.band,
        fits=_fits(records, held_out, compiled, estimate, settings, trusted=trusted),
        trained=trained_by(compiled, estimate.as_dict(), settings),
        engine=engine_of(method, options),
    )


def _declared(
    model: Model, records: Sequence[Record], held_out: Sequence[Record], vehicle: VehicleFile, method: str
) -> tuple[Model, Sequence[Record], Sequence[Record], str]:
    """The model with what a measured attitude tells of it, the records with what the method takes of them, and a sentence on that."""
    if vehicle.own is not None:
        return model, records, held_out, ""
    if not uses_attitude(vehicle, method):
        model, every = without_theta(model, [*records, *held_out])
        records, held_out = every[: len(records)], every[len(records) :]
    model, said = weighed(model, records, _measured(model, records))
    return model, records, held_out, said


def _measured(model: Model, records: Sequence[Record]) -> list[str]:
    """The model's outputs that one of the records has."""
    return [signal.name for signal in model.equations.outputs if any(signal.name in each.output_names for each in records)]


def _derived(vehicle: VehicleFile, system: System, estimate: Estimate, flown: Estimate | None) -> dict[str, tuple[float, float]]:
    """The modes of what was estimated, ``flown`` where it moves about a rest, and the delay of a low-order system."""
    derived = modal_estimate(system, flown, SLOW) if flown is not None else {}
    if vehicle.model == "loes" and "delay" in estimate.names:
        derived["delay"] = estimate.value("delay"), estimate.sigma("delay")
    return derived


def _low_order(record: Record, vehicle: VehicleFile, held_out: Sequence[Record], engine: str | None, *, trusted: bool) -> Identification:
    """The low-order system by its own filter, and what it predicts."""
    from scenarios.identification.low_order import identify_loes

    found = identify_loes(record, vehicle, engine)
    model, settings = model_of_file(vehicle), FitSettings(FIT_STEP)
    outputs = [signal.name for signal in model.equations.outputs if signal.name in record.output_names]
    system = compile_model(model.with_biases(outputs), outputs)
    values = {**found.estimate.as_dict(), **{name: value for name, (value, _) in found.fixed.items()}}
    fits = record_fits([record], held_out, system, values, settings, trusted=trusted)
    modes = characteristics(compile_model(model), found.estimate)
    cautions, trained = cautions_of(vehicle, found.estimate, found.rows), trained_by(system, values, settings)
    return replace(found, cautions=cautions, fits=fits, modes=modes, system=compile_model(model), trained=trained)


def _fits(
    records: Sequence[Record], held_out: Sequence[Record], system: System, estimate: Estimate, settings: FitSettings, *, trusted: bool
) -> tuple[RecordFit, ...]:
    """Free simulations of all records; those that the estimate carries already are not made again."""
    simulated = estimate.fitted if estimate.method in SIMULATED and estimate.output_names == system.output_names else ()
    return record_fits(records, held_out, system, estimate.as_dict(), settings, [PATH], simulated, trusted=trusted)


def _laid_down(vehicle: VehicleFile, model: Model) -> tuple[str, ...]:
    units = {item.name: item.unit for item in model.parameters}
    return constraint_sentences(vehicle.constraints, {item.name: item.value for item in model.parameters}, units)


def _intervals(
    records: Sequence[Record], model: Model, outputs: list[str], estimate: Estimate, settings: FitSettings, options: Options
) -> tuple[ProfileInterval, ...]:
    """Profile-likelihood intervals where they are asked."""
    if options.profile is None:
        return ()
    calm = compile_model(model, outputs)
    system = compile_model(forced(model, records), outputs) if estimate.method == "filter-error" else calm
    return profiled(estimate, records, system, settings, options.profile, calm=calm, local=[PATH], delays=delays_of(model), band=options.band)


def _tests(records: Sequence[Record], estimate: Estimate) -> tuple[ResidualTest, ...]:
    """Tests of the residuals of all records, one after the other."""
    measured = [each.output_array(estimate.output_names) for each in records]
    valid = np.concatenate([known for _, known in measured], axis=1)
    residuals = np.concatenate([z - fitted for (z, _), fitted in zip(measured, estimate.fitted, strict=True)], axis=1)
    return residual_tests(estimate, np.where(valid, residuals, 0.0), valid)
