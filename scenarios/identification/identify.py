"""Identification of a measured record: no truth, noise levels from the data themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.filters.ekf import FilterSettings
from ident.filters.iterated_ekf import run_iterated_ekf
from ident.flying_qualities.modal import modal_estimate
from ident.statistics.profile import ProfileInterval
from ident.statistics.residuals import ResidualTest, residual_tests
from ident.whole_record.output_error import FitSettings, fit_output_error
from scenarios.files.constraints import constraint_sentences
from scenarios.files.own_models import is_own
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.assessment.bounds import tied_rows, within_bounds
from scenarios.identification.assessment.intervals import profiled, refuse_profile
from scenarios.identification.assessment.prediction import RecordFit, record_fits
from scenarios.identification.cautions import cautions_of
from scenarios.identification.frequency import METHOD as FREQUENCY
from scenarios.identification.frequency import chosen_band, delays_of, estimated, refuse_band
from scenarios.identification.gravity import PATH, weighed, without_theta
from scenarios.identification.result import PLAIN, Identification, Options
from scenarios.preparation.trim import of_totals
from scenarios.preparation.vehicle_model import model_of_file, moves_about_rest, outputs_with_bias, step_for
from scenarios.studies.rows import rows_of
from sim.declaration.compile import compile_model
from sim.declaration.model import Model, Noise
from sim.declaration.parameters import ParameterSet
from sim.declaration.system import System
from sim.effects.disturbance.phugoid import ATTITUDE, SPEED
from sim.errors import DeclarationError, RecordError
from sim.record import Record

FILTERS = ("ekf", "ukf")
SIMULATED = ("output-error", FREQUENCY)  # methods whose fitted outputs are those of a free simulation
METHODS = ("ekf", "ukf", "output-error", "filter-error", "equation-error", FREQUENCY)
FIT_STEP = 0.01
PASSES = 5
BIASED = 1.0  # of a total channel's scatter, by which its sensor may be off
BEGINNING = 5  # samples whose median says where a sensor begins
ACCELERATION_DENSITY = 1.0  # (m/s2)^2 s, start of the noise that forces a falling body
TURBULENCE = "gust-turbulence"
LARGEST = 1e50  # squares and sums of larger numbers leave the range of finite ones


def identify(
    record: Record,
    vehicle: VehicleFile,
    method: str,
    others: Sequence[Record] = (),
    model: Model | None = None,
    held_out: Sequence[Record] = (),
    options: Options = PLAIN,
) -> Identification:
    """Estimate a vehicle file's model from a record, or by a whole-record method from it and ``others`` together.

    ``model`` is the vehicle file's with a measured flow among its inputs; None: the file's own. Records ``held_out`` are predicted.

    Each output but an altitude (of an own model those that it names) gets a bias, each record its own initial state. A filter takes its measurement
    noise from the residual of an output-error fit, its initial state from the first samples, and is
    iterated from its own result, because a file's starting values may be far off. ``filter-error`` puts an aircraft into
    Dryden turbulence of unknown intensity and length, and forces a falling body by white noise of unknown size.

    Raises
    ------
    DeclarationError : an unknown method. ModelError : the record has none of the model's outputs. RecordError : a number beyond all measure.
    """
    records = [record, *others]
    _refuse([*records, *held_out], vehicle, method, options, len(records))
    if vehicle.model == "loes" and method == "ekf":
        return _low_order(record, vehicle, held_out)
    model, every = _as_fitted(vehicle, method, model or model_of_file(vehicle), [*records, *held_out])
    records, held_out = every[: len(records)], every[len(records) :]
    outputs = [signal.name for signal in model.equations.outputs if any(signal.name in each.output_names for each in records)]
    model, said = weighed(model, records, outputs) if vehicle.own is None else (model, "")
    biased = model.with_biases(outputs_with_bias(model, outputs) if vehicle.model != "ballistic" else [])
    # A common factor of an elastic coordinate is not in the data: only a prior fixes it.
    settings = FitSettings(step_for(model, records, FIT_STEP), use_priors=bool(vehicle.modes))
    if method == FREQUENCY:
        options = replace(options, band=chosen_band(records, biased, outputs, options.band))
    kept = method not in FILTERS  # filters know no bounds
    bounded, system, estimate, at_bounds = within_bounds(
        biased, lambda each: _estimated(records, each, outputs, method, settings, options), kept=kept
    )
    rows = rows_of(estimate)
    names = [f"bias_{name}" for name in biased.biases]
    return Identification(
        record,
        vehicle,
        method,
        estimate,
        tuple(row for row in rows if row.name not in names),
        tuple(row for row in rows if row.name in names),
        _derived(vehicle, model, system, estimate),
        {item.name: (item.value, item.unit) for item in biased.parameters if not item.free and item.name not in {tie.name for tie in model.ties}},
        _tests(records, estimate),
        tuple(others),
        notes=(*(note for note in (said, estimate.message) if note), *_laid_down(vehicle, model)),
        cautions=cautions_of(vehicle, estimate, rows),
        tied=tied_rows(bounded, estimate),
        at_bounds=at_bounds,
        intervals=_intervals(records, bounded, outputs, estimate, settings, options),
        band=options.band,
        fits=_fits(records, held_out, compile_model(bounded, outputs), estimate, settings),
    )


def _as_fitted(vehicle: VehicleFile, method: str, model: Model, records: Sequence[Record]) -> tuple[Model, list[Record]]:
    """Model and records, less a pitch attitude that the method cannot use."""
    unused = vehicle.own is None and not uses_attitude(vehicle, method)
    return without_theta(model, records) if unused else (model, list(records))


def _derived(vehicle: VehicleFile, model: Model, system: System, estimate: Estimate) -> dict[str, tuple[float, float]]:
    """The modes of what was estimated, and the delay of a low-order system."""
    airborne = vehicle.model != "ballistic" and moves_about_rest(model) and bool(np.all(np.isfinite(estimate.values)))
    derived = modal_estimate(system, _of_parameters(estimate, system.parameters), (SPEED, ATTITUDE)) if airborne else {}
    if vehicle.model == "loes" and "delay" in estimate.names:
        derived["delay"] = estimate.value("delay"), estimate.sigma("delay")
    return derived


def _low_order(record: Record, vehicle: VehicleFile, held_out: Sequence[Record]) -> Identification:
    """The low-order system by its own filter, and what it predicts."""
    from scenarios.identification.low_order import identify_loes

    found = identify_loes(record, vehicle)
    model, settings = model_of_file(vehicle), FitSettings(FIT_STEP)
    outputs = [signal.name for signal in model.equations.outputs if signal.name in record.output_names]
    system = compile_model(model.with_biases(outputs), outputs)
    values = {**found.estimate.as_dict(), **{name: value for name, (value, _) in found.fixed.items()}}
    fits = record_fits([record], held_out, system, values, settings)
    return replace(found, cautions=cautions_of(vehicle, found.estimate, found.rows), fits=fits)


def _fits(records: Sequence[Record], held_out: Sequence[Record], system: System, estimate: Estimate, settings: FitSettings) -> tuple[RecordFit, ...]:
    """Free simulations of all records; those that the estimate carries already are not made again."""
    simulated = estimate.fitted if estimate.method in SIMULATED and estimate.output_names == system.output_names else ()
    return record_fits(records, held_out, system, estimate.as_dict(), settings, [PATH], simulated)


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
    system = compile_model(_forced(model), outputs) if estimate.method == "filter-error" else calm
    return profiled(estimate, records, system, settings, options.profile, calm=calm, local=[PATH], delays=delays_of(model), band=options.band)


def uses_attitude(vehicle: VehicleFile, method: str) -> bool:
    """Whether a measured pitch attitude can enter: the speed that it changes is a state which only a whole-record simulation has."""
    return vehicle.model == "rigid" and method in ("output-error", "filter-error")


def _refuse(records: Sequence[Record], vehicle: VehicleFile, method: str, options: Options, fitted: int) -> None:
    """Refuse a method that there is not, or not for these records (the first ``fitted`` of them to be fitted) and this model."""
    if method not in METHODS:
        raise DeclarationError(f"there is no method {method!r}", where="--method", remedy=f"use one of {', '.join(METHODS)}")
    if fitted > 1 and method in FILTERS:
        what = f"a filter runs along one segment, and there are {fitted}"
        raise DeclarationError(what, where="--method", remedy="use output-error, filter-error or equation-error, or one pair of --from and --to")
    if options.profile is not None:
        refuse_profile(method)
    refuse_band(options.band, method)
    if method in FILTERS and vehicle.constraints.bounds:
        what = f"a filter keeps no bounds, and the vehicle file bounds {', '.join(vehicle.constraints.bounds)}"
        raise DeclarationError(what, where="--method", remedy="use output-error, filter-error, equation-error or frequency-domain")
    for each in records:
        _refuse_beyond_measure(each)
    if vehicle.model == "loes" and method == "ekf" and vehicle.constraints:
        what = "the bank of delays estimates every derivative from its start, and the vehicle file fixes or ties some"
        raise DeclarationError(what, where="--method", remedy="use output-error, filter-error or frequency-domain")
    if vehicle.model == "loes" and method == "ukf":
        raise DeclarationError("a pure delay has no unscented filter here", where="--method", remedy="use ekf: a bank of filters, refined")
    if vehicle.model == "longitudinal" and method == "ukf":
        # Its points reach as far as the priors of CL_0, Cm_0 and the zeros of all sensors together: six sigmas off and more, and no test shows it.
        what = "an unscented filter of totals is biased by the open zeros of the sensors and does not show it"
        raise DeclarationError(what, where="--method", remedy="use ekf, output-error, filter-error or equation-error")


def _estimated(
    records: Sequence[Record], model: Model, outputs: list[str], method: str, settings: FitSettings, options: Options
) -> tuple[System, Estimate]:
    """The system that a method estimates, and what it finds; a filter runs along the first record, begun from a fit of it."""
    system = compile_model(model, outputs)
    if method == "equation-error":
        from ident.regression.equation_error import run_equation_error

        return system, run_equation_error(records, system)
    if method == FREQUENCY:
        return system, estimated(records, system, settings, delays_of(model), options.band)
    if method == "filter-error":
        from ident.process_noise.filter_error import fit_filter_error

        return system, fit_filter_error(records, compile_model(_forced(model), outputs), settings, calm=system, local=[PATH])
    fit = fit_output_error(records, system, settings, local=[PATH])
    if method not in FILTERS:
        return system, fit
    record, ready = records[0], _for_filter(model, records[0], outputs, fit)
    if method == "ekf":
        system = compile_model(ready, outputs, online=True)
        return system, run_iterated_ekf(record, system)
    from ident.filters.ukf import run_ukf

    system = compile_model(_for_points(ready), outputs, online=True)
    return system, run_ukf(record, system, FilterSettings(passes=PASSES))


def _tests(records: Sequence[Record], estimate: Estimate) -> tuple[ResidualTest, ...]:
    """Tests of the residuals of all records, one after the other."""
    measured = [each.output_array(estimate.output_names) for each in records]
    valid = np.concatenate([known for _, known in measured], axis=1)
    residuals = np.concatenate([z - fitted for (z, _), fitted in zip(measured, estimate.fitted, strict=True)], axis=1)
    return residual_tests(estimate, np.where(valid, residuals, 0.0), valid)


def _forced(model: Model) -> Model:
    """The model with what filter error estimates besides: turbulence where gusts act, white noise on the acceleration of a falling body.

    Raises
    ------
    DeclarationError : equations on which neither is known to act.
    """
    from sim.effects.library import effects_for

    rough = next((effect for effect in effects_for(model.equations) if effect.name == TURBULENCE), None)
    if rough is not None:
        return model.with_effects(rough)
    if not any(state.name == "velocity" for state in model.equations.states):
        what = f"the {model.equations.name} model has no turbulence that filter-error could estimate"
        raise DeclarationError(what, where="--method", remedy="use output-error, ekf, ukf or equation-error")
    return model.with_noise(replace(model.noise, process_density={"velocity": ACCELERATION_DENSITY}))


def _of_parameters(estimate: Estimate, parameters: ParameterSet) -> Estimate:
    at = [i for i, name in enumerate(estimate.names) if name in parameters]
    return replace(
        estimate,
        names=tuple(estimate.names[i] for i in at),
        units=tuple(estimate.units[i] for i in at),
        values=estimate.values[at],
        covariance=estimate.covariance[np.ix_(at, at)],
    )


def _refuse_beyond_measure(record: Record) -> None:
    for channel in record.channels:
        wrong = np.flatnonzero(channel.valid & (np.abs(channel.values) > LARGEST))
        if wrong.size:
            where = f"{record.name}, channel {channel.name} at {record.time[wrong[0]]:g} s"
            raise RecordError(
                f"{channel.values[wrong[0]]:g} is no measurement", where=where, remedy="leave the cell empty where the sample is missing"
            )


def _for_filter(model: Model, record: Record, outputs: list[str], fit: Estimate) -> Model:
    """Noise, initial state and bias priors for a filter, from the record alone.

    A sensor's zero is looked for about where its record begins, the perturbation from trim about zero: a record of total
    angles must not start the state at the trim's. Equations of totals are the other way about.
    """
    std, spread, begins = {}, {}, {}
    totals = of_totals(model)
    for name, fitted in zip(fit.output_names, fit.noise_std, strict=True):
        channel = record[name]
        values = channel.values[channel.valid]
        spread[name] = max(float(np.std(values)), 1e-12)
        sound = fit.outcome in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS) and 0 < fitted < spread[name]
        std[name] = float(fitted) if sound else 0.1 * spread[name]
        begins[name] = float(np.median(values[:BEGINNING]))
    states = []
    for item in model.initial:
        if totals and item.name in outputs:
            value, prior = begins[item.name], BIASED * spread[item.name]
        elif is_own(model):
            value, prior = item.value, max(abs(item.value), 1.0)
        else:
            value, prior = _first_state(item.name, record, outputs, std, spread)
        states.append(replace(item, value=value, prior_std=prior))
    zeros = {f"bias_{name}": 0.0 if totals else begins[name] for name in model.biases}
    parameters = model.parameters.with_values(zeros)
    parameters = parameters.with_prior({f"bias_{name}": (BIASED if totals else 3.0) * spread[name] for name in model.biases})
    return replace(model, initial=ParameterSet(tuple(states)), parameters=parameters, noise=Noise(std))


def _for_points(model: Model) -> Model:
    """Priors of derivatives for an unscented filter: its points lie sqrt(n) sigmas out, n unknowns, and none shall have another sign."""
    count = sum(item.free for item in model.initial) + len(model.parameters.free_names)
    names = [name for name in model.parameters.free_names if name not in {f"bias_{output}" for output in model.biases}]
    widest = {name: abs(model.parameters[name].value) / np.sqrt(count) for name in names}
    narrowed = {name: min(model.parameters[name].prior_std, float(std)) for name, std in widest.items() if std > 0.0}
    return model.with_parameters(model.parameters.with_prior(narrowed))


def _first_state(name: str, record: Record, outputs: list[str], std: dict[str, float], spread: dict[str, float]) -> tuple[float, float]:
    if name in outputs:
        channel = record[name]
        if name != "altitude":
            return 0.0, max(3.0 * std[name], spread[name])
        return float(channel.values[channel.valid][0]), 3.0 * std[name]
    if name == "velocity" and "altitude" in outputs:
        channel = record["altitude"]
        t, h = record.time[channel.valid], channel.values[channel.valid]
        early = max(3, min(len(t), int(np.searchsorted(t, t[0] + 0.1 * (t[-1] - t[0])))))
        slope = float(np.polyfit(t[:early] - t[0], h[:early], 1)[0])
        return slope, max(0.1 * abs(slope), 4.0 * std["altitude"] / max(t[early - 1] - t[0], 1e-9))
    return 0.0, 1.0
