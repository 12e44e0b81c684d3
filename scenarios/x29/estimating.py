"""The low-order filter of a closed-loop scenario, other methods and starts, and its misfit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.banks.bank import BankEstimate, run_bank
from ident.banks.delays import (
    DELAYS,
    DelayBank,
    likelihood_weights,
    parabola_vertex,
    run_delay_bank,
)
from ident.banks.engines import BATCHED, ENGINES, BankEngine, run_iterated_bank
from ident.estimate import Estimate, Outcome
from ident.filters.smoother import smooth
from ident.statistics.noise_levels import noise_envelope
from ident.statistics.residuals import ljung_box
from scenarios.identification.low_order import ENGINEERING_STD, loes_filter_system
from scenarios.x29.declaration import (
    METHODS,
    LoopEstimation,
    LoopScenario,
    SimulatedLoop,
    Variant,
    fly_loop,
    low_order_model,
    printed_density,
    printed_start,
    short_period,
    telemetry_noise,
)
from sim.declaration.effect import Parameter
from sim.declaration.model import System
from sim.propagation import drive_from_record, make_grid, simulate
from sim.record import Record

# ---- The low-order filter of a closed-loop scenario

SETTLED_SIGMAS = 0.1  # a restart that moves all values by less, in sigmas, has converged
ROUGH_DELAYS = tuple(0.0875 + 0.0125 * i for i in range(7))  # s, for variants


@dataclass(frozen=True, eq=False)
class SetUp:
    """A record cut to the window, the filter's System, the assumed noise, and the engine."""

    record: Record
    system: System
    noise_std: Mapping[str, float]
    engine: BankEngine = BATCHED


@dataclass(frozen=True, eq=False)
class SinglePass:
    """Result of the paper's procedure: one pass of a bank of filters over the record.

    Attributes
    ----------
    bank : all filters.
    delays, weights : delay (s) and weight by likelihood of each filter.
    delay : most likely delay, s.
    weighted_mean : mean of the delays by likelihood, s.
    estimate : parameters of the filter of the most likely delay, without the delay.
    """

    bank: BankEstimate
    delays: np.ndarray
    weights: np.ndarray
    delay: float
    weighted_mean: float
    estimate: Estimate


def set_up(
    estimation: LoopEstimation,
    simulated: SimulatedLoop,
    start: Mapping[str, float],
    initial: Mapping[str, float] | None = None,
    prior: str = "",
) -> SetUp:
    """Return the fourteen-state filter for a flight's record.

    Parameters
    ----------
    start : starting values by the names of a vehicle file.
    initial : further starting values, of constants.
    prior : rule for P0; empty: that of the estimation.
    """
    record = simulated.record
    if estimation.window_start is not None or estimation.window_stop is not None:
        record = record.window(estimation.window_start, estimation.window_stop)
    sensors = telemetry_noise(simulated.x29)
    noise_std = noise_envelope(record) if estimation.noise_from == "envelope" else sensors
    noise = {name: estimation.noise_share * noise_std[name] for name in sensors}
    # The delay here is only a place holder: the bank holds it at each of its values.
    model = low_order_model(simulated.x29, {**start, "delay": 0.0})
    system = loes_filter_system(model, record, noise, estimation.process_noise, ENGINEERING_STD)
    if (prior or estimation.prior) == "printed":
        system = _printed_prior(system)
    system = replace(system, initial=system.initial.with_prior(dict(estimation.initial_std)))
    if initial:
        system = replace(system, parameters=system.parameters.with_values(dict(initial)))
    return SetUp(record, system, noise, ENGINES[estimation.engine])


def _printed_prior(system: System) -> System:
    """Return the System with P0 of the paper's Tables 1 and 2, which agree."""
    printed = {
        name: cell.std for name, cell in printed_start("simulation").items() if cell.std is not None
    }
    states = {name: std for name, std in printed.items() if name in system.state_names}
    others = {name: std for name, std in printed.items() if name not in states}
    return replace(
        system,
        initial=system.initial.with_prior(states),
        parameters=system.parameters.with_prior(others),
    )


