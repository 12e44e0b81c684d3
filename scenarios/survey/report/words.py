"""What a survey found, in sentences and rows that terminal, page and JSON share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ident.pooling import Trend
from ident.tracing.diagnosis import Verdict
from scenarios.survey.derivatives import TOLD, Derivative
from scenarios.survey.recurring import EQUAL, Recurring
from scenarios.survey.survey import Survey
from scenarios.terminal.display_units import shown_in, spaced
from scenarios.terminal.numbers import number

# Linear effects between the recorded input and the aircraft: exchanged with it, they act on all outputs alike.
AT_THE_INPUT = ("actuator-lag", "actuator-second-order", "input-delay", "input-recorded-late")
FORCES = ("CL_", "CD_", "CX_", "CY_", "CZ_")
FAR = 1e-99  # a chance below it is told as one
HAS, HAS_NOT, UNTOLD = "has it", "has it not", "not told"


def verdict_of(survey: Survey) -> tuple[str, str]:
    """A word or two, and the sentence after it."""
    kept = survey.grown.kept
    if not kept:
        return "NO FLIGHT", "no flight could be used"
    if survey.recurs:
        return "RECURS", "; ".join(effect_phrase(each) for each in survey.recurs)
    open_ones = survey.verdicts.get(Verdict.UNEXPLAINED.value, 0)
    besides = f"; {open_ones} of them {'are' if open_ones > 1 else 'is'} unexplained" if open_ones else ""
    return "NOTHING RECURS", f"no effect acts in two or more of {len(kept)} flights beyond chance{besides}"


def verdicts_phrase(survey: Survey) -> str:
    """``"by themselves 26 flights are traced, 11 ambiguous"``."""
    counts = [f"{count} {verdict}" for verdict, count in survey.verdicts.items()]
    return f"by themselves, flights are: {', '.join(counts)}" if counts else ""


def effect_phrase(each: Recurring) -> str:
    """``"vane-offset 3.00 +- 0.02 m in 40 of 40 flights"``."""
    values = values_of(each)
    told = f" {values[0].partition(' ')[2]}" if len(values) == 1 else f" ({', '.join(values)})" if len(values) == 2 else ""
    return f"{each.name}{told} in {len(each.has)} of {len(each.flights)} flights"


def values_of(each: Recurring) -> list[str]:
    """The common values with sigmas, in the units in which they are shown."""
    out = []
    sigmas = np.sqrt(np.diag(each.found.covariance))
    for (local, unit), value, sigma in zip(each.parameters.items(), each.found.value, sigmas, strict=True):
        factor, text = shown_in(unit, local)
        out.append(f"{local} {number(factor * value, factor * sigma)} +- {number(factor * sigma, factor * sigma)}{spaced(text)}")
    return out


def belongs_phrase(each: Recurring, survey: Survey) -> str:
    """Whose it is, and whether its value is one, or changes with a condition."""
    told = f"{len(each.has)} have it, {len(each.has_not)} have it not, {len(each.untold)} do not tell"
    whose = (
        f"it belongs to the aircraft: no flight excludes it ({told})" if each.found.belongs == "aircraft" else f"it acts in some flights only: {told}"
    )
    same = (
        "the values of all flights agree"
        if each.found.agrees
        else f"its values differ by {100 * each.found.scatter:.0f} % (one sigma) between flights"
    )
    changes = [f"{local} {change}" for local in each.parameters if (change := _effect_change(survey, each, local))]
    return "; ".join([whose, same, *changes])


def _effect_change(survey: Survey, each: Recurring, local: str) -> str:
    found = survey.effect_trends.get((each.name, local))
    if found is None:
        return ""
    factor, text = shown_in(each.parameters[local], local)
    return _change(*found, survey.condition_units.get(found[0], "1"), text, factor)


def rivals_phrase(each: Recurring) -> str:
    """What it was told from, and what not."""
    equal = [name for name, margin in each.rivals.items() if margin < EQUAL]
    told = {name: margin for name, margin in each.rivals.items() if margin >= EQUAL}
    out = []
    if equal:
        out.append(
            f"likelihood does not tell it from {' or '.join(equal)}: named by the derivatives, which it scatters less, or by the flights' diagnoses"
        )
    if told:
        least = f"by {min(told.values()):.3g} of twice the log likelihood{' at least' if len(told) > 1 else ''}"
        out.append(f"preferred to {' and '.join((', '.join(list(told)[:-1]), list(told)[-1])) if len(told) > 1 else next(iter(told))} {least}")
    if each.name in AT_THE_INPUT:
        out.append("the same filter or delay before all recorded outputs alike would do as well: a linear aircraft cannot tell the two apart")
    return "; ".join(out)


def drift_phrase(survey: Survey, each: Derivative) -> str:
    """``"Cm_alpha changes with mass by -3.0e-05 +- 1e-06 1/rad per kg"``; empty where it does not change."""
    drift = each.drifts
    if drift is None:
        return ""
    return f"{each.name} {_change(*drift, survey.condition_units.get(drift[0], '1'), each.unit)}"


def _change(condition: str, line: Trend, per: str, unit: str, factor: float = 1.0) -> str:
    """``"changes with mass by -3.0e-05 +- 1e-06 1/rad per kg"``."""
    own = "" if unit in ("", "1") else f" {unit}"
    slope, sigma = factor * line.slope, factor * line.slope_sigma
    return f"changes with {condition} by {slope:.3g} +- {sigma:.2g}{own} per {per if per != '1' else 'unit'}"


def drifts(survey: Survey) -> list[str]:
    """Every derivative that changes with a condition."""
    return [phrase for each in survey.derivatives if (phrase := drift_phrase(survey, each))]


def hints(survey: Survey) -> list[str]:
    """What a change with a condition may mean other than what it says."""
    forces = [each.name for each in survey.derivatives if each.drifts is not None and each.drifts[0] == "mass" and each.name.startswith(FORCES)]
    if not forces:
        return []
    change = "change" if len(forces) > 1 else "changes"
    return [f"{' and '.join(forces)} {change} with mass, which no force coefficient does by itself: check the masses that the flights were given"]


def outstanding(survey: Survey) -> list[tuple[str, str, float]]:
    """Flights that stand out: flight, derivative, standard deviations."""
    return [
        (flight, each.name, float(far))
        for each in survey.derivatives
        for flight, far, out in zip(each.flights, each.off, each.out, strict=True)
        if out
    ]


def news(survey: Survey) -> str:
    """What this survey computed, and what is new, failed or removed since the last one."""
    grown = survey.grown
    parts = [f"{len(grown.kept)} flights", f"{len(grown.computed)} computed now, {len(grown.kept) - len(grown.computed)} kept"]
    parts += [f"new: {listed(grown.new)}"] if grown.new else []
    parts += [f"{len(grown.failed)} failed: {listed(list(grown.failed))}"] if grown.failed else []
    parts += [f"removed since the last survey: {listed(grown.removed)}"] if grown.removed else []
    return "; ".join(parts)


def single_phrases(survey: Survey) -> list[str]:
    """Effects that flights claim and that do not recur."""
    out = [f"{effect} is claimed in {listed(flights)} and does not recur" for effect, flights in survey.alone.items()]
    return out + [f"{effect} is claimed in {listed(flights)}, where what recurs explains as much" for effect, flights in survey.needless.items()]


def fresh(survey: Survey) -> list[str]:
    """What is new: each flight by itself, and what it has of what recurs."""
    out = []
    for name in survey.grown.new:
        kept = survey.grown.kept[name]
        has = [each.name for each in survey.recurs if name in each.has]
        besides = f"; of what recurs it has {' and '.join(has)}" if has else "; it has nothing of what recurs" if survey.recurs else ""
        out.append(f"{kept['verdict']}, {name}: {kept['headline']}{besides}")
    return out


def listed(names: Sequence[str], most: int = 6) -> str:
    """Names with commas, those beyond ``most`` counted."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def state(each: Recurring, flight: str) -> str:
    """What is told of an effect in one flight."""
    if flight not in each.flights:
        return "–"
    return HAS if flight in each.has else HAS_NOT if flight in each.has_not else UNTOLD


