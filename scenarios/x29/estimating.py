"""The low-order filter of a closed-loop scenario, other methods and starts, and its misfit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ident.banks.bank import BankEstimate, run_bank, run_iterated_bank
from ident.banks.delays import (
    BATCHED,
    DELAYS,
    ENGINES,
    BankEngine,
    DelayBank,
    likelihood_weights,
    run_delay_bank,
    vertex,
)
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
)
from sim.declaration.model import System
from sim.propagation import drive_from_record, make_grid, simulate
from sim.record import Record

# ---- The low-order filter of a closed-loop scenario

SETTLED_SIGMAS = 0.1  # a restart that moves all values by less, in sigmas, has converged
ROUGH_DELAYS = tuple(0.0875 + 0.0125 * i for i in range(7))  # s, for variants


@dataclass(frozen=True, eq=False)
class SetUp:
    """A record cut to the window, the filter's System for it, the noise it assumes, and who runs
    it.
    """

    record: Record
    system: System
    noise_std: Mapping[str, float]
    engine: BankEngine = BATCHED


@dataclass(frozen=True, eq=False)
class SinglePass:
    """Result of the paper's procedure: one pass of the bank, and the filter of the most likely
    delay.

    ``estimate`` has the parameters without the delay.
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
    """The fourteen-state filter for a flight's record. ``start`` : by the names of a vehicle file;
    ``initial`` : further starts of constants; ``prior`` : another rule for P0 than the
    estimation's."""
    record = simulated.record
    if estimation.window_start is not None or estimation.window_stop is not None:
        record = record.window(estimation.window_start, estimation.window_stop)
    t = simulated.x29.telemetry
    sensors = {"alpha": t.alpha_noise, "q": t.q_noise, "nz": t.nz_noise}
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


def refined(setting: SetUp) -> DelayBank:
    """Return the bank with a delay between its grid points; P0 stays as the paper's rule has it,
    also where the record contradicts it.
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
    return setting.engine.alone(
        setting.record, _at(setting.system, float(delays[best])), None, trajectories[:, :, best]
    ), float(delays[best])


def free_simulation(setting: SetUp, estimate: Estimate, delay: float) -> np.ndarray:
    """Outputs ``(3, N)`` of the final estimate driven by the stick alone, from the smoothed state
    at the window's begin.
    """
    record, system = setting.record, setting.system
    values = {name: value for name, value in estimate.as_dict().items() if name != "delay"}
    p = system.parameters.with_values({**values, "delay": delay}).values().tolist()
    grid = make_grid(record.time, float(np.diff(record.time).max()))
    drive = drive_from_record(
        system, p, record.input_array(system.input_names), record.time, record.hold, grid
    )
    x0 = (
        [0.0, 0.0, 0.0]
        if estimate.history is None
        else smooth(estimate.history).mean[:3, 0].tolist()
    )
    return np.array(simulate(system, p, x0, drive, grid))


def _at(system: System, delay: float) -> System:
    return replace(system, parameters=system.parameters.with_values({"delay": delay}))


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
        """Error of the final peak of the simulation, percent of the measured one (negative: too
        small).
        """
        return (
            100.0 * (abs(self.peak_simulated) / abs(self.peak_measured) - 1.0)
            if self.peak_measured
            else 0.0
        )


def sensor_noise(simulated: SimulatedLoop) -> np.ndarray:
    """Return the telemetry's sigma of alpha, q and nz."""
    t = simulated.x29.telemetry
    return np.array([t.alpha_noise, t.q_noise, t.nz_noise])


