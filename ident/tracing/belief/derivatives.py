"""What a set of effects does to the derivatives: whether they still are what the vehicle file can be believed to say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ident.statistics.contradictions import SIGMAS, THREEFOLD, contradiction
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity, Requirement
from ident.whole_record.output_error import fit_covariance


@dataclass(frozen=True)
class Wreck:
    """A derivative that a set of effects ruins: its name, its value with the declared model alone and with the set, what is wrong.

    ``requirement`` : the number against its bar.
    """

    name: str
    before: Quantity
    after: Quantity
    why: str
    requirement: Requirement | None = None


def wrecked(root: FittedModel, best: FittedModel) -> list[Wreck]:
    """Derivatives that contradict the vehicle file, or are no longer known, with a set of effects and did not or were without it.

    They contradict it where two sigmas to either side leave no value of the declared sign below ``THREEFOLD`` times the declared
    one; one that comes nearer to it from the side where it was without the set is not laid to the set, however well it is known now. They are no
    longer known where sigma grows tenfold or more and exceeds the value. What is ``wild`` with the set is ruined whatever
    it was without: either the file is wrong or the set is.
    """
    declared, before, after = declared_derivatives(best), derivatives_of(root), derivatives_of(best)
    far, out = _far_off(after, declared), []
    for name, value in declared.items():
        if name not in before or name not in after:
            continue
        known = max(thresholds.BLURRED * before[name].std, abs(after[name].value), abs(value))
        lost, declared_word = after[name].std > known, f"{name} over the value of the vehicle file, two sigmas nearer to it,"
        share, two = after[name].value / value, SIGMAS * abs(after[name].std / value)
        if name in far:
            high = share - two > 1.0 + THREEFOLD
            bar = 1.0 + THREEFOLD if high else 1.0 - THREEFOLD
            asked = Requirement(declared_word, share - two if high else share + two, bar, at_least=not high)
            out.append(Wreck(name, before[name], after[name], f"is far from the {value:.3g} of the vehicle file", asked))
        elif contradicts(before[name], value):
            continue
        elif contradicts(after[name], value) and not _nearer(before[name].value - value, after[name].value - value):
            turned = after[name].value * value < 0.0
            bar = 0.0 if turned else THREEFOLD
            asked = Requirement(declared_word, share + two if turned else share - two, bar, at_least=turned)
            out.append(Wreck(name, before[name], after[name], "turns its sign" if turned else "grows more than threefold", asked))
        elif lost:
            asked = Requirement(f"the standard deviation of {name}", after[name].std, known, at_least=False, unit=after[name].unit)
            out.append(Wreck(name, before[name], after[name], "is no longer known", asked))
    return out


def _nearer(before: float, after: float) -> bool:
    """Whether a distance has become smaller on the side where it was."""
    return before * after > 0.0 and abs(after) <= abs(before)


def wild(fitted: FittedModel) -> list[str]:
    """Derivatives that lie farther from the declared value than three times that value, by more than two sigmas.

    Nothing where the model has so few that their declared values are mere starts (the ballistic coefficient of an unknown body).
    """
    return _far_off(derivatives_of(fitted), declared_derivatives(fitted))


def _far_off(found: Mapping[str, Quantity], declared: Mapping[str, float]) -> list[str]:
    far = 1.0 + THREEFOLD
    if len(declared) < thresholds.FEWEST_DECLARED:
        return []
    return [name for name, value in declared.items() if name in found and _outside(found[name], value, 2.0 - far, far)]


def contradicts(found: Quantity, declared: float) -> bool:
    """Whether no value within two sigmas has the declared sign and is below threefold the declared one."""
    return bool(contradiction(found.value, found.std, declared))


def declared_derivatives(fitted: FittedModel) -> dict[str, float]:
    """Values in the vehicle file of what the declared model estimates; one of zero says nothing and is left out, as is a bias."""
    return {item.name: item.value for item in fitted.declared.parameters if item.free and item.value != 0.0 and not item.name.startswith("bias_")}


def derivatives_of(fitted: FittedModel) -> Mapping[str, Quantity]:
    """Shared parameters of the declared model as fitted, with sigmas corrected for coloured residuals."""
    covariance, _ = fit_covariance(fitted.fit)
    names, theta, declared = fitted.fit.layout.shared, fitted.fit.theta, fitted.declared.parameters
    return {
        name: Quantity(float(theta[i]), float(max(covariance[i, i], 1e-300) ** 0.5), declared[name].unit)
        for i, name in enumerate(names)
        if name in declared
    }


def _outside(found: Quantity, declared: float, low: float, high: float) -> bool:
    """Whether ``found``, by two sigmas, lies outside ``low`` to ``high`` times the declared value."""
    share, sigma = found.value / declared, abs(found.std / declared)
    return share + SIGMAS * sigma < low or share - SIGMAS * sigma > high
