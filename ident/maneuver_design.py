"""Design of maneuvers: simulation of planned flights, the information in them, and the decision
between two effects.

A flight under a true effect is fitted with this effect and with a rival. Let D be twice the log
likelihood of the fit with the true effect minus that with the rival. With the noise of a flight, D
is nearly normal. Let s_i be the sum of weighted squared residuals of output i when the rival is
fitted to the flight without noise, and N_i the number of its samples:

    mean D = sum_i N_i ln(1 + s_i / N_i) + n - n'      variance D = sum_i (4 s_i + 2 s_i^2 / N_i) /
    (1 + s_i / N_i)^2 + 4 s / f

Here n and n' are the numbers of parameters of the true effect and of the rival, s = sum s_i, and f
is the sum of squares when the declared model alone is fitted. For s much smaller than N the mean is
s and the variance 4 s; for the log likelihood itself they are s/2 and s. The logarithm is due to
the estimated noise levels, and the last term to the noise along the signatures of the two effects.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.statistics.intervals import inverse_information
from ident.tracing.evidence import FAMILY_ODDS, FEWEST_FAMILY_MEMBERS
from ident.tracing.fitted_model import FittedModel, added_parameters, declared_priors, is_event
from ident.tracing.linear_sets import likely_starts
from ident.tracing.names import CLAIM_LEVEL
from ident.tracing.problem import search_context
from ident.tracing.scan import SCANNED_ONSETS
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
    """Noise model with independent Gaussian noise of known ``variance (m,)``. The cost is half the
    sum of weighted squares.

    It is needed for data without noise, for which the variances that ``White`` estimates would be
    zero.
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
        """Return the residuals and sensitivities unchanged, with the cost for the known
        variances.
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


# ---- Simulation of a planned flight, and fits to it

NEWTON_PASSES = 12  # most Newton iterations on the trajectory; each doubles the correct digits


@dataclass(frozen=True, eq=False)
class PlannedManeuver:
    """A planned maneuver as a record, with its sensors.

    Attributes
    ----------
    record : inputs of the maneuver. Its outputs are placeholders: only their names, and the first
        guess of a trajectory, are taken from them.
    model : the declared model with its biases, at the assumed values.
    outputs : names of the m measured outputs.
    noise : ``(m,)`` standard deviation of each measured output.
    settings : settings of the fits.
    """

    record: Record
    model: Model
    outputs: tuple[str, ...]
    noise: np.ndarray
    settings: FitSettings = field(default_factory=FitSettings)

    def with_outputs(self, y: np.ndarray) -> PlannedManeuver:
        """Return the maneuver with the outputs ``y (m, N)`` in its record."""
        rows = zip(self.outputs, y, strict=True)
        return replace(
            self,
            record=replace(
                self.record,
                outputs=tuple(Channel.of(name, self.record[name].unit, row) for name, row in rows),
            ),
        )


def simulate_maneuver(
    planned: PlannedManeuver,
    effects: Sequence[Traceable] = (),
    values: Mapping[str, float] | None = None,
    *,
    slopes: bool = True,
) -> FittedModel:
    """Return the model with ``effects``, simulated over the maneuver. Nothing is fitted.

    The residual of the result is measured minus simulated.

    Parameters
    ----------
    values : full name -> value of parameters that differ from those of the model and the effects.
    slopes : whether the result has sensitivities, which take most of the time.

    Raises
    ------
    ModelError : where the simulation diverges.
    """
    layout = _layout_of_plan(planned, effects, values)
    problem = FitProblem(layout, KnownLevels(planned.noise**2))
    bare = without_sensitivities(problem)
    fit = evaluate(bare, layout.start, layout.guesses(layout.start))
    for _ in range(NEWTON_PASSES):
        if fit is None or (
            _trajectory_gap(fit) < LARGEST_TRAJECTORY_GAP and (fit.problem is problem or not slopes)
        ):
            break
        fit = evaluate(problem if slopes else bare, layout.start, fit.trajectories)
    if fit is None:
        raise ModelError(
            "the simulation diverges",
            where=planned.record.name,
            remedy="give starting values with which the simulation stays finite",
        )
    return _as_fitted_model(planned, effects, layout, fit)


def fit_maneuver(
    planned: PlannedManeuver,
    effects: Sequence[Traceable],
    values: Mapping[str, float] | None = None,
) -> FittedModel | None:
    """Return the model with ``effects`` fitted to the outputs in the record of the maneuver,
    starting from ``values``; None where no cost is finite.
    """
    layout = _layout_of_plan(planned, effects, values)
    fit = fit_whole_records(FitProblem(layout, KnownLevels(planned.noise**2)))
    return None if fit is None else _as_fitted_model(planned, effects, layout, fit)


def shared_sigmas(fit: Fit) -> dict[str, float]:
    """Return name -> standard deviation of the shared parameters, from the information matrix of a
    fit or a simulation; infinite for a parameter without information.
    """
    information, _ = fit.normal_equations()
    inverse, _ = inverse_information(information, fit.theta)
    determined = np.diag(information) > 0.0
    std = np.where(determined, np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.inf)
    return dict(zip(fit.layout.shared, std.tolist(), strict=False))


def _layout_of_plan(
    planned: PlannedManeuver, effects: Sequence[Traceable], values: Mapping[str, float] | None
) -> FitLayout:
    """Return the layout of a fit to the maneuver, with the declared values as start and priors."""
    model = planned.model.with_effects(*effects)
    system = compile_model(model.with_values(values) if values else model, planned.outputs)
    plain = lay_out([planned.record], system, planned.settings)
    # The first samples of a planned record are unknown: start from the initial state of the model.
    items = [system.parameters[name] for name in (*plain.shared, *plain.local)] + [
        system.initial.items[i] for i in plain.free_initial
    ]
    layout = replace(
        plain,
        start=np.clip(np.array([item.value for item in items], dtype=float), plain.low, plain.high),
    )
    return replace(layout, prior=declared_priors(planned.model, effects, layout))


def _as_fitted_model(
    planned: PlannedManeuver, effects: Sequence[Traceable], layout: FitLayout, fit: Fit
) -> FittedModel:
    """Return a fit, or a simulation in its form, as a fitted model with ``effects``."""
    return FittedModel(
        tuple(effects), planned.model, planned.model.with_effects(*effects), layout.system, fit
    )


def _trajectory_gap(fit: Fit) -> float:
    """Return the largest difference of guessed and corrected trajectory, over the largest state."""
    gaps = (
        np.max(np.abs(linearisation.states - guess), initial=0.0)
        for linearisation, guess in zip(fit.linearisations, fit.guesses, strict=True)
    )
    size = max(
        np.max(np.abs(linearisation.states), initial=0.0) for linearisation in fit.linearisations
    )
    return float(max(gaps) / max(size, 1e-300))


# ---- Probability that a flight distinguishes two effects

# twice the log likelihood ratio at which one of two effects is claimed
DECISIVE_LOG_LIKELIHOOD_RATIO = 2.0 * math.log(CLAIM_LEVEL / (1.0 - CLAIM_LEVEL))


@dataclass(frozen=True)
class RivalDecision:
    """Decision between two effects by a flight under the true one.

    Attributes
    ----------
    mean, std : of twice the difference of the log likelihoods, true effect minus rival.
    price : cost of the parameters of the rival minus that of the true effect, in twice the log
        likelihood.
    """

    mean: float
    std: float
    price: float = 0.0

    @property
    def log_likelihood(self) -> float:
        """Expected difference of the log likelihoods of the true effect and the rival."""
        return 0.5 * self.mean

    @property
    def right(self) -> float:
        """Probability that the search prefers the true effect by more than
        ``DECISIVE_LOG_LIKELIHOOD_RATIO``.
        """
        return self._above(DECISIVE_LOG_LIKELIHOOD_RATIO)

    @property
    def wrong(self) -> float:
        """Probability that the search prefers the rival by more than this."""
        return 1.0 - self._above(-DECISIVE_LOG_LIKELIHOOD_RATIO)

    def _above(self, limit: float) -> float:
        """Return the probability that twice the log likelihood difference exceeds ``limit``."""
        return normal_above(self.mean + self.price - limit, self.std)


def rival_decision(
    squares: np.ndarray,
    counts: np.ndarray,
    gain: float,
    true_count: int,
    rival_count: int,
    price: float = 0.0,
) -> RivalDecision:
    """Return the decision between the true effect and a rival.

    Parameters
    ----------
    squares, counts : ``(m,)`` weighted squares of each output with the rival fitted, and numbers of
        samples.
    gain : weighted squares with the declared model alone fitted.
    true_count, rival_count : numbers of free parameters of the true effect and of the rival.
    price : as in `RivalDecision`.
    """
    samples = np.maximum(counts, 1)
    share = squares / samples
    total = float(squares.sum())
    mean = float(np.sum(samples * np.log1p(share))) + true_count - rival_count
    variance = float(np.sum((4.0 * squares + 2.0 * squares * share) / (1.0 + share) ** 2))
    along = min(1.0, total / gain) if gain > 0.0 else 1.0
    return RivalDecision(mean, math.sqrt(variance + 4.0 * along), price)


def detection_probability(gain: float, count: int, price: float, accept: float) -> float:
    """Return the probability that an effect raises twice the log likelihood by more than its cost.

    Parameters
    ----------
    gain : expected gain of the log likelihood over the declared model.
    count : number of free parameters of the effect.
    price : cost of these parameters, in twice the log likelihood.
    accept : cost of the prior odds of the effect, in twice the log likelihood.
    """
    mean = 2.0 * gain + count
    return normal_above(mean - price - accept, math.sqrt(8.0 * gain + 2.0 * count))


def normal_above(mean: float, std: float) -> float:
    """Return the probability that a normal number of this mean and standard deviation is above
    zero.
    """
    return 0.5 * math.erfc(-mean / (std * math.sqrt(2.0))) if std > 0.0 else float(mean > 0.0)


# ---- Two confusable effects

RIVAL_STARTS = 2  # starts of a search from which a rival is fitted
# cost of an effect's prior odds, in twice the log evidence
ODDS_COST = -2.0 * math.log(FAMILY_ODDS / FEWEST_FAMILY_MEMBERS)


@dataclass(frozen=True, eq=False)
class ActingEffect:
    """An effect that acts, and its values.

    Attributes
    ----------
    effect : the effect, in the form in which it acts.
    values : local name -> value of its parameters.
    """

    effect: Traceable
    values: Mapping[str, float]

    @property
    def full_values(self) -> dict[str, float]:
        """Full name in a model -> value of its parameters."""
        return {full_name(self.effect, local): value for local, value in self.values.items()}


@dataclass(frozen=True, eq=False)
class Contest:
    """Comparison of a true effect and a rival by a flight under the true one.

    Attributes
    ----------
    true : the true effect.
    rival : the rival, with the values that fit best.
    gain : gain of the log likelihood by the true effect over the declared model alone.
    shown : probability that this gain is large enough for a search to add the effect.
    left : half of the weighted squares of the flight without noise, with the rival fitted.
    decision : decision between the two.
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


