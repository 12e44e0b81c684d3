"""Findings of a survey in sentences, in survey.json and in the terminal."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from ident.pooling import Trend
from ident.tracing.diagnosis import Verdict
from scenarios.files.sources import versions
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    SIGMAS,
    Cell,
    Column,
    Link,
    Number,
    Table,
    formatted,
    table,
)
from scenarios.report.quantities import number_text, shown_in, spaced
from scenarios.report.summary import BELOW, WIDTH, Summary, summary_lines, wrapped
from scenarios.report.terminal import table_as_lines
from scenarios.survey.flights import FOLDER
from scenarios.survey.growing import GROWING_SCHEMA
from scenarios.survey.recurring import EQUAL_CHI_SQUARE, LIBRARY_SIZE, Recurring
from scenarios.survey.survey import FALSE_DISCOVERY_RATE, Derivative, SurveyResult

# ---- Sentences and tables for terminal, page and JSON

# Linear effects between the recorded input and the aircraft. In a linear model they are equivalent
# to the same effect in all outputs.
AT_THE_INPUT = ("actuator-lag", "actuator-second-order", "input-delay", "input-recorded-late")
FORCES = ("CL_", "CD_", "CX_", "CY_", "CZ_")
LEAST_P_VALUE = 1e-9  # smaller probabilities are not exact, and are reported as below this
HAS, HAS_NOT, UNDECIDED = "has it", "does not have it", "undecided"


def verdict_of(survey: SurveyResult) -> tuple[str, str]:
    """Return the verdict in one or two words, and the sentence after it."""
    diagnoses = survey.survey_files.diagnoses
    if not diagnoses:
        return "NO FLIGHT", "no flight could be used"
    if survey.recurs:
        return "RECURS", "; ".join(map(effect_phrase, survey.recurs))
    sentence = f"no effect acts in two or more of {len(diagnoses)} flights beyond chance"
    unexplained = survey.verdicts.get(Verdict.UNEXPLAINED.value, 0)
    if unexplained:
        sentence += f"; {unexplained} of them {'are' if unexplained > 1 else 'is'} unexplained"
    return "NOTHING RECURS", sentence


def verdicts_phrase(survey: SurveyResult) -> str:
    """``"each flight diagnosed alone: 26 traced, 11 ambiguous"``."""
    counts = [f"{count} {verdict}" for verdict, count in survey.verdicts.items()]
    return f"each flight diagnosed alone: {', '.join(counts)}" if counts else ""


def effect_phrase(effect: Recurring) -> str:
    """``"vane-offset 3.00 +- 0.02 m in 40 of 40 flights"``."""
    values, text = values_of(effect), ""
    if len(values) == 1:
        text = f" {values[0].partition(' ')[2]}"  # without the name of the only parameter
    elif len(values) == 2:
        text = f" ({', '.join(values)})"
    return f"{effect.name}{text} in {len(effect.has)} of {len(effect.flights)} flights"


def values_of(effect: Recurring) -> list[str]:
    """Return the common values of the parameters with their sigmas, in display units."""
    texts = []
    sigmas = np.sqrt(np.diag(effect.recurrence.covariance))
    for (local, unit), value, sigma in zip(
        effect.parameters.items(), effect.recurrence.value, sigmas, strict=True
    ):
        factor, text = shown_in(unit, local)
        texts.append(
            f"{local} {number_text(factor * value, factor * sigma)} +- "
            f"{number_text(factor * sigma, factor * sigma)}{spaced(text)}"
        )
    return texts


def belongs_phrase(effect: Recurring, survey: SurveyResult) -> str:
    """Return the flights in which an effect is present, and whether its value is constant or
    changes with a condition.
    """
    counts = (
        f"{len(effect.has)} have it, {len(effect.has_not)} do not, "
        f"{len(effect.undecided)} are undecided"
    )
    where = f"it acts in some flights only: {counts}"
    if effect.recurrence.belongs == "aircraft":
        where = f"it belongs to the aircraft: no flight excludes it ({counts})"
    scatter = "the values of all flights agree"
    if not effect.recurrence.agrees:
        percent = f"{100 * effect.recurrence.scatter:.0f} %"
        scatter = f"its values differ by {percent} (one sigma) between flights"
    changes = [
        f"{local} {change}"
        for local in effect.parameters
        if (change := _effect_change(survey, effect, local))
    ]
    return "; ".join([where, scatter, *changes])


def _effect_change(survey: SurveyResult, effect: Recurring, local: str) -> str:
    """Return the change of an effect's parameter with a condition; empty if it does not change."""
    change = survey.effect_trends.get((effect.name, local))
    if change is None:
        return ""
    factor, unit = shown_in(effect.parameters[local], local)
    return _change(*change, survey.condition_units.get(change[0], "1"), unit, factor)