def start_of(system: System, name: str) -> Parameter:
    """Return the initial state or parameter of a filter with this name, with its prior."""
    return system.initial[name] if name in system.state_names else system.parameters[name]


def refined(setting: SetUp) -> DelayBank:
    """Return the bank with the delay refined between its grid points.

    P0 stays as declared, even if the record contradicts it.
    """
    return run_delay_bank(setting.record, setting.system, widenings=0, engine=setting.engine)


def single_pass(setting: SetUp) -> SinglePass:
    """Run nine filters over the record once and take the estimate of the most likely one."""
    system, delays = setting.system, np.array(DELAYS)
    bank = setting.engine.run(setting.record, system, fixed_values={"delay": delays})
    best, n_x = int(np.argmax(bank.log_likelihood)), len(system.states)
    names = bank.names[n_x:]
    weights = likelihood_weights(bank.log_likelihood)
    estimate = Estimate(
        "ekf",
        names,
        tuple(system.parameters[name].unit for name in names),
        bank.mean[n_x:, best].copy(),
        bank.covariance[best, n_x:, n_x:].copy(),
        Outcome.CONVERGED if bank.sound[best] else Outcome.DIVERGED,
        float(np.maximum(bank.log_likelihood[best], -1e300)),
        system.output_names,
        np.array([setting.noise_std[name] for name in system.output_names]),
        (),
    )
    return SinglePass(bank, delays, weights, DELAYS[best], float(weights @ delays), estimate)


def started_again(
    estimation: LoopEstimation, simulated: SimulatedLoop, estimate: Estimate
) -> SetUp:
    """Return the filter for the same flight started at a result, with the same rule for P0."""
    values = estimate.as_dict()
    constants = {name: values[name] for name in ("L_0", "M_0", "delta_0")}
    start = {
        name: value for name, value in values.items() if name not in (*constants, "nz_0", "delay")
    }
    return set_up(estimation, simulated, start, constants)


def rough(setting: SetUp) -> tuple[Estimate, float]:
    """Return the most likely filter of a coarse bank and its delay (s), for variants.

    Seven delays, 12.5 ms apart, relinearised once.
    """
    delays = np.array(ROUGH_DELAYS)
    bank, trajectories = setting.engine.iterated(
        setting.record, setting.system, fixed_values={"delay": delays}, tolerance=np.inf
    )
    best = int(np.argmax(bank.log_likelihood))
    delay = float(delays[best])
    parameters = setting.system.parameters.with_values({"delay": delay})
    system = replace(setting.system, parameters=parameters)
    estimate = setting.engine.alone(setting.record, system, None, trajectories[:, :, best])
    return estimate, delay


def free_simulation(setting: SetUp, estimate: Estimate, delay: float) -> np.ndarray:
    """Return the outputs ``(3, N)`` of an estimate, simulated from the stick alone.

    The simulation starts from the smoothed state at the start of the window.
    """
    record, system = setting.record, setting.system
    values = {name: value for name, value in estimate.as_dict().items() if name != "delay"}
    p = system.parameters.with_values({**values, "delay": delay}).values().tolist()
    grid = make_grid(record.time, float(np.diff(record.time).max()))
    drive = drive_from_record(
        system, p, record.input_array(system.input_names), record.time, record.hold, grid
    )
    x0 = [0.0, 0.0, 0.0]
    if estimate.history is not None:
        x0 = smooth(estimate.history).mean[:3, 0].tolist()
    return np.array(simulate(system, p, x0, drive, grid))


# ---- Misfit of the low-order filter

LARGE_CORRELATION = 0.9  # size of a correlation that is worth a mark


