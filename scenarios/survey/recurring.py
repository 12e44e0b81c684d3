"""Effects that recur over flights, and derivatives of all flights given them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.pooling import (
    Evidence,
    Pooled,
    Recurrence,
    Trend,
    adjusted_p_values,
    conditioned,
    outlying_flights,
    pooled,
    recurrence,
    trend,
    without_one,
)

# ---- Which effects may recur

# flights with an effect as claim or alternative that make it a candidate
FEWEST_NAMED = 2
MOST_EFFECTS = 5  # effects that are tried together: 32 sets a flight

DiagnosesByFlight = Mapping[str, Mapping[str, Any]]


def candidates(diagnoses: DiagnosesByFlight) -> tuple[str, ...]:
    """Return the effects that may recur, the most often named first: claimed somewhere, and named
    in two flights at least.
    """
    claimed: Counter[str] = Counter()
    named: Counter[str] = Counter()
    for flight in diagnoses.values():
        names = {
            name for each in flight["effects"] for name in (each["name"], *each["alternatives"])
        }
        named.update(names)
        claimed.update(
            {
                name
                for each in flight["effects"]
                if each["claimed"]
                for name in (each["name"], *each["alternatives"])
            }
        )
    # Flights may name one effect differently: alternatives are tried as rivals.
    wanted = [
        name
        for name in named
        if named[name] >= FEWEST_NAMED and claimed[name] and not is_of_flight(name)
    ]
    return tuple(
        sorted(wanted, key=lambda name: (-claimed[name], -named[name], name))[:MOST_EFFECTS]
    )


def is_of_flight(name: str) -> bool:
    """Return whether an effect concerns single flights only: an event, a drift, rough air."""
    from sim.effects.library import library

    traits = {effect.name: effect.traits for effect in library() if hasattr(effect, "traits")}
    mine = traits.get(name)
    return mine is not None and (
        mine.per_record or bool(mine.onset) or mine.background or bool(mine.wrong_samples_of)
    )


def effects_of_one_flight(
    flight: Mapping[str, Any], shared: Sequence[str]
) -> dict[str, dict[str, float]]:
    """Effects that a flight claims and that are its own, with their values by full name."""
    rivals = {
        name
        for each in flight["effects"]
        if each["name"] in shared
        for name in each["alternatives"]
    }
    mine = [
        e
        for e in flight["effects"]
        if e["claimed"] and e["name"] not in shared and e["name"] not in rivals
    ]
    return {
        e["name"]: {f"{e['name']}.{local}": q["value"] for local, q in e["parameters"].items()}
        for e in mine
    }


def starts_of(diagnoses: DiagnosesByFlight, names: Sequence[str]) -> dict[str, float]:
    """Starting values of each effect's parameters: the median over the flights that name it."""
    seen: dict[str, list[float]] = {}
    for flight in diagnoses.values():
        for each in flight["effects"]:
            if each["name"] in names:
                for local, q in each["parameters"].items():
                    seen.setdefault(f"{each['name']}.{local}", []).append(q["value"])
    return {name: float(np.median(values)) for name, values in seen.items()}


# ---- Which effects recur: judged over all flights together

# effects that a search may name, for which the chance of a false recurrence is counted
LIBRARY_SIZE = 60
EQUAL_CHI_SQUARE = 3.0  # twice the log likelihood, as in a diagnosis: below it two names are equal
CLEAR_CHI_SQUARE = 10.0  # least gain; chosen, as for an effect in a diagnosis
PRESENT_PROBABILITY = 0.5  # probability from which an effect belongs to a flight's model


