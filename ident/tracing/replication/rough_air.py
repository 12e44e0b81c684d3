"""Process noise that stands although what it leaves is not white: rough air that is rougher than its model, as real air is.

No free simulation can tell it, since its history is not known: it is judged by predictions of one step, on records that were not fitted.
Three things set it apart from what only looks like it. Against any colour of each channel by itself, it explains as much from one gust that
all channels see. It is there where the controls rest as where they move, while what a model lacks of its forces is not. And its strength is
determined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.process_noise.filter_error import noise_levels, predictive_log_likelihood
from ident.process_noise.innovations_model import has_process_noise
from ident.tracing import thresholds
from ident.tracing.belief.evenness import is_even
from ident.tracing.belief.standing import why_not
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.quantities import quantities, stands_out_somewhere
from ident.tracing.diagnosis import Candidate, Step
from ident.tracing.replication.coloured_null import innovation_level
from ident.tracing.selection.ledger import Ledger, fit
from ident.tracing.validation.held_out import HeldOutData, held_out, predicted_by
from ident.tracing.validation.improvement import changes
from ident.tracing.validation.scatter_of_change import scatter_of_change
from ident.whole_record.gauss_newton import Fit
from sim.declaration.effect import NoiseEffect


@dataclass(frozen=True)
class Predicted:
    """Gain of log likelihood on records that were not fitted, over white noise: by one-step predictions, and by any colour of each channel."""

    by_process_noise: float
    by_any_colour: float

    @property
    def share(self) -> float:
        """The one over the other; zero where nothing is coloured."""
        return self.by_process_noise / self.by_any_colour if self.by_any_colour > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class RoughAir:
    """A set whose last effect is process noise that stands, and by how much it raises the log likelihood of each record that was not fitted."""

    fitted: FittedModel
    gains: tuple[float, ...]


def process_noise_that_stands(ledger: Ledger, base: FittedModel, held: HeldOutData) -> tuple[Ledger, RoughAir | None]:
    """The declared model, with what any record may have, and process noise; None where that does not stand, or nothing could tell.

    ``base`` : fitted to the training records. ``held`` : the others, on which it is judged.
    """
    if not held.records or held.masks is None or has_process_noise(base.system):
        return ledger, None
    frozen = [held_out(base, [record], [mask], informed=False).frozen for record, mask in zip(held.records, held.masks, strict=True)]
    known = [each for each in frozen if each is not None]
    if len(known) < len(frozen) or not is_even([base.fit, *known]):
        return ledger, None
    for effect in ledger.problem.candidates:
        if not isinstance(effect, NoiseEffect):
            continue
        ledger, fitted = fit(ledger, (*base.effects, effect), base)
        if fitted is None or not stands_out_somewhere(fitted, effect, thresholds.CLEARLY_OFF_ABSENCE):
            continue
        if any(why_not(each, quantities(fitted, each), fitted) is not None for each in fitted.effects):
            continue
        if _simulates_worse(base, fitted, held) or _steadier(ledger, fitted):
            continue
        gains = [predicted(fitted, one) for one in known]
        ledger = ledger.told(evidence=[_evidence(base, fitted, gains)])
        if (
            all(gain.share > thresholds.SHARE_OF_ANY_COLOUR for gain in gains)
            and min(g.by_process_noise for g in gains) > ledger.problem.settings.accept
        ):
            told = ", ".join(f"{gain.by_process_noise:.0f}" for gain in gains)
            sentence = f"{effect.name} raises the log likelihood of one-step predictions on records not fitted by {told}"
            step = Step(fitted.names, fitted.criterion, fitted.fit.log_likelihood, sentence)
            return ledger.kept(fitted, fitted.criterion).told(step), RoughAir(fitted, tuple(float(gain.by_process_noise) for gain in gains))
    return ledger, None


def _steadier(ledger: Ledger, fitted: FittedModel) -> bool:
    """Whether a set without process noise that the search has passed explains the fitted records better: what it lacks is no chance."""
    return any(other.criterion < fitted.criterion for other in ledger.models.values() if not has_process_noise(other.system))


def _simulates_worse(base: FittedModel, fitted: FittedModel, held: HeldOutData) -> bool:
    """Whether its derivatives simulate records that were not fitted clearly worse: turbulence in the place of a steady cause bends them.

    By more than is worth a claim, beyond chance: in rough air the gusts of one record move the error of a free simulation by a tenth and more.
    """
    before, after = (predicted_by(model, held, informed=False).frozen for model in (base, fitted))
    if before is None or after is None:
        return True
    change, chance = changes(before, after), thresholds.BEYOND_ITS_SCATTER * scatter_of_change(before, after)
    return bool(change.size) and float(np.mean(change)) > thresholds.WORTH + chance


def predicted(fitted: FittedModel, frozen: Fit) -> Predicted:
    """What a set with process noise brings on one record, of which ``frozen`` is the prediction without."""
    problem = frozen.layout.problems[0]
    settings, levels = fitted.fit.layout.settings, noise_levels(fitted.fit)
    mine = predictive_log_likelihood([problem.record], fitted.system, fitted.values.shared, levels, settings, masks=[problem.valid])
    coloured = sum(_log_likelihood(frozen.residuals[0][i], problem.valid[i]) for i in np.flatnonzero(frozen.layout.used))
    return Predicted(mine - frozen.log_likelihood, coloured - frozen.log_likelihood)


def _log_likelihood(residual: np.ndarray, valid: np.ndarray) -> float:
    """Gaussian log likelihood of a series as an autoregression of its own, whose order it pays for."""
    return -0.5 * float(np.count_nonzero(valid)) * (innovation_level(residual, valid) + 1.0 + float(np.log(2.0 * np.pi)))


def _evidence(base: FittedModel, fitted: FittedModel, gains: Sequence[Predicted]) -> Candidate:
    effect = fitted.effects[-1]
    share = min(gain.share for gain in gains)
    remark = f"one-step predictions bring {share:.2f} of what any colour of each channel brings"
    brought = base.fit.cost - fitted.fit.cost
    return Candidate(len(fitted.effects), base.names, effect.name, brought, 0.0, True, True, quantities(fitted, effect), None, (), remark)