@dataclass(frozen=True)
class Misfit:
    """Misfit of a simulation with the estimate, and of its filter.

    Attributes
    ----------
    rms : measured minus simulated over the noise's sigma, by output.
    stretch, elsewhere : rms of q (over sigma) inside the scenario's stretch and outside; zero if it
        has none.
    peak_measured, peak_simulated : q at the largest |q| of the scenario's peak interval, rad/s;
        zero if it has none.
    lag_one : lag-one correlation of the normalised q innovations.
    q_box : Ljung-Box statistic over 25 lags.
    low_share : share of the q innovations' power below a fifth of the Nyquist frequency; white
        noise has a fifth.
    ratio : root mean square of all normalised innovations.
    """

    rms: dict[str, float]
    stretch: float
    elsewhere: float
    peak_measured: float
    peak_simulated: float
    lag_one: float
    q_box: float
    low_share: float
    ratio: float

    @property
    def peak_percent(self) -> float:
        """Error of the simulated final peak, percent of the measured one; negative: too small."""
        if not self.peak_measured:
            return 0.0
        return 100.0 * (abs(self.peak_simulated) / abs(self.peak_measured) - 1.0)


def sensor_noise(simulated: SimulatedLoop) -> np.ndarray:
    """Return the noise of the telemetry ``(3,)``: alpha (rad), q (rad/s) and nz (g)."""
    return np.array(list(telemetry_noise(simulated.x29).values()))