@dataclass(frozen=True)
class Recurring:
    """An effect that recurs.

    ``parameters`` with units, in the order of ``found.value``; ``flights`` in the order of
    ``found.probability``. ``rivals``: by how much twice the log likelihood of all flights prefers
    it to each. ``named``: flights that claimed it by themselves.
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
        return tuple(
            name for name, there in zip(self.flights, self.recurrence.has, strict=True) if there
        )

    @property
    def has_not(self) -> tuple[str, ...]:
        return tuple(
            name for name, there in zip(self.flights, self.recurrence.has_not, strict=True) if there
        )

    @property
    def untold(self) -> tuple[str, ...]:
        return tuple(
            name for name in self.flights if name not in self.has and name not in self.has_not
        )


def evidence_of(
    fits: Sequence[Mapping[str, Any]], name: str, beside: Sequence[frozenset[str]]
) -> tuple[Evidence, np.ndarray]:
    """Return parameters of effects that differ between flights, with their clearest trend."""
    gain: list[float] = []
    value: list[np.ndarray] = []
    covariance: list[np.ndarray] = []
    able: list[bool] = []
    size = max(
        (len(each["effects"][name]["parameters"]) for each in fits if name in each["effects"]),
        default=1,
    )
    for each, others in zip(fits, beside, strict=True):
        without, with_it = (
            each["sets"].get("+".join(sorted(taken)))
            for taken in (others - {name}, others | {name})
        )
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
    return Evidence(np.array(gain), np.array(value), np.array(covariance)), np.array(
        able, dtype=bool
    )


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
    taken: list[str] = []
    sets = [frozenset[str]() for _ in fits]
    while len(taken) < len(names):
        pooled = {
            name: recurrence_of_effect(fits, name, sets) for name in names if name not in taken
        }
        tried = {name: each for name, each in pooled.items() if each is not None and each.recurs}
        if not tried:
            break
        best = max(tried, key=lambda name: tried[name].log_likelihood)
        taken.append(best)
        sets = assigned(fits, taken, sets)
        for name in list(taken):
            again = recurrence_of_effect(fits, name, sets)
            if again is None or not again.recurs:
                taken.remove(name)
                sets = [each - {name} for each in sets]
        if best not in taken:
            break
    for name in list(taken):
        better = _preferred(
            name, [rival for rival in names if rival not in taken], fits, sets, diagnoses
        )
        if better != name:
            taken[taken.index(name)] = better
            sets = assigned(fits, taken, [each - {name} for each in sets])
    return [
        _recurring_of(name, names, taken, flights, fits, sets, diagnoses) for name in taken
    ], sets


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
    bare = [each - {name} for each in sets]
    result = {one: recurrence_of_effect(fits, one, bare) for one in (name, *rivals)}
    likely = {
        one: 2.0 * each.log_likelihood
        for one, each in result.items()
        if each is not None and each.recurs
    }
    if not likely:
        return name
    equal = [one for one, each in likely.items() if each > max(likely.values()) - EQUAL_CHI_SQUARE]
    if len(equal) == 1:
        return equal[0]
    differ = {
        one: _differences(
            fits,
            [each | {one} if name in mine else each for each, mine in zip(bare, sets, strict=True)],
        )
        for one in equal
    }
    steady = [one for one in equal if differ[one] < min(differ.values()) + CLEAR_CHI_SQUARE]
    claims = Counter(
        e["name"] for flight in diagnoses.values() for e in flight["effects"] if e["claimed"]
    )
    return max(steady, key=lambda one: (claims[one], one == name, one))


def _differences(fits: Sequence[Mapping[str, Any]], sets: Sequence[frozenset[str]]) -> float:
    """Return the difference of the derivatives of all flights from common values: the sum of
    Cochran's statistics.
    """
    seen: dict[str, list[tuple[float, float]]] = {}
    for each, taken in zip(fits, sets, strict=True):
        fitted = each["sets"].get("+".join(sorted(taken)))
        if fitted is not None:
            sigmas = np.sqrt(np.diag(fitted["covariance"]))
            for name, value, sigma in zip(
                each["declared"], fitted["estimate"], sigmas, strict=False
            ):
                seen.setdefault(name, []).append((value, float(sigma)))
    return sum(pooled(*np.array(values).T).q for values in seen.values() if len(values) > 1)


def recurrence_of_effect(
    fits: Sequence[Mapping[str, Any]], name: str, sets: Sequence[frozenset[str]]
) -> Recurrence | None:
    """Pool an effect over the flights that can be used; None with fewer than two."""
    evidence, able = evidence_of(fits, name, sets)
    if able.sum() < 2:
        return None
    result = recurrence(evidence.of(np.flatnonzero(able)), LIBRARY_SIZE)
    if able.all():
        return result
    probability = np.full(len(able), result.share)
    probability[able] = result.probability
    at_common = np.zeros(len(able))
    at_common[able] = result.at_common
    return Recurrence(**{**vars(result), "probability": probability, "at_common": at_common})


def assigned(
    fits: Sequence[Mapping[str, Any]], taken: Sequence[str], sets: Sequence[frozenset[str]]
) -> list[frozenset[str]]:
    """Effects of each flight that are more likely present than not, iterated until none changes."""
    now = list(sets)
    for _ in range(4):
        before = list(now)
        for name in taken:
            result = recurrence_of_effect(fits, name, now)
            if result is not None:
                now = [
                    each | {name} if p > PRESENT_PROBABILITY else each - {name}
                    for each, p in zip(now, result.probability, strict=True)
                ]
        if now == before:
            break
    return now


def _recurring_of(
    name: str,
    names: Sequence[str],
    taken: Sequence[str],
    flights: Sequence[str],
    fits: Sequence[Mapping[str, Any]],
    sets: Sequence[frozenset[str]],
    diagnoses: DiagnosesByFlight,
) -> Recurring:
    result = recurrence_of_effect(fits, name, sets)
    assert result is not None
    evidence, _ = evidence_of(fits, name, sets)
    effect_content = next(each["effects"][name] for each in fits if name in each["effects"])
    margins = {}
    for rival in names:
        if rival not in taken:
            other = recurrence_of_effect(fits, rival, [each - {name} for each in sets])
            margins[rival] = 2.0 * (
                result.log_likelihood - (other.log_likelihood if other is not None else 0.0)
            )
    by_itself = tuple(
        one
        for one in flights
        if any(e["claimed"] and e["name"] == name for e in diagnoses[one]["effects"])
    )
    sigmas = np.sqrt(np.einsum("nii->ni", evidence.covariance))
    return Recurring(
        name,
        {local: effect_content["units"][local] for local in effect_content["parameters"]},
        tuple(flights),
        result,
        evidence.value,
        sigmas,
        margins,
        by_itself,
    )


# ---- Recurring effects in addition to those of single flights

# twice the log likelihood, of a flight's own effect beside those that recur. chosen, as in a
# diagnosis
NEEDED_CHI_SQUARE = 10.0
MOST_ROUNDS = 4  # repetitions of the search; usually fewer


def recurring_with_other_effects(
    names: Sequence[str],
    flights: Sequence[str],
    fits: Sequence[Mapping[str, Any]],
    diagnoses: DiagnosesByFlight,
) -> tuple[list[Recurring], list[frozenset[str]], list[Mapping[str, Any]]]:
    """Find recurring effects as ``recurring``, and drop unnecessary effects of single flights.

    A flight alone may claim one effect instead of two recurring ones. Its own effects are dropped
    if the recurring ones fit it about as well; then the search is repeated. Also returns the fits
    of each flight.
    """
    left = (False,) * len(fits)
    for _ in range(MOST_ROUNDS):
        now = [
            {**each, "sets": each["sets_without"]} if without else each
            for each, without in zip(fits, left, strict=True)
        ]
        result, sets = recurring(names, flights, now, diagnoses)
        taken = frozenset(each.name for each in result)
        before, left = left, tuple(_needless(each, taken) for each in fits)
        if left == before:
            break
    return result, sets, now


def _needless(fitted: Mapping[str, Any], taken: frozenset[str]) -> bool:
    """Return whether a flight's own effects are unnecessary in addition to ``taken``."""

    def most(sets: Mapping[str, Any]) -> float:
        return max(
            (
                each["log_likelihood"]
                for key, each in sets.items()
                if frozenset(filter(None, key.split("+"))) <= taken
            ),
            default=-np.inf,
        )

    return (
        "sets_without" in fitted
        and 2.0 * (most(fitted["sets"]) - most(fitted["sets_without"])) < NEEDED_CHI_SQUARE
    )