def rivals_phrase(effect: Recurring) -> str:
    """Return the other effects that are equally likely, and those that are less likely."""
    equal = [name for name, margin in effect.rivals.items() if margin < EQUAL_CHI_SQUARE]
    margins = {name: margin for name, margin in effect.rivals.items() if margin >= EQUAL_CHI_SQUARE}
    phrases = []
    if equal:
        phrases.append(
            f"equally likely: {' or '.join(equal)}; chosen since the derivatives agree better "
            "between flights, or by the flights' diagnoses"
        )
    if margins:
        *others, last = margins
        names = f"{', '.join(others)} and {last}" if others else last
        more = " at least" if others else ""
        least = f"likelihood ratio test: {min(margins.values()):.4g}{more}"
        phrases.append(f"preferred to {names} ({least})")
    if effect.name in AT_THE_INPUT:
        phrases.append(
            "the same lag or delay in all recorded outputs fits as well: a linear model cannot "
            "tell the two apart"
        )
    return "; ".join(phrases)


def drift_phrase(survey: SurveyResult, derivative: Derivative) -> str:
    """``"Cm_alpha changes with mass by -3.0e-05 +- 1e-06 1/rad per kg"``; empty if it does not
    change.
    """
    drift = derivative.drifts
    if drift is None:
        return ""
    per = survey.condition_units.get(drift[0], "1")
    return f"{derivative.name} {_change(*drift, per, derivative.unit)}"


def _change(condition: str, line: Trend, per: str, unit: str, factor: float = 1.0) -> str:
    """Return ``"changes with mass by -3.0e-05 +- 1e-06 1/rad per kg"``.

    ``per`` is the unit of the condition, and ``factor`` converts the slope to ``unit``.
    """
    unit_text = "" if unit in ("", "1") else f" {unit}"
    slope, sigma = factor * line.slope, factor * line.slope_sigma
    return (
        f"changes with {condition} by {slope:.3g} +- {sigma:.2g}{unit_text} per "
        f"{per if per != '1' else 'unit'}"
    )


def drift_phrases(survey: SurveyResult) -> list[str]:
    """Return a phrase on each derivative that changes with a condition."""
    return [phrase for item in survey.derivatives if (phrase := drift_phrase(survey, item))]


def other_cause_phrases(survey: SurveyResult) -> list[str]:
    """Return other possible causes of the changes with a condition, such as wrong masses."""
    forces = [
        item.name
        for item in survey.derivatives
        if item.drifts is not None and item.drifts[0] == "mass" and item.name.startswith(FORCES)
    ]
    if not forces:
        return []
    change = "change" if len(forces) > 1 else "changes"
    return [
        f"{' and '.join(forces)} {change} with mass, which no force coefficient does by itself: "
        "check the masses in the file of flights"
    ]


def outlying(survey: SurveyResult) -> list[tuple[str, str, float]]:
    """Return flight, derivative and distance in standard deviations of each outlier."""
    return [
        (flight, item.name, float(off))
        for item in survey.derivatives
        for flight, off, out in zip(item.flights, item.off, item.out, strict=True)
        if out
    ]


def counts_phrase(survey: SurveyResult) -> str:
    """Return the numbers of flights: all, computed, kept, new, failed and removed."""
    files = survey.survey_files
    parts = [
        f"{len(files.diagnoses)} flights",
        f"{len(files.computed)} computed now, {len(files.diagnoses) - len(files.computed)} kept",
    ]
    parts += [f"new: {names_and_count(files.new)}"] if files.new else []
    parts += (
        [f"{len(files.failed)} failed: {names_and_count(list(files.failed))}"]
        if files.failed
        else []
    )
    parts += (
        [f"removed since the last survey: {names_and_count(files.removed)}"]
        if files.removed
        else []
    )
    return "; ".join(parts)


def single_phrases(survey: SurveyResult) -> list[str]:
    """Return the effects that flights claim and that do not recur."""
    return [
        f"{effect} is named in {names_and_count(flights)} and does not recur"
        for effect, flights in survey.alone.items()
    ] + [
        f"{effect} is named in {names_and_count(flights)}, where the recurring effects explain as "
        "much"
        for effect, flights in survey.needless.items()
    ]


