"""Effects that recur over the flights of a survey."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import Any

import numpy as np

from ident.pooling import Evidence, Recurrence, pool_values, recurrence

# ---- Which effects may recur

FEWEST_NAMED = 2  # least number of flights with an effect as claim or alternative
MOST_EFFECTS = 5  # effects that are tried together: 32 sets for each flight

DiagnosesByFlight = Mapping[str, Mapping[str, Any]]


def candidates(diagnoses: DiagnosesByFlight) -> tuple[str, ...]:
    """Return the effects that may recur, the most often claimed first.

    They are claimed in one flight at least, and named in two. Flights may name one effect
    differently, so an alternative of an effect counts as well.
    """
    claimed: Counter[str] = Counter()
    named: Counter[str] = Counter()
    for flight in diagnoses.values():
        for counter, effects in (
            (named, flight["effects"]),
            (claimed, [effect for effect in flight["effects"] if effect["claimed"]]),
        ):
            counter.update(
                {name for effect in effects for name in (effect["name"], *effect["alternatives"])}
            )
    recurring_names = [
        name
        for name in named
        if named[name] >= FEWEST_NAMED and claimed[name] and not is_of_flight(name)
    ]
    recurring_names.sort(key=lambda name: (-claimed[name], -named[name], name))
    return tuple(recurring_names[:MOST_EFFECTS])


def is_of_flight(name: str) -> bool:
    """Return whether an effect concerns single flights only: an event, a drift, rough air."""
    from sim.effects.library import library

    by_name = {effect.name: effect.traits for effect in library() if hasattr(effect, "traits")}
    traits = by_name.get(name)
    return traits is not None and (
        traits.per_record
        or bool(traits.onset)
        or traits.background
        or bool(traits.wrong_samples_of)
    )


def effects_of_one_flight(
    flight: Mapping[str, Any], shared: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Return the effects that only this flight claims, with the values of their parameters by full
    name. The ``shared`` effects and their alternatives are left out.
    """
    rivals = {
        name
        for effect in flight["effects"]
        if effect["name"] in shared
        for name in effect["alternatives"]
    }
    return {
        effect["name"]: _values_by_full_name(effect)
        for effect in flight["effects"]
        if effect["claimed"] and effect["name"] not in {*shared, *rivals}
    }


def _values_by_full_name(effect: Mapping[str, Any]) -> dict[str, float]:
    return {
        f"{effect['name']}.{local}": quantity["value"]
        for local, quantity in effect["parameters"].items()
    }


def starts_of(diagnoses: DiagnosesByFlight, names: Sequence[str]) -> dict[str, float]:
    """Return full name -> starting value of each effect's parameters: the median over the flights
    that name the effect.
    """
    found: dict[str, list[float]] = {}
    for flight in diagnoses.values():
        for effect in flight["effects"]:
            if effect["name"] in names:
                for name, value in _values_by_full_name(effect).items():
                    found.setdefault(name, []).append(value)
    return {name: float(np.median(values)) for name, values in found.items()}


# ---- Which effects recur: decided over all flights together

# Number of effects for which the chance of a false recurrence is corrected.
LIBRARY_SIZE = 60
# Differences of twice the log likelihood, as in a diagnosis: below the first, two effects are
# equally likely; above the second, a difference is clear.
EQUAL_CHI_SQUARE = 3.0
CLEAR_CHI_SQUARE = 10.0
PRESENT_PROBABILITY = 0.5  # probability from which an effect belongs to a flight's model


@dataclass(frozen=True)
class Recurring:
    """An effect that recurs.

    Attributes
    ----------
    name : name of the effect.
    parameters : parameter -> unit, in the order of the values.
    flights : names of the N flights that were fitted.
    recurrence : common value, and the probability that each flight has the effect.
    values, sigmas : parameters in each flight and their standard deviations, ``(N, p)``.
    rivals : other effect -> by how much twice the log likelihood of all flights prefers this one.
    named : flights whose own diagnosis claims the effect.
    """

    name: str
    parameters: Mapping[str, str]
    flights: tuple[str, ...]
    recurrence: Recurrence
    values: np.ndarray
    sigmas: np.ndarray
    rivals: Mapping[str, float]
    named: tuple[str, ...]

    @property
    def has(self) -> tuple[str, ...]:
        """Return the flights that have the effect."""
        return tuple(compress(self.flights, self.recurrence.has))

    @property
    def has_not(self) -> tuple[str, ...]:
        """Return the flights that do not have the effect."""
        return tuple(compress(self.flights, self.recurrence.has_not))

    @property
    def undecided(self) -> tuple[str, ...]:
        """Return the flights that may have the effect or not."""
        return tuple(name for name in self.flights if name not in {*self.has, *self.has_not})