def misfit(
    record: Record,
    simulated: np.ndarray,
    estimate: Estimate,
    noise_std: np.ndarray,
    stretch: tuple[float, float] | None,
    peak: tuple[float, float] | None,
) -> Misfit:
    """Misfit of a simulation ``(3, N)`` and of the innovations of its estimate, relative to
    ``noise_std (3,)``.
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
    series = (history.innovation[row] / history.innovation_std[row])[history.valid[row]]
    centred = series - series.mean()
    power = np.abs(np.fft.rfft(centred)) ** 2
    nis = float(history.nis.sum()) / max(int(history.degrees.sum()), 1)
    return Misfit(
        {name: float(np.sqrt(np.mean(line**2))) for name, line in zip(names, error, strict=True)},
        float(np.sqrt(np.mean(error[row, inside] ** 2))) if inside.any() else 0.0,
        float(np.sqrt(np.mean(error[row, ~inside] ** 2))) if inside.any() else 0.0,
        measured,
        simulated_peak,
        float(centred[1:] @ centred[:-1] / (centred @ centred)),
        ljung_box(series, np.ones(len(series), dtype=bool), "q").statistic,
        float(power[1 : max(2, len(power) // 5)].sum() / power[1:].sum()),
        float(np.sqrt(nis)),
    )


# ---- The same record estimated in other ways than the scenario's own

RESTART_PASSES = 5  # restarts of plain filters from their own result


@dataclass(frozen=True, eq=False)
class LoopMethodResult:
    """Result of one method: delay (s), values and sigmas by name of the parameters,
    log-likelihood.
    """

    name: str
    label: str
    delay: float
    values: Mapping[str, float]
    std: Mapping[str, float]
    log_likelihood: float

    @property
    def frequency(self) -> float:
        """Undamped natural frequency of its short period, rad/s; NaN if that does not
        oscillate.
        """
        v = self.values
        stiffness = v["L_alpha"] * v["M_q"] - v["L_q"] * v["M_alpha"]
        return float(np.sqrt(stiffness)) if stiffness > 0 else float("nan")

    @property
    def damping(self) -> float:
        """Its damping ratio."""
        return -(self.values["L_alpha"] + self.values["M_q"]) / (2.0 * self.frequency)


@dataclass(frozen=True, eq=False)
class Restarts:
    """Plain filters with the printed P0 held at some delays (s), each started again from its own
    result.

    ``values`` : by parameter, ``(passes, delays)``.
    """

    delays: tuple[float, ...]
    values: Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class MethodInputs:
    """Inputs of the methods: the paper's set-up and its bank, ours and its refined bank, and the
    record set up again.
    """

    paper: SetUp
    single_pass: SinglePass
    estimation: LoopEstimation
    refined: DelayBank
    again: Callable[[LoopEstimation], SetUp]


def run_methods(names: Sequence[str], ways: MethodInputs) -> tuple[LoopMethodResult, ...]:
    """Each named method on the record; ``names`` are keys of ``METHODS``."""
    return tuple(_RUN[name](name, ways) for name in names)


def other_side(first_estimate: SinglePass, refined_delay: float) -> int:
    """Return the filter next to the refined delay, on the side opposite to the most likely one."""
    best = int(np.argmax(first_estimate.bank.log_likelihood))
    step = 1 if first_estimate.delays[best] < refined_delay else -1
    return min(max(best + step, 0), len(first_estimate.delays) - 1)


def all_restarts(ways: MethodInputs, delays: Sequence[float]) -> dict[str, Restarts]:
    """Plain restarts at some delays (s), with P0 and R as printed and with each of them another."""
    louder = _set_up(ways, prior="printed", noise_share=2.0 * ways.estimation.noise_share)
    settings = {
        "R and P0 as printed": ways.paper,
        "P0 a quarter of the start": _set_up(ways, prior="quarter"),
        "R four times as large": louder,
    }
    return {label: single_pass_restarts(setting, delays) for label, setting in settings.items()}


def single_pass_restarts(
    setting: SetUp, delays: Sequence[float], passes: int = RESTART_PASSES
) -> Restarts:
    """Plain filters at held delays, ``passes`` times each from its last parameters with the same
    P0.
    """
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
    """Vertex of the parabola through the largest log-likelihood of the bank and its neighbours,
    s.
    """
    L, best = first_estimate.bank.log_likelihood, int(np.argmax(first_estimate.bank.log_likelihood))
    near = slice(min(max(best - 1, 0), len(L) - 3), min(max(best + 2, 3), len(L)))
    return vertex(first_estimate.delays[near], L[near])[0]


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


def _at_fixed_delay(name: str, ways: MethodInputs) -> LoopMethodResult:
    delay = ways.refined.refined
    bank = run_bank(ways.paper.record, ways.paper.system, fixed_values={"delay": np.array([delay])})
    return _of_bank(name, replace(ways.single_pass, bank=bank, delays=np.array([delay])), 0)


def _relinearised(name: str, ways: MethodInputs) -> LoopMethodResult:
    bank, _ = run_iterated_bank(
        ways.paper.record,
        ways.paper.system,
        fixed_values={"delay": np.array([ways.single_pass.delay])},
    )
    return _of_bank(
        name, replace(ways.single_pass, bank=bank, delays=np.array([ways.single_pass.delay])), 0
    )


def _set_up(ways: MethodInputs, **changes: Any) -> SetUp:
    return ways.again(replace(ways.estimation, **changes))


def _refined(name: str, setting: SetUp) -> LoopMethodResult:
    return of_refined(name, METHODS[name], refined(setting))


def of_refined(name: str, label: str, bank: DelayBank) -> LoopMethodResult:
    """Return a refined bank's result in the same form."""
    estimate = bank.estimate
    std = dict(zip(estimate.names, estimate.std.tolist(), strict=True))
    return LoopMethodResult(
        name, label, bank.refined, estimate.as_dict(), std, estimate.log_likelihood
    )