def new_flight_phrases(survey: SurveyResult) -> list[str]:
    """Return the new flights, each with its own verdict and the recurring effects that it has."""
    phrases = []
    for name in survey.survey_files.new:
        diagnosis = survey.survey_files.diagnoses[name]
        phrase = f"{diagnosis['verdict']}, {name}: {diagnosis['headline']}"
        effects = [effect.name for effect in survey.recurs if name in effect.has]
        if effects:
            phrase += f"; it has the recurring {' and '.join(effects)}"
        elif survey.recurs:
            phrase += "; it has no recurring effect"
        phrases.append(phrase)
    return phrases


def names_and_count(names: Sequence[str], most: int = 6) -> str:
    """Return the first ``most`` names with commas, and the number of further ones."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def status_in_flight(effect: Recurring, flight: str) -> str:
    """Return whether a flight has an effect, in words."""
    if flight not in effect.flights:
        return MISSING
    return HAS if flight in effect.has else HAS_NOT if flight in effect.has_not else UNDECIDED


def newest_first(survey: SurveyResult) -> list[str]:
    """Return the names of the flights, the newest first.

    First are those that are new in this survey; then later dates, and later places in the file.
    """
    order = list(survey.survey_files.diagnoses)
    new = set(survey.survey_files.new)
    return sorted(
        order,
        key=lambda name: (name in new, survey.survey_files.flights[name].date, order.index(name)),
        reverse=True,
    )


def effects_table(survey: SurveyResult) -> Table:
    """Return the table of the recurring effects."""
    effects = survey.recurs

    def counts(flights: Callable[[Recurring], Sequence[str]]) -> list[Cell]:
        return [Number(len(flights(effect)), digits=0) for effect in effects]

    owners = {"aircraft": "the aircraft"}
    chances = [
        Number(p, shown=f"{p:.1g}" if p >= LEAST_P_VALUE else "<1e-9")
        for p in (effect.recurrence.p_value for effect in effects)
    ]
    return table(
        "effects that recur",
        (Column("effect"), [effect.name for effect in effects]),
        (Column("common value"), ["; ".join(values_of(effect)) for effect in effects]),
        (
            Column("belongs to"),
            [owners.get(effect.recurrence.belongs, "some flights") for effect in effects],
        ),
        (Column("have it", PURE), counts(lambda effect: effect.has)),
        (Column("do not have it", PURE), counts(lambda effect: effect.has_not)),
        (Column("undecided", PURE), counts(lambda effect: effect.undecided)),
        (Column("named by the flight alone", PURE), counts(lambda effect: effect.named)),
        (
            Column("values agree", right=True),
            ["yes" if effect.recurrence.agrees else "no" for effect in effects],
        ),
        (Column("chance of a false recurrence", PURE), chances),
    )


def derivatives_table(survey: SurveyResult) -> Table:
    """Return the table of the derivatives over the flights."""
    items = survey.derivatives
    changes = [drift_phrase(survey, item).partition(" changes ")[2] or MISSING for item in items]
    differs = ["yes" if item.differs < FALSE_DISCOVERY_RATE else "no" for item in items]
    return table(
        "derivatives over the flights",
        (Column("derivative"), [item.name for item in items]),
        (
            Column("common value", BY_ROW),
            [Number(item.common.value, item.common.sigma) for item in items],
        ),
        (
            Column("scatter between flights", BY_ROW),
            [formatted(item.common.scatter, ".2g") for item in items],
        ),
        (Column("differs", right=True), differs),
        (Column("changes"), changes),
        units=[item.unit for item in items],
    )


def outlying_table(survey: SurveyResult) -> Table:
    """Return the table of flights that lie outside the scatter of the others."""
    outliers = outlying(survey)
    return table(
        "flights that stand out",
        (Column("flight"), [flight for flight, _, _ in outliers]),
        (Column("derivative"), [name for _, name, _ in outliers]),
        (Column("off", SIGMAS), [formatted(off, "+.1f") for _, _, off in outliers]),
    )


def flights_table(survey: SurveyResult, linked: Collection[str] = ()) -> Table:
    """Return the table of flights, newest first; ``linked`` flights have links to their pages."""
    order, files = newest_first(survey), survey.survey_files
    diagnoses = [files.diagnoses[name] for name in order]

    def alone(name: str) -> str:
        effects = [effect for effect, flights in survey.alone.items() if name in flights]
        return ", ".join(effects) or MISSING

    names = [
        Link(name, f"{FOLDER}/{name}/report.html") if name in linked else name for name in order
    ]
    shown = survey.recurs[0].flights if survey.recurs else ()  # numbered as in the figure
    numbers = {name: Number(number, digits=0) for number, name in enumerate(shown, start=1)}
    columns: list[tuple[Column, Sequence[Cell]]] = [
        (Column("number", PURE), [numbers.get(name, MISSING) for name in order]),
        (Column("flight"), names),
        (Column("this survey"), ["new" if name in files.new else "" for name in order]),
        (Column("date"), [files.flights[name].date or MISSING for name in order]),
        (Column("tail"), [files.flights[name].tail or MISSING for name in order]),
        (Column("verdict"), [diagnosis["verdict"] for diagnosis in diagnoses]),
        *(
            (Column(effect.name), [status_in_flight(effect, name) for name in order])
            for effect in survey.recurs
        ),
        (Column("alone"), [alone(name) for name in order]),
        (Column("kinematics"), [kinematics(diagnosis) for diagnosis in diagnoses]),
    ]
    always = ("flight", "verdict", "kinematics")
    return table(
        "flights, the newest first",
        *(
            (column, cells)
            for column, cells in columns
            if column.heading in always or any(cell not in ("", MISSING) for cell in cells)
        ),
    )


def kinematics(diagnosis: Mapping[str, Any]) -> str:
    """Return the first sensor fault that kinematics shows in a flight, and the number of others."""
    if not diagnosis["check"]["done"]:
        return "not possible"
    first, *others = diagnosis["check"]["findings"] or ["no fault found"]
    return f"{first}, {len(others)} more" if others else str(first)


# ---- The content of survey.json and derivatives.csv


def survey_content(survey: SurveyResult, created: str) -> dict[str, Any]:
    """Return the content of a survey (SI), with the folders of its flights' studies."""
    files, (word, rest) = survey.survey_files, verdict_of(survey)
    return {
        "schema": GROWING_SCHEMA,
        "created": created,
        "title": survey.flights.title,
        "model": survey.flights.model,
        "verdict": word.lower(),
        "headline": rest,
        "effects": [effect_content(effect, survey) for effect in survey.recurs],
        "tried": list(survey.tried),
        "candidates": LIBRARY_SIZE,
        "alone": {name: list(flights) for name, flights in survey.alone.items()},
        "needless": {name: list(flights) for name, flights in survey.needless.items()},
        "unfitted": dict(survey.unfitted),
        "derivatives": {item.name: derivative_content(item, survey) for item in survey.derivatives},
        "stand_out": [
            {"flight": flight, "derivative": name, "sigmas": off}
            for flight, name, off in outlying(survey)
        ],
        "flights": {name: _flight(survey, name) for name in files.diagnoses},
        "failed": dict(files.failed),
        "removed": list(files.removed),
        "computed": list(files.computed),
        "new": list(files.new),
        "refitted": survey.refitted,
        "verdicts": dict(survey.verdicts),
        "warnings": list(survey.warnings),
        "notes": list(survey.notes),
        "inputs": {"survey": {"name": survey.flights.path.name, "sha256": survey.flights.sha256}},
        "versions": versions(),
    }


