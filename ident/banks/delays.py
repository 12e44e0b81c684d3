"""Pure delays by a bank of filters, and the two engines of the extended Kalman filter.

The engines solve the same equations and agree to rounding; docs/decisions/0022-who-runs-the-bank.md
compares their times. By default filterpy filters a single record, and the batched kernel a bank of
delays. ``against_filterpy`` compares the most likely filter of a bank with that of filterpy.

NASA TM-101722 ran nine filters from 0 to 200 ms, and used the most likely one and the weighted sum.
Both are given here, and a refined delay between the grid points. Wrong starting values bias plain
filters, since delay, lag and short period are correlated. The refined banks are therefore
linearised about their own smoothed result (`ident.banks.bank`). Their grids shrink about the
maximum until the log likelihood is a parabola. Its vertex is the delay, and its curvature gives the
sigma.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import (
    MOST_ITERATIONS,
    BankEstimate,
    filter_alone,
    filter_batched,
    run_bank,
    run_iterated_bank,
)
from ident.estimate import Estimate, Outcome
from ident.filters.ekf import SETTLED_SIGMAS, FilterSettings, OnePass, filter_by_filterpy, run_ekf
from ident.filters.problem import filter_problem
from ident.filters.smoother import smooth
from sim.declaration.model import System
from sim.errors import ModelError
from sim.record import Record

# ---- The two engines of the extended Kalman filter


@dataclass(frozen=True)
class BankEngine:
    """Functions of an engine that runs an extended Kalman filter, alone or in a bank of delays.

    Attributes
    ----------
    name : key in ``ENGINES``, in scenario files, on the command line and in study files.
    label : name in reports.
    run : runs a filter for each value of a fixed parameter, as ``run_bank``.
    iterated : does so with each filter linearised about its own smoothed result, as
        ``run_iterated_bank``.
    alone : runs one filter with its history, as ``filter_alone``.
    one_pass : runs one pass, as ``filter_by_filterpy``.
    """

    name: str
    label: str
    run: Callable[..., BankEstimate]
    iterated: Callable[..., tuple[BankEstimate, np.ndarray]]
    alone: Callable[[Record, System, FilterSettings | None, np.ndarray | None], Estimate]
    one_pass: OnePass


def run_one_by_one(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    fixed_values: Mapping[str, np.ndarray],
) -> BankEstimate:
    """Return the result of ``run_bank`` by B calls of ``run_ekf`` with filterpy; ``fixed_values``
    maps a parameter to its values ``(B,)``.
    """
    estimates = [
        run_ekf(record, fixed_system, settings, by=filter_by_filterpy)
        for fixed_system in _systems(system, fixed_values)
    ]
    sound = [estimate.outcome is Outcome.CONVERGED for estimate in estimates]
    return _bank(estimates, np.array(sound))


def run_iterated_one_by_one(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    fixed_values: Mapping[str, np.ndarray],
    about: np.ndarray | None = None,
    iterations: int = MOST_ITERATIONS,
    tolerance: float = SETTLED_SIGMAS,
) -> tuple[BankEstimate, np.ndarray]:
    """Return the result of ``run_iterated_bank`` with filterpy; arguments and errors are equal."""
    settings = settings or FilterSettings()
    problems = [
        filter_problem(record, fixed_system, settings.max_step)
        for fixed_system in _systems(system, fixed_values)
    ]
    count, N = len(problems), len(record)
    points: list[np.ndarray | None] = (
        [None] * count
        if about is None
        else list(np.moveaxis(np.broadcast_to(about, (*about.shape[:2], count)), 2, 0))
    )
    before: np.ndarray | None = None
    converged, passes = np.zeros(count, dtype=bool), 0
    while True:
        passes += 1
        estimates = [
            filter_by_filterpy(problem, settings, about=point)
            for problem, point in zip(problems, points, strict=True)
        ]
        sound = np.array([item.outcome is Outcome.CONVERGED for item in estimates])
        # A failed filter is linearised about its start.
        points = [
            smooth(estimate.history).mean
            if finite and estimate.history is not None
            else np.repeat(problem.start[:, None], N, axis=1)
            for problem, estimate, finite in zip(problems, estimates, sound, strict=True)
        ]
        values = np.stack([estimate.values for estimate in estimates], axis=1)
        std = np.stack([estimate.std for estimate in estimates], axis=1)
        if before is not None:
            sigmas = np.abs(values - before) / np.maximum(std, np.finfo(float).tiny)
            converged = np.max(sigmas, axis=0, initial=0.0) < tolerance
        if (np.all(converged | ~sound) and before is not None) or passes == iterations:
            break
        before = values
    trajectories = [point for point in points if point is not None]
    return replace(
        _bank(estimates, sound & converged), iterations=np.full(count, passes)
    ), np.stack(trajectories, axis=2)


def alone_by_filterpy(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    about: np.ndarray | None = None,
) -> Estimate:
    """Return the result of ``filter_alone`` by filterpy; ``about (n, N)`` as there."""
    settings = settings or FilterSettings()
    return filter_by_filterpy(
        filter_problem(record, system, settings.max_step), settings, about=about
    )


BATCHED = BankEngine(
    "batched", "batched kernel", run_bank, run_iterated_bank, filter_alone, filter_batched
)
FILTERPY = BankEngine(
    "filterpy",
    "filterpy ExtendedKalmanFilter",
    run_one_by_one,
    run_iterated_one_by_one,
    alone_by_filterpy,
    filter_by_filterpy,
)
ENGINES: Mapping[str, BankEngine] = {engine.name: engine for engine in (FILTERPY, BATCHED)}


@dataclass(frozen=True)
class SecondPass:
    """Differences of the most likely filter of a batched bank from that by filterpy, in one pass.

    Attributes
    ----------
    delay : fixed value of the parameter of the bank, e.g. the delay in s.
    mean, std : largest differences of states and parameters, and of their standard deviations,
        after the last sample, in sigmas.
    log_likelihood : relative difference.
    """

    delay: float
    mean: float
    std: float
    log_likelihood: float

    @property
    def sigmas(self) -> float:
        """The larger of the differences of means and of standard deviations, in sigmas."""
        return max(self.mean, self.std)


def against_filterpy(
    record: Record, system: System, bank: BankEstimate, values: np.ndarray
) -> SecondPass | None:
    """Compare the most likely filter of a batched bank of one pass with that by filterpy.

    Parameters
    ----------
    record, system : those of the bank.
    bank : the bank.
    values : ``(B,)`` delays of its filters, s.

    Returns
    -------
    The differences; None where no filter of the bank is sound.
    """
    best = int(np.argmax(bank.log_likelihood))
    if not bank.sound[best]:
        return None
    best_filter = replace(
        bank,
        mean=bank.mean[:, best : best + 1],
        covariance=bank.covariance[best : best + 1],
        log_likelihood=bank.log_likelihood[best : best + 1],
        sound=bank.sound[best : best + 1],
    )
    single_pass = replace(FilterSettings(), passes=1)
    differences = agreement(
        best_filter,
        run_one_by_one(
            record, system, single_pass, fixed_values={"delay": np.atleast_1d(values[best])}
        ),
    )
    if not differences.sound:
        return None
    return SecondPass(
        float(values[best]), differences.mean, differences.std, differences.log_likelihood
    )


@dataclass(frozen=True)
class BankDifferences:
    """Largest differences of two banks over the same delays, for runs that are sound in both.

    Attributes
    ----------
    mean : of states and parameters after the last sample, in sigmas.
    std : of their standard deviations, relative.
    log_likelihood : relative.
    sound : whether the same runs are sound in both.
    """

    mean: float
    std: float
    log_likelihood: float
    sound: bool

    @property
    def largest(self) -> float:
        """The largest of the three."""
        return max(self.mean, self.std, self.log_likelihood)


def agreement(first: BankEstimate, second: BankEstimate) -> BankDifferences:
    """Return the differences of two banks of the same runs, in sigmas of the ``first``."""
    both = first.sound & second.sound
    sigma = np.maximum(first.std[:, both], np.finfo(float).tiny)
    likelihood = first.log_likelihood[both]
    return BankDifferences(
        float(np.max(np.abs(second.mean[:, both] - first.mean[:, both]) / sigma, initial=0.0)),
        float(np.max(np.abs(second.std[:, both] / sigma - 1.0), initial=0.0)),
        float(
            np.max(
                np.abs(second.log_likelihood[both] - likelihood) / np.abs(likelihood), initial=0.0
            )
        ),
        bool(np.array_equal(first.sound, second.sound)),
    )


def _systems(system: System, fixed_values: Mapping[str, np.ndarray]) -> list[System]:
    """Return the System of each run, with its fixed values."""
    runs = zip(*(np.atleast_1d(values).tolist() for values in fixed_values.values()), strict=True)
    return [
        replace(
            system,
            parameters=system.parameters.with_values(dict(zip(fixed_values, values, strict=True))),
        )
        for values in runs
    ]


def _bank(estimates: list[Estimate], sound: np.ndarray) -> BankEstimate:
    """Return the estimates of single filters as a bank; a failed run has zero likelihood."""
    histories = [item.history for item in estimates if item.history is not None]
    assert len(histories) == len(estimates)
    return BankEstimate(
        histories[0].names,
        np.stack([history.mean[:, -1] for history in histories], axis=1),
        np.stack([history.covariance[-1] for history in histories]),
        np.where(sound, [estimate.log_likelihood for estimate in estimates], -np.inf),
        np.stack([history.nis for history in histories], axis=1),
        sound,
        np.array([estimate.iterations for estimate in estimates]),
    )


# ---- A pure delay found by a bank of filters

DELAYS = tuple(0.025 * i for i in range(9))  # s
_LARGEST_PARABOLA_FALL = 4.5  # largest drop of log likelihood over a parabola: three sigmas
_FINEST_SPACING = 1e-4  # smallest difference of two delays, s
_REFINED_POINTS = 7  # delays in a refined bank
_MOST_BANKS = 8  # most refined banks
_REFINED_REACH = 6.0  # half-width of a refined bank, in sigmas
_SETTLED_SIGMAS = 0.1  # tolerance of the last bank; it changes the log likelihood by 0.005
WIDENINGS = 4  # most repetitions with wider priors
FAR_SIGMAS = 3.0  # largest change of a parameter, in sigmas of its prior, that agrees with it


@dataclass(frozen=True, eq=False)
class DelayBank:
    """Result of a bank of filters with different delays.

    Attributes
    ----------
    delays, log_likelihood : ``(B,)`` of the declared grid, s; minus infinity for a filter that
        broke down.
    weights : ``(B,)`` likelihoods normalised to a sum of one.
    bank : estimates of the declared grid.
    most_likely : delay of the largest likelihood, s.
    weighted_mean : mean of the delays by their weights, s.
    refined, refined_std : delay between the grid points and its standard deviation, s, which holds
        for white innovations and a correct model.
    at_edge : whether no maximum is inside the grid; the refined delay then has no sigma.
    estimate : the iterated filter at the refined delay, with its history. Where the delay has a
        sigma, it is the last parameter, and its uncertainty is in the covariance of the others.
        The message names contradicted priors.
    contradicted : parameters that are more than ``FAR_SIGMAS`` sigmas of the prior from the start,
        with this distance. Their estimates depend on the start.
    system : the System of ``estimate``, with the widened priors.
    about : ``(n, N)`` smoothed trajectory that the refined filters were linearised about; None
        where none was sound.
    """

    delays: np.ndarray
    log_likelihood: np.ndarray
    weights: np.ndarray
    bank: BankEstimate
    most_likely: float
    weighted_mean: float
    refined: float
    refined_std: float
    at_edge: bool
    estimate: Estimate
    contradicted: tuple[tuple[str, float], ...]
    system: System
    about: np.ndarray | None


def run_delay_bank(
    record: Record,
    system: System,
    delays: Sequence[float] = DELAYS,
    *,
    name: str = "delay",
    widenings: int = WIDENINGS,
    engine: BankEngine = BATCHED,
) -> DelayBank:
    """Run a filter for each delay in one batched pass, then refine.

    Parameters
    ----------
    record : as for ``run_ekf``.
    system : model compiled with ``online=True``, with a fixed parameter ``name``.
    delays : at least three, increasing, s.
    widenings : most repetitions with wider priors where the record contradicts the priors, so that
        the result does not depend on a wrong start. The sigma of such a prior becomes the distance
        of the estimate from the start. With 0 the declared priors are kept.
    engine : runs the filters; both engines give the same result.

    Raises
    ------
    ModelError : as for ``run_ekf``. Also where there are fewer than three delays, they do not
        increase, or ``name`` is free or unknown.
    """
    grid = np.asarray(delays, dtype=float)
    if grid.ndim != 1 or grid.size < 3 or np.any(np.diff(grid) <= 0):
        raise ModelError(
            "fewer than three delays, or not increasing",
            where="delay bank",
            remedy="give three or more in order, in s",
        )
    settings = FilterSettings()
    bank = engine.run(record, system, settings, fixed_values={name: grid})
    weights, best = likelihood_weights(bank.log_likelihood), int(np.argmax(bank.log_likelihood))
    between = (float(grid[max(best - 1, 0)]), float(grid[min(best + 1, grid.size - 1)]))

    def refined(start: float, about: np.ndarray | None) -> _RefinedDelay:
        return _refine_delay(engine, record, system, settings, name, grid, start, between, about)

    bank_result = refined(float(grid[best]), None)
    for _ in range(widenings):
        contradicted_parameters = contradicted(system, bank_result.parameters)
        if not contradicted_parameters:
            break
        system = widened(system, contradicted_parameters)
        half = 0.5 * (between[1] - between[0])
        between = (
            max(bank_result.delay - half, float(grid[0])),
            min(bank_result.delay + half, float(grid[-1])),
        )
        bank_result = refined(bank_result.delay, bank_result.about)
    held = replace(system, parameters=system.parameters.with_values({name: bank_result.delay}))
    nearest = None if bank_result.about is None else bank_result.about[:, :, 0]
    estimate = engine.alone(record, held, settings, nearest)
    contradicted_parameters = contradicted(system, estimate.as_dict())
    if contradicted_parameters and estimate.outcome is Outcome.CONVERGED:
        text = ", ".join(f"{each} by {abs(sigmas):.1f}" for each, sigmas in contradicted_parameters)
        message = (
            f"but far from the start, in sigmas of its prior: {text}; start again from this result"
        )
        estimate = replace(estimate, message=message)
    if bank_result.std > 0 and estimate.outcome is Outcome.CONVERGED:
        estimate = _with_delay(
            estimate, name, system.parameters[name].unit, bank_result, len(system.states)
        )
    return DelayBank(
        grid,
        bank.log_likelihood,
        weights,
        bank,
        float(grid[best]),
        float(weights @ grid),
        bank_result.delay,
        bank_result.std,
        bank_result.std == 0.0,
        estimate,
        contradicted_parameters,
        system,
        nearest,
    )


def contradicted(system: System, values: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    """Return the free parameters beyond ``FAR_SIGMAS`` of their prior, with their distance."""
    free = [system.parameters[name] for name in system.parameters.free_names if name in values]
    far = [
        (item.name, (values[item.name] - item.value) / item.prior_std)
        for item in free
        if item.prior_std > 0
    ]
    return tuple((name, float(sigmas)) for name, sigmas in far if abs(sigmas) > FAR_SIGMAS)


def widened(system: System, contradicted_parameters: Sequence[tuple[str, float]]) -> System:
    """Return the System with the sigmas of these priors as large as the distance of the
    estimates.
    """
    parameters = system.parameters
    wider = {name: abs(far) * parameters[name].prior_std for name, far in contradicted_parameters}
    return replace(system, parameters=parameters.with_prior(wider))


def likelihood_weights(log_likelihood: np.ndarray) -> np.ndarray:
    """Return likelihoods ``(..., B)`` normalised to a sum of one; equal if none is finite."""
    top = np.max(log_likelihood, axis=-1, keepdims=True)
    finite = np.isfinite(top)
    weights = np.exp(np.where(finite, log_likelihood - np.where(finite, top, 0.0), 0.0))
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))


def vertex(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the vertex of the parabola through three points ``(3,)``, and minus its second
    derivative.
    """
    d1, d2 = (y[1] - y[0]) / (x[1] - x[0]), (y[2] - y[1]) / (x[2] - x[1])
    curvature = -2.0 * (d2 - d1) / (x[2] - x[0])
    if not curvature > 0:
        return float(x[1]), 0.0
    return float(0.5 * (x[0] + x[1]) + d1 / curvature), float(curvature)