_RUN: Mapping[str, Callable[[str, MethodInputs], LoopMethodResult]] = {
    "paper": lambda name, ways: _best(name, ways.single_pass),
    "paper-other": lambda name, ways: _of_bank(
        name, ways.single_pass, other_side(ways.single_pass, ways.refined.refined)
    ),
    "paper-density": lambda name, ways: _best(
        name, single_pass(_set_up(ways, prior="printed", process_noise=printed_density("flight")))
    ),
    "plain-quarter": lambda name, ways: _best(name, single_pass(_set_up(ways, prior="quarter"))),
    "held": _at_fixed_delay,
    "relinearised": _relinearised,
    "refined-printed": lambda name, ways: _refined(name, _set_up(ways, prior="printed")),
    "refined-quarter": lambda name, ways: _refined(name, _set_up(ways, prior="quarter")),
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
    """Fly a variant with a seed and estimate it; ``start`` is the scenario's, where the variant
    declares none.
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
    """The paper's bank on flights that differ in their noise alone.

    Attributes
    ----------
    seeds : ``(k,)``.
    delays : the most likely delay of each, s.
    names : of the parameters.
    values : ``(k, n)`` parameters of the filter at that delay.
    """

    seeds: tuple[int, ...]
    delays: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray

    def by_delay(self) -> list[tuple[float, np.ndarray]]:
        """Each delay that was chosen, with the rows ``(j, n)`` of the flights that chose it; the
        most frequent first.
        """
        chosen = [
            (float(delay), self.values[self.delays == delay]) for delay in np.unique(self.delays)
        ]
        return sorted(chosen, key=lambda each: -len(each[1]))


def run_over_seeds(
    scenario: LoopScenario, start: Mapping[str, float], prior: str
) -> OverSeeds | None:
    """Return the paper's bank with the seeds 1 to ``scenario.seeds``; ``prior`` is its rule for P0.
    None if no seeds are requested.
    """
    if not scenario.seeds:
        return None
    seeds = tuple(range(1, scenario.seeds + 1))
    estimate = [
        single_pass(
            set_up(scenario.estimation, fly_loop(scenario.flight, seed), start, prior=prior)
        )
        for seed in seeds
    ]
    delays = np.array([round(each.delay, 6) for each in estimate])
    return OverSeeds(
        seeds,
        delays,
        estimate[0].estimate.names,
        np.array([each.estimate.values for each in estimate]),
    )