def misfit(
    record: Record,
    simulated: np.ndarray,
    estimate: Estimate,
    noise_std: np.ndarray,
    stretch: tuple[float, float] | None,
    peak: tuple[float, float] | None,
) -> Misfit:
    """Return the misfit of a simulation ``(3, N)`` and of the innovations of its estimate.

    ``noise_std``: noise of the outputs, ``(3,)``.
    """
    names = estimate.output_names
    z, valid = record.output_array(names)
    error = np.where(valid, z - simulated, 0.0) / noise_std[:, None]
    row = names.index("q")
    inside = (
        np.zeros(len(record), dtype=bool)
        if stretch is None
        else (record.time >= stretch[0]) & (record.time <= stretch[1])
    )
    measured = simulated_peak = 0.0
    if peak is not None:
        within = np.flatnonzero((record.time >= peak[0]) & (record.time <= peak[1]))
        if within.size:
            at = within[int(np.argmax(np.abs(z[row, within])))]
            # Over five samples, so that the noise of one does not decide.
            near = slice(max(at - 2, 0), at + 3)
            measured = float(z[row, near].mean())
            simulated_peak = float(simulated[row, near].mean())
    history = estimate.history
    assert history is not None
    innovations = (history.innovation[row] / history.innovation_std[row])[history.valid[row]]
    centred = innovations - innovations.mean()
    power = np.abs(np.fft.rfft(centred)) ** 2
    nis = float(history.nis.sum()) / max(int(history.degrees.sum()), 1)
    return Misfit(
        {name: _rms(errors) for name, errors in zip(names, error, strict=True)},
        _rms(error[row, inside]) if inside.any() else 0.0,
        _rms(error[row, ~inside]) if inside.any() else 0.0,
        measured,
        simulated_peak,
        float(centred[1:] @ centred[:-1] / (centred @ centred)),
        ljung_box(innovations, np.ones(len(innovations), dtype=bool), "q").statistic,
        float(power[1 : max(2, len(power) // 5)].sum() / power[1:].sum()),
        float(np.sqrt(nis)),
    )


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


# ---- The same record estimated by further methods

RESTART_PASSES = 5  # restarts of plain filters from their own result


@dataclass(frozen=True, eq=False)
class LoopMethodResult:
    """Result of one method: delay (s), values and sigmas of the parameters, log-likelihood."""

    name: str
    label: str
    delay: float
    values: Mapping[str, float]
    std: Mapping[str, float]
    log_likelihood: float

    @property
    def frequency(self) -> float:
        """Undamped natural frequency of the short period, rad/s; NaN if it does not oscillate."""
        return short_period(self.values)[0]

    @property
    def damping(self) -> float:
        """Damping ratio of the short period; NaN if it does not oscillate."""
        return short_period(self.values)[1]


@dataclass(frozen=True, eq=False)
class Restarts:
    """Plain filters with fixed delays (s), each restarted several times from its own result.

    ``values``: estimates by parameter, shape ``(passes, delays)``.
    """

    delays: tuple[float, ...]
    values: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class MethodInputs:
    """Inputs of the methods.

    Attributes
    ----------
    paper, single_pass : filter with the paper's settings, and its result.
    estimation, refined : the scenario's estimation and its refined bank.
    set_up : returns the filter for the same record with another estimation.
    """

    paper: SetUp
    single_pass: SinglePass
    estimation: LoopEstimation
    refined: DelayBank
    set_up: Callable[[LoopEstimation], SetUp]


def run_methods(names: Sequence[str], inputs: MethodInputs) -> tuple[LoopMethodResult, ...]:
    """Return the results of the methods ``names``, keys of ``METHODS``."""
    return tuple(_RUN[name](name, inputs) for name in names)


def other_side(first_estimate: SinglePass, refined_delay: float) -> int:
    """Return the index of the filter beyond the refined delay, as seen from the most likely one."""
    best = int(np.argmax(first_estimate.bank.log_likelihood))
    step = 1 if first_estimate.delays[best] < refined_delay else -1
    return min(max(best + step, 0), len(first_estimate.delays) - 1)


def all_restarts(inputs: MethodInputs, delays: Sequence[float]) -> dict[str, Restarts]:
    """Return restarts at some delays (s): P0 and R as printed, other P0, and other R."""
    louder = _set_up(inputs, prior="printed", noise_share=2.0 * inputs.estimation.noise_share)
    settings = {
        "R and P0 as printed": inputs.paper,
        "P0 a quarter of the start": _set_up(inputs, prior="quarter"),
        "R four times as large": louder,
    }
    return {label: single_pass_restarts(setting, delays) for label, setting in settings.items()}


def single_pass_restarts(
    setting: SetUp, delays: Sequence[float], passes: int = RESTART_PASSES
) -> Restarts:
    """Return plain filters at fixed delays (s), restarted ``passes`` times with the same P0."""
    system, start = setting.system, None
    n_x, rows, names = len(system.states), [], system.parameters.free_names
    for _ in range(passes):
        bank = run_bank(
            setting.record, system, fixed_values={"delay": np.array(delays)}, start=start
        )
        rows.append(bank.mean[n_x:])
        first = np.array([system.initial[name].value for name in system.state_names])
        start = np.concatenate([np.repeat(first[:, None], len(delays), axis=1), bank.mean[n_x:]])
    stacked = np.array(rows)
    return Restarts(tuple(delays), {name: stacked[:, i] for i, name in enumerate(names)})


def between_grid_points(first_estimate: SinglePass) -> float:
    """Return the delay (s) at the vertex of a parabola through the largest log-likelihoods.

    The parabola goes through the most likely filter of the bank and its two neighbours.
    """
    L, best = first_estimate.bank.log_likelihood, int(np.argmax(first_estimate.bank.log_likelihood))
    near = slice(min(max(best - 1, 0), len(L) - 3), min(max(best + 2, 3), len(L)))
    return parabola_vertex(first_estimate.delays[near], L[near])[0]


def _of_bank(name: str, first_estimate: SinglePass, at: int) -> LoopMethodResult:
    bank = first_estimate.bank
    rows = range(len(bank.names) - len(first_estimate.estimate.names), len(bank.names))
    values = {bank.names[i]: float(bank.mean[i, at]) for i in rows}
    std = {bank.names[i]: float(np.sqrt(bank.covariance[at, i, i])) for i in rows}
    return LoopMethodResult(
        name,
        METHODS[name],
        float(first_estimate.delays[at]),
        values,
        std,
        float(bank.log_likelihood[at]),
    )


def _best(name: str, first_estimate: SinglePass) -> LoopMethodResult:
    return _of_bank(name, first_estimate, int(np.argmax(first_estimate.bank.log_likelihood)))


def _at_fixed_delay(name: str, inputs: MethodInputs) -> LoopMethodResult:
    delays = np.array([inputs.refined.refined])
    bank = run_bank(inputs.paper.record, inputs.paper.system, fixed_values={"delay": delays})
    return _of_bank(name, replace(inputs.single_pass, bank=bank, delays=delays), 0)


def _relinearised(name: str, inputs: MethodInputs) -> LoopMethodResult:
    delays = np.array([inputs.single_pass.delay])
    bank, _ = run_iterated_bank(
        inputs.paper.record, inputs.paper.system, fixed_values={"delay": delays}
    )
    return _of_bank(name, replace(inputs.single_pass, bank=bank, delays=delays), 0)


def _set_up(inputs: MethodInputs, **changes: Any) -> SetUp:
    return inputs.set_up(replace(inputs.estimation, **changes))


def _refined(name: str, setting: SetUp) -> LoopMethodResult:
    return of_refined(name, METHODS[name], refined(setting))


def of_refined(name: str, label: str, bank: DelayBank) -> LoopMethodResult:
    """Return the result of a refined bank as that of a method."""
    estimate = bank.estimate
    std = dict(zip(estimate.names, estimate.std.tolist(), strict=True))
    return LoopMethodResult(
        name, label, bank.refined, estimate.as_dict(), std, estimate.log_likelihood
    )


_RUN: Mapping[str, Callable[[str, MethodInputs], LoopMethodResult]] = {
    "paper": lambda name, inputs: _best(name, inputs.single_pass),
    "paper-other": lambda name, inputs: _of_bank(
        name, inputs.single_pass, other_side(inputs.single_pass, inputs.refined.refined)
    ),
    "paper-density": lambda name, inputs: _best(
        name, single_pass(_set_up(inputs, prior="printed", process_noise=printed_density("flight")))
    ),
    "plain-quarter": lambda name, inputs: _best(
        name, single_pass(_set_up(inputs, prior="quarter"))
    ),
    "held": _at_fixed_delay,
    "relinearised": _relinearised,
    "refined-printed": lambda name, inputs: _refined(name, _set_up(inputs, prior="printed")),
    "refined-quarter": lambda name, inputs: _refined(name, _set_up(inputs, prior="quarter")),
}


# ---- Variants of a scenario


@dataclass(frozen=True, eq=False)
class VariantResult:
    """A variant's name, label, quick estimate, delay and misfit."""

    name: str
    label: str
    estimate: Estimate
    delay: float
    misfit: Misfit


def run_variant(
    scenario: LoopScenario, variant: Variant, seed: int, start: Mapping[str, float]
) -> VariantResult:
    """Simulate a variant with a seed and estimate it.

    ``start``: starting values of the scenario, for a variant without its own.
    """
    simulated_flight = fly_loop(variant.flight, seed)
    setting = set_up(variant.estimation, simulated_flight, variant.estimation.start or start)
    estimate, delay = rough(setting)
    simulated = free_simulation(setting, estimate, delay)
    measured = misfit(
        setting.record,
        simulated,
        estimate,
        sensor_noise(simulated_flight),
        scenario.stretch,
        scenario.peak,
    )
    return VariantResult(variant.name, variant.label, estimate, delay, measured)


@dataclass(frozen=True, eq=False)
class OverSeeds:
    """Results of the paper's bank on k flights that differ only in their noise.

    Attributes
    ----------
    seeds : seeds of the flights.
    delays : most likely delay of each flight, s, ``(k,)``.
    names : names of the n parameters.
    values : parameters of the filter with the most likely delay, ``(k, n)``.
    """

    seeds: tuple[int, ...]
    delays: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray

    def by_delay(self) -> list[tuple[float, np.ndarray]]:
        """Return each most likely delay with the parameters ``(j, n)`` of its flights.

        The most frequent delay comes first.
        """
        by_delay = [
            (float(delay), self.values[self.delays == delay]) for delay in np.unique(self.delays)
        ]
        return sorted(by_delay, key=lambda pair: -len(pair[1]))


def run_over_seeds(
    scenario: LoopScenario, start: Mapping[str, float], prior: str
) -> OverSeeds | None:
    """Return the results of the paper's bank on flights with the seeds 1 to ``scenario.seeds``.

    None if no seeds are requested. ``prior``: rule for P0.
    """
    if not scenario.seeds:
        return None
    seeds = tuple(range(1, scenario.seeds + 1))
    results = [
        single_pass(
            set_up(scenario.estimation, fly_loop(scenario.flight, seed), start, prior=prior)
        )
        for seed in seeds
    ]
    return OverSeeds(
        seeds,
        np.array([round(result.delay, 6) for result in results]),
        results[0].estimate.names,
        np.array([result.estimate.values for result in results]),
    )
