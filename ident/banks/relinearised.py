"""On-line bank of delays, linearised again while rows arrive: its estimate is the refined one of
`run_delay_bank` for the record so far.

When the rows are informative enough, the refinement runs over all of them. Filters at delays one
sigma apart about its result, linearised at the smoothed trajectory, then continue row by row. Near
the optimum an extended Kalman filter is as good as the iterated one. The bank is linearised again
when the information has grown much or the estimate has moved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.bank import run_iterated_bank
from ident.banks.delays import likelihood_weights, run_delay_bank
from ident.banks.online import BankState, OnlineBank, Rows, advance, online_bank, with_delays
from ident.estimate import Estimate, Outcome
from sim.declaration.model import System
from sim.errors import FlightidError
from sim.record import Record

# filters on either side, one sigma of the delay apart: their sum gives a Gaussian's integral to
# 1e-4
FILTERS_ON_EITHER_SIDE = 4
# fewest filters for a poorly known delay: at the midpoints of five equal cells, the standard
# deviation of a uniform density is right to 2 %
FEWEST_FILTERS = 5
# ratio of a sigma to that at the last linearisation, below which a new one is due
SHARPENED_SHARE = 0.5
# largest change of a mean, in sigmas of the last linearisation, that needs no new one: the
# quadratic term is still small
MOVED_SIGMAS = 1.0
# smallest sigma of the delay, in steps of the grid, for which a sum approximates the integral
COARSE_GRID_SIGMAS = 0.5
# largest likelihood of the outermost filter: above it, the grid misses likely delays
EDGE_LIKELIHOOD = 0.01
# largest ratio of sigmas from the last rows alone to those from all rows, at which the last rows
# suffice: they hold nearly two thirds of the information
LARGEST_SIGMA_RATIO = 1.25
CONTRADICTED_SIGMAS = 2.0  # distance of two estimates that contradict each other, in sigmas
SETTLED_SIGMAS = 0.1  # largest change of converged iterated filters, in sigmas
OTHER_OPTIMUM_SIGMAS = 0.5  # smallest distance of different optima, in sigmas


@dataclass(frozen=True, eq=False)
class Relinearised:
    """The ``bank`` at fine delays and its ``state``. ``rows``: number of rows at its last
    linearisation, with ``mean`` and ``std (n + 1,)`` then, the delay last. ``start_dependence
    (n,)``: distance of iterated filters with other starts, zero if they agree.
    """

    bank: OnlineBank
    state: BankState
    rows: int
    mean: np.ndarray
    std: np.ndarray
    start_dependence: np.ndarray


def informative_enough(bank: OnlineBank, state: BankState, names: Sequence[str]) -> bool:
    """Return whether the most likely filter has halved the sigma of any of these parameters since
    the first row.
    """
    at = [bank.names.index(name) for name in names]
    return bool(
        np.any(
            state.std(state.best)[at] < SHARPENED_SHARE * np.sqrt(np.diagonal(bank.covariance)[at])
        )
    )


def linearise(
    record: Record,
    system: System,
    first_pass: OnlineBank,
    state: BankState,
    other_starts: np.ndarray,
    name: str = "delay",
) -> Relinearised | None:
    """Refine over all rows and continue from there; None where the refinement finds no delay inside
    the grid or does not converge.

    Parameters
    ----------
    record : the rows so far, or the last ones of them.
    system : for them, as for ``run_delay_bank``.
    first_pass, state : the bank on line after the last row; ``state`` knows the recent inputs.
    other_starts : means ``(n, K)``; the iterated filter is also started from their parameters, to
        see whether it ends elsewhere.
    """
    try:
        bank_result = run_delay_bank(record, system, name=name)
    except FlightidError:
        return None
    if (
        not bank_result.refined_std > 0
        or bank_result.estimate.outcome is not Outcome.CONVERGED
        or bank_result.about is None
    ):
        return None
    fine = _fine_delays(
        bank_result.refined,
        bank_result.refined_std,
        float(first_pass.delays.min()),
        float(first_pass.delays.max()),
    )
    runs, _ = run_iterated_bank(
        record,
        bank_result.system,
        fixed_values={name: fine},
        about=bank_result.about[:, :, None],
        tolerance=SETTLED_SIGMAS,
    )
    if np.count_nonzero(runs.sound) < 3:
        return None
    no_innovation = np.full(len(first_pass.R), np.nan)
    none = np.zeros(len(first_pass.R), dtype=bool)
    first_values = (
        runs.mean,
        runs.covariance,
        runs.log_likelihood,
        runs.sound,
        no_innovation,
        no_innovation,
        none,
        none.astype(int),
    )
    after = BankState(*first_values, state.rows_seen, state.past_time, state.past_inputs)
    bank = replace(
        online_bank(bank_result.system, first_pass.interval, fine.tolist(), name=name),
        memory=first_pass.memory,
    )
    mean, covariance = joint(bank, after)
    std = np.sqrt(np.diagonal(covariance))
    return Relinearised(
        bank,
        after,
        state.rows_seen,
        mean,
        std,
        _start_dependence(
            record,
            bank_result.system,
            name,
            bank_result.refined,
            bank_result.about,
            other_starts,
            std[:-1],
        ),
    )


def advanced(current: Relinearised, rows: Rows) -> list[Relinearised]:
    """Advance through rows and return the bank after each of them."""
    return [replace(current, state=state) for state in advance(current.bank, current.state, rows)]


def with_fitting_grid(current: Relinearised) -> Relinearised:
    """Return the bank, with a new grid of delays if the present one is too coarse for a sum or
    misses likely delays.
    """
    bank, state = current.bank, current.state
    mean, covariance = joint(bank, state)
    weights = likelihood_weights(np.where(state.sound, state.log_likelihood, -np.inf))
    step = float(np.diff(bank.delays).mean())
    # At a bound of the delays the Gaussian is cut off; a new grid would cut it again and narrow it
    # without data.
    inside = (weights[0] < EDGE_LIKELIHOOD or bank.delays[0] < step) and (
        weights[-1] < EDGE_LIKELIHOOD or bank.delays[-1] > bank.memory - step
    )
    fine_enough = float(np.sqrt(covariance[-1, -1])) > COARSE_GRID_SIGMAS * step
    return (
        current
        if not state.sound.any() or (inside and fine_enough)
        else _with_new_grid(current, mean, covariance)
    )


def linearisation_due(current: Relinearised, names: Sequence[str]) -> bool:
    """Return whether the filters need a new linearisation: the sigmas of these parameters have
    fallen much, or their means moved. Constant terms need not be included: they are linear.
    """
    mean, covariance = joint(current.bank, current.state)
    at = [*(current.bank.names.index(name) for name in names), len(mean) - 1]
    std, before = np.sqrt(np.diagonal(covariance))[at], current.std[at]
    return bool(
        np.any(std < SHARPENED_SHARE * before)
        or np.any(np.abs(mean - current.mean)[at] > MOVED_SIGMAS * before)
    )


def bank_that_continues(
    current: Relinearised | None, linearised: Relinearised | None, names: Sequence[str]
) -> Relinearised | None:
    """Return which of two banks continues, where ``linearised`` comes from the last rows alone.

    The new bank continues if its sigmas of these parameters are hardly larger: its rows then hold
    nearly all information. Else the current one continues; where the two means
    differ by more than two of the new sigmas, its start dependence is at least the difference.
    """
    if linearised is None or current is None:
        return current if linearised is None else linearised
    at = [linearised.bank.names.index(name) for name in names]
    mean, covariance = joint(current.bank, current.state)
    std = np.sqrt(np.diagonal(covariance))
    if np.all(linearised.std[at] <= LARGEST_SIGMA_RATIO * std[at]):
        return linearised
    off = np.abs(mean - linearised.mean)[:-1]
    start_dependence = np.where(
        off > CONTRADICTED_SIGMAS * linearised.std[:-1],
        np.maximum(off, current.start_dependence),
        current.start_dependence,
    )
    return replace(
        current, rows=current.state.rows_seen, mean=mean, std=std, start_dependence=start_dependence
    )


def joint(bank: OnlineBank, state: BankState) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean ``(n + 1,)`` and covariance of states, parameters and delay over all filters
    by their likelihood: within and between them.
    """
    weights = likelihood_weights(np.where(state.sound, state.log_likelihood, -np.inf))
    use = np.flatnonzero(state.sound & (weights > 1e-12))
    use = use if use.size else np.array([state.best])
    points = np.vstack([state.mean[:, use], bank.delays[use]])
    share = weights[use] / weights[use].sum()
    mean = points @ share
    away = points - mean[:, None]
    covariance = (share * away) @ away.T
    n = len(mean) - 1
    covariance[:n, :n] += np.einsum("b,bij->ij", share, state.covariance[use])
    # A single filter leaves the delay open within one step of the grid.
    if use.size == 1:
        covariance[n, n] = float(np.diff(bank.delays).mean()) ** 2 / 12.0
    return mean, 0.5 * (covariance + covariance.T)