def evidence_of(
    fits: Sequence[Mapping[str, Any]], name: str, others: Sequence[frozenset[str]]
) -> tuple[Evidence, np.ndarray]:
    """Return the evidence of each flight on an effect, and whether the flight has any, ``(N,)``.

    Parameters
    ----------
    fits : stored fits of the N flights.
    name : the effect.
    others : further effects of each flight.
    """
    size = max(
        (len(fitted["effects"][name]["full"]) for fitted in fits if name in fitted["effects"]),
        default=1,
    )
    gain, has_evidence = np.zeros(len(fits)), np.zeros(len(fits), dtype=bool)
    value, covariance = np.zeros((len(fits), size)), np.tile(np.eye(size), (len(fits), 1, 1))
    for n, (fitted, others_of_flight) in enumerate(zip(fits, others, strict=True)):
        without = fit_with(fitted, others_of_flight - {name})
        with_effect = fit_with(fitted, others_of_flight | {name})
        if without is None or with_effect is None or name not in fitted["effects"]:
            continue
        at = [with_effect["names"].index(full) for full in fitted["effects"][name]["full"]]
        has_evidence[n] = True
        gain[n] = max(0.0, with_effect["log_likelihood"] - without["log_likelihood"])
        value[n] = np.array(with_effect["estimate"])[at]
        covariance[n] = np.array(with_effect["covariance"])[np.ix_(at, at)]
    return Evidence(gain, value, covariance), has_evidence


def fit_with(fitted: Mapping[str, Any], effects: frozenset[str]) -> Mapping[str, Any] | None:
    """Return the fit of a flight with a set of effects; None if it failed."""
    fit: Mapping[str, Any] | None = fitted["sets"].get("+".join(sorted(effects)))
    return fit


def recurring(
    names: Sequence[str],
    flights: Sequence[str],
    fits: Sequence[Mapping[str, Any]],
    diagnoses: DiagnosesByFlight,
) -> tuple[list[Recurring], list[frozenset[str]]]:
    """Return the recurring effects, the strongest first, and those of each flight.

    Forward selection: the effect with the largest gain in likelihood is added, and assigned to each
    flight with a probability above one half. Then each selected effect is tested again with the
    others, and replaced if all flights together prefer a rival.
    """
    selected: list[str] = []
    sets = [frozenset[str]() for _ in fits]
    while len(selected) < len(names):
        remaining = [name for name in names if name not in selected]
        likelihoods = _likelihoods(fits, remaining, sets)
        if not likelihoods:
            break
        best = max(likelihoods, key=lambda name: likelihoods[name])
        selected.append(best)
        sets = assigned(fits, selected, sets)
        for name in list(selected):
            if not _likelihoods(fits, [name], sets):
                selected.remove(name)
                sets = [effects - {name} for effects in sets]
        if best not in selected:
            break
    for name in list(selected):
        rivals = [rival for rival in names if rival not in selected]
        preferred = _preferred(name, rivals, fits, sets, diagnoses)
        if preferred != name:
            selected[selected.index(name)] = preferred
            sets = assigned(fits, selected, [effects - {name} for effects in sets])
    found = [
        _recurring_of(name, names, selected, flights, fits, sets, diagnoses) for name in selected
    ]
    return found, sets


def _likelihoods(
    fits: Sequence[Mapping[str, Any]], names: Sequence[str], sets: Sequence[frozenset[str]]
) -> dict[str, float]:
    """Return effect -> gain in log likelihood over all flights, for the effects that recur."""
    results = {name: recurrence_of_effect(fits, name, sets) for name in names}
    return {
        name: result.log_likelihood
        for name, result in results.items()
        if result is not None and result.recurs
    }


def _preferred(
    name: str,
    rivals: Sequence[str],
    fits: Sequence[Mapping[str, Any]],
    sets: Sequence[frozenset[str]],
    diagnoses: DiagnosesByFlight,
) -> str:
    """Return an effect, or the rival that all flights together prefer in its place.

    Of effects with equal likelihood, the one with the smaller scatter of the derivatives over the
    conditions is preferred, since the aircraft has one value. If this does not decide, the
    diagnoses of the flights do, which use the declared derivatives.
    """
    without = [effects - {name} for effects in sets]
    likelihoods = _likelihoods(fits, (name, *rivals), without)
    if not likelihoods:
        return name
    least = max(likelihoods.values()) - 0.5 * EQUAL_CHI_SQUARE
    equal = [rival for rival, likelihood in likelihoods.items() if likelihood > least]
    if len(equal) == 1:
        return equal[0]
    differences = {
        rival: _differences(
            fits,
            [
                others | {rival} if name in effects else others
                for others, effects in zip(without, sets, strict=True)
            ],
        )
        for rival in equal
    }
    most = min(differences.values()) + CLEAR_CHI_SQUARE
    steady = [rival for rival in equal if differences[rival] < most]
    claims = Counter(
        effect["name"]
        for flight in diagnoses.values()
        for effect in flight["effects"]
        if effect["claimed"]
    )
    return max(steady, key=lambda rival: (claims[rival], rival == name, rival))


def _differences(fits: Sequence[Mapping[str, Any]], sets: Sequence[frozenset[str]]) -> float:
    """Return the difference of the derivatives of all flights from common values: the sum of
    Cochran's statistics.
    """
    found: dict[str, list[tuple[float, float]]] = {}
    for fitted, effects in zip(fits, sets, strict=True):
        fit = fit_with(fitted, effects)
        if fit is not None:
            sigmas = np.sqrt(np.diag(fit["covariance"]))
            for name, value, sigma in zip(
                fitted["declared"], fit["estimate"], sigmas, strict=False
            ):
                found.setdefault(name, []).append((value, float(sigma)))
    return sum(pool_values(*np.array(values).T).q for values in found.values() if len(values) > 1)


