"""Estimate any model by any method: requirements of the methods, and their calls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.banks.delays import ENGINES, FILTERPY, WIDENINGS, contradicted, widened
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
LARGEST_BIAS_SCATTERS = 1.0  # prior sigma of a bias, share of the channel's scatter
STARTING_SAMPLES = 5  # initial samples whose median is a sensor's initial value
ACCELERATION_DENSITY = 1.0  # (m/s2)^2 s, start of the noise that forces a falling body
TURBULENCE = "gust-turbulence"
# Starting process noise: share of a state's typical change in one second.
PROCESS_NOISE_SHARE = 0.1
TRIAL_OFFSET = 0.1  # offset from rest at which effects of parameters on rates are tested
FILTER_AGREEMENT_SIGMAS = 3.0  # prior of a filter's first pass about a fit, in sigmas of the fit
# prior of a filter about a fit, in sigmas of the fit; the data then count 1 + 1/400 times
FILTER_PRIOR_SIGMAS = 20.0
# Of a channel's scatter, a filter's least noise: variances then lie half the digits apart, and the
# rest is left for the update.
LEAST_NOISE = float(np.finfo(float).eps ** 0.25)
SETTLED = (Outcome.CONVERGED, Outcome.MAX_ITERATIONS)
LARGEST_NUMBER = 1e50  # squares and sums of larger numbers leave the range of finite ones


def uses_attitude(vehicle: VehicleFile, method: str) -> bool:
    """Return whether a measured pitch attitude can enter: the speed that it changes is a state
    which only a whole-record simulation has.
    """
    return vehicle.model == "rigid" and method in ("output-error", "filter-error")


def refuse_method(
    records: Sequence[Record], vehicle: VehicleFile, method: str, options: Options, fitted: int
) -> None:
    """Refuse a method that there is not, or not for these records (the first ``fitted`` of them to
    be fitted) and this model.
    """
    if method not in METHODS:
        raise DeclarationError(
            f"there is no method {method!r}",
            where="--method",
            remedy=closest(method, METHODS),
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
    for each in records:
        refuse_beyond_measure(each, [channel.name for channel in each.channels], LARGEST_NUMBER)
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
    engine = ENGINES[options.engine or FILTERPY.name]
    return {"name": engine.name, "sentence": engine.label} if method == "ekf" else {}


def estimated_by(
    records: Sequence[Record],
    model: Model,
    outputs: list[str],
    method: str,
    settings: FitSettings,
    options: Options,
) -> tuple[System, Estimate]:
    """Return the system of a method and its estimate.

    A filter runs over the first record and starts from an output-error fit of it.

    Raises
    ------
    RecordError : the method's linear algebra fails on these numbers.
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
    held = model.with_parameters(model.parameters.with_values({delay: value}).hold([delay]))
    filtered, found = _filtered(
        records[0],
        held,
        outputs,
        method,
        settings,
        options,
        fit.only([name for name in fit.names if name != delay]),
    )
    return filtered, _with_delay(found, fit, delay) if _values_of(fit) else found


def _with_delay(found: Estimate, fit: Estimate, delay: str) -> Estimate:
    """Return a filter's estimate, completed by the delay of an output-error ``fit``.

    The delay was fixed in the filter. Its uncertainty propagates to the others as in the fit.
    """
    at = fit.names.index(delay)
    variance = float(fit.covariance[at, at])
    if not variance > 0.0:
        return found
    slopes = {
        name: float(fit.covariance[fit.names.index(name), at]) / variance for name in fit.names
    }
    moves = np.array([*(slopes.get(name, 0.0) for name in found.names), 1.0])
    covariance = np.pad(found.covariance, (0, 1)) + variance * np.outer(moves, moves)
    sentence = (
        f"{delay} is that of the output-error fit: a pure delay has no state that a filter could "
        "estimate"
    )
    return replace(
        found,
        names=(*found.names, delay),
        units=(*found.units, fit.units[at]),
        values=np.append(found.values, fit.values[at]),
        covariance=covariance,
        message="; ".join(text for text in (found.message, sentence) if text),
    )


