"""The two engines of the extended Kalman filter: filterpy's ExtendedKalmanFilter, and the batched kernel of our own.

Both solve the same equations and agree to rounding (docs/decisions/0022-who-runs-the-bank.md says what each costs). A single record is
filtered by filterpy unless the user asks otherwise; a bank of delays is filtered by the batched kernel, and ``against_filterpy`` compares its
likeliest filter with filterpy's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import BankEstimate, run_bank
from ident.banks.iterated import ITERATIONS, run_iterated_bank
from ident.banks.single_filter import filter_alone, filter_batched
from ident.estimate import Estimate, Outcome
from ident.filters.ekf import SETTLED, FilterSettings, OnePass, filter_by_filterpy, run_ekf
from ident.filters.problem import filter_problem
from ident.filters.smoother import smooth
from sim.declaration.model import System
from sim.record import Record


@dataclass(frozen=True)
class BankEngine:
    """What an extended Kalman filter, alone or in a bank of delays, asks of its engine.

    Attributes
    ----------
    name : key in ``ENGINES``; the same in scenario files, on the command line and in study files.
    label : for people.
    run : a filter for each value of a held parameter, as ``run_bank``.
    iterated : the same, each linearised anew about its own smoothed result, as ``run_iterated_bank``.
    alone : one filter with its whole history, as ``filter_alone``.
    one_pass : one pass over a prepared problem, as ``filter_by_filterpy``.
    """

    name: str
    label: str
    run: Callable[..., BankEstimate]
    iterated: Callable[..., tuple[BankEstimate, np.ndarray]]
    alone: Callable[[Record, System, FilterSettings | None, np.ndarray | None], Estimate]
    one_pass: OnePass


def run_one_by_one(record: Record, system: System, settings: FilterSettings | None = None, *, held: Mapping[str, np.ndarray]) -> BankEstimate:
    """``run_bank`` for values ``held (B,)`` by name, by B calls of ``run_ekf`` with filterpy's passes. Raises as it does."""
    estimates = [run_ekf(record, each, settings, by=filter_by_filterpy) for each in _systems(system, held)]
    return _bank(estimates, np.array([each.outcome is Outcome.CONVERGED for each in estimates]))


def run_iterated_one_by_one(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    held: Mapping[str, np.ndarray],
    about: np.ndarray | None = None,
    iterations: int = ITERATIONS,
    tolerance: float = SETTLED,
) -> tuple[BankEstimate, np.ndarray]:
    """``run_iterated_bank`` with each pass of each filter by filterpy. Arguments, result ``(n, N, B)`` and errors as there."""
    settings = settings or FilterSettings()
    problems = [filter_problem(record, each, settings.max_step) for each in _systems(system, held)]
    count, N = len(problems), len(record)
    points: list[np.ndarray | None] = [None] * count if about is None else list(np.moveaxis(np.broadcast_to(about, (*about.shape[:2], count)), 2, 0))
    before: np.ndarray | None = None
    settled, passes = np.zeros(count, dtype=bool), 0
    while True:
        passes += 1
        found = [filter_by_filterpy(problem, settings, about=point) for problem, point in zip(problems, points, strict=True)]
        sound = np.array([each.outcome is Outcome.CONVERGED for each in found])
        # A filter that broke down is linearised at its start, as in the batched bank.
        points = [
            smooth(each.history).mean if good and each.history is not None else np.repeat(problem.start[:, None], N, axis=1)
            for problem, each, good in zip(problems, found, sound, strict=True)
        ]
        values, std = np.stack([each.values for each in found], axis=1), np.stack([each.std for each in found], axis=1)
        if before is not None:
            settled = np.max(np.abs(values - before) / np.maximum(std, np.finfo(float).tiny), axis=0, initial=0.0) < tolerance
        if (np.all(settled | ~sound) and before is not None) or passes == iterations:
            break
        before = values
    trajectories = [point for point in points if point is not None]
    return replace(_bank(found, sound & settled), iterations=np.full(count, passes)), np.stack(trajectories, axis=2)


def alone_by_filterpy(record: Record, system: System, settings: FilterSettings | None = None, about: np.ndarray | None = None) -> Estimate:
    """``filter_alone`` by filterpy: one pass, linearised about ``about (n, N)`` where given."""
    settings = settings or FilterSettings()
    return filter_by_filterpy(filter_problem(record, system, settings.max_step), settings, about=about)


