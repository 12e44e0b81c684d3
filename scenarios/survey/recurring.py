"""Which effects recur: judged over all flights together."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.pooling import Evidence, Recurrence, pooled, recurrence
from scenarios.survey.candidates import Kept

LIBRARY = 60  # effects that a search may name, for which the chance of a false recurrence is counted
EQUAL = 3.0  # twice the log likelihood, as in a diagnosis: below it two names are equal
CLEARLY = 10.0  # of that sum. chosen, as what an addition has to bring in a diagnosis
PRESENT = 0.5  # probability from which an effect belongs to a flight's model


@dataclass(frozen=True)
class Recurring:
    """An effect that recurs.

    ``parameters`` with units, in the order of ``found.value``; ``flights`` in the order of ``found.probability``. ``rivals``: by how much twice the
    log likelihood of all flights prefers it to each. ``named``: flights that claimed it by themselves.
    """

    name: str
    parameters: Mapping[str, str]
    flights: tuple[str, ...]
    found: Recurrence
    values: np.ndarray
    sigmas: np.ndarray
    rivals: Mapping[str, float]
    named: tuple[str, ...]

    @property
    def has(self) -> tuple[str, ...]:
        return tuple(name for name, there in zip(self.flights, self.found.has, strict=True) if there)

    @property
    def has_not(self) -> tuple[str, ...]:
        return tuple(name for name, there in zip(self.flights, self.found.has_not, strict=True) if there)

    @property
    def untold(self) -> tuple[str, ...]:
        return tuple(name for name in self.flights if name not in self.has and name not in self.has_not)


def evidence_of(fits: Sequence[Mapping[str, Any]], name: str, beside: Sequence[frozenset[str]]) -> tuple[Evidence, np.ndarray]:
    """What each flight says of an effect added to the sets ``beside``, and which flights can say anything ``(n,)``."""
    gain: list[float] = []
    value: list[np.ndarray] = []
    covariance: list[np.ndarray] = []
    able: list[bool] = []
    size = max((len(each["effects"][name]["parameters"]) for each in fits if name in each["effects"]), default=1)
    for each, others in zip(fits, beside, strict=True):
        without, with_it = (each["sets"].get("+".join(sorted(taken))) for taken in (others - {name}, others | {name}))
        sound = without is not None and with_it is not None and name in each["effects"]
        able.append(sound)
        if not sound:
            gain.append(0.0)
            value.append(np.zeros(size))
            covariance.append(np.eye(size))
            continue
        assert without is not None
        assert with_it is not None
        at = [with_it["names"].index(full) for full in each["effects"][name]["full"]]
        gain.append(max(0.0, with_it["log_likelihood"] - without["log_likelihood"]))
        value.append(np.array(with_it["estimate"])[at])
        covariance.append(np.array(with_it["covariance"])[np.ix_(at, at)])
    return Evidence(np.array(gain), np.array(value), np.array(covariance)), np.array(able, dtype=bool)


def recurring(
    names: Sequence[str], flights: Sequence[str], fits: Sequence[Mapping[str, Any]], kept: Kept
) -> tuple[list[Recurring], list[frozenset[str]]]:
    """The effects that recur, the strongest first, and of each flight those that it has.

    Forward selection over effects: the one whose recurrence gains most likelihood is added, each flight then has it where that is likelier than not;
    then each that was taken is asked again beside the others, and gives way to a rival that all flights together prefer in its place.
    """
    taken: list[str] = []
    sets = [frozenset[str]() for _ in fits]
    while len(taken) < len(names):
        asked = {name: judged(fits, name, sets) for name in names if name not in taken}
        tried = {name: each for name, each in asked.items() if each is not None and each.recurs}
        if not tried:
            break
        best = max(tried, key=lambda name: tried[name].log_likelihood)
        taken.append(best)
        sets = assigned(fits, taken, sets)
        for name in list(taken):
            again = judged(fits, name, sets)
            if again is None or not again.recurs:
                taken.remove(name)
                sets = [each - {name} for each in sets]
        if best not in taken:
            break
    for name in list(taken):
        better = _preferred(name, [rival for rival in names if rival not in taken], fits, sets, kept)
        if better != name:
            taken[taken.index(name)] = better
            sets = assigned(fits, taken, [each - {name} for each in sets])
    return [_told(name, names, taken, flights, fits, sets, kept) for name in taken], sets


def _preferred(name: str, rivals: Sequence[str], fits: Sequence[Mapping[str, Any]], sets: Sequence[frozenset[str]], kept: Kept) -> str:
    """An effect, or the rival that all flights together prefer in its place.

    Names that are equal in likelihood are told apart by what they make of the derivatives: one aircraft has one value, the wrong name scatters
    it over the conditions; where that says nothing either, by the flights' own diagnoses, which know the declared derivatives.
    """
    bare = [each - {name} for each in sets]
    found = {one: judged(fits, one, bare) for one in (name, *rivals)}
    likely = {one: 2.0 * each.log_likelihood for one, each in found.items() if each is not None and each.recurs}
    if not likely:
        return name
    equal = [one for one, each in likely.items() if each > max(likely.values()) - EQUAL]
    if len(equal) == 1:
        return equal[0]
    differ = {one: _differences(fits, [each | {one} if name in mine else each for each, mine in zip(bare, sets, strict=True)]) for one in equal}
    steady = [one for one in equal if differ[one] < min(differ.values()) + CLEARLY]
    claims = Counter(e["name"] for flight in kept.values() for e in flight["effects"] if e["claimed"])
    return max(steady, key=lambda one: (claims[one], one == name, one))


def _differences(fits: Sequence[Mapping[str, Any]], sets: Sequence[frozenset[str]]) -> float:
    """By how much the derivatives of all flights differ from one value each: Cochran's statistic, summed."""
    seen: dict[str, list[tuple[float, float]]] = {}
    for each, taken in zip(fits, sets, strict=True):
        fitted = each["sets"].get("+".join(sorted(taken)))
        if fitted is not None:
            sigmas = np.sqrt(np.diag(fitted["covariance"]))
            for name, value, sigma in zip(each["declared"], fitted["estimate"], sigmas, strict=False):
                seen.setdefault(name, []).append((value, float(sigma)))
    return sum(pooled(*np.array(values).T).q for values in seen.values() if len(values) > 1)