def _by_filter_error(
    records: Sequence[Record],
    model: Model,
    outputs: list[str],
    settings: FitSettings,
    options: Options,
) -> tuple[System, Estimate]:
    """Return the filter-error estimate in turbulence, or with white noise on the states.

    Turbulence acts through the angle of attack only. If this fit does not converge for equations of
    totals, because speed and pitch are disturbed as well, each state gets white noise and sensor
    biases are dropped.
    """
    from ident.process_noise.filter_error import fit_filter_error

    def fitted(calm: Model, rough: Model) -> tuple[System, Estimate]:
        system = compile_model(calm, outputs)
        return system, fit_filter_error(
            records, compile_model(rough, outputs), settings, calm=system, local=[PATH]
        )

    first = fitted(model, forced(model, records))
    if (
        first[1].outcome is Outcome.CONVERGED
        or is_own(model)
        or not of_totals(model)
        or options.profile is not None
    ):
        return first
    zeros = [name for name in model.parameters.free_names if not name.startswith("bias_")]
    calm = model.with_parameters(model.parameters.only_free(zeros))
    noise = {name: _density(name, records) for name in _driven_states(calm, records)}
    system, second = fitted(calm, calm.with_noise(replace(calm.noise, process_density=noise)))
    if second.outcome is not Outcome.CONVERGED or second.log_likelihood <= first[1].log_likelihood:
        return first
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
    its integration steps are those of the fit, so that their error stays below the noise.
    """
    ready = _for_filter(model, record, outputs, fit)
    first = compile_model(_near_fit(ready, fit), outputs, online=True)
    if not settings.use_priors:
        ready = _about_fit(ready, fit)
    system = compile_model(ready, outputs, online=True)
    calm = _calm(fit, ready)
    steps = FilterSettings(max_step=settings.max_step) if calm else None
    estimate = _run_filter(record, system, first, method, options, steps)
    for _ in range(WIDENINGS):
        held_back = contradicted(system, estimate.as_dict()) if estimate.outcome in SETTLED else ()
        if not held_back:
            break
        system = widened(system, held_back)
        estimate = _run_filter(record, system, first, method, options, steps)
    estimate = with_coloured_covariance(estimate)
    if calm and not estimate.message:
        sentence = (
            f"{', '.join(calm)}: hardly any noise; a filter needs some, and assumes "
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


def _calm(fit: Estimate, ready: Model) -> list[str]:
    """Return outputs in which a converged fit finds less noise than the filter assumes."""
    if not _values_of(fit):
        return []
    assumed = ready.noise.measurement_std
    return [
        name
        for name, found in zip(fit.output_names, fit.noise_std.tolist(), strict=True)
        if found < assumed[name]
    ]


def _run_filter(
    record: Record,
    system: System,
    first: System,
    method: str,
    options: Options,
    steps: FilterSettings | None,
) -> Estimate:
    if method == "ekf":
        return run_iterated_ekf(
            record, system, steps, first=first, by=ENGINES[options.engine or FILTERPY.name].one_pass
        )
    from ident.filters.ukf import run_iterated_ukf

    return run_iterated_ukf(record, system, steps, first=first)


def forced(model: Model, records: Sequence[Record] = ()) -> Model:
    """Return the model with what filter error estimates besides the derivatives.

    Turbulence where gusts act, white noise on the acceleration of a falling body. Of a user's own
    model and of a multirotor, which feels gusts as moments without a model of them, white noise on
    each state whose rate has a free parameter, in proportion to what that state changes in a second
    in ``records``; a common factor on its standard deviation is estimated.

    Raises
    ------
    DeclarationError : built-in equations on which neither is known to act.
    """
    from sim.effects.library import effects_for

    if is_own(model):
        return _with_white_noise(model, records)
    rough = next(
        (effect for effect in effects_for(model.equations) if effect.name == TURBULENCE), None
    )
    if rough is not None:
        return model.with_effects(rough)
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
    """Return states whose rate depends on a free parameter; others have no process noise."""
    system = compile_model(model)
    times = np.concatenate([np.zeros(1), *(record.time for record in records)])
    rest = np.array([*system.initial.values(), *inputs_at_rest(model)]) + TRIAL_OFFSET
    x, u = rest[: len(system.states)].tolist(), rest[len(system.states) :].tolist()
    p = system.parameters.values()
    moved: set[str] = set()
    for name in system.parameters.free_names:
        other = p.copy()
        other[system.parameters.index(name)] += TRIAL_OFFSET * max(
            1.0, abs(other[system.parameters.index(name)])
        )
        rates = zip(
            system.f(times, x, u, p.tolist()),
            system.f(times, x, u, other.tolist()),
            system.state_names,
            strict=True,
        )
        moved |= {state for one, two, state in rates if np.any(one != two)}
    return [name for name in system.state_names if name in moved]


def _density(state: str, records: Sequence[Record]) -> float:
    """Spectral density, unit^2/s, that moves a state in a second by a tenth of what it is recorded
    to change in one; not recorded: .1 of its unit.

    Airspeed changes in a second by a small part of its scatter along a record: noise in proportion
    to that would follow its sensor everywhere.
    """
    channels = [(record.time, record[state]) for record in records if state in record.output_names]
    changes = max((_change_in_a_second(time, channel) for time, channel in channels), default=0.0)
    return (PROCESS_NOISE_SHARE * (changes or 1.0)) ** 2


def _change_in_a_second(time: np.ndarray, channel: Channel) -> float:
    """Return the standard deviation of a channel's change in one second, or its scatter."""
    t, values = time[channel.valid], channel.values[channel.valid]
    if t.size < 2 or t[-1] - t[0] < 2.0:
        return float(np.std(values)) if t.size else 0.0
    late = t[t >= t[0] + 1.0]
    return float(np.std(np.interp(late, t, values) - np.interp(late - 1.0, t, values)))