def newest_first(survey: Survey) -> list[str]:
    """Names of the flights: new ones first, then by date, the last first, then in the order of the file from its end."""
    order = list(survey.grown.kept)
    fresh = set(survey.grown.new)
    return sorted(order, key=lambda name: (name in fresh, survey.grown.flights[name].date, order.index(name)), reverse=True)


def effect_rows(survey: Survey) -> tuple[list[str], list[list[str]]]:
    """What recurs."""
    rows = []
    for each in survey.recurs:
        whose = "the aircraft" if each.found.belongs == "aircraft" else "some flights"
        chance = f"{each.found.p_value:.1g}" if each.found.p_value > FAR else f"<{FAR:.0e}"
        counts = [str(len(each.has)), str(len(each.has_not)), str(len(each.untold)), str(len(each.named))]
        rows.append([each.name, "; ".join(values_of(each)), whose, *counts, "yes" if each.found.agrees else "no", chance])
    return ["effect", "common value", "belongs to", "have it", "have it not", "not told", "named alone", "one value", "chance"], rows


def derivative_rows(survey: Survey) -> tuple[list[str], list[list[str]]]:
    """Derivatives over the flights."""
    rows = []
    for each in survey.derivatives:
        common = each.common
        drift = drift_phrase(survey, each).partition(" changes ")[2] or "–"
        differs = "yes" if each.differs < TOLD else "no"
        sigma = number(common.sigma, common.sigma)
        rows.append([each.name, each.unit or "1", number(common.value, common.sigma), sigma, f"{common.scatter:.2g}", differs, drift])
    return ["derivative", "unit", "common value", "+- sigma", "scatter between flights", "differs", "changes"], rows


def flight_rows(survey: Survey) -> tuple[list[str], list[list[str]]]:
    """Flights, the newest first; columns in which no flight has anything are left out."""
    rows = []
    for name in newest_first(survey):
        flight, kept = survey.grown.flights[name], survey.grown.kept[name]
        effects = [state(each, name) for each in survey.recurs]
        alone = [effect for effect, flights in survey.alone.items() if name in flights]
        since = "new" if name in survey.grown.new else ""
        rows.append([name, since, flight.date or "–", flight.tail or "–", kept["verdict"], *effects, ", ".join(alone) or "–", kinematics(kept)])
    names = ["flight", "since", "date", "tail", "verdict", *(each.name for each in survey.recurs), "alone", "kinematics"]
    told = [at for at, name in enumerate(names) if name in ("flight", "verdict", "kinematics") or any(row[at] not in ("", "–") for row in rows)]
    return [names[at] for at in told], [[row[at] for at in told] for row in rows]


def kinematics(kept: Mapping[str, Any]) -> str:
    """What stands of a flight's sensors by kinematics alone: the first, and how many would do as well or stand beside it."""
    if not kept["check"]["done"]:
        return "not possible"
    first, *others = kept["check"]["findings"] or ["nothing stands"]
    return f"{first}, {len(others)} more" if others else str(first)