def fit_declared_model(
    planned: PlannedManeuver, true: ActingEffect
) -> tuple[PlannedManeuver, FittedModel]:
    """Return the flight without noise under an effect, and the declared model fitted to it. The
    cost of this fit, half the sum of squares, is the expected gain of the effect.
    """
    simulated_fit = simulate_maneuver(planned, (true.effect,), true.full_values, slopes=False)
    measured = planned.with_outputs(simulated_fit.fit.linearisations[0].y)
    base = fit_maneuver(measured, ())
    return measured, base if base is not None else simulate_maneuver(measured)


def contest(
    planned: PlannedManeuver,
    true: ActingEffect,
    rival: Traceable,
    hint: Mapping[str, float] | None = None,
) -> Contest:
    """Return the comparison of a true effect, which is simulated, and a rival, which is fitted as
    well as possible.

    ``hint`` maps local names of the rival to values from which an additional fit starts. Where no
    fit of the rival succeeds, the declared model takes its place.
    """
    measured, base = fit_declared_model(planned, true)
    best = best_rival_fit(measured, base, rival, hint) or base
    counts = best.fit.counts
    true_count, rival_count = added_parameters(true.effect, 1), added_parameters(rival, 1)
    price = parameter_cost(rival, counts) - parameter_cost(true.effect, counts)
    # The priors of the true effect have a cost too.
    true_prior_cost = _prior_cost_of_true_effect(measured, true)
    squares = _weighted_squares(best)
    prior_cost = best.fit.cost - 0.5 * float(squares.sum())
    price += 2.0 * (prior_cost - true_prior_cost)
    decision = rival_decision(squares, counts, 2.0 * base.fit.cost, true_count, rival_count, price)
    gain = max(0.0, base.fit.cost - true_prior_cost)
    shown = detection_probability(gain, true_count, parameter_cost(true.effect, counts), ODDS_COST)
    return Contest(
        true,
        ActingEffect(_rival_form(best, rival), _rival_values(best, rival)),
        gain,
        shown,
        best.fit.cost,
        decision,
    )