BATCHED = BankEngine("batched", "batched kernel", run_bank, run_iterated_bank, filter_alone, filter_batched)
FILTERPY = BankEngine("filterpy", "filterpy ExtendedKalmanFilter", run_one_by_one, run_iterated_one_by_one, alone_by_filterpy, filter_by_filterpy)
ENGINES: Mapping[str, BankEngine] = {each.name: each for each in (FILTERPY, BATCHED)}


@dataclass(frozen=True)
class SecondPass:
    """The likeliest filter of a batched bank, run again by filterpy in one pass.

    Attributes
    ----------
    held : value that the filter was held at, e.g. its delay in s.
    mean, std : largest differences of states and parameters, and of their standard deviations, after the last sample; in sigmas.
    log_likelihood : relative difference.
    """

    held: float
    mean: float
    std: float
    log_likelihood: float

    @property
    def sigmas(self) -> float:
        """The larger of the differences of means and of standard deviations, in sigmas."""
        return max(self.mean, self.std)


def against_filterpy(
    record: Record, system: System, bank: BankEstimate, values: np.ndarray, name: str = "delay", settings: FilterSettings | None = None
) -> SecondPass | None:
    """Compare the likeliest filter of a plain batched bank with filterpy's.

    Parameters
    ----------
    record, system, settings : as the bank was run with.
    bank, values : the bank, and the values ``(B,)`` at which its filters hold the parameter ``name``.

    Returns
    -------
    The differences; None where no filter of the bank is sound.
    """
    best = int(np.argmax(bank.log_likelihood))
    if not bank.sound[best]:
        return None
    own = replace(
        bank,
        mean=bank.mean[:, best : best + 1],
        covariance=bank.covariance[best : best + 1],
        log_likelihood=bank.log_likelihood[best : best + 1],
        sound=bank.sound[best : best + 1],
    )
    settings = replace(settings or FilterSettings(), passes=1)
    found = agreement(own, run_one_by_one(record, system, settings, held={name: np.atleast_1d(values[best])}))
    return SecondPass(float(values[best]), found.mean, found.std, found.log_likelihood) if found.sound else None


@dataclass(frozen=True)
class Agreement:
    """Largest differences of two banks over the same delays, over the runs that are sound in both.

    Attributes
    ----------
    mean : of states and parameters after the last sample, in sigmas. std : of their sigmas, relative.
    log_likelihood : relative. sound : whether the same runs are.
    """

    mean: float
    std: float
    log_likelihood: float
    sound: bool

    @property
    def largest(self) -> float:
        """The largest of the three."""
        return max(self.mean, self.std, self.log_likelihood)


def agreement(one: BankEstimate, other: BankEstimate) -> Agreement:
    """How far two banks of the same runs are apart; ``one`` gives the sigmas to divide by."""
    both = one.sound & other.sound
    sigma = np.maximum(one.std[:, both], np.finfo(float).tiny)
    likelihood = one.log_likelihood[both]
    return Agreement(
        float(np.max(np.abs(other.mean[:, both] - one.mean[:, both]) / sigma, initial=0.0)),
        float(np.max(np.abs(other.std[:, both] / sigma - 1.0), initial=0.0)),
        float(np.max(np.abs(other.log_likelihood[both] - likelihood) / np.abs(likelihood), initial=0.0)),
        bool(np.array_equal(one.sound, other.sound)),
    )


def _systems(system: System, held: Mapping[str, np.ndarray]) -> list[System]:
    """The System once for each run, with its values held."""
    runs = zip(*(np.atleast_1d(values).tolist() for values in held.values()), strict=True)
    return [replace(system, parameters=system.parameters.with_values(dict(zip(held, values, strict=True)))) for values in runs]


def _bank(estimates: list[Estimate], sound: np.ndarray) -> BankEstimate:
    """Estimates of single filters as those of a bank; a run that is not ``sound`` has a likelihood of zero."""
    histories = [each.history for each in estimates if each.history is not None]
    assert len(histories) == len(estimates)
    return BankEstimate(
        histories[0].names,
        np.stack([each.mean[:, -1] for each in histories], axis=1),
        np.stack([each.covariance[-1] for each in histories]),
        np.where(sound, [each.log_likelihood for each in estimates], -np.inf),
        np.stack([each.nis for each in histories], axis=1),
        sound,
        np.array([each.iterations for each in estimates]),
    )
