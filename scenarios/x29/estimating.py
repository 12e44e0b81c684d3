"""The low-order filter of a closed-loop scenario: set up by the paper's rules, run as a bank of delays, refined, flown freely."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import BankEstimate
from ident.banks.delays import BATCHED, DELAYS, ENGINES, BankEngine, DelayBank, likelihood_weights, run_delay_bank
from ident.estimate import Estimate, Outcome
from ident.filters.smoother import smooth
from ident.statistics.noise_levels import noise_envelope
from scenarios.identification.low_order_filter import ENGINEERING_STD, loes_filter_system
from scenarios.x29.declaration import LoopEstimation
from scenarios.x29.flying import Flown, low_order_model
from scenarios.x29.published import printed_start
from sim.declaration.model import System
from sim.propagation import drive_from_record, make_grid, simulate
from sim.record import Record

SETTLED = 0.1  # sigmas: a restart that moves nothing further has settled
ROUGH_DELAYS = tuple(0.0875 + 0.0125 * i for i in range(7))  # s, for variants


@dataclass(frozen=True, eq=False)
class SetUp:
    """A record cut to the window, the filter's System for it, the noise it assumes, and who runs it."""

    record: Record
    system: System
    noise_std: Mapping[str, float]
    engine: BankEngine = BATCHED


@dataclass(frozen=True, eq=False)
class Plain:
    """The paper's own way: one pass of the bank, and the filter of the most likely delay.

    ``estimate`` has the parameters without the delay.
    """

    bank: BankEstimate
    delays: np.ndarray
    weights: np.ndarray
    delay: float
    weighted_mean: float
    estimate: Estimate


def set_up(
    estimation: LoopEstimation, flown: Flown, start: Mapping[str, float], initial: Mapping[str, float] | None = None, prior: str = ""
) -> SetUp:
    """The fourteen-state filter for a flight's record. ``start`` : by the names of a vehicle file; ``initial`` : further starts of
    constants; ``prior`` : another rule for P0 than the estimation's."""
    record = flown.record
    if estimation.window_start is not None or estimation.window_stop is not None:
        record = record.window(estimation.window_start, estimation.window_stop)
    t = flown.x29.telemetry
    sensors = {"alpha": t.alpha_noise, "q": t.q_noise, "nz": t.nz_noise}
    found = noise_envelope(record) if estimation.noise_from == "envelope" else sensors
    noise = {name: estimation.noise_share * found[name] for name in sensors}
    # The delay here is only a place holder: the bank holds it at each of its values.
    model = low_order_model(flown.x29, {**start, "delay": 0.0})
    system = loes_filter_system(model, record, noise, estimation.process_noise, ENGINEERING_STD)
    if (prior or estimation.prior) == "printed":
        system = _printed_prior(system)
    system = replace(system, initial=system.initial.with_prior(dict(estimation.initial_std)))
    if initial:
        system = replace(system, parameters=system.parameters.with_values(dict(initial)))
    return SetUp(record, system, noise, ENGINES[estimation.engine])


def _printed_prior(system: System) -> System:
    """The System with P0 of the paper's Tables 1 and 2, which are alike: it carries the simulation's over to the flight."""
    printed = {name: cell.std for name, cell in printed_start("simulation").items() if cell.std is not None}
    states = {name: std for name, std in printed.items() if name in system.state_names}
    others = {name: std for name, std in printed.items() if name not in states}
    return replace(system, initial=system.initial.with_prior(states), parameters=system.parameters.with_prior(others))


def refined(setting: SetUp) -> DelayBank:
    """The bank with a delay between its grid points; P0 stays as the paper's rule has it, also where the record contradicts it."""
    return run_delay_bank(setting.record, setting.system, widenings=0, engine=setting.engine)


def plain(setting: SetUp) -> Plain:
    """One pass of nine filters, and the estimate of the most likely one."""
    system, delays = setting.system, np.array(DELAYS)
    bank = setting.engine.run(setting.record, system, held={"delay": delays})
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
    return Plain(bank, delays, weights, DELAYS[best], float(weights @ delays), estimate)


def started_again(estimation: LoopEstimation, flown: Flown, found: Estimate) -> SetUp:
    """The filter for the same flight started at a result, with the same rule for P0."""
    values = found.as_dict()
    constants = {name: values[name] for name in ("L_0", "M_0", "delta_0")}
    start = {name: value for name, value in values.items() if name not in (*constants, "nz_0", "delay")}
    return set_up(estimation, flown, start, constants)


def rough(setting: SetUp) -> tuple[Estimate, float]:
    """A quick estimate for variants: seven delays 12.5 ms apart, linearised once anew; the likeliest filter and its delay (s)."""
    delays = np.array(ROUGH_DELAYS)
    bank, trajectories = setting.engine.iterated(setting.record, setting.system, held={"delay": delays}, tolerance=np.inf)
    best = int(np.argmax(bank.log_likelihood))
    return setting.engine.alone(setting.record, _at(setting.system, float(delays[best])), None, trajectories[:, :, best]), float(delays[best])


def free_simulation(setting: SetUp, estimate: Estimate, delay: float) -> np.ndarray:
    """Outputs ``(3, N)`` of the final estimate driven by the stick alone, from the smoothed state at the window's begin."""
    record, system = setting.record, setting.system
    values = {name: value for name, value in estimate.as_dict().items() if name != "delay"}
    p = system.parameters.with_values({**values, "delay": delay}).values().tolist()
    grid = make_grid(record.time, float(np.diff(record.time).max()))
    drive = drive_from_record(system, p, record.input_array(system.input_names), record.time, record.hold, grid)
    x0 = [0.0, 0.0, 0.0] if estimate.history is None else smooth(estimate.history).mean[:3, 0].tolist()
    return np.array(simulate(system, p, x0, drive, grid))


def _at(system: System, delay: float) -> System:
    return replace(system, parameters=system.parameters.with_values({"delay": delay}))
