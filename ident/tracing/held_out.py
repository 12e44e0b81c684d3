"""Fits of a fitted model to held-out data: its predictions, and whether the residual is noise.

A held-out record is fitted twice. The frozen fit estimates initial states, biases and
record-specific parameters only, and gives the reported errors. The informed fit also estimates the
shared parameters, with the training posterior as Gaussian prior, and gives the verdict: frozen
values would reject correct sets of effects whose parameters are correlated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.intervals import add_normal_equations, inverse_information
from ident.tracing.diagnosis import Trained
from ident.tracing.fitted_model import (
    FitData,
    FittedModel,
    Start,
    Values,
    belongs_to_record,
    compiled_with,
    fit_as_declared,
    fit_set,
    levels_of,
    local_names,
    start_and_guesses,
)
from ident.tracing.linear_sets import likely_starts
from ident.tracing.problem import search_context
from ident.tracing.scan import KEPT_LEADS
from ident.tracing.whiteness import whiteness
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitProblem, Prior, lay_out
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.record import Record

COLOURED_P_VALUE = 1e-3  # p-value of a residual test below which a residual is examined again


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Frozen and informed fit of a fitted model to held-out records; None if a fit failed or was
    not made.
    """

    frozen: Fit | None
    informed: Fit | None


@dataclass(frozen=True, eq=False)
class HeldOutData:
    """Held-out records, with spikes of their inputs mended; empty if there are none.

    Attributes
    ----------
    masks : one mask ``(m, N)`` for each record, True where a sample counts; None if the declared
        model cannot be simulated on the records.
    declared : fit of the declared model to the records.
    """

    records: Sequence[Record] = ()
    masks: Sequence[np.ndarray] | None = None
    declared: HeldOut = HeldOut(None, None)


def predicted_by(fitted: FittedModel, held: HeldOutData) -> HeldOut:
    """Return the fits of a fitted model to all held-out records (``fit_held_out``)."""
    return fit_held_out(fitted, held.records, held.masks) if held.records else HeldOut(None, None)


def fit_held_out(
    fitted: FittedModel,
    records: Sequence[Record],
    masks: Sequence[np.ndarray] | None,
    *,
    informed: bool = True,
) -> HeldOut:
    """Return the fits of a fitted model to other records: frozen and, if wanted, informed by the
    training prior.

    Record-specific effects (events, drifts) are searched for anew in each record.
    """
    frozen = _fitter(fitted, records, masks).fit_event_by_event()
    if not informed:
        return HeldOut(None if frozen is None else frozen.fit, None)
    informed_fit = (
        None
        if frozen is None
        else _fitter(fitted, records, masks, training_prior(fitted)).fit(
            fitted.effects, frozen.values
        )
    )
    filtered = has_process_noise(fitted.system)
    local = any(belongs_to_record(effect) for effect in fitted.effects)
    # With a filter another start gives the same fit, so only records with events are fitted again.
    if informed_fit is None or (
        (local or not filtered) and fails_residual_tests(HeldOut(None, informed_fit.fit))
    ):
        by_event = _fitter(fitted, records, masks, training_prior(fitted)).fit_event_by_event()
        informed_fit = _best(informed_fit, by_event)
    if (
        informed_fit is not None
        and not filtered
        and fails_residual_tests(HeldOut(None, informed_fit.fit))
    ):
        prior = prior_at_common_point(fitted, informed_fit, masks)
        if prior is not None:
            relinearised_fit = _fitter(fitted, records, masks, prior).fit_event_by_event()
            informed_fit = _best(informed_fit, relinearised_fit)
    if informed_fit is not None and local:
        # An event found by the informed fit may have been missed by the frozen one.
        refit = _fitter(fitted, records, masks).fit(fitted.effects, informed_fit.values)
        frozen = _best(frozen, refit)
    return HeldOut(
        None if frozen is None else frozen.fit, None if informed_fit is None else informed_fit.fit
    )


def _best(*fits: FittedModel | None) -> FittedModel | None:
    """Return the fit with the lowest cost, the first of equal ones; None without a fit."""
    found = [fit for fit in fits if fit is not None]
    return min(found, key=lambda fitted: fitted.fit.cost, default=None)