# ---- Derivatives of all flights

# rate of false discoveries among the trends, and among the derivatives said to differ
FALSE_DISCOVERY_RATE = 0.05
UNDETERMINED_SIGMA_RATIO = (
    1e6  # sigma over value above which a flight does not determine a derivative
)


@dataclass(frozen=True, eq=False)
class Derivative:
    """One derivative over the flights.

    Attributes
    ----------
    values, sigmas : ``(n,)`` of ``flights``.
    differs : false discovery rate at which the value is not constant.
    trends : by condition, with their false discovery rates.
    off : ``(n,)``, distance from line or common value in sigmas.
    out : outlying flights.
    """

    name: str
    unit: str
    flights: tuple[str, ...]
    values: np.ndarray
    sigmas: np.ndarray
    common: Pooled
    differs: float
    trends: Mapping[str, tuple[Trend, float]]
    off: np.ndarray
    out: np.ndarray

    @property
    def drifts(self) -> tuple[str, Trend] | None:
        """The condition with which it changes most surely, where one does."""
        significant = {
            name: (line, q) for name, (line, q) in self.trends.items() if q < FALSE_DISCOVERY_RATE
        }
        if not significant:
            return None
        best = min(significant, key=lambda name: (significant[name][0].p_value, name))
        return best, significant[best][0]