def recurrence_of_effect(
    fits: Sequence[Mapping[str, Any]], name: str, sets: Sequence[frozenset[str]]
) -> Recurrence | None:
    """Return the recurrence of an effect over the flights with evidence on it; None with fewer than
    two such flights.
    """
    evidence, has_evidence = evidence_of(fits, name, sets)
    if has_evidence.sum() < 2:
        return None
    result = recurrence(evidence.select(np.flatnonzero(has_evidence)), LIBRARY_SIZE)
    if has_evidence.all():
        return result
    probability = np.full(len(has_evidence), result.share)
    probability[has_evidence] = result.probability
    at_common = np.zeros(len(has_evidence))
    at_common[has_evidence] = result.at_common
    return replace(result, probability=probability, at_common=at_common)


def assigned(
    fits: Sequence[Mapping[str, Any]], selected: Sequence[str], sets: Sequence[frozenset[str]]
) -> list[frozenset[str]]:
    """Return the ``selected`` effects that each flight has with a probability above one half.

    The probabilities depend on the other effects of a flight, so they are computed again until no
    set changes.
    """
    current = list(sets)
    for _ in range(4):
        before = list(current)
        for name in selected:
            result = recurrence_of_effect(fits, name, current)
            if result is not None:
                current = [
                    effects | {name} if p > PRESENT_PROBABILITY else effects - {name}
                    for effects, p in zip(current, result.probability, strict=True)
                ]
        if current == before:
            break
    return current


def _recurring_of(
    name: str,
    names: Sequence[str],
    selected: Sequence[str],
    flights: Sequence[str],
    fits: Sequence[Mapping[str, Any]],
    sets: Sequence[frozenset[str]],
    diagnoses: DiagnosesByFlight,
) -> Recurring:
    """Return a selected effect with its values and its rivals among ``names``."""
    result = recurrence_of_effect(fits, name, sets)
    assert result is not None
    evidence, _ = evidence_of(fits, name, sets)
    content = next(fitted["effects"][name] for fitted in fits if name in fitted["effects"])
    without = [effects - {name} for effects in sets]
    margins = {}
    for rival in names:
        if rival not in selected:
            other = recurrence_of_effect(fits, rival, without)
            margins[rival] = 2.0 * (
                result.log_likelihood - (other.log_likelihood if other is not None else 0.0)
            )
    named = tuple(
        flight
        for flight in flights
        if any(
            effect["claimed"] and effect["name"] == name for effect in diagnoses[flight]["effects"]
        )
    )
    sigmas = np.sqrt(np.einsum("nii->ni", evidence.covariance))
    return Recurring(
        name,
        {local: content["units"][local] for local in content["parameters"]},
        tuple(flights),
        result,
        evidence.value,
        sigmas,
        margins,
        named,
    )


# ---- Recurring effects in addition to those of single flights

# An effect of a single flight is needed if it raises twice the log likelihood by this; as in a
# diagnosis.
NEEDED_CHI_SQUARE = 10.0
MOST_ROUNDS = 4  # repetitions of the search; usually fewer


def recurring_with_other_effects(
    names: Sequence[str],
    flights: Sequence[str],
    fits: Sequence[Mapping[str, Any]],
    diagnoses: DiagnosesByFlight,
) -> tuple[list[Recurring], list[frozenset[str]], list[Mapping[str, Any]]]:
    """Return the recurring effects and those of each flight as ``recurring``, and the fits used.

    A flight alone may claim one effect instead of two recurring ones. Its single effects are
    dropped if the recurring ones fit it about as well; then the search is repeated.
    """
    dropped = (False,) * len(fits)
    for _ in range(MOST_ROUNDS):
        used_fits = [
            {**fitted, "sets": fitted["sets_without"]} if is_dropped else fitted
            for fitted, is_dropped in zip(fits, dropped, strict=True)
        ]
        result, sets = recurring(names, flights, used_fits, diagnoses)
        recurring_names = frozenset(effect.name for effect in result)
        before, dropped = dropped, tuple(_needless(fitted, recurring_names) for fitted in fits)
        if dropped == before:
            break
    return result, sets, used_fits


def _needless(fitted: Mapping[str, Any], recurring_names: frozenset[str]) -> bool:
    """Return whether a flight fits about as well without its single effects."""

    def largest_likelihood(sets: Mapping[str, Any]) -> float:
        return max(
            (
                fit["log_likelihood"]
                for key, fit in sets.items()
                if frozenset(filter(None, key.split("+"))) <= recurring_names
            ),
            default=-np.inf,
        )

    if "sets_without" not in fitted:
        return False
    gain = largest_likelihood(fitted["sets"]) - largest_likelihood(fitted["sets_without"])
    return 2.0 * gain < NEEDED_CHI_SQUARE