def fails_residual_tests(out: HeldOut) -> bool:
    """Return whether a residual test of the informed fit has a p-value below
    ``COLOURED_P_VALUE``.
    """
    if out.informed is None:
        return False
    return (
        min((test.p_value for test in whiteness(out.informed, "informed")), default=1.0)
        < COLOURED_P_VALUE
    )


def frozen_on(
    trained: Trained, declared: Model, records: Sequence[Record], masks: Sequence[np.ndarray] | None
) -> HeldOut:
    """Return the fit to these records with the shared parameters frozen; initial states, biases and
    record-specific parameters are estimated.
    """
    frozen = _HeldOutFitter(trained, declared, records, masks).fit_event_by_event()
    return HeldOut(None if frozen is None else frozen.fit, None)


def _fitter(
    fitted: FittedModel,
    records: Sequence[Record],
    masks: Sequence[np.ndarray] | None,
    prior: Prior | None = None,
) -> _HeldOutFitter:
    """Return the fitter of a fitted model; with a prior, its shared parameters are free."""
    return _HeldOutFitter(
        fitted.trained,
        fitted.declared,
        records,
        masks,
        prior,
        levels_of(fitted) if prior is not None else None,
    )


@dataclass(frozen=True, eq=False)
class _HeldOutFitter:
    """Fits of a fitted model to records that were not fitted: its shared parameters are frozen, or
    free under a prior.

    ``levels`` : noise levels of the fit where it has process noise.
    """

    trained: Trained
    declared: Model
    records: Sequence[Record]
    masks: Sequence[np.ndarray] | None
    prior: Prior | None = None
    levels: Mapping[str, float] | None = None

    def fit(
        self,
        effects: Sequence[Traceable],
        values: Values | None = None,
        added: Mapping[str, float] | None = None,
    ) -> FittedModel | None:
        """Return a fit of the effects of the model, or of some of them, to these records.

        ``values`` are the start, by default the values of training; ``added``, by parameter,
        replaces single values of the start in every record.
        """
        trained, prior = self.trained, self.prior
        settings = replace(trained.settings, iterations=40, tolerance=1e-3)
        full, system = compiled_with(self.declared, effects, trained.outputs)
        known = {name: value for name, value in trained.shared.items() if name in system.parameters}
        parameters = system.parameters.with_values({**known, **self._mean_biases()})
        system = replace(system, parameters=parameters.hold(known) if prior is None else parameters)
        local = [name for effect in effects for name in local_names(effect)]
        layout = lay_out(self.records, system, settings, local=local, masks=self.masks)
        first, guesses = start_and_guesses(layout, values, added or {})
        layout = lay_out(self.records, system, settings, local=local, masks=self.masks, start=first)
        if prior is not None:
            layout = replace(layout, prior=prior)
        # The frozen fit has no filter; the informed fit uses the process noise of training.
        fit = (
            fit_whole_records(FitProblem(layout), guesses)
            if prior is None
            else fit_as_declared(layout, guesses, self.levels)
        )
        return (
            None if fit is None else FittedModel(tuple(effects), self.declared, full, system, fit)
        )

    def _mean_biases(self) -> dict[str, float]:
        """Return the mean biases of the fitted records. Fits start there: with slow motion, trim is
        in the biases, and the default start is too far away.
        """
        values_by_record = self.trained.own
        names = [name for name in next(iter(values_by_record), {}) if name.startswith("bias_")]
        return {
            name: float(np.mean([values[name] for values in values_by_record if name in values]))
            for name in names
        }

    def fit_event_by_event(self) -> FittedModel | None:
        """Return a fit to which record-specific effects were added one after the other, each from
        starts of a scan; None if a fit failed.

        Nuisance dynamics are included from the start; without them other parameters would be
        biased.
        """
        effects = self.trained.effects
        event_effects = [
            effect
            for effect in effects
            if not effect.traits.background and belongs_to_record(effect)
        ]
        present = [effect for effect in effects if effect not in event_effects]
        background_names = {
            name for effect in effects if effect.traits.background for name in local_names(effect)
        }
        best = self.fit(
            present,
            None,
            {
                name: value
                for name, value in self.trained.own[0].items()
                if name in background_names
            },
        )
        for effect in event_effects:
            if best is None:
                return None
            best = self._with_event(best, present, effect, self.trained.own[0])
            present = [*present, effect]
        if best is None or len(event_effects) < 2:
            return best
        return self._refit_each_event(best, event_effects)

    def _refit_each_event(
        self, best: FittedModel, event_effects: Sequence[Traceable]
    ) -> FittedModel:
        """Return a better fit with each record-specific effect fitted again, together with all
        others: the first onsets were found before the other effects were in the model.
        """
        for effect in event_effects:
            rest = [other for other in best.effects if other is not effect]
            base = self.fit(rest, best.values)
            if base is None:
                continue
            refit = self._with_event(base, rest, effect)
            # a smaller gain is the same optimum
            best = refit if refit is not None and refit.fit.cost < best.fit.cost - 0.5 else best
        return best

    def _with_event(
        self,
        base: FittedModel,
        rest: Sequence[Traceable],
        effect: Traceable,
        *further: Mapping[str, float],
    ) -> FittedModel | None:
        """Return the best fit of ``rest`` and one more effect, from the starts of a scan at the fit
        ``base`` of ``rest`` and from ``further`` starts.
        """
        starts = [
            start for _, start in likely_starts(base, effect, search_context(base))[:KEPT_LEADS]
        ]
        fits = [self.fit([*rest, effect], base.values.with_added(start)) for start in starts]
        fits += [self.fit([*rest, effect], base.values, start) for start in further]
        return _best(*fits)