def _for_filter(model: Model, record: Record, outputs: list[str], fit: Estimate) -> Model:
    """Noise, initial state and bias priors for a filter, from the record alone.

    A sensor's zero is looked for about where its record begins, the perturbation from trim about
    zero: a record of total angles must not start the state at the trim's. Equations of totals are
    the other way about.
    """
    std, spread, begins = {}, {}, {}
    totals = of_totals(model)
    for name, fitted in zip(fit.output_names, fit.noise_std, strict=True):
        channel = record[name]
        values = channel.values[channel.valid]
        spread[name] = max(float(np.std(values)), 1e-12)
        sound = (
            fit.outcome in (Outcome.CONVERGED, Outcome.MAX_ITERATIONS) and 0 < fitted < spread[name]
        )
        std[name] = max(float(fitted), LEAST_NOISE * spread[name]) if sound else 0.1 * spread[name]
        begins[name] = float(np.median(values[:STARTING_SAMPLES]))
    states = []
    for item in model.initial:
        if totals and item.name in outputs:
            value, prior = begins[item.name], LARGEST_BIAS_SCATTERS * spread[item.name]
        elif is_own(model):
            value, prior = item.value, max(abs(item.value), 1.0)
        else:
            value, prior = _first_state(item.name, record, outputs, std, spread)
        states.append(replace(item, value=value, prior_std=prior))
    states += _settled_actuators(model, record)
    zeros = {f"bias_{name}": 0.0 if totals else begins[name] for name in model.biases}
    parameters = model.parameters.with_values(zeros)
    parameters = parameters.with_prior(
        {
            f"bias_{name}": (LARGEST_BIAS_SCATTERS if totals else 3.0) * spread[name]
            for name in model.biases
        }
    )
    return replace(
        model, initial=ParameterSet(tuple(states)), parameters=parameters, noise=Noise(std)
    )


def _settled_actuators(model: Model, record: Record) -> list[Parameter]:
    """Return the initial states of the model's own lags in a filter: settled at the first input, as
    a whole-record simulation has them.
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

    Priors are near an output-error fit. Without a fit they are as declared, but so narrow that the
    points of an unscented filter (sqrt(n) sigmas, n unknowns) do not change a sign.
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
    """Return the values of a fit that has settled, by name; empty for one that has not."""
    sound = fit.outcome in (Outcome.CONVERGED, Outcome.DEGENERATE) and bool(
        np.all(np.isfinite([*fit.values, *fit.std]))
    )
    return fit.as_dict() if sound else {}


def _first_state(
    name: str, record: Record, outputs: list[str], std: dict[str, float], spread: dict[str, float]
) -> tuple[float, float]:
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