@dataclass(frozen=True, eq=False)
class _RefinedDelay:
    """Refined delay and its sigma, s, which is 0 without a maximum inside the grid; derivative
    ``slope (n,)`` of the mean with respect to the delay; smoothed trajectory ``about (n, N, 1)`` of
    the nearest filter, and its final parameters.
    """

    delay: float
    std: float
    slope: np.ndarray
    about: np.ndarray | None
    parameters: Mapping[str, float]


def _refine_delay(
    engine: BankEngine,
    record: Record,
    system: System,
    settings: FilterSettings,
    name: str,
    grid: np.ndarray,
    best: float,
    between: tuple[float, float],
    about: np.ndarray | None,
) -> _RefinedDelay:
    """Return the delay of the maximum likelihood, by iterated banks on shrinking grids.

    Each grid has its centre at the vertex of the one before and a width by its curvature. Where the
    maximum is at an end, the grid is moved first. Only the last bank is iterated to convergence.
    """
    low, high = between
    without_maximum = _RefinedDelay(best, 0.0, np.zeros(0), about, {})
    for _ in range(_MOST_BANKS):
        fine = np.linspace(low, high, _REFINED_POINTS)
        bank, trajectories = engine.iterated(
            record, system, settings, fixed_values={name: fine}, about=about, tolerance=np.inf
        )
        if not np.any(bank.sound):
            return without_maximum
        top = int(np.argmax(bank.log_likelihood))
        about = trajectories[:, :, top : top + 1]
        without_maximum = _RefinedDelay(
            float(fine[top]), 0.0, np.zeros(0), about, _at_end(system, about)
        )
        if top in (0, _REFINED_POINTS - 1):
            shift = (
                (fine[top] - 0.5 * (low + high)) if top else -min(0.5 * (high - low), low - grid[0])
            )
            shift = min(shift, grid[-1] - high)
            if shift == 0.0:
                return without_maximum
            low, high = low + shift, high + shift
            continue
        near = slice(top - 1, top + 2)
        spacing = fine[1] - fine[0]
        fall = bank.log_likelihood[top] - bank.log_likelihood[near].min()
        if fall <= _LARGEST_PARABOLA_FALL or spacing <= _FINEST_SPACING:
            bank, trajectories = engine.iterated(
                record,
                system,
                settings,
                fixed_values={name: fine[near]},
                about=trajectories[:, :, near],
                tolerance=_SETTLED_SIGMAS,
            )
            delay, curvature = vertex(fine[near], bank.log_likelihood)
            if curvature > 0 and np.all(bank.sound) and abs(delay - fine[top]) <= spacing:
                slope = (bank.mean[:, 2] - bank.mean[:, 0]) / (2.0 * spacing)
                nearest = trajectories[:, :, 1:2]
                return _RefinedDelay(
                    delay, curvature**-0.5, slope, nearest, _at_end(system, nearest)
                )
            if curvature > 0 and np.all(bank.sound):
                low, high = delay - 0.5 * (high - low), delay + 0.5 * (high - low)
                continue
            return without_maximum
        delay, curvature = vertex(fine[near], bank.log_likelihood[near])
        half = spacing
        if curvature > 0:
            half = max(min(_REFINED_REACH * curvature**-0.5, spacing), 3.0 * _FINEST_SPACING)
        low, high = delay - half, delay + half
    return without_maximum


def _at_end(system: System, trajectory: np.ndarray) -> Mapping[str, float]:
    """Return the free parameters at the last sample of a trajectory ``(n, N, 1)``."""
    values = trajectory[len(system.states) :, -1, 0].tolist()
    return dict(zip(system.parameters.free_names, values, strict=True))


def _with_delay(
    estimate: Estimate, name: str, unit: str, refined: _RefinedDelay, n_x: int
) -> Estimate:
    """Return the estimate with the delay as its last parameter. The uncertainty of the delay is
    added to the covariance of the others.
    """
    n = len(estimate.names)
    covariance = np.zeros((n + 1, n + 1))
    covariance[:n, :n] = estimate.covariance
    delay_sigmas = np.append(refined.slope[n_x:], 1.0) * refined.std
    return replace(
        estimate,
        names=(*estimate.names, name),
        units=(*estimate.units, unit),
        values=np.append(estimate.values, refined.delay),
        covariance=covariance + np.outer(delay_sigmas, delay_sigmas),
    )