def best_rival_fit(
    measured: PlannedManeuver,
    base: FittedModel,
    rival: Traceable,
    hint: Mapping[str, float] | None = None,
) -> FittedModel | None:
    """Return the best fit of the rival to a flight, from the starts of a search and from ``hint``;
    None where no fit has a finite cost.
    """
    shared_values = base.values.shared
    places = likely_starts(base, rival, search_context(base))
    tries = [(form, {**shared_values, **start}) for form, (start,) in places[:RIVAL_STARTS]]
    if hint:
        form = places[0][0] if places else rival
        named = {
            full_name(form, local): value
            for local, value in hint.items()
            if local in {item.name for item in form.parameters}
        }
        tries.insert(0, (form, {**shared_values, **named}))
    fits = [
        result
        for effect, start in tries
        if (result := fit_maneuver(measured, (effect,), start)) is not None
    ]
    return min(fits, key=lambda result: result.fit.cost, default=None)


def linear_squares(planned: PlannedManeuver, true: ActingEffect, rival: ActingEffect) -> float:
    """Return the sum of weighted squares of the flight under the true effect with the rival fitted,
    to first order about the values of the rival. It is quick and serves to compare maneuvers.
    """
    simulated_fit = simulate_maneuver(planned, (true.effect,), true.full_values, slopes=False).fit
    other = simulate_maneuver(planned, (rival.effect,), rival.full_values).fit
    sigma = planned.noise[:, None]
    difference = ((simulated_fit.linearisations[0].y - other.linearisations[0].y) / sigma).ravel()
    slopes = (other.jacobians[0] / sigma[:, :, None]).reshape(difference.size, -1)
    size = np.linalg.norm(slopes, axis=0)
    basis = np.linalg.qr(slopes[:, size > 0.0] / size[size > 0.0])[0]
    residual = difference - basis @ (basis.T @ difference)
    return float(residual @ residual)


