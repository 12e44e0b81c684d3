"""Estimate any model by any method: what each method requires, and how it is called."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.banks.delays import WIDENINGS, contradicted, widened
from ident.banks.engines import ENGINES, FILTERPY
from ident.estimate import Estimate, Outcome
from ident.filters.ekf import FilterSettings, run_iterated_ekf
from ident.filters.smoother import with_coloured_covariance
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_output_error
from scenarios.files.declarations import closest
from scenarios.files.user_models import inputs_at_rest, is_own
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.assessment import Options, refuse_profile
from scenarios.identification.conditions import METHOD as FREQUENCY
from scenarios.identification.conditions import PATH, delays_of, estimated, refuse_band
from scenarios.preparation.measured_inputs import of_totals
from scenarios.studies.comparison import UNSCENTED
from sim.declaration.compile import compile_model
from sim.declaration.effect import Parameter, ParameterSet
from sim.declaration.model import Model, Noise, System
from sim.effects.input_path.actuator import ActuatorLag
from sim.errors import DeclarationError, RecordError
from sim.record import Channel, Record, refuse_beyond_measure
from sim.vehicles.other_vehicles import Multirotor

FILTERS = ("ekf", "ukf")
METHODS = ("ekf", "ukf", "output-error", "filter-error", "equation-error", FREQUENCY)
# Prior standard deviation of a bias, as a share of the channel's scatter: for equations of total
# motion, and for those of perturbations.
BIAS_SCATTERS, BIAS_SCATTERS_OF_PERTURBATIONS = 1.0, 3.0
STARTING_SAMPLES = 5  # first samples, whose median is the initial value of a sensor
ACCELERATION_DENSITY = 1.0  # (m/s2)^2 s; starting value for the noise on a falling body
TURBULENCE = "gust-turbulence"
# Starting process noise changes a state in one second by this share of its typical change.
PROCESS_NOISE_SHARE = 0.1
TRIAL_OFFSET = 0.1  # offset from rest at which the effects of parameters on rates are tested
# Prior of a filter's first pass about an output-error fit, in sigmas of that fit.
FILTER_AGREEMENT_SIGMAS = 3.0
# Prior of a filter about an output-error fit, in sigmas of that fit. The data count twice, the
# second time with a weight of 1/400.
FILTER_PRIOR_SIGMAS = 20.0
# Least noise of a filter, as a share of a channel's scatter. The variances then differ by half of
# the digits of a float, and the update of the covariance keeps the other half.
LEAST_NOISE = float(np.finfo(float).eps ** 0.25)
UNKNOWN_NOISE = 0.1  # noise over scatter of a channel for which a fit gives no noise level
SETTLED = (Outcome.CONVERGED, Outcome.MAX_ITERATIONS)
LARGEST_NUMBER = 1e50  # squares and sums of larger numbers could overflow


def uses_attitude(vehicle: VehicleFile, method: str) -> bool:
    """Return whether a method can use a measured pitch attitude of a rigid aircraft.

    The attitude changes the speed, a state that only simulations of whole records have.
    """
    return vehicle.model == "rigid" and method in ("output-error", "filter-error")


def refuse_method(
    records: Sequence[Record], vehicle: VehicleFile, method: str, options: Options, fitted: int
) -> None:
    """Raise DeclarationError for a method that is unknown or cannot take the records or the model.

    ``fitted``: number of records that are fitted.
    """
    if method not in METHODS:
        raise DeclarationError(
            f"there is no method {method!r}", where="--method", remedy=closest(method, METHODS)
        )
    if fitted > 1 and method in FILTERS:
        what = f"a filter runs along one segment, and there are {fitted}"
        raise DeclarationError(
            what,
            where="--method",
            remedy=(
                "use output-error, filter-error or equation-error, or one pair of --from and --to"
            ),
        )
    if options.profile is not None:
        refuse_profile(method)
    refuse_band(options.band, method)
    if method in FILTERS and vehicle.constraints.bounds:
        what = (
            "a filter keeps no bounds, and the vehicle file bounds "
            f"{', '.join(vehicle.constraints.bounds)}"
        )
        raise DeclarationError(
            what,
            where="--method",
            remedy="use output-error, filter-error, equation-error or frequency-domain",
        )
    for record in records:
        refuse_beyond_measure(record, [channel.name for channel in record.channels], LARGEST_NUMBER)
    if vehicle.model == "loes" and method == "ekf" and vehicle.constraints:
        what = (
            "the bank of delays estimates every derivative from its start, and the vehicle file "
            "fixes or ties some"
        )
        raise DeclarationError(
            what, where="--method", remedy="use output-error, filter-error or frequency-domain"
        )
    if options.engine is not None:
        _refuse_engine(options.engine, method)
    if vehicle.model == "loes" and method == "ukf":
        raise DeclarationError(
            "a pure delay has no unscented filter here",
            where="--method",
            remedy="use ekf: a bank of filters, refined",
        )


def _refuse_engine(engine: str, method: str) -> None:
    if engine not in ENGINES:
        raise DeclarationError(
            f"there is no engine {engine!r}",
            where="--engine",
            remedy=f"use one of {', '.join(ENGINES)}",
        )
    if method != "ekf":
        what = f"only the extended Kalman filter has two engines, and the method is {method}"
        raise DeclarationError(what, where="--engine", remedy="leave it out, or use --method ekf")


def engine_of(method: str, options: Options) -> dict[str, str]:
    """Return the content of the key ``engine`` for a single filter; empty for other methods."""
    if method == "ukf":
        sentence = f"first pass {UNSCENTED}; further passes by the own sigma-point kernel"
        return {"name": "filterpy", "sentence": sentence}
    if method != "ekf":
        return {}
    engine = ENGINES[options.engine or FILTERPY.name]
    return {"name": engine.name, "sentence": engine.label}


def estimated_by(
    records: Sequence[Record],
    model: Model,
    outputs: list[str],
    method: str,
    settings: FitSettings,
    options: Options,
) -> tuple[System, Estimate]:
    """Return the system that a method estimates, and its estimate.

    A filter runs over the first record and starts from an output-error fit of it.

    Raises
    ------
    RecordError : the linear algebra of the method fails.
    """
    try:
        return _estimated_by(records, model, outputs, method, settings, options)
    except np.linalg.LinAlgError as error:
        what = f"the linear algebra of {method} fails on it ({error})"
        remedy = "check the units and the size of times and channels, or use another --method"
        raise RecordError(
            what, where=", ".join(record.name for record in records), remedy=remedy
        ) from error


def _estimated_by(
    records: Sequence[Record],
    model: Model,
    outputs: list[str],
    method: str,
    settings: FitSettings,
    options: Options,
) -> tuple[System, Estimate]:
    system = compile_model(model, outputs)
    if method == "equation-error":
        from ident.regression.equation_error import RegressionSettings, run_equation_error
        from ident.whole_record.numerical_errors import with_sampling_error

        found = run_equation_error(records, system, RegressionSettings(instruments=True))
        return system, with_sampling_error(found, records, system, settings)
    if method == FREQUENCY:
        return system, estimated(records, system, settings, delays_of(model), options.band)
    if method == "filter-error":
        return _by_filter_error(records, model, outputs, settings, options)
    fit = fit_output_error(records, system, settings, local=[PATH])
    if method not in FILTERS:
        return system, fit
    delay = next(
        (name for name in set(delays_of(model).values()) if model.parameters[name].free), None
    )
    if delay is None:
        return _filtered(records[0], model, outputs, method, settings, options, fit)
    value = _values_of(fit).get(delay, model.parameters[delay].value)
    # A filter cannot estimate a pure delay: it takes that of the fit.
    held = model.with_parameters(model.parameters.with_values({delay: value}).hold([delay]))
    without_delay = fit.only([name for name in fit.names if name != delay])
    filter_system, estimate = _filtered(
        records[0], held, outputs, method, settings, options, without_delay
    )
    if _values_of(fit):
        estimate = _with_delay(estimate, fit, delay)
    return filter_system, estimate


def _with_delay(estimate: Estimate, fit: Estimate, delay: str) -> Estimate:
    """Return a filter's estimate with the delay of an output-error ``fit`` added.

    The delay was fixed in the filter. Its uncertainty widens the other sigmas as in the fit.
    """
    at = fit.names.index(delay)
    variance = float(fit.covariance[at, at])
    if not variance > 0.0:
        return estimate
    slopes = {
        name: float(fit.covariance[fit.names.index(name), at]) / variance for name in fit.names
    }
    per_delay = np.array([*(slopes.get(name, 0.0) for name in estimate.names), 1.0])
    covariance = np.pad(estimate.covariance, (0, 1)) + variance * np.outer(per_delay, per_delay)
    sentence = (
        f"{delay} is that of the output-error fit: a pure delay has no state that a filter could "
        "estimate"
    )
    return replace(
        estimate,
        names=(*estimate.names, delay),
        units=(*estimate.units, fit.units[at]),
        values=np.append(estimate.values, fit.values[at]),
        covariance=covariance,
        message="; ".join(text for text in (estimate.message, sentence) if text),
    )


def _by_filter_error(
    records: Sequence[Record],
    model: Model,
    outputs: list[str],
    settings: FitSettings,
    options: Options,
) -> tuple[System, Estimate]:
    """Return the filter-error estimate in turbulence, or with white noise on the states.

    Turbulence acts through the angle of attack only. In equations of total motion, speed and pitch
    may be disturbed as well, so that the fit does not converge. Then each state gets white noise,
    and the sensor biases are dropped.
    """
    from ident.process_noise.filter_error import fit_filter_error

    def fitted(without_noise: Model, with_noise: Model) -> tuple[System, Estimate]:
        system = compile_model(without_noise, outputs)
        return system, fit_filter_error(
            records, compile_model(with_noise, outputs), settings, calm=system, local=[PATH]
        )

    first_system, first = fitted(model, forced(model, records))
    if (
        first.outcome is Outcome.CONVERGED
        or is_own(model)
        or not of_totals(model)
        or options.profile is not None
    ):
        return first_system, first
    not_biases = [name for name in model.parameters.free_names if not name.startswith("bias_")]
    unbiased = model.with_parameters(model.parameters.only_free(not_biases))
    noise = {name: _density(name, records) for name in _driven_states(unbiased, records)}
    system, second = fitted(
        unbiased, unbiased.with_noise(replace(unbiased.noise, process_density=noise))
    )
    if second.outcome is not Outcome.CONVERGED or second.log_likelihood <= first.log_likelihood:
        return first_system, first
    sentence = (
        f"white noise on {', '.join(noise)} and no sensor biases: the fit with vertical turbulence "
        "and biases did not settle"
    )
    return system, replace(
        second, message="; ".join(text for text in (second.message, sentence) if text)
    )


def _filtered(
    record: Record,
    model: Model,
    outputs: list[str],
    method: str,
    settings: FitSettings,
    options: Options,
    fit: Estimate,
) -> tuple[System, Estimate]:
    """Return a filter's estimate from one record, started from an output-error ``fit``.

    The covariance is corrected for coloured innovations. A prior that the record contradicts is
    widened to the distance of the estimate. If the filter assumes more noise than the record has,
    it takes the integration steps of the fit, whose error is below the noise.
    """
    ready = _for_filter(model, record, outputs, fit)
    first = compile_model(_near_fit(ready, fit), outputs, online=True)
    if not settings.use_priors:
        ready = _about_fit(ready, fit)
    system = compile_model(ready, outputs, online=True)
    quiet = _quiet_outputs(fit, ready)
    steps = FilterSettings(max_step=settings.max_step) if quiet else None
    estimate = _run_filter(record, system, first, method, options, steps)
    for _ in range(WIDENINGS):
        held_back = contradicted(system, estimate.as_dict()) if estimate.outcome in SETTLED else ()
        if not held_back:
            break
        system = widened(system, held_back)
        estimate = _run_filter(record, system, first, method, options, steps)
    estimate = with_coloured_covariance(estimate)
    if quiet and not estimate.message:
        sentence = (
            f"{', '.join(quiet)}: hardly any noise; a filter needs some, and assumes "
            f"{LEAST_NOISE:.1g} of the channel's scatter"
        )
        estimate = replace(
            estimate,
            message=f"{sentence}: sigmas are those of that noise, and output-error gives smaller "
            "ones",
        )
    if not _values_of(fit) and not estimate.message:
        sentence = (
            "the output-error fit that gives the filter its start did not settle "
            f"({fit.outcome.value}): it started from the vehicle file"
        )
        estimate = replace(estimate, message=sentence)
    return system, estimate


def _quiet_outputs(fit: Estimate, ready: Model) -> list[str]:
    """Return the outputs in which a converged fit finds less noise than the filter assumes."""
    if not _values_of(fit):
        return []
    assumed = ready.noise.measurement_std
    return [
        name
        for name, std in zip(fit.output_names, fit.noise_std.tolist(), strict=True)
        if std < assumed[name]
    ]


def _run_filter(
    record: Record,
    system: System,
    first: System,
    method: str,
    options: Options,
    steps: FilterSettings | None,
) -> Estimate:
    """Return the estimate of an iterated filter; ``first``: the system of its first pass."""
    if method == "ekf":
        one_pass = ENGINES[options.engine or FILTERPY.name].one_pass
        return run_iterated_ekf(record, system, steps, first=first, by=one_pass)
    from ident.filters.ukf import run_iterated_ukf

    return run_iterated_ukf(record, system, steps, first=first)


def forced(model: Model, records: Sequence[Record] = ()) -> Model:
    """Return the model with the process noise that filter error estimates.

    - Aircraft: turbulence, if gusts act on the equations.
    - Falling body: white noise on the acceleration.
    - User's model, and multirotor, on which gusts act as moments that are not modelled: white noise
      on each state whose rate has a free parameter. Its size is in proportion to the change of the
      state in a second of ``records``; a common factor on it is estimated.

    Raises
    ------
    DeclarationError : no process noise is known for the built-in equations.
    """
    from sim.effects.library import effects_for

    if is_own(model):
        return _with_white_noise(model, records)
    turbulence = next(
        (effect for effect in effects_for(model.equations) if effect.name == TURBULENCE), None
    )
    if turbulence is not None:
        return model.with_effects(turbulence)
    if model.equations.name == Multirotor().name:
        return _with_white_noise(model, records)
    if not any(state.name == "velocity" for state in model.equations.states):
        what = (
            f"the {model.equations.name} model has no turbulence that filter-error could estimate"
        )
        raise DeclarationError(
            what, where="--method", remedy="use output-error, ekf, ukf or equation-error"
        )
    return model.with_noise(
        replace(model.noise, process_density={"velocity": ACCELERATION_DENSITY})
    )


def _with_white_noise(model: Model, records: Sequence[Record]) -> Model:
    """Return the model with white noise on each state whose rate has a free parameter."""
    return model.with_noise(
        replace(
            model.noise,
            process_density={
                name: _density(name, records) for name in _driven_states(model, records)
            },
        )
    )


def _driven_states(model: Model, records: Sequence[Record]) -> list[str]:
    """Return the states whose rate depends on a free parameter."""
    system = compile_model(model)
    times = np.concatenate([np.zeros(1), *(record.time for record in records)])
    rest = np.array([*system.initial.values(), *inputs_at_rest(model)]) + TRIAL_OFFSET
    x, u = rest[: len(system.states)].tolist(), rest[len(system.states) :].tolist()
    p = system.parameters.values()
    driven: set[str] = set()
    for name in system.parameters.free_names:
        changed = p.copy()
        i = system.parameters.index(name)
        changed[i] += TRIAL_OFFSET * max(1.0, abs(changed[i]))
        rates = zip(
            system.f(times, x, u, p.tolist()),
            system.f(times, x, u, changed.tolist()),
            system.state_names,
            strict=True,
        )
        driven |= {state for before, after, state in rates if np.any(before != after)}
    return [name for name in system.state_names if name in driven]


def _density(state: str, records: Sequence[Record]) -> float:
    """Return the starting spectral density of the white noise on a state, unit^2/s.

    In a second the noise changes the state by a tenth of its recorded change in a second, or by 0.1
    of its unit if it is not recorded. The scatter over a record would be a wrong measure: that of
    an airspeed is so large that the state would follow its sensor.
    """
    channels = [(record.time, record[state]) for record in records if state in record.output_names]
    changes = max((_change_in_a_second(time, channel) for time, channel in channels), default=0.0)
    return (PROCESS_NOISE_SHARE * (changes or 1.0)) ** 2


def _change_in_a_second(time: np.ndarray, channel: Channel) -> float:
    """Return the standard deviation of a channel's change in 1 s; its scatter if it is short."""
    t, values = time[channel.valid], channel.values[channel.valid]
    if t.size < 2 or t[-1] - t[0] < 2.0:
        return float(np.std(values)) if t.size else 0.0
    late = t[t >= t[0] + 1.0]
    return float(np.std(np.interp(late, t, values) - np.interp(late - 1.0, t, values)))


