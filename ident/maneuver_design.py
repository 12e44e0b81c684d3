"""Design of maneuvers: planned flights, the information in them, and the decision between two
effects.

With the noise of a flight the difference D of twice the log likelihoods of the two best fits, the
true one less the other, is nearly normal. Let s_i be the weighted squares of output i that the
other leaves of the flight without noise, N_i its samples:

    mean D = sum_i N_i ln(1 + s_i / N_i) + n - n'      variance D = sum_i (4 s_i + 2 s_i^2 / N_i) /
    (1 + s_i / N_i)^2 + 4 s / f

where n and n' count the parameters of the true effect and of the other, s = sum s_i, and f is what
the declared model alone leaves. For s much smaller than N this is mean s and variance 4 s, of the
log likelihood itself s/2 and s; the logarithm is there because noise levels are estimated, the last
term is what the noise along the two signatures adds.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.statistics.intervals import inverse_information
from ident.tracing.context import search_context
from ident.tracing.fitted_model import FittedModel, added_parameters, declared_priors, is_event
from ident.tracing.names import CLAIM_LEVEL
from ident.tracing.priors import FAMILY_ODDS, FEWEST_FAMILY_MEMBERS
from ident.tracing.scan import SCANNED_PLACES, starts_at
from ident.whole_record.gauss_newton import Fit, evaluate, fit_whole_records, without_sensitivities
from ident.whole_record.layout import FitLayout, FitProblem, FitSettings, lay_out
from ident.whole_record.linearise import LARGEST_TRAJECTORY_GAP, Linearisation
from ident.whole_record.noise_model import (
    LayoutView,
    Standardised,
    WeightedResiduals,
    WithoutUnknowns,
)
from sim.declaration.compile import compile_model
from sim.declaration.effect import full_name
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.errors import ModelError
from sim.record import Channel, Record

# ---- Noise whose standard deviations are known


@dataclass(frozen=True, eq=False)
class KnownLevels(WithoutUnknowns):
    """Independent Gaussian noise of known ``variance (m,)``: the cost is half the sum of the
    weighted squares.

    Where the data have no noise at all, the estimated variances of ``White`` would be nothing.
    """

    variance: np.ndarray

    def weight_residuals(
        self,
        layout: LayoutView,
        theta: np.ndarray,
        linearisations: Sequence[Linearisation],
        residuals: Sequence[np.ndarray],
        counts: np.ndarray,
    ) -> WeightedResiduals:
        """Return the residuals and sensitivities as they are; the cost is that of residuals over
        the known levels.
        """
        cost = 0.5 * float(
            sum(np.sum(residual**2 / self.variance[:, None]) for residual in residuals)
        )
        filters = tuple(Standardised(problem.valid, self.variance) for problem in layout.problems)
        return WeightedResiduals(
            tuple(residuals),
            tuple(linearisation.jacobian for linearisation in linearisations),
            self.variance,
            cost,
            filters,
        )


# ---- A flight that is planned

NEWTON_PASSES = 12  # Newton iterations on the trajectory; each doubles the digits


@dataclass(frozen=True, eq=False)
class Planned:
    """A planned maneuver as a record, with its sensors.

    Attributes
    ----------
    record : inputs to be flown; its outputs only say which are measured, and from where a
        simulation begins.
    model : the declared model with its biases, at the values that it is believed to have.
    noise : standard deviation of each measured output, ``(m,)`` in the order of ``outputs``.
    settings : of the fits.
    """

    record: Record
    model: Model
    outputs: tuple[str, ...]
    noise: np.ndarray
    settings: FitSettings = field(default_factory=FitSettings)

    def measuring(self, y: np.ndarray) -> Planned:
        """Return the maneuver with outputs ``(m, N)`` without noise in its record."""
        rows = zip(self.outputs, y, strict=True)
        return replace(
            self,
            record=replace(
                self.record,
                outputs=tuple(Channel.of(name, self.record[name].unit, row) for name, row in rows),
            ),
        )


def simulated(
    planned: Planned,
    effects: Sequence[Traceable] = (),
    values: Mapping[str, float] | None = None,
    *,
    slopes: bool = True,
) -> FittedModel:
    """Return the model with effects in the maneuver, nothing fitted; ``values`` by full name where
    they are not the model's and the effects' own.

    Its residual is measured minus simulated. ``slopes`` False: without sensitivities, which are
    most of the work.

    Raises ModelError where the motion leaves all measure.
    """
    layout = _laid_out(planned, effects, values)
    problem = FitProblem(layout, KnownLevels(planned.noise**2))
    bare = without_sensitivities(problem)
    fit = evaluate(bare, layout.start, layout.guesses(layout.start))
    for _ in range(NEWTON_PASSES):
        if fit is None or (
            _gap(fit) < LARGEST_TRAJECTORY_GAP and (fit.problem is problem or not slopes)
        ):
            break
        fit = evaluate(
            problem if slopes else bare,
            layout.start,
            fit.trajectories,
        )
    if fit is None:
        raise ModelError(
            "the simulation leaves all measure",
            where=planned.record.name,
            remedy="give starting values of a motion that stays finite",
        )
    return _as_model(planned, effects, layout, fit)


def fitted(
    planned: Planned, effects: Sequence[Traceable], values: Mapping[str, float] | None = None
) -> FittedModel | None:
    """Return the model with effects fitted to what the record of the maneuver holds, from
    ``values``; None where no cost is finite.
    """
    layout = _laid_out(planned, effects, values)
    fit = fit_whole_records(FitProblem(layout, KnownLevels(planned.noise**2)))
    return None if fit is None else _as_model(planned, effects, layout, fit)


def sigmas_of(fit: Fit) -> dict[str, float]:
    """Return the standard deviations of the shared parameters by name, from the information of a
    fit or a simulation.
    """
    information, _ = fit.normal_equations()
    inverse, _ = inverse_information(information, fit.theta)
    determined = np.diag(information) > 0.0
    std = np.where(determined, np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.inf)
    return dict(zip(fit.layout.shared, std.tolist(), strict=False))


def _laid_out(
    planned: Planned, effects: Sequence[Traceable], values: Mapping[str, float] | None
) -> FitLayout:
    model = planned.model.with_effects(*effects)
    system = compile_model(model.with_values(values) if values else model, planned.outputs)
    plain = lay_out([planned.record], system, planned.settings)
    # Not where the record begins, which a plan does not know, but where the model does.
    items = [system.parameters[name] for name in (*plain.shared, *plain.local)] + [
        system.initial.items[i] for i in plain.free_initial
    ]
    layout = replace(
        plain,
        start=np.clip(np.array([item.value for item in items], dtype=float), plain.low, plain.high),
    )
    return replace(layout, prior=declared_priors(planned.model, effects, layout))


def _as_model(
    planned: Planned, effects: Sequence[Traceable], layout: FitLayout, fit: Fit
) -> FittedModel:
    return FittedModel(
        tuple(effects), planned.model, planned.model.with_effects(*effects), layout.system, fit
    )


def _gap(fit: Fit) -> float:
    gaps = (
        np.max(np.abs(linearisation.states - guess), initial=0.0)
        for linearisation, guess in zip(fit.linearisations, fit.guesses, strict=True)
    )
    size = max(
        np.max(np.abs(linearisation.states), initial=0.0) for linearisation in fit.linearisations
    )
    return float(max(gaps) / max(size, 1e-300))


# ---- Probability that a flight distinguishes two effects

# twice the log likelihood ratio of a certain claim
DECISIVE_LOG_LIKELIHOOD_RATIO = 2.0 * math.log(CLAIM_LEVEL / (1.0 - CLAIM_LEVEL))


@dataclass(frozen=True)
class RivalDecision:
    """Decision between two effects by a flight under the first.

    ``mean`` and ``std`` of twice the difference of the log likelihoods; ``price``: by how much more
    the loop charges for the other's parameters.
    """

    mean: float
    std: float
    price: float = 0.0

    @property
    def log_likelihood(self) -> float:
        """Expected difference of the log likelihoods."""
        return 0.5 * self.mean

    @property
    def right(self) -> float:
        """Probability that the search prefers the acting effect by more than the ambiguous
        margin.
        """
        return self._above(DECISIVE_LOG_LIKELIHOOD_RATIO)

    @property
    def wrong(self) -> float:
        """Probability that it prefers the other by more than that."""
        return 1.0 - self._above(-DECISIVE_LOG_LIKELIHOOD_RATIO)

    def _above(self, limit: float) -> float:
        return normal_above(self.mean + self.price - limit, self.std)


def decision_of(
    squares: np.ndarray, counts: np.ndarray, gain: float, own: int, other: int, price: float = 0.0
) -> RivalDecision:
    """Return the decision between two effects.

    Parameters
    ----------
    squares, counts : ``(m,)`` weighted squares that the rival leaves, and samples, by output.
    gain : weighted squares that the declared model alone leaves.
    own, other : free parameters of the true effect and of the rival.
    price : what the loop charges for the rival less what it charges for the true one, in twice the
        log likelihood.
    """
    samples = np.maximum(counts, 1)
    share = squares / samples
    total = float(squares.sum())
    mean = float(np.sum(samples * np.log1p(share))) + own - other
    variance = float(np.sum((4.0 * squares + 2.0 * squares * share) / (1.0 + share) ** 2))
    along = min(1.0, total / gain) if gain > 0.0 else 1.0
    return RivalDecision(mean, math.sqrt(variance + 4.0 * along), price)


def detection_probability(gain: float, own: int, price: float, accept: float) -> float:
    """Probability that an effect raises twice the log likelihood by more than its prior odds cost.

    ``gain``: expected gain of the log likelihood over the declared model. ``own``, ``price``: its
    free parameters and their cost; ``accept``: threshold of an addition.
    """
    mean = 2.0 * gain + own
    return normal_above(mean - price - accept, math.sqrt(8.0 * gain + 2.0 * own))


def normal_above(mean: float, std: float) -> float:
    """Return the probability that a normal number is above zero."""
    return 0.5 * math.erfc(-mean / (std * math.sqrt(2.0))) if std > 0.0 else float(mean > 0.0)


# ---- Two confusable effects

RIVAL_STARTS = 2
# cost of an effect's prior odds, in twice the log evidence
ODDS_COST = -2.0 * math.log(FAMILY_ODDS / FEWEST_FAMILY_MEMBERS)


@dataclass(frozen=True, eq=False)
class ActingEffect:
    """An acting effect in its present form, with ``values`` of its own parameters by local name."""

    effect: Traceable
    values: Mapping[str, float]

    @property
    def full_values(self) -> dict[str, float]:
        """The values by the names that they have in a model."""
        return {full_name(self.effect, local): value for local, value in self.values.items()}


@dataclass(frozen=True, eq=False)
class Contest:
    """Comparison of ``true`` and ``rival`` by a flight under the former.

    ``gain`` : gain of the log likelihood of the true effect over the declared model alone,
    ``shown`` the probability that this is enough for a search; ``rival`` has the values that fit
    best, and ``left`` is half of the weighted squares that it leaves of the flight without noise.
    """

    true: ActingEffect
    rival: ActingEffect
    gain: float
    shown: float
    left: float
    decision: RivalDecision

    @property
    def chance(self) -> float:
        """Lower bound of the probability that the true effect is found and preferred to the
        rival.
        """
        return max(0.0, self.shown + self.decision.right - 1.0)


def declared_fit(planned: Planned, true: ActingEffect) -> tuple[Planned, FittedModel]:
    """Return the noise-free flight with an effect, and the declared model fitted to it: half the
    sum of squares is the expected gain of the effect.
    """
    simulated_fit = simulated(planned, (true.effect,), true.full_values, slopes=False)
    measured = planned.measuring(simulated_fit.fit.linearisations[0].y)
    base = fitted(measured, ())
    return measured, base if base is not None else simulated(measured)


def contest(
    planned: Planned, true: ActingEffect, rival: Traceable, hint: Mapping[str, float] | None = None
) -> Contest:
    """Simulate an effect, fit its rival as well as possible, and evaluate the residual.

    ``hint`` : values of the rival by local name from which a fit begins as well. A rival that
    explains nothing leaves what the declared model does.
    """
    measured, base = declared_fit(planned, true)
    best = best_fit(measured, base, rival, hint) or base
    counts = best.fit.counts
    own, other = _free(true.effect), _free(rival)
    paid = price(rival, counts) - price(true.effect, counts)
    # Priors of the true effect cost it something, too.
    spent = _own_cost(measured, true)
    decision = decision_of(
        _squares(best),
        counts,
        2.0 * base.fit.cost,
        own,
        other,
        paid + 2.0 * (_prior_cost(best) - spent),
    )
    gain = max(0.0, base.fit.cost - spent)
    shown = detection_probability(gain, own, price(true.effect, counts), ODDS_COST)
    return Contest(
        true,
        ActingEffect(_form(best, rival), _values(best, rival)),
        gain,
        shown,
        best.fit.cost,
        decision,
    )


def best_fit(
    measured: Planned, base: FittedModel, rival: Traceable, hint: Mapping[str, float] | None = None
) -> FittedModel | None:
    """Best fit of the rival to a flight, from the starts of a search and from ``hint``; None if it
    explains nothing.
    """
    known = base.values.shared
    places = starts_at(base, rival, search_context(base))
    tries = [(form, {**known, **start}) for form, (start,) in places[:RIVAL_STARTS]]
    if hint:
        form = places[0][0] if places else rival
        named = {
            full_name(form, local): value
            for local, value in hint.items()
            if local in {item.name for item in form.parameters}
        }
        tries.insert(0, (form, {**known, **named}))
    fits = [
        result
        for effect, start in tries
        if (result := fitted(measured, (effect,), start)) is not None
    ]
    return min(fits, key=lambda each: each.fit.cost, default=None)


def linear_squares(planned: Planned, true: ActingEffect, rival: ActingEffect) -> float:
    """Weighted squares that a rival leaves to first order, about the values that it has: quick, for
    comparing maneuvers.
    """
    simulated_fit = simulated(planned, (true.effect,), true.full_values, slopes=False).fit
    other = simulated(planned, (rival.effect,), rival.full_values).fit
    sigma = planned.noise[:, None]
    difference = ((simulated_fit.linearisations[0].y - other.linearisations[0].y) / sigma).ravel()
    slopes = (other.jacobians[0] / sigma[:, :, None]).reshape(difference.size, -1)
    size = np.linalg.norm(slopes, axis=0)
    basis = np.linalg.qr(slopes[:, size > 0.0] / size[size > 0.0])[0]
    left = difference - basis @ (basis.T @ difference)
    return float(left @ left)


def _squares(best: FittedModel) -> np.ndarray:
    return np.asarray(np.sum(best.fit.residuals[0] ** 2, axis=1) / best.fit.variance)


def _prior_cost(best: FittedModel) -> float:
    """Return the cost of a fit from its priors."""
    return best.fit.cost - 0.5 * float(_squares(best).sum())


def _own_cost(measured: Planned, true: ActingEffect) -> float:
    """Return the cost of the true effect fitted to its own flight: that of its priors."""
    there = simulated(measured, (true.effect,), true.full_values, slopes=False)
    if there.fit.layout.prior is None or there.fit.cost < 1e-9:
        return there.fit.cost
    own = fitted(measured, (true.effect,), true.full_values)
    return there.fit.cost if own is None else min(own.fit.cost, there.fit.cost)


def _free(effect: Traceable) -> int:
    return added_parameters(effect, 1)


def price(effect: Traceable, counts: np.ndarray) -> float:
    """Approximate cost of an effect's parameters in twice the log evidence, for ``counts`` samples
    (Schwarz).
    """
    return _free(effect) * float(np.log(counts.sum())) + 2.0 * math.log(SCANNED_PLACES) * is_event(
        effect
    )


def _form(best: FittedModel, rival: Traceable) -> Traceable:
    return best.effects[0] if best.effects else rival


def _values(best: FittedModel, rival: Traceable) -> dict[str, float]:
    """Fitted values of the rival; those of its absence if it explains nothing."""
    effect = _form(best, rival)
    initial_values = {item.name: item.value for item in effect.parameters}
    if not best.effects:
        return {**initial_values, **effect.absent}
    values = best.values
    known = {**values.shared, **values.own[0]}
    named = {item.name: full_name(effect, item.name) for item in effect.parameters}
    return {local: known.get(full, initial_values[local]) for local, full in named.items()}
