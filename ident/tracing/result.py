"""The Diagnosis from fitted models and their predictions: derivatives with sigmas, error figures,
fitted and predicted outputs.
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
# smallest noise level of a fit, relative to the noise at high frequencies; below it the level was
# lost
LOST_NOISE_SHARE = 0.1


def _derivatives_under_each(
    problem: TraceProblem,
    best: FittedModel,
    claim: Claim,
    under: Mapping[str, Quantity],
    inflation: Mapping[str, float],
    spread: Callable[[FittedModel], Mapping[str, float]],
    fits: Mapping[frozenset[str], FittedModel],
) -> Claim:
    """Return a claim with the derivatives under its own name and under each alternative; a hint
    without them.

    ``under`` : those of the accepted set. ``spread`` : their change with the form of the effects.
    ``fits`` : fits of the search, from which those of the alternatives start.
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
    return replace(claim, derivatives_under={claim.name: under, **members}) if members else claim


@dataclass(frozen=True, eq=False)
class Before:
    """The declared model as fitted, its residual tests, and the scatter between records."""

    root: FittedModel
    tests: tuple[ResidualTest, ...]
    scatter: RecordScatter


@dataclass(frozen=True, eq=False)
class ForSimulation:
    """The model with the effects found, as simulations use it.

    Attributes
    ----------
    trained : its values. fit : to the fitted records.
    frozen : fit to held-out records with frozen derivatives; None without such records, or where
        the model cannot be simulated.
    """

    trained: Trained
    fit: Fit
    frozen: Fit | None


@dataclass(frozen=True, eq=False)
class After:
    """The accepted set, its judgement, the model for simulations, the scatter between records, and
    the fits of the search by the names of their effects.
    """

    judgement: Judgement
    simulated: ForSimulation
    scatter: RecordScatter
    fits: Mapping[frozenset[str], FittedModel]


def _tests_for_noise_floor(before: Before, judgement: Judgement) -> tuple[ResidualTest, ...]:
    """Return the tests that show which residuals are noise; without claims, those of the declared
    model.
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
    """Return the Diagnosis. ``validation`` are the held-out records as given, spikes of inputs
    included.
    """
    judgement, root, simulated = after.judgement, before.root, after.simulated
    best, inflation = judgement.best, after.scatter.inflation
    shown = validation or problem.records
    fits = (held.declared.frozen, simulated.frozen) if validation else (root.fit, simulated.fit)
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

    under = _derivatives(problem, best, inflation, spread(best))
    every_level = _noise_levels(root, best)
    levels = {name: std for name, std in every_level.items() if name in channels}
    fitted = tuple(
        FittedRecord(
            record,
            best.system.output_names,
            root.fit.residuals[r],
            _in_units(best, r, every_level),
            problem.masks[r],
        )
        for r, record in enumerate(problem.records)
    )
    not_met = requirements_not_met(judgement)
    claims = tuple(with_reasons(claim, judgement, not_met) for claim in judgement.claims)
    return Diagnosis(
        verdict=judgement.verdict,
        effects=tuple(
            _derivatives_under_each(problem, best, claim, under, inflation, spread, after.fits)
            for claim in claims
        ),
        before=_derivatives(problem, root, before.scatter.inflation),
        after=under,
        trained_before=root.trained,
        trained_after=simulated.trained,
        modes_before=_characteristics(root, before.scatter.inflation),
        modes_after=_characteristics(best, inflation),
        derived_before=_derived(root, before.scatter.inflation),
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
    """Return the requirements that were not met; of several residual tests, the one with the
    smallest p-value, and their number.
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
    """Return a hint with its reasons: requirements not met by it or by all effects, and cautions
    without a number.
    """
    if claim.claimed or claim.reasons:
        return claim
    mine = [
        requirement.sentence
        for requirement in not_met
        if not requirement.effects or claim.name in requirement.effects
    ]
    plain = [caution.sentence for caution in judgement.cautions if caution.requirement is None]
    return replace(claim, reasons=(*mine, *(plain if not mine else [])))


def _error_masks(
    problem: TraceProblem, channels: Sequence[str], shown: Sequence[Record], fit: Fit | None
) -> list[np.ndarray]:
    """Return the samples that count in errors, ``(channels, N)`` a record; ``fit`` of held-out
    records.
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
    """Return frequency, damping and delay, with sigmas propagated from the reported ones of the
    derivatives.
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
    return (
        characteristics(fitted.system, _inflated_estimate(fitted, inflation), _slow(fitted))
        if fitted.system.inputs
        else None
    )


def _slow(fitted: FittedModel) -> set[str]:
    """The short period is meant, at one speed: what any record may have beside it is slower."""
    return {
        state.name
        for effect in fitted.background
        if isinstance(effect, DynamicsEffect)
        for state in effect.states
    }


def _inflated_estimate(fitted: FittedModel, inflation: Mapping[str, float]) -> Estimate:
    plain = fitted.estimate
    inflated = np.array([inflation.get(name, 1.0) for name in plain.names])
    return replace(plain, covariance=plain.covariance * np.outer(inflated, inflated))


def _noise_levels(root: FittedModel, best: FittedModel) -> dict[str, float]:
    """Return the measurement noise by output; if a fit with process noise lost it, the noise at
    high frequencies of the declared model's residual.
    """
    levels = noise_levels(best.fit)
    if has_process_noise(best.system):
        lost = set(levels_at_limit(best.fit))
        for name, level in levels.items():
            shown = noise_shown(root.fit, name) if name in root.system.output_names else None
            # Rough air or a discrepancy has also explained the noise of this sensor.
            if shown is not None and (name in lost or level < LOST_NOISE_SHARE * shown):
                levels[name] = shown
    return levels


def _in_units(fitted: FittedModel, r: int, levels: Mapping[str, float]) -> np.ndarray:
    """Return the residuals in the outputs' units; innovations of unit variance are multiplied by
    the noise of their output.
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
    best : the set.
    out : its fit to held-out data.
    claims : its effects and hints.
    tests : of its residuals.
    cautions : reasons to doubt more than the verdict states.
    """

    verdict: Verdict
    best: FittedModel
    out: HeldOut
    claims: tuple[Claim, ...]
    tests: ResidualTests
    cautions: tuple[Caution, ...]


def residual_tests(best: FittedModel, out: HeldOut) -> ResidualTests:
    """Test whether the residuals are noise, on the fitted records and on the others."""
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