def _for_filter(model: Model, record: Record, outputs: list[str], fit: Estimate) -> Model:
    """Return the model with noise, initial state and priors of biases for a filter.

    They come from the record and the noise levels of an output-error ``fit``. In equations of
    perturbations the states start at zero, and each bias at the first value of its sensor: a record
    of total angles starts at its trim. In equations of total motion the states start at the first
    values, and the biases at zero.
    """
    std, scatter, begins = {}, {}, {}
    totals = of_totals(model)
    for name, fitted in zip(fit.output_names, fit.noise_std, strict=True):
        channel = record[name]
        values = channel.values[channel.valid]
        scatter[name] = max(float(np.std(values)), 1e-12)
        if fit.outcome in SETTLED and 0 < fitted < scatter[name]:
            std[name] = max(float(fitted), LEAST_NOISE * scatter[name])
        else:
            std[name] = UNKNOWN_NOISE * scatter[name]
        begins[name] = float(np.median(values[:STARTING_SAMPLES]))
    states = []
    for item in model.initial:
        if totals and item.name in outputs:
            value, prior = begins[item.name], BIAS_SCATTERS * scatter[item.name]
        elif is_own(model):
            value, prior = item.value, max(abs(item.value), 1.0)
        else:
            value, prior = _first_state(item.name, record, outputs, std, scatter)
        states.append(replace(item, value=value, prior_std=prior))
    states += _settled_actuators(model, record)
    biases = {f"bias_{name}": 0.0 if totals else begins[name] for name in model.biases}
    parameters = model.parameters.with_values(biases)
    scatters = BIAS_SCATTERS if totals else BIAS_SCATTERS_OF_PERTURBATIONS
    parameters = parameters.with_prior(
        {f"bias_{name}": scatters * scatter[name] for name in model.biases}
    )
    return replace(
        model, initial=ParameterSet(tuple(states)), parameters=parameters, noise=Noise(std)
    )


