"""On-line bank of delays that is linearised again while rows arrive.

The estimate equals the refined estimate of `run_delay_bank` for the record so far. When the rows
are informative enough, `run_delay_bank` is run over all of them. Filters at delays one sigma apart
are linearised about its smoothed trajectory. These filters then continue row by row: near the
optimum, an extended Kalman filter is as good as an iterated one. The bank is linearised again when
the information has increased or the estimate has changed by much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.delays import likelihood_weights, run_delay_bank
from ident.banks.engines import run_iterated_bank
from ident.banks.online import BankState, OnlineBank, Rows, advance, online_bank, with_delays
from ident.estimate import Estimate, Outcome
from sim.declaration.model import System
from sim.errors import FlightidError
from sim.record import Record

# filters on either side of the estimate, one sigma of the delay apart: a sum over them approximates
# the integral of a Gaussian to 1e-4
FILTERS_ON_EITHER_SIDE = 4
# fewest filters for a poorly known delay: with five equal cells, the standard deviation of a
# uniform density has an error of 2 %
FEWEST_FILTERS = 5
FEWEST_SOUND_FILTERS = 3  # fewest filters that converge in a linearisation
# a new linearisation is due if a sigma is less than this share of the sigma at the last one
SHARPENED_SHARE = 0.5
# a new linearisation is due if a mean has changed by more sigmas since the last one: quadratic
# terms are then not small
MOVED_SIGMAS = 1.0
# smallest sigma of the delay, in steps of the grid, for which a sum approximates the integral
COARSE_GRID_SIGMAS = 0.5
# largest likelihood weight of the first and last delay of a grid that contains all likely delays
EDGE_LIKELIHOOD = 0.01
NEGLIGIBLE_WEIGHT = 1e-12  # filters with a smaller likelihood weight are left out
# a bank linearised from the last rows alone continues if its sigmas are at most this times those
# from all rows: the last rows then have nearly two thirds of the information
LARGEST_SIGMA_RATIO = 1.25
CONTRADICTED_SIGMAS = 2.0  # distance of two estimates that contradict each other, in sigmas
SETTLED_SIGMAS = 0.1  # largest change in the last iteration of a converged filter, in sigmas
OTHER_OPTIMUM_SIGMAS = 0.5  # smallest distance of different optima, in sigmas
# largest loss of log likelihood of another optimum: three sigmas
OTHER_OPTIMUM_LOSS = 4.5


@dataclass(frozen=True, eq=False)
class Relinearised:
    """A bank at fine delays after its last linearisation.

    Attributes
    ----------
    bank : the bank.
    state : its present state.
    rows : number of rows at the last linearisation.
    mean : ``(n + 1,)`` mean at the last linearisation, the delay last.
    std : ``(n + 1,)`` standard deviations at the last linearisation.
    start_dependence : ``(n,)`` largest difference between iterated filters from different starts;
        zero if all starts give the same estimate.
    """

    bank: OnlineBank
    state: BankState
    rows: int
    mean: np.ndarray
    std: np.ndarray
    start_dependence: np.ndarray


def informative_enough(bank: OnlineBank, state: BankState, names: Sequence[str]) -> bool:
    """Return whether the rows are informative enough for a linearisation: the most likely filter
    has halved the prior sigma of at least one of the parameters ``names``.
    """
    positions = [bank.names.index(name) for name in names]
    prior_std = np.sqrt(np.diagonal(bank.covariance)[positions])
    return bool(np.any(state.std(state.best)[positions] < SHARPENED_SHARE * prior_std))


def linearise(
    record: Record,
    system: System,
    first_pass: OnlineBank,
    state: BankState,
    other_starts: np.ndarray,
    name: str = "delay",
) -> Relinearised | None:
    """Return a bank that is linearised at the refined estimate of a record; None if the refinement
    finds no delay inside the grid or does not converge.

    Parameters
    ----------
    record : the rows so far, or the last of them.
    system : System of the record, as for ``run_delay_bank``.
    first_pass : the on-line bank without new linearisation.
    state : its state after the last row, from which the recent inputs are taken.
    other_starts : ``(n, K)`` other starts of the iterated filter, which show whether there are
        other optima.
    name : name of the parameter that is the delay.
    """
    try:
        bank_result = run_delay_bank(record, system, name=name)
    except FlightidError:
        return None
    if (
        not bank_result.refined_std > 0
        or bank_result.estimate.outcome is not Outcome.CONVERGED
        or bank_result.nominal is None
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
        nominal=bank_result.nominal[:, :, None],
        tolerance=SETTLED_SIGMAS,
    )
    if np.count_nonzero(runs.sound) < FEWEST_SOUND_FILTERS:
        return None
    m = len(first_pass.R)
    fine_state = BankState(
        mean=runs.mean,
        covariance=runs.covariance,
        log_likelihood=runs.log_likelihood,
        sound=runs.sound,
        innovation=np.full(m, np.nan),
        expected=np.full(m, np.nan),
        skipped=np.zeros(m, dtype=bool),
        streak=np.zeros(m, dtype=int),
        rows_seen=state.rows_seen,
        past_time=state.past_time,
        past_inputs=state.past_inputs,
    )
    bank = replace(
        online_bank(bank_result.system, first_pass.interval, fine.tolist(), name=name),
        memory=first_pass.memory,
    )
    mean, covariance = joint_moments(bank, fine_state)
    std = np.sqrt(np.diagonal(covariance))
    return Relinearised(
        bank,
        fine_state,
        state.rows_seen,
        mean,
        std,
        _start_dependence(
            record,
            bank_result.system,
            name,
            bank_result.refined,
            bank_result.nominal,
            other_starts,
            std[:-1],
        ),
    )


def advance_bank(current: Relinearised, rows: Rows) -> list[Relinearised]:
    """Return the bank after each of the new ``rows``."""
    return [replace(current, state=state) for state in advance(current.bank, current.state, rows)]


def with_fitting_grid(current: Relinearised) -> Relinearised:
    """Return the bank with a new grid of delays if the present grid is too coarse or does not
    contain all likely delays; else the bank unchanged.
    """
    bank, state = current.bank, current.state
    mean, covariance = joint_moments(bank, state)
    weights = likelihood_weights(np.where(state.sound, state.log_likelihood, -np.inf))
    step = float(np.diff(bank.delays).mean())
    # A grid that ends at a bound of the delay is not replaced: the bound would cut off the density
    # again and decrease sigma without data.
    contains_low = weights[0] < EDGE_LIKELIHOOD or bank.delays[0] < step
    contains_high = weights[-1] < EDGE_LIKELIHOOD or bank.delays[-1] > bank.memory - step
    fine_enough = float(np.sqrt(covariance[-1, -1])) > COARSE_GRID_SIGMAS * step
    if not state.sound.any() or (contains_low and contains_high and fine_enough):
        return current
    return _with_new_grid(current, mean, covariance)


def linearisation_due(current: Relinearised, names: Sequence[str]) -> bool:
    """Return whether the filters need a new linearisation: the sigma of one of the parameters
    ``names`` or of the delay has decreased by much, or its mean has changed.

    Constant terms may be left out of ``names``, since the equations are linear in them.
    """
    mean, covariance = joint_moments(current.bank, current.state)
    positions = [*(current.bank.names.index(name) for name in names), len(mean) - 1]
    std, std_before = np.sqrt(np.diagonal(covariance))[positions], current.std[positions]
    change = np.abs(mean - current.mean)[positions]
    sharpened = bool(np.any(std < SHARPENED_SHARE * std_before))
    return sharpened or bool(np.any(change > MOVED_SIGMAS * std_before))


def bank_that_continues(
    current: Relinearised | None, linearised: Relinearised | None, names: Sequence[str]
) -> Relinearised | None:
    """Return the bank that continues: the ``current`` bank, or the bank ``linearised`` from the
    last rows alone.

    The new bank continues if its sigmas of the parameters ``names`` are hardly larger: the last
    rows then have most of the information. Otherwise the current bank continues. Where the means of
    the two banks contradict each other, its start dependence is at least their difference.
    """
    if linearised is None:
        return current
    if current is None:
        return linearised
    positions = [linearised.bank.names.index(name) for name in names]
    mean, covariance = joint_moments(current.bank, current.state)
    std = np.sqrt(np.diagonal(covariance))
    if np.all(linearised.std[positions] <= LARGEST_SIGMA_RATIO * std[positions]):
        return linearised
    difference = np.abs(mean - linearised.mean)[:-1]
    start_dependence = np.where(
        difference > CONTRADICTED_SIGMAS * linearised.std[:-1],
        np.maximum(difference, current.start_dependence),
        current.start_dependence,
    )
    return replace(
        current, rows=current.state.rows_seen, mean=mean, std=std, start_dependence=start_dependence
    )


def joint_moments(bank: OnlineBank, state: BankState) -> tuple[np.ndarray, np.ndarray]:
    """Return the joint mean ``(n + 1,)`` and covariance ``(n + 1, n + 1)`` of states, parameters
    and delay.

    The filters are averaged with their likelihoods. The covariance is the sum of the mean
    covariance of the filters and the covariance of their means.
    """
    weights = likelihood_weights(np.where(state.sound, state.log_likelihood, -np.inf))
    used = np.flatnonzero(state.sound & (weights > NEGLIGIBLE_WEIGHT))
    if not used.size:
        used = np.array([state.best])
    means = np.vstack([state.mean[:, used], bank.delays[used]])
    probability = weights[used] / weights[used].sum()
    mean = means @ probability
    deviation = means - mean[:, None]
    covariance = (probability * deviation) @ deviation.T
    n = len(mean) - 1
    covariance[:n, :n] += np.einsum("b,bij->ij", probability, state.covariance[used])
    # With a single filter, the delay is distributed uniformly over one step of the grid.
    if used.size == 1:
        covariance[n, n] = float(np.diff(bank.delays).mean()) ** 2 / 12.0
    return mean, 0.5 * (covariance + covariance.T)


def joint_estimate(current: Relinearised) -> Estimate:
    """Return the estimate of the parameters, with the delay as the last one. The covariance
    includes the start dependence.
    """
    bank, state = current.bank, current.state
    n_x = len(bank.system.states)
    mean, covariance = joint_moments(bank, state)
    covariance = covariance + np.diag(np.append(np.square(current.start_dependence), 0.0))
    outcome = Outcome.CONVERGED if state.sound.any() else Outcome.DIVERGED
    log_likelihood = float(state.log_likelihood[state.best])
    names, units = (*bank.names[n_x:], "delay"), (*bank.units, "s")
    std = np.sqrt(np.diag(bank.R))
    return Estimate(
        "online",
        names,
        units,
        mean[n_x:],
        covariance[n_x:, n_x:],
        outcome,
        log_likelihood,
        bank.system.output_names,
        std,
        (),
    )


def _fine_delays(delay: float, std: float, least: float, most: float) -> np.ndarray:
    """Return delays at most one sigma apart. They are the centres of equal cells that cover a
    Gaussian with the mean ``delay`` and the standard deviation ``std``, between the bounds
    ``least`` and ``most``. All are in s.
    """
    half_range = (FILTERS_ON_EITHER_SIDE + 0.5) * std
    low, high = (min(max(end, least), most) for end in (delay - half_range, delay + half_range))
    count = max(round((high - low) / std + 0.499), FEWEST_FILTERS)  # rounded up, but for rounding
    return low + (high - low) / count * (np.arange(count) + 0.5)


def _with_new_grid(current: Relinearised, mean: np.ndarray, covariance: np.ndarray) -> Relinearised:
    """Return the bank with a new grid of delays. Its filters together have the joint ``mean (n +
    1,)`` and ``covariance (n + 1, n + 1)`` of states, parameters and delay.
    """
    bank, state, n = current.bank, current.state, len(mean) - 1
    variance = max(float(covariance[n, n]), 1e-12)
    fine = _fine_delays(float(mean[n]), variance**0.5, 0.0, bank.memory)
    # mean and covariance of the other quantities, given the delay
    slope = covariance[:n, n] / variance
    conditional = covariance[:n, :n] - np.outer(slope, slope) * variance
    means = mean[:n, None] + slope[:, None] * (fine - mean[n])
    greatest = float(state.log_likelihood[state.best])
    new_state = state._replace(
        mean=means,
        covariance=np.repeat(conditional[None], fine.size, axis=0),
        log_likelihood=greatest - 0.5 * np.square(fine - mean[n]) / variance,
        sound=np.ones(fine.size, dtype=bool),
    )
    return replace(current, bank=with_delays(bank, fine), state=new_state)


def _start_dependence(
    record: Record,
    system: System,
    name: str,
    delay: float,
    nominal: np.ndarray,
    other_starts: np.ndarray,
    std: np.ndarray,
) -> np.ndarray:
    """Return the largest difference ``(n,)`` between iterated filters with other starts and the
    filter with the trajectory ``nominal (n, N)``.

    It is zero if the filters agree within ``OTHER_OPTIMUM_SIGMAS`` of the standard deviations ``std
    (n,)``.
    """
    n_x, count = len(system.states), other_starts.shape[1]
    trajectories = np.repeat(nominal[:, :, None], 1 + count, axis=2)
    trajectories[n_x:, :, 1:] = other_starts[n_x:, None]
    runs, _ = run_iterated_bank(
        record,
        system,
        fixed_values={name: np.full(1 + count, delay)},
        nominal=trajectories,
        tolerance=SETTLED_SIGMAS,
    )
    others = runs.sound.copy()
    others[0] = False
    if not others.any():
        return np.zeros(len(std))
    others &= runs.log_likelihood > runs.log_likelihood[0] - OTHER_OPTIMUM_LOSS
    distance = np.max(np.abs(runs.mean[:, others] - runs.mean[:, :1]), axis=1, initial=0.0)
    return np.where(distance > OTHER_OPTIMUM_SIGMAS * std, distance, 0.0)