def _weighted_squares(best: FittedModel) -> np.ndarray:
    """Return the sum of squared residuals of each output over its noise variance, ``(m,)``."""
    return np.asarray(np.sum(best.fit.residuals[0] ** 2, axis=1) / best.fit.variance)


def _prior_cost_of_true_effect(measured: PlannedManeuver, true: ActingEffect) -> float:
    """Return the cost of the true effect fitted to its own flight, which its priors cause."""
    simulation = simulate_maneuver(measured, (true.effect,), true.full_values, slopes=False)
    if simulation.fit.layout.prior is None or simulation.fit.cost < 1e-9:
        return simulation.fit.cost
    refit = fit_maneuver(measured, (true.effect,), true.full_values)
    return simulation.fit.cost if refit is None else min(refit.fit.cost, simulation.fit.cost)


def parameter_cost(effect: Traceable, counts: np.ndarray) -> float:
    """Return the approximate cost of the parameters of an effect, in twice the log evidence, for
    ``counts (m,)`` samples (Schwarz). For an event, the number of scanned times adds to it.
    """
    return added_parameters(effect, 1) * float(np.log(counts.sum())) + 2.0 * math.log(
        SCANNED_ONSETS
    ) * is_event(effect)


def _rival_form(best: FittedModel, rival: Traceable) -> Traceable:
    """Return the rival in the form that was fitted; unchanged where it was not fitted."""
    return best.effects[0] if best.effects else rival


def _rival_values(best: FittedModel, rival: Traceable) -> dict[str, float]:
    """Return local name -> fitted value of the rival, or its value when absent if not fitted."""
    effect = _rival_form(best, rival)
    initial_values = {item.name: item.value for item in effect.parameters}
    if not best.effects:
        return {**initial_values, **effect.absent}
    values = best.values
    known = {**values.shared, **values.own[0]}
    named = {item.name: full_name(effect, item.name) for item in effect.parameters}
    return {local: known.get(full, initial_values[local]) for local, full in named.items()}