# ---- Prior of the shared parameters from training


def training_prior(fitted: FittedModel) -> Prior:
    """Return the training posterior of the shared parameters as a prior; record-specific unknowns
    are projected out.
    """
    fit, n = fitted.fit, len(fitted.fit.layout.shared)
    normal, _ = fit.normal_equations()
    covariance, _ = inverse_information(normal, fit.theta)
    information, _ = inverse_information(covariance[:n, :n], np.ones(n))
    return Prior(np.arange(n), fit.theta[:n].copy(), information)


def prior_at_common_point(
    fitted: FittedModel, informed_fit: FittedModel, masks: Sequence[np.ndarray] | None
) -> Prior | None:
    """Return the training prior linearised at a point that training and held-out records share;
    None if no such point is found.

    Training may determine only a combination, such as rate limit times control derivative, hence a
    curve in parameter space. Its Gaussian approximation holds only near the optimum.
    """
    trained, other = fitted.fit.layout.problems, informed_fit.fit.layout.problems
    values = Values(
        fitted.values.shared,
        (*fitted.values.own, *informed_fit.values.own),
        (*fitted.values.states, *informed_fit.values.states),
    )
    records = [problem.record for problem in (*trained, *other)]
    valid = [
        *(problem.valid for problem in trained),
        *(masks if masks is not None else (problem.valid for problem in other)),
    ]
    settings = replace(fitted.fit.layout.settings, iterations=40, tolerance=1e-2, enough=0.1)
    both = fit_set(
        FitData(records, valid, fitted.declared, fitted.system.output_names),
        fitted.effects,
        settings,
        Start(values),
    )
    if both is None:
        return None
    fit, n = both.fit, len(both.fit.layout.shared)
    normal, gradient = np.zeros((len(fit.theta),) * 2), np.zeros(len(fit.theta))
    for r, problem in enumerate(fit.layout.problems[: len(trained)]):
        weight = np.where(problem.valid, 1.0 / fitted.fit.variance[:, None], 0.0)
        add_normal_equations(
            normal, gradient, fit.layout.columns(r), fit.jacobians[r], fit.residuals[r], weight
        )
    # unknowns of the training records: shared ones, then those of each record
    count = n + len(trained) * fit.layout.unknowns_per_record
    normal, gradient = normal[:count, :count], gradient[:count]
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    covariance, _ = inverse_information(normal, fit.theta[:count])
    step = (
        np.linalg.lstsq(normal / np.outer(scale, scale), gradient / scale, rcond=1e-10)[0] / scale
    )
    information, _ = inverse_information(covariance[:n, :n], np.ones(n))
    return Prior(np.arange(n), fit.theta[:n] + step[:n], information)