def joint_estimate(current: Relinearised) -> Estimate:
    """Return the parameters with the delay as the last one; sigmas include the distance from other
    linearisations.
    """
    bank, state = current.bank, current.state
    n_x = len(bank.system.states)
    mean, covariance = joint(bank, state)
    covariance = covariance + np.diag(np.append(np.square(current.start_dependence), 0.0))
    outcome = Outcome.CONVERGED if state.sound.any() else Outcome.DIVERGED
    likely = float(state.log_likelihood[state.best])
    names, units = (*bank.names[n_x:], "delay"), (*bank.units, "s")
    std = np.sqrt(np.diag(bank.R))
    return Estimate(
        "online",
        names,
        units,
        mean[n_x:],
        covariance[n_x:, n_x:],
        outcome,
        likely,
        bank.system.output_names,
        std,
        (),
    )


def _fine_delays(delay: float, std: float, least: float, most: float) -> np.ndarray:
    """Return delays at most one sigma apart, at the centres of equal cells that cover the Gaussian
    between two bounds.
    """
    low, high = (
        min(max(delay + side * (FILTERS_ON_EITHER_SIDE + 0.5) * std, least), most)
        for side in (-1.0, 1.0)
    )
    count = max(round((high - low) / std + 0.499), FEWEST_FILTERS)
    return low + (high - low) / count * (np.arange(count) + 0.5)