def effect_content(effect: Recurring, survey: SurveyResult) -> dict[str, Any]:
    """Return the JSON content of a recurring effect."""
    result = effect.recurrence
    sigmas = np.sqrt(np.diag(result.covariance))
    common = zip(effect.parameters.items(), result.value, sigmas, strict=True)
    return {
        "name": effect.name,
        "belongs_to": result.belongs,
        "sentence": belongs_phrase(effect, survey),
        "rivals_sentence": rivals_phrase(effect),
        "parameters": {
            local: {"value": float(value), "std": float(sigma), "unit": unit}
            for (local, unit), value, sigma in common
        },
        "one_value": result.agrees,
        "scatter": result.scatter,
        "changes": {
            local: {
                "with": condition,
                "slope": line.slope,
                "std": line.slope_sigma,
                "per": survey.condition_units[condition],
                "p": line.p_value,
            }
            for (name, local), (condition, line) in survey.effect_trends.items()
            if name == effect.name
        },
        "share": result.share,
        "log_likelihood": result.log_likelihood,
        "chance_of_as_much": result.p_value,
        "rivals": dict(effect.rivals),
        "named_alone": list(effect.named),
        "flights": {
            name: {
                "state": status_in_flight(effect, name),
                "probability": float(p),
                "values": dict(zip(effect.parameters, map(float, v), strict=True)),
                "stds": list(s),
            }
            for name, p, v, s in zip(
                effect.flights, result.probability, effect.values, effect.sigmas, strict=True
            )
        },
    }


