"""What a stream has told so far: estimates with deviations that hold the start's share, and what hangs on the start alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtr

from ident.banks.delays import likelihood_weights
from ident.banks.online import MEDIAN_SQUARE, BankState, OnlineBank, moved_starts, spread_covariance
from ident.banks.relinearised import joint_estimate
from ident.estimate import Estimate, Outcome
from scenarios.identification.low_order import derived_of, mean_delay
from scenarios.watching.session import STARTED, Session, Step


@dataclass(frozen=True, eq=False)
class SoFar:
    """``estimate`` of the parameters, ``derived`` quantities with deviations, ``weights (B,)`` of the declared delays: likelihoods of the plain
    filters, or where it is refined the probability that the delay is nearest to each.

    ``refined``: linearised anew on its way, with the delay between the grid points. Else the most likely filter's, and ``hanging`` are the
    quantities that hang on the start: other starts end as far apart as they began.
    """

    estimate: Estimate
    derived: Mapping[str, tuple[float, float]]
    weights: np.ndarray
    refined: bool
    hanging: frozenset[str] = frozenset()


def so_far(session: Session, step: Step | None = None) -> SoFar:
    """The estimate after a step, the last when None: the one that was linearised anew where there is one."""
    step = session.last if step is None else step
    assert session.bank is not None and step is not None
    if step.refined is None:
        return plain_so_far(session, step)
    estimate = joint_estimate(step.refined)
    weights = nearest(session.bank.delays, estimate.value("delay"), estimate.sigma("delay"))
    return SoFar(estimate, derived_of(estimate, session.vehicle, (0.0, 0.0)), weights, True)


def nearest(delays: np.ndarray, value: float, std: float) -> np.ndarray:
    """The probability ``(B,)`` of a normal delay (s) to be nearer to each of the increasing ``delays`` than to any other."""
    between = 0.5 * (delays[1:] + delays[:-1])
    below = ndtr((between - value) / max(std, 1e-9))
    return np.diff(np.concatenate([[0.0], below, [1.0]]))


def plain_so_far(session: Session, step: Step | None = None) -> SoFar:
    """The most likely plain filter's estimate; its deviations hold what other starts end apart by."""
    bank, step = session.bank, session.last if step is None else step
    assert bank is not None and step is not None
    estimate, weights, (delay, std) = likely_estimate(bank, step.state)
    n_x = len(bank.system.states)
    spread, apart = step.spread[n_x:], step.differences[:, n_x:]
    derived = derived_of(estimate, session.vehicle, (delay, std))
    ended = _derived_spread(session, estimate, derived, apart)
    began = _derived_spread(session, *_at_start(session, estimate))
    prior = np.sqrt(np.diagonal(bank.covariance))[n_x:]
    hanging = {name for name, far, wide in zip(estimate.names, spread.tolist(), prior.tolist(), strict=True) if far >= wide}
    hanging |= {name for name, far in ended.items() if far >= began.get(name, np.inf)}
    spans = {**ended, "delay": step.delay_spread}
    # Between the first and the last delay of the grid, any of which might have been.
    hanging |= {"delay"} if step.delay_spread >= float(np.ptp(bank.delays)) / 12.0**0.5 else set()
    wide = {name: (value, float(np.hypot(sigma, spans.get(name, 0.0)))) for name, (value, sigma) in derived.items()}
    held = np.isfinite(spread)
    covariance = estimate.covariance + spread_covariance(np.where(held, spread, prior), apart)
    return SoFar(replace(estimate, covariance=covariance), wide, weights, False, frozenset(hanging))


def likely_estimate(bank: OnlineBank, state: BankState) -> tuple[Estimate, np.ndarray, tuple[float, float]]:
    """The most likely filter's parameters with its own covariance, the likelihood weights ``(B,)``, and the weighted delay with its deviation (s)."""
    best, n_x = state.best, len(bank.system.states)
    names = bank.names[n_x:]
    P = state.covariance[best, n_x:, n_x:]
    outcome = Outcome.CONVERGED if state.sound[best] else Outcome.DIVERGED
    log_likelihood = np.where(state.sound, state.log_likelihood, -np.inf)
    weights = likelihood_weights(log_likelihood)
    std = np.sqrt(np.diag(bank.R))
    likely = float(state.log_likelihood[best])
    estimate = Estimate(
        "online", names, bank.units, state.mean[n_x:, best].copy(), 0.5 * (P + P.T), outcome, likely, bank.system.output_names, std, ()
    )
    return estimate, weights, mean_delay(bank.delays, weights)


def _at_start(session: Session, estimate: Estimate) -> tuple[Estimate, Mapping[str, tuple[float, float]], np.ndarray]:
    """The declared start as an estimate, what is derived of it, and how far the other starts began from it ``(K, n)``."""
    bank = session.bank
    assert bank is not None
    n_x = len(bank.system.states)
    begun = replace(estimate, values=bank.start[n_x:])
    moved = (moved_starts(bank, STARTED) - bank.start[:, None]).T[:, n_x:]
    return begun, derived_of(begun, session.vehicle, (0.0, 0.0)), moved


def _derived_spread(session: Session, about: Estimate, derived: Mapping[str, tuple[float, float]], apart: np.ndarray) -> dict[str, float]:
    """Typical differences of natural frequency and damping between estimates that differ by ``apart (K, n)``; infinite where half have none."""
    each = [derived_of(replace(about, values=about.values + away), session.vehicle, (0.0, 0.0)) for away in apart]
    out = {}
    for name, (value, _) in derived.items():
        if name != "delay":
            far = [found[name][0] - value if name in found else np.inf for found in each]
            out[name] = float(np.sqrt(np.median(np.square(far)) / MEDIAN_SQUARE))
    return out
