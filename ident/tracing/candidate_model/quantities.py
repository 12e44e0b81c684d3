"""An effect's parameters in a fitted model: values with corrected sigmas, the records they act on, and which lie beyond belief."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.statistics.information import inverse_information
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.diagnosis import Quantity
from sim.declaration.effect import full_name
from sim.declaration.proposal import Traceable


def quantities(fitted: FittedModel, effect: Traceable) -> dict[str, Quantity]:
    """An effect's free parameters in a fitted model, by local name; of the record in which it stands out most where each has its own."""
    return max(_quantities_by_record(fitted, effect), key=lambda found: sigmas_from_absence(effect, found))


def records_of(fitted: FittedModel, effect: Traceable) -> tuple[int, ...]:
    """Numbers, from 0, of the records that an effect with parameters of its own for each acts on; empty where it acts on all."""
    each = _quantities_by_record(fitted, effect)
    seen = tuple(r for r, found in enumerate(each) if sigmas_from_absence(effect, found) > thresholds.CLEARLY_OFF_ABSENCE)
    return seen if 0 < len(seen) < len(each) else ()


def _quantities_by_record(fitted: FittedModel, effect: Traceable) -> list[dict[str, Quantity]]:
    """The same for every record; alike where the parameters are shared."""
    normal, _ = fitted.fit.normal_equations()
    covariance, _ = inverse_information(normal, fitted.fit.theta)
    return quantities_with(fitted, effect, covariance)


def quantities_with(fitted: FittedModel, effect: Traceable, covariance: np.ndarray) -> list[dict[str, Quantity]]:
    """An effect's parameters in each record of a fitted model, with sigmas from a covariance ``(n, n)`` of all unknowns."""
    places = {name: i for i, name in enumerate(fitted.fit.layout.names)}
    out: list[dict[str, Quantity]] = []
    for r in range(len(fitted.fit.layout.problems)):
        found = {}
        for item in effect.parameters:
            full = full_name(effect, item.name)
            at = places.get(full, places.get(f"{full}, record {r + 1}"))
            if at is not None:
                found[item.name] = Quantity(float(fitted.fit.theta[at]), float(np.sqrt(max(covariance[at, at], 1e-300))), item.unit)
        out.append(found)
    return out


def implausible(effect: Traceable, found: Mapping[str, Quantity], slack: float = 2.0) -> list[str]:
    """Parameters of an effect that lie outside what is believed of them by more than ``slack`` times their sigma."""
    ranges = effect.traits.plausible
    return [name for name, q in found.items() if name in ranges and not ranges[name][0] - slack * q.std <= q.value <= ranges[name][1] + slack * q.std]


def stands_out_somewhere(fitted: FittedModel, effect: Traceable, sigmas: float = thresholds.OFF_ABSENCE) -> bool:
    """Whether an effect stands out in a record by so many sigmas, one parameter or all together, an event inside it.

    Shapes of a curve may each be open, since a derivative takes up what one does, and yet be far off their absence together. An event that begins
    with the record, or after it, is a constant or nothing.
    """
    onset = effect.traits.onset
    normal, _ = fitted.fit.normal_equations()
    covariance, _ = inverse_information(normal, fitted.fit.theta)
    for r, (problem, found) in enumerate(zip(fitted.fit.layout.problems, quantities_with(fitted, effect, covariance), strict=True)):
        inside = onset not in found or problem.record.time[3] < found[onset].value < problem.record.time[-4]
        if inside and (sigmas_from_absence(effect, found) > sigmas or _together_from_absence(fitted, effect, r, covariance) > sigmas):
            return True
    return False


def _together_from_absence(fitted: FittedModel, effect: Traceable, r: int, covariance: np.ndarray) -> float:
    """The root of Wald's statistic per parameter, for the parameters of an effect in record ``r``; zero where fewer than two could be absent."""
    names = fitted.fit.layout.names
    absent = {full_name(effect, local): value for local, value in effect.absent.items()}
    absent |= {f"{name}, record {r + 1}": value for name, value in absent.items()}
    at = [i for i, name in enumerate(names) if name in absent]
    if len(at) < 2:
        return 0.0
    away = fitted.fit.theta[at] - np.array([absent[names[i]] for i in at])
    return float(np.sqrt(max(squared_distance(covariance, at, away), 0.0) / len(at)))


def squared_distance(covariance: np.ndarray, at: Sequence[int], away: np.ndarray) -> float:
    """away' C^-1 away of the unknowns ``at``, ``covariance`` ``(n, n)`` that of all, of the directions that the data determine."""
    if not len(at):
        return 0.0
    scale = np.sqrt(np.maximum(np.diag(covariance)[list(at)], 1e-300))
    inside = covariance[np.ix_(at, at)] / np.outer(scale, scale)
    return float((away / scale) @ np.linalg.lstsq(inside, away / scale, rcond=1e-8)[0])


def sigmas_from_absence(effect: Traceable, found: Mapping[str, Quantity]) -> float:
    """By how many standard deviations an effect's parameters differ from its absence, at most; infinite where none could."""
    known = [abs(found[local].value - value) / found[local].std for local, value in effect.absent.items() if local in found]
    return max(known, default=np.inf)