def judged(fits: Sequence[Mapping[str, Any]], name: str, sets: Sequence[frozenset[str]]) -> Recurrence | None:
    """An effect over the flights that can tell it; None with fewer than two."""
    evidence, able = evidence_of(fits, name, sets)
    if able.sum() < 2:
        return None
    found = recurrence(evidence.of(np.flatnonzero(able)), LIBRARY)
    if able.all():
        return found
    probability = np.full(len(able), found.share)
    probability[able] = found.probability
    at_common = np.zeros(len(able))
    at_common[able] = found.at_common
    return Recurrence(**{**vars(found), "probability": probability, "at_common": at_common})


def assigned(fits: Sequence[Mapping[str, Any]], taken: Sequence[str], sets: Sequence[frozenset[str]]) -> list[frozenset[str]]:
    """Of each flight the effects that it is likelier to have than not, asked in turn until none changes."""
    now = list(sets)
    for _ in range(4):
        before = list(now)
        for name in taken:
            found = judged(fits, name, now)
            if found is not None:
                now = [each | {name} if p > PRESENT else each - {name} for each, p in zip(now, found.probability, strict=True)]
        if now == before:
            break
    return now


def _told(
    name: str,
    names: Sequence[str],
    taken: Sequence[str],
    flights: Sequence[str],
    fits: Sequence[Mapping[str, Any]],
    sets: Sequence[frozenset[str]],
    kept: Kept,
) -> Recurring:
    found = judged(fits, name, sets)
    assert found is not None
    evidence, _ = evidence_of(fits, name, sets)
    told = next(each["effects"][name] for each in fits if name in each["effects"])
    margins = {}
    for rival in names:
        if rival not in taken:
            other = judged(fits, rival, [each - {name} for each in sets])
            margins[rival] = 2.0 * (found.log_likelihood - (other.log_likelihood if other is not None else 0.0))
    by_itself = tuple(one for one in flights if any(e["claimed"] and e["name"] == name for e in kept[one]["effects"]))
    sigmas = np.sqrt(np.einsum("nii->ni", evidence.covariance))
    return Recurring(
        name, {local: told["units"][local] for local in told["parameters"]}, tuple(flights), found, evidence.value, sigmas, margins, by_itself
    )
