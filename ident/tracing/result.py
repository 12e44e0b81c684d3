"""Diagnosis from fitted models and their predictions.

It has derivatives with sigmas, error figures, and fitted and predicted outputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.modes import (
    MODAL_UNITS,
    Characteristics,
    characteristics,
    modal_estimate,
)
from ident.process_noise.best_start import levels_at_limit
from ident.process_noise.filter_error import noise_levels
from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.residuals import ResidualTest, error_figures
from ident.tracing.between_records import RecordScatter, form_spread
from ident.tracing.diagnosis import (
    Caution,
    Claim,
    Concern,
    Diagnosis,
    FittedRecord,
    Prediction,
    Quantity,
    Requirement,
    Trained,
    Verdict,
)
from ident.tracing.fitted_model import FittedModel
from ident.tracing.held_out import HeldOut, HeldOutData
from ident.tracing.predictive import prediction, spike_masks_of
from ident.tracing.problem import TraceProblem
from ident.tracing.whiteness import FITTED, HELD_OUT, noise_floors, noise_shown, whiteness
from ident.tracing.wrong_samples import measured_masks
from ident.whole_record.gauss_newton import Fit
from sim.declaration.effect import DynamicsEffect
from sim.record import Record

_NONE: Mapping[str, float] = MappingProxyType({})
# Smallest noise level of a fit relative to the noise at high frequencies. Below it, process noise
# has taken over the measurement noise.
LOST_NOISE_SHARE = 0.1


def _derivatives_under_each(
    problem: TraceProblem,
    best: FittedModel,
    claim: Claim,
    accepted_derivatives: Mapping[str, Quantity],
    inflation: Mapping[str, float],
    spread: Callable[[FittedModel], Mapping[str, float]],
    fits: Mapping[frozenset[str], FittedModel],
) -> Claim:
    """Return a claim with the derivatives under its own effect and under each alternative; a hint
    is returned unchanged.

    Parameters
    ----------
    best : the accepted set. accepted_derivatives : derivatives under it.
    inflation : factor on the sigma of each derivative.
    spread : function that returns the change of the derivatives with the form of the effects.
    fits : fits of the search, from which the fits with alternatives start.
    """
    offered, members = {each.name: each for each in problem.candidates}, {}
    rest = [each for each in best.effects if each.name != claim.name]
    for name in claim.alternatives if claim.claimed else ():
        if name not in offered:
            continue
        effects = (*rest, offered[name])
        start = fits.get(frozenset(each.name for each in effects), best)
        other = problem.fit(effects, start)
        if other is not None:
            members[name] = _derivatives(problem, other, inflation, spread(other))
    return (
        replace(claim, derivatives_under={claim.name: accepted_derivatives, **members})
        if members
        else claim
    )


@dataclass(frozen=True, eq=False)
class Before:
    """The declared model as fitted.

    Attributes
    ----------
    fitted : the fit. tests : of its residuals.
    scatter : of its derivatives between records.
    """

    fitted: FittedModel
    tests: tuple[ResidualTest, ...]
    scatter: RecordScatter


@dataclass(frozen=True, eq=False)
class ForSimulation:
    """The model with the effects found, as a free simulation uses it.

    Attributes
    ----------
    trained : its estimates. fit : its fit to the fitted records.
    frozen : fit to held-out records with frozen derivatives; None without such records, or where
        the model cannot be simulated.
    """

    trained: Trained
    fit: Fit
    frozen: Fit | None


@dataclass(frozen=True, eq=False)
class After:
    """The accepted set of effects.

    Attributes
    ----------
    judgement : of the set. simulated : the model with it, for free simulations.
    scatter : of its derivatives between records.
    fits : fits of the search, by the names of their effects.
    """

    judgement: Judgement
    simulated: ForSimulation
    scatter: RecordScatter
    fits: Mapping[frozenset[str], FittedModel]


def _tests_for_noise_floor(before: Before, judgement: Judgement) -> tuple[ResidualTest, ...]:
    """Return the residual tests that show which residuals are noise: of the accepted set, or of the
    declared model if the verdict is ``unexplained``.
    """
    # A catch-all term or turbulence whitens the innovations: its tests would accept the declared
    # model's residual as sensor noise.
    return before.tests if judgement.verdict is Verdict.UNEXPLAINED else judgement.tests.all


def reported(
    problem: TraceProblem,
    before: Before,
    after: After,
    held: HeldOutData,
    validation: Sequence[Record],
) -> Diagnosis:
    """Return the Diagnosis.

    ``held`` : held-out data with mended inputs. ``validation`` : the same records as given.
    """
    judgement, declared_fit, simulated = after.judgement, before.fitted, after.simulated
    best, inflation = judgement.best, after.scatter.inflation
    shown = validation or problem.records
    fits = (
        (held.declared.frozen, simulated.frozen)
        if validation
        else (declared_fit.fit, simulated.fit)
    )
    channels = [
        name for name in problem.outputs if any(name in record.output_names for record in shown)
    ]
    predictions = [
        Prediction(
            record,
            tuple(channels),
            prediction(fits[0], r, record, channels),
            prediction(fits[1], r, record, channels),
        )
        for r, record in enumerate(shown)
    ]
    masks = _error_masks(problem, channels, shown, fits[1] if validation else None)

    def spread(fitted: FittedModel) -> Mapping[str, float]:
        # Without claims the refined form is not worth a fit.
        return form_spread(problem, fitted) if judgement.verdict is not Verdict.UNEXPLAINED else {}

    accepted_derivatives = _derivatives(problem, best, inflation, spread(best))
    all_levels = _noise_levels(declared_fit, best)
    levels = {name: std for name, std in all_levels.items() if name in channels}
    fitted = tuple(
        FittedRecord(
            record,
            best.system.output_names,
            declared_fit.fit.residuals[r],
            _in_units(best, r, all_levels),
            problem.masks[r],
        )
        for r, record in enumerate(problem.records)
    )
    not_met = requirements_not_met(judgement)
    claims = tuple(with_reasons(claim, judgement, not_met) for claim in judgement.claims)
    return Diagnosis(
        verdict=judgement.verdict,
        effects=tuple(
            _derivatives_under_each(
                problem, best, claim, accepted_derivatives, inflation, spread, after.fits
            )
            for claim in claims
        ),
        before=_derivatives(problem, declared_fit, before.scatter.inflation),
        after=accepted_derivatives,
        trained_before=declared_fit.trained,
        trained_after=simulated.trained,
        modes_before=_characteristics(declared_fit, before.scatter.inflation),
        modes_after=_characteristics(best, inflation),
        derived_before=_derived(declared_fit, before.scatter.inflation),
        derived_after=_derived(best, inflation),
        error_before=error_figures([p.before for p in predictions], shown, masks, channels),
        error_after=error_figures([p.after for p in predictions], shown, masks, channels),
        noise_floor=noise_floors(fitted, _tests_for_noise_floor(before, judgement), levels),
        residual_std=levels,
        held_out=bool(validation),
        tests_before=before.tests,
        tests_after=judgement.tests.all,
        steps=(),
        candidates=(),
        warnings=judgement.cautions,
        predictions=tuple(predictions),
        fitted=fitted,
        scatter=after.scatter.scatter,
        inflation=inflation,
        not_met=not_met,
    )


def requirements_not_met(judgement: Judgement) -> tuple[Requirement, ...]:
    """Return the requirements that were not met.

    Several residual tests that fail are one requirement, with the smallest p-value and their
    number.
    """
    cautions = [caution for caution in judgement.cautions if caution.requirement is not None]
    tests = [
        caution.requirement
        for caution in cautions
        if caution.test is not None and caution.requirement is not None
    ]
    others = [
        caution.requirement
        for caution in cautions
        if caution.test is None and caution.requirement is not None
    ]
    if tests:
        worst = min(tests, key=lambda each: each.value)
        many = (
            f"{len(tests)} of {len(judgement.tests.all)} residual tests fail, and the smallest "
            "p-value"
        )
        tests = [replace(worst, asked=many) if len(tests) > 1 else worst]
    return (*others, *tests)


def with_reasons(claim: Claim, judgement: Judgement, not_met: Sequence[Requirement]) -> Claim:
    """Return a hint with its reasons: the requirements that it, or the whole set, does not meet, or
    without any the cautions that have no number. A claim is returned unchanged.
    """
    if claim.claimed or claim.reasons:
        return claim
    unmet = [
        requirement.sentence
        for requirement in not_met
        if not requirement.effects or claim.name in requirement.effects
    ]
    without_number = [
        caution.sentence for caution in judgement.cautions if caution.requirement is None
    ]
    return replace(claim, reasons=(*unmet, *(without_number if not unmet else [])))


def _error_masks(
    problem: TraceProblem, channels: Sequence[str], shown: Sequence[Record], fit: Fit | None
) -> list[np.ndarray]:
    """Return for each record the mask ``(channels, N)`` of the samples that count in errors.

    ``fit`` : to the held-out records; None if there are none or it failed.
    """
    masks = measured_masks(shown, problem.outputs)
    if shown is problem.records:
        masks = [mask & used for mask, used in zip(masks, problem.masks, strict=True)]
    elif fit is not None:
        masks = spike_masks_of(fit, masks)
    rows = [problem.outputs.index(name) for name in channels]
    return [mask[rows] for mask in masks]


def _derivatives(
    problem: TraceProblem,
    fitted: FittedModel,
    inflation: Mapping[str, float] = _NONE,
    form: Mapping[str, float] = _NONE,
) -> dict[str, Quantity]:
    """Return the shared parameters of the declared model, with sigmas corrected for colour,
    inflated by the differences between records, and by ``form``.

    ``form`` : uncertainty from the form of an effect, added in squares.
    """
    estimate = fitted.estimate
    declared = set(problem.model.parameters.names)

    def sigma(name: str, std: float) -> float:
        return max(inflation.get(name, 1.0) * float(np.hypot(std, form.get(name, 0.0))), 1e-300)

    return {
        name: Quantity(float(value), sigma(name, float(std)), unit)
        for name, unit, value, std in zip(
            estimate.names, estimate.units, estimate.values, estimate.std, strict=True
        )
        if name in declared
    }


def _derived(fitted: FittedModel, inflation: Mapping[str, float] = _NONE) -> dict[str, Quantity]:
    """Return frequency and damping of the modes, and the delay, with sigmas propagated from the
    reported sigmas of the derivatives.
    """
    if not fitted.system.inputs:
        return {}
    estimate = _inflated_estimate(fitted, inflation)
    modes = modal_estimate(fitted.system, estimate, _slow(fitted))
    out = {
        name: Quantity(value, max(std, 1e-300), MODAL_UNITS[name])
        for name, (value, std) in modes.items()
    }
    if "delay" in estimate.names:
        out["delay"] = Quantity(estimate.value("delay"), max(estimate.sigma("delay"), 1e-300), "s")
    return out


def _characteristics(fitted: FittedModel, inflation: Mapping[str, float]) -> Characteristics | None:
    """Return the characteristics of the modes; None for a model without inputs."""
    return (
        characteristics(fitted.system, _inflated_estimate(fitted, inflation), _slow(fitted))
        if fitted.system.inputs
        else None
    )


def _slow(fitted: FittedModel) -> set[str]:
    """Return the states of nuisance dynamics by name: they are slower than the short period."""
    return {
        state.name
        for effect in fitted.background
        if isinstance(effect, DynamicsEffect)
        for state in effect.states
    }


def _inflated_estimate(fitted: FittedModel, inflation: Mapping[str, float]) -> Estimate:
    """Return the estimate with each sigma multiplied by its inflation."""
    estimate = fitted.estimate
    inflated = np.array([inflation.get(name, 1.0) for name in estimate.names])
    return replace(estimate, covariance=estimate.covariance * np.outer(inflated, inflated))


def _noise_levels(declared_fit: FittedModel, best: FittedModel) -> dict[str, float]:
    """Return the standard deviation of the measurement noise by output.

    If process noise has taken over the noise of an output, it is the noise at high frequencies in
    the residual of the declared model.
    """
    levels = noise_levels(best.fit)
    if has_process_noise(best.system):
        lost = set(levels_at_limit(best.fit))
        for name, level in levels.items():
            shown = (
                noise_shown(declared_fit.fit, name)
                if name in declared_fit.system.output_names
                else None
            )
            # Rough air or a discrepancy has also explained the noise of this sensor.
            if shown is not None and (name in lost or level < LOST_NOISE_SHARE * shown):
                levels[name] = shown
    return levels


def _in_units(fitted: FittedModel, r: int, levels: Mapping[str, float]) -> np.ndarray:
    """Return the residuals ``(m, N)`` of record ``r`` in the units of the outputs: innovations of
    unit variance are multiplied by the noise of their output.
    """
    if not has_process_noise(fitted.system):
        return fitted.fit.residuals[r]
    return (
        fitted.fit.residuals[r]
        * np.array([levels[name] for name in fitted.system.output_names])[:, None]
    )


# ---- Residual tests and judgement


@dataclass(frozen=True, eq=False)
class ResidualTests:
    """Residual tests of the fitted records, and of the held-out ones under the training prior."""

    fitted: tuple[ResidualTest, ...]
    others: tuple[ResidualTest, ...] = ()

    @property
    def all(self) -> tuple[ResidualTest, ...]:
        """All tests."""
        return (*self.fitted, *self.others)


@dataclass(frozen=True, eq=False)
class Judgement:
    """A verdict on a set of effects.

    Attributes
    ----------
    verdict : of the diagnosis.
    best : the set.
    out : fits of the set to held-out data.
    claims : effects of the set that are claimed, and hints.
    tests : residual tests of the set.
    cautions : reasons to doubt more than the verdict states.
    """

    verdict: Verdict
    best: FittedModel
    out: HeldOut
    claims: tuple[Claim, ...]
    tests: ResidualTests
    cautions: tuple[Caution, ...]


def residual_tests(best: FittedModel, out: HeldOut) -> ResidualTests:
    """Return the tests whether the residuals are noise, on the fitted and the held-out records."""
    others = whiteness(out.informed, HELD_OUT) if out.informed is not None else ()
    return ResidualTests(tuple(whiteness(best.fit, FITTED)), tuple(others))


def not_noise(tests: Sequence[ResidualTest], least: float) -> list[Caution]:
    """Return a caution for each residual test whose p-value is below ``least``."""
    return [
        Caution(
            Concern.NOT_NOISE,
            f"{test.channel}: {test.sentence} (p = {test.p_value:.1e})",
            test,
            Requirement(
                f"the p-value of the residual test of {test.channel}",
                test.p_value,
                least,
                at_least=True,
            ),
        )
        for test in tests
        if test.p_value < least
    ]