def derivative_content(derivative: Derivative, survey: SurveyResult) -> dict[str, Any]:
    """Return the JSON content of a derivative over the flights."""
    common = derivative.common
    return {
        "unit": derivative.unit,
        "value": common.value,
        "std": common.sigma,
        "interval": [common.low, common.high],
        "scatter": common.scatter,
        "p_one_value": common.p_same,
        "false_discovery_rate": derivative.differs,
        "trends": {
            name: {
                "slope": line.slope,
                "std": line.slope_sigma,
                "per": survey.condition_units[name],
                "at": line.middle,
                "value_there": line.at_middle,
                "scatter": line.scatter,
                "p": line.p_value,
                "false_discovery_rate": rate,
            }
            for name, (line, rate) in derivative.trends.items()
        },
        "flights": {
            name: {"value": float(v), "std": float(s)}
            for name, v, s in zip(
                derivative.flights, derivative.values, derivative.sigmas, strict=True
            )
        },
    }


def _flight(survey: SurveyResult, name: str) -> dict[str, Any]:
    flight, diagnosis = survey.survey_files.flights[name], survey.survey_files.diagnoses[name]
    return {
        "digest": flight.digest,
        "verdict": diagnosis["verdict"],
        "headline": diagnosis["headline"],
        "date": flight.date,
        "tail": flight.tail,
        "condition": {
            key: {"value": value, "unit": unit} for key, (value, unit) in flight.condition.items()
        },
        "claimed": [effect["name"] for effect in diagnosis["effects"] if effect["claimed"]],
        "check": diagnosis["check"],
        "report": f"flights/{name}/report.html",
    }


def derivatives_text(survey: SurveyResult) -> str:
    """Return ``derivatives.csv``: one row per flight and derivative, with the conditions, in SI."""
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    columns = ("flight", "derivative", "unit", "value", "std", "sigmas_off", "stands_out")
    writer.writerow([*columns, *survey.conditions])
    for item in survey.derivatives:
        for flight, value, sigma, off, out in zip(
            item.flights, item.values, item.sigmas, item.off, item.out, strict=True
        ):
            conditions = [
                repr(by_flight[flight]) if flight in by_flight else ""
                for by_flight in survey.conditions.values()
            ]
            numbers = (repr(float(value)), repr(float(sigma)), f"{off:.4g}", int(out))
            writer.writerow([flight, item.name, item.unit, *numbers, *conditions])
    return text.getvalue()


# ---- Text for the terminal: a summary of five lines, then tables


def survey_text(survey: SurveyResult, width: int = WIDTH, details: str = BELOW) -> str:
    """Return the text of the survey for a terminal of this width."""
    lines = [*summary_lines(summary_of(survey, details), width), ""]
    lines += table_as_lines(effects_table(survey), width)
    for effect in survey.recurs:
        text = "; ".join(filter(None, (belongs_phrase(effect, survey), rivals_phrase(effect))))
        lines += wrapped(f"{effect.name}: {text}", width)
    lines += ["", *table_as_lines(derivatives_table(survey), width)]
    outliers = table_as_lines(outlying_table(survey), width)
    lines += ["", *outliers] if outliers else []
    lines += ["", *table_as_lines(flights_table(survey), width)]
    for text in (
        *survey.warnings,
        *(f"note: {note}" for note in survey.notes),
        *other_cause_phrases(survey),
        *single_phrases(survey),
    ):
        lines += wrapped(text, width)
    return "\n".join(lines) + "\n"


def summary_of(survey: SurveyResult, details: str = BELOW) -> Summary:
    """Return the summary: the flights, recurring effects, trends, outlying flights."""
    word, rest = verdict_of(survey)
    changes = (
        "; ".join(drift_phrases(survey)) or "no derivative changes with a condition beyond chance"
    )
    outliers = list(dict.fromkeys(flight for flight, _, _ in outlying(survey)))
    outlier_phrase = (
        f"stand out: {names_and_count(outliers)}" if outliers else "no flight stands out"
    )
    return Summary(
        f"{survey.flights.title}: {counts_phrase(survey)}",
        f"{word}: {rest}",
        changes,
        "; ".join(filter(None, (outlier_phrase, verdicts_phrase(survey)))),
        details,
    )