def _with_new_grid(current: Relinearised, mean: np.ndarray, covariance: np.ndarray) -> Relinearised:
    """Return the same Gaussian of states, parameters and delay, split at other delays."""
    bank, state, n = current.bank, current.state, len(mean) - 1
    variance = max(float(covariance[n, n]), 1e-12)
    fine = _fine_delays(float(mean[n]), variance**0.5, 0.0, bank.memory)
    slope = covariance[:n, n] / variance
    within = covariance[:n, :n] - np.outer(slope, slope) * variance
    means = mean[:n, None] + slope[:, None] * (fine - mean[n])
    likely = float(state.log_likelihood[state.best]) - 0.5 * np.square(fine - mean[n]) / variance
    count = fine.size
    new = state._replace(
        mean=means,
        covariance=np.repeat(within[None], count, axis=0),
        log_likelihood=likely,
        sound=np.ones(count, dtype=bool),
    )
    return replace(current, bank=with_delays(bank, fine), state=new)


def _start_dependence(
    record: Record,
    system: System,
    name: str,
    delay: float,
    about: np.ndarray,
    other_starts: np.ndarray,
    std: np.ndarray,
) -> np.ndarray:
    """Return the largest distance ``(n,)`` of the iterated filters that started at other
    parameters from the one that did not; zero where they agree.
    """
    n_x, count = len(system.states), other_starts.shape[1]
    points = np.repeat(about[:, :, None], 1 + count, axis=2)
    points[n_x:, :, 1:] = other_starts[n_x:, None]
    runs, _ = run_iterated_bank(
        record,
        system,
        fixed_values={name: np.full(1 + count, delay)},
        about=points,
        tolerance=SETTLED_SIGMAS,
    )
    others = runs.sound.copy()
    others[0] = False
    if not others.any():
        return np.zeros(len(std))
    # Lower likelihood by three sigmas or more excludes a filter.
    others &= runs.log_likelihood > runs.log_likelihood[0] - 4.5
    far = np.max(np.abs(runs.mean[:, others] - runs.mean[:, :1]), axis=1, initial=0.0)
    return np.where(far > OTHER_OPTIMUM_SIGMAS * std, far, 0.0)