def _settled_actuators(model: Model, record: Record) -> list[Parameter]:
    """Return the initial states of the model's actuator lags in a filter.

    Each lag is at rest at its first input, as in a simulation of the whole record.
    """
    lags = [effect for effect in model.effects if isinstance(effect, ActuatorLag)]
    first = {effect.signal: float(record[effect.signal].values[0]) for effect in lags}
    return [
        Parameter(state.name, first[effect.signal], state.unit, free=False, source="settled")
        for effect in lags
        for state in effect.online_states
    ]


def _near_fit(model: Model, fit: Estimate) -> Model:
    """Return the model for a filter's first pass, which only gives a point of linearisation.

    The priors are near an output-error fit; without a fit they are about the declared values. They
    are so narrow that no sigma point of an unscented filter (sqrt(n) sigmas from its mean, for n
    unknowns) changes the sign of a parameter.
    """
    count = sum(item.free for item in model.initial) + len(model.parameters.free_names)
    biases = {f"bias_{output}" for output in model.biases}
    values = _values_of(fit)
    std = {
        name: FILTER_AGREEMENT_SIGMAS * float(sigma)
        for name, sigma in zip(fit.names, fit.std, strict=True)
        if name in values
    }
    parameters, narrowed = model.parameters.with_values(values), {}
    for name in parameters.free_names:
        if name in biases:
            continue
        item = parameters[name]
        widest = float(abs(item.value) / np.sqrt(count))
        limit = min(std.get(name, np.inf), widest if widest > 0.0 else np.inf)
        if 0.0 < limit < item.prior_std:
            narrowed[name] = limit
    return model.with_parameters(parameters.with_prior(narrowed))