def estimates(
    flights: Sequence[str],
    fits: Sequence[Mapping[str, Any]],
    recurring_effects: Sequence[Recurring],
    sets: Sequence[frozenset[str]],
) -> list[dict[str, tuple[float, float]]]:
    """Return the derivatives of each flight, with shared values estimated from all flights."""
    out: list[dict[str, tuple[float, float]]] = []
    shared = {each.name: each for each in recurring_effects if each.recurrence.agrees}
    for number, (each, taken) in enumerate(zip(fits, sets, strict=True)):
        fitted = each["sets"].get("+".join(sorted(taken)))
        if fitted is None:
            out.append({})
            continue
        value, covariance = np.array(fitted["estimate"]), np.array(fitted["covariance"])
        covariance_own = covariance
        for name in sorted(taken & set(shared)):
            one = shared[name]
            at = np.array([fitted["names"].index(full) for full in each["effects"][name]["full"]])
            # as it weighs in the common value
            own = covariance_own[np.ix_(at, at)] / one.recurrence.probability[number]
            others = without_one(
                one.recurrence.value, one.recurrence.covariance, one.values[number], own
            )
            if others is not None:
                value, covariance = conditioned(value, covariance, at, *others)
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        out.append(
            {
                n: (float(v), float(s))
                for n, v, s in zip(each["declared"], value, sigma, strict=False)
                if 0 < s < UNDETERMINED_SIGMA_RATIO * max(abs(v), 1e-12)
            }
        )
    return out


def effects_over(
    recurring_effects: Sequence[Recurring], conditions: Mapping[str, Mapping[str, float]]
) -> dict[tuple[str, str], tuple[str, Trend]]:
    """Return parameters of effects that differ between flights, with the most significant trend."""
    trends_found: list[tuple[tuple[str, str], str, Trend]] = []
    for each in recurring_effects:
        if each.recurrence.agrees:
            continue
        for condition, by_flight in conditions.items():
            at = [
                number
                for number, name in enumerate(each.flights)
                if name in each.has and name in by_flight
            ]
            where = np.array([by_flight[each.flights[number]] for number in at])
            for place, local in enumerate(each.parameters):
                line = trend(each.values[at, place], each.sigmas[at, place], where)
                if line is not None:
                    trends_found.append(((each.name, local), condition, line))
    rates = adjusted_p_values(np.array([line.p_value for *_, line in trends_found]))
    out: dict[tuple[str, str], tuple[str, Trend]] = {}
    for (key, condition, line), rate in zip(trends_found, rates, strict=True):
        if rate < FALSE_DISCOVERY_RATE and (key not in out or line.p_value < out[key][1].p_value):
            out[key] = condition, line
    return out


def over_flights(
    flights: Sequence[str],
    told: Sequence[Mapping[str, tuple[float, float]]],
    conditions: Mapping[str, Mapping[str, float]],
    units: Mapping[str, str],
) -> list[Derivative]:
    """Each derivative over all flights; ``conditions`` by name and flight."""
    names = list(dict.fromkeys(name for each in told for name in each))
    made = []
    for name in names:
        has = [number for number, each in enumerate(told) if name in each]
        values, sigmas = (
            np.array([told[number][name][which] for number in has]) for which in (0, 1)
        )
        lines: dict[str, Trend] = {}
        for condition, by_flight in conditions.items():
            at = [place for place, number in enumerate(has) if flights[number] in by_flight]
            line = trend(
                values[at], sigmas[at], np.array([by_flight[flights[has[place]]] for place in at])
            )
            if line is not None:
                lines[condition] = line
        made.append(
            (
                name,
                tuple(flights[number] for number in has),
                values,
                sigmas,
                pooled(values, sigmas),
                lines,
            )
        )
    rates = iter(
        adjusted_p_values(np.array([line.p_value for *_, lines in made for line in lines.values()]))
    )
    differ = adjusted_p_values(np.array([common.p_same for *_, common, _ in made]))
    out = []
    for (name, here, values, sigmas, common, lines), rate in zip(made, differ, strict=True):
        trends = {condition: (line, float(next(rates))) for condition, line in lines.items()}
        derivative = Derivative(
            name,
            units.get(name, ""),
            here,
            values,
            sigmas,
            common,
            float(rate),
            trends,
            np.zeros(len(here)),
            np.zeros(len(here), dtype=bool),
        )
        drift = derivative.drifts
        left = values - common.value
        if drift is not None:
            left = (
                values
                - drift[1].band(
                    np.array([conditions[drift[0]].get(one, drift[1].middle) for one in here])
                )[0]
            )
        off, stands = outlying_flights(left, sigmas)
        out.append(Derivative(**{**vars(derivative), "off": off, "out": stands}))
    return out
