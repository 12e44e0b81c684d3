"""Derivatives of all flights, with what recurs known from the others: common values, trends over the flight condition, flights that stand out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ident.pooling import Pooled, Trend, adjusted, conditioned, pooled, standing_out, trend, without_one
from scenarios.survey.recurring import Recurring

TOLD = 0.05  # rate of false discoveries among the trends, and among the derivatives said to differ
UNDETERMINED = 1e6  # sigma over the value, from which a flight says nothing of it


@dataclass(frozen=True, eq=False)
class Derivative:
    """One derivative over the flights.

    ``values``, ``sigmas (n,)`` of ``flights``. ``differs``: rate of false discoveries at which it has not one value. ``trends`` by condition with the
    rate at which each is told. ``off (n,)``: standard deviations from the line or the common value, ``out`` those that stand out.
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
        told = {name: (line, q) for name, (line, q) in self.trends.items() if q < TOLD}
        if not told:
            return None
        best = min(told, key=lambda name: (told[name][0].p_value, name))
        return best, told[best][0]


def estimates(
    flights: Sequence[str], fits: Sequence[Mapping[str, Any]], found: Sequence[Recurring], sets: Sequence[frozenset[str]]
) -> list[dict[str, tuple[float, float]]]:
    """Derivatives of each flight with sigmas, once the other flights have told the values that are shared."""
    out: list[dict[str, tuple[float, float]]] = []
    shared = {each.name: each for each in found if each.found.agrees}
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
            own = covariance_own[np.ix_(at, at)] / one.found.probability[number]  # as it weighs in the common value
            others = without_one(one.found.value, one.found.covariance, one.values[number], own)
            if others is not None:
                value, covariance = conditioned(value, covariance, at, *others)
        sigma = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        out.append(
            {n: (float(v), float(s)) for n, v, s in zip(each["declared"], value, sigma, strict=False) if 0 < s < UNDETERMINED * max(abs(v), 1e-12)}
        )
    return out


def effects_over(found: Sequence[Recurring], conditions: Mapping[str, Mapping[str, float]]) -> dict[tuple[str, str], tuple[str, Trend]]:
    """Parameters of effects whose values differ between flights, by effect and name, with the condition with which each changes most surely."""
    asked: list[tuple[tuple[str, str], str, Trend]] = []
    for each in found:
        if each.found.agrees:
            continue
        for condition, by_flight in conditions.items():
            at = [number for number, name in enumerate(each.flights) if name in each.has and name in by_flight]
            where = np.array([by_flight[each.flights[number]] for number in at])
            for place, local in enumerate(each.parameters):
                line = trend(each.values[at, place], each.sigmas[at, place], where)
                if line is not None:
                    asked.append(((each.name, local), condition, line))
    rates = adjusted(np.array([line.p_value for *_, line in asked]))
    out: dict[tuple[str, str], tuple[str, Trend]] = {}
    for (key, condition, line), rate in zip(asked, rates, strict=True):
        if rate < TOLD and (key not in out or line.p_value < out[key][1].p_value):
            out[key] = condition, line
    return out


def over_flights(
    flights: Sequence[str], told: Sequence[Mapping[str, tuple[float, float]]], conditions: Mapping[str, Mapping[str, float]], units: Mapping[str, str]
) -> list[Derivative]:
    """Each derivative over all flights; ``conditions`` by name and flight."""
    names = list(dict.fromkeys(name for each in told for name in each))
    made = []
    for name in names:
        has = [number for number, each in enumerate(told) if name in each]
        values, sigmas = (np.array([told[number][name][which] for number in has]) for which in (0, 1))
        lines: dict[str, Trend] = {}
        for condition, by_flight in conditions.items():
            at = [place for place, number in enumerate(has) if flights[number] in by_flight]
            line = trend(values[at], sigmas[at], np.array([by_flight[flights[has[place]]] for place in at]))
            if line is not None:
                lines[condition] = line
        made.append((name, tuple(flights[number] for number in has), values, sigmas, pooled(values, sigmas), lines))
    rates = iter(adjusted(np.array([line.p_value for *_, lines in made for line in lines.values()])))
    differ = adjusted(np.array([common.p_same for *_, common, _ in made]))
    out = []
    for (name, here, values, sigmas, common, lines), rate in zip(made, differ, strict=True):
        trends = {condition: (line, float(next(rates))) for condition, line in lines.items()}
        plain = Derivative(
            name, units.get(name, ""), here, values, sigmas, common, float(rate), trends, np.zeros(len(here)), np.zeros(len(here), dtype=bool)
        )
        drift = plain.drifts
        left = values - common.value
        if drift is not None:
            left = values - drift[1].band(np.array([conditions[drift[0]].get(one, drift[1].middle) for one in here]))[0]
        off, stands = standing_out(left, sigmas)
        out.append(Derivative(**{**vars(plain), "off": off, "out": stands}))
    return out