def _about_fit(model: Model, fit: Estimate) -> Model:
    """Return the model with wide, nearly uninformative priors about an output-error fit."""
    values = _values_of(fit)
    sigma = dict(zip(fit.names, fit.std.tolist(), strict=True))
    prior = {
        name: max(model.parameters[name].prior_std, FILTER_PRIOR_SIGMAS * sigma[name])
        for name in values
    }
    return model.with_parameters(model.parameters.with_values(values).with_prior(prior))


def _values_of(fit: Estimate) -> dict[str, float]:
    has_converged = fit.outcome in (Outcome.CONVERGED, Outcome.DEGENERATE)
    if has_converged and np.all(np.isfinite([*fit.values, *fit.std])):
        return fit.as_dict()
    return {}


def _first_state(
    name: str, record: Record, outputs: list[str], std: dict[str, float], scatter: dict[str, float]
) -> tuple[float, float]:
    """Return initial value and prior standard deviation of a state of built-in equations.

    A perturbation starts at zero, an altitude at its first sample, and the velocity of a falling
    body at the slope of the altitude over the first tenth of the record.
    """
    if name in outputs:
        channel = record[name]
        if name != "altitude":
            return 0.0, max(3.0 * std[name], scatter[name])
        return float(channel.values[channel.valid][0]), 3.0 * std[name]
    if name == "velocity" and "altitude" in outputs:
        channel = record["altitude"]
        t, h = record.time[channel.valid], channel.values[channel.valid]
        early = max(3, min(len(t), int(np.searchsorted(t, t[0] + 0.1 * (t[-1] - t[0])))))
        slope = float(np.polyfit(t[:early] - t[0], h[:early], 1)[0])
        return slope, max(0.1 * abs(slope), 4.0 * std["altitude"] / max(t[early - 1] - t[0], 1e-9))
    return 0.0, 1.0
