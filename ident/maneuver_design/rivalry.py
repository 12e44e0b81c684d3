"""Two effects that could explain the same: what a flight under one leaves unexplained when the other is fitted as well as it can."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ident.maneuver_design.decision import Decision, chance_found, decision_of
from ident.maneuver_design.planned_flight import Planned, fitted, sigmas_of, simulated
from ident.tracing.candidate_model.fitted_model import FittedModel, added_parameters, is_event
from ident.tracing.evidence.priors import FEWEST, ODDS
from ident.tracing.screening.context import search_context
from ident.tracing.screening.score_test import screen
from ident.tracing.thresholds import PLACES
from sim.declaration.effect import full_name
from sim.declaration.proposal import Traceable

STARTS = 2  # of the rival
ODDS_COST = -2.0 * math.log(ODDS / FEWEST)  # what the prior odds of an effect cost, of twice the log evidence


@dataclass(frozen=True, eq=False)
class Acting:
    """An effect as it acts: in the form that it has, with ``values`` of its own parameters by local name."""

    effect: Traceable
    values: Mapping[str, float]

    @property
    def full_values(self) -> dict[str, float]:
        """The values by the names that they have in a model."""
        return {full_name(self.effect, local): value for local, value in self.values.items()}


@dataclass(frozen=True, eq=False)
class Contest:
    """What a flight under ``true`` says against ``rival``.

    ``found`` : gain of the log likelihood of the true effect over the declared model alone, ``shown`` the probability that this is enough for a
    search; ``rival`` has the values that fit best, and ``left`` is half of the weighted squares that it leaves of the flight without noise.
    """

    true: Acting
    rival: Acting
    found: float
    shown: float
    left: float
    decision: Decision

    @property
    def chance(self) -> float:
        """Probability, at least, that the true effect is found and preferred to the rival by more than what is called ambiguous."""
        return max(0.0, self.shown + self.decision.right - 1.0)


def found_by(planned: Planned, true: Acting) -> tuple[Planned, FittedModel]:
    """The flight under an effect without noise, and the declared model alone fitted to it: half the squares that this leaves is what finds it."""
    flown = simulated(planned, (true.effect,), true.full_values, slopes=False)
    held = planned.measuring(flown.fit.lines[0].y)
    base = fitted(held, ())
    return held, base if base is not None else simulated(held)


def contest(planned: Planned, true: Acting, rival: Traceable, hint: Mapping[str, float] | None = None) -> Contest:
    """Fly an effect, fit its rival as well as that can, and weigh what is left.

    ``hint`` : values of the rival by local name from which a fit begins as well. A rival that explains nothing leaves what the declared model does.
    """
    held, base = found_by(planned, true)
    best = best_fit(held, base, rival, hint) or base
    counts = best.fit.counts
    own, other = _free(true.effect), _free(rival)
    paid = price(rival, counts) - price(true.effect, counts)
    # Priors of the true effect cost it something, too.
    spent = _own_cost(held, true)
    decision = decision_of(_squares(best), counts, 2.0 * base.fit.cost, own, other, paid + 2.0 * (_prior_cost(best) - spent))
    found = max(0.0, base.fit.cost - spent)
    shown = chance_found(found, own, price(true.effect, counts), ODDS_COST)
    return Contest(true, Acting(_form(best, rival), _values(best, rival)), found, shown, best.fit.cost, decision)


def best_fit(held: Planned, base: FittedModel, rival: Traceable, hint: Mapping[str, float] | None = None) -> FittedModel | None:
    """The rival fitted to a flight from where a search would begin, and from ``hint``; the best of all, None where it can explain nothing."""
    findings = screen(base, [rival], search_context(base))
    known = base.values.shared
    tries = [(finding.effect, {**known, **start}) for finding in findings for start in finding.starts[:STARTS]]
    if hint:
        form = findings[0].effect if findings else rival
        named = {full_name(form, local): value for local, value in hint.items() if local in {item.name for item in form.parameters}}
        tries.insert(0, (form, {**known, **named}))
    fits = [found for effect, start in tries if (found := fitted(held, (effect,), start)) is not None]
    return min(fits, key=lambda each: each.fit.cost, default=None)


def linear_squares(planned: Planned, true: Acting, rival: Acting) -> float:
    """Weighted squares that a rival leaves to first order, about the values that it has: quick, for comparing maneuvers."""
    flown = simulated(planned, (true.effect,), true.full_values, slopes=False).fit
    other = simulated(planned, (rival.effect,), rival.full_values).fit
    sigma = planned.noise[:, None]
    apart = ((flown.lines[0].y - other.lines[0].y) / sigma).ravel()
    slopes = (other.jacobians[0] / sigma[:, :, None]).reshape(apart.size, -1)
    size = np.linalg.norm(slopes, axis=0)
    basis = np.linalg.qr(slopes[:, size > 0.0] / size[size > 0.0])[0]
    left = apart - basis @ (basis.T @ apart)
    return float(left @ left)


def sigma_of(planned: Planned, acting: Acting) -> dict[str, float]:
    """Expected standard deviations of all parameters where the effect is in the model that is fitted."""
    return sigmas_of(simulated(planned, (acting.effect,), acting.full_values).fit)


def _squares(best: FittedModel) -> np.ndarray:
    return np.asarray(np.sum(best.fit.residuals[0] ** 2, axis=1) / best.fit.variance)


def _prior_cost(best: FittedModel) -> float:
    """What the priors take of a fit's cost."""
    return best.fit.cost - 0.5 * float(_squares(best).sum())


def _own_cost(held: Planned, true: Acting) -> float:
    """Cost of the true effect fitted to its own flight: nothing but what its priors hold against it."""
    there = simulated(held, (true.effect,), true.full_values, slopes=False)
    if there.fit.layout.prior is None or there.fit.cost < 1e-9:
        return there.fit.cost
    own = fitted(held, (true.effect,), true.full_values)
    return there.fit.cost if own is None else min(own.fit.cost, there.fit.cost)


def _free(effect: Traceable) -> int:
    return added_parameters(effect, 1)


def price(effect: Traceable, counts: np.ndarray) -> float:
    """About what an effect's parameters and place cost of twice the log evidence, in a record of so many samples (Schwarz's limit of it)."""
    return _free(effect) * float(np.log(counts.sum())) + 2.0 * math.log(PLACES) * is_event(effect)


def _form(best: FittedModel, rival: Traceable) -> Traceable:
    return best.effects[0] if best.effects else rival


def _values(best: FittedModel, rival: Traceable) -> dict[str, float]:
    """The rival's values as fitted; those at which it vanishes where it explains nothing."""
    effect = _form(best, rival)
    plain = {item.name: item.value for item in effect.parameters}
    if not best.effects:
        return {**plain, **effect.absent}
    values = best.values
    known = {**values.shared, **values.own[0]}
    named = {item.name: full_name(effect, item.name) for item in effect.parameters}
    return {local: known.get(full, plain[local]) for local, full in named.items()}
