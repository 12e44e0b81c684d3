"""Tables and phrases of a design, for the terminal and for its page."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from ident.maneuver_design import ActingEffect
from scenarios.files.user_models import unit_in
from scenarios.maneuver_design.design import DesignedManeuver, DesignResult
from scenarios.maneuver_design.setting import PRINTED_AS
from scenarios.report.document import (
    BY_ROW,
    PURE,
    UNDETERMINED,
    Cell,
    Column,
    Number,
    Table,
    formatted,
    table,
)
from scenarios.report.quantities import number_text, shown_in, spaced, span_text

# ---- Phrases


def maneuver_text(design: DesignResult, maneuver: DesignedManeuver) -> str:
    """Return kind, pulse width and peaks: ``"3-2-1-1 (step 0.48 s), elevator 3.2 deg"``."""
    peaks = [
        f"{name} {_shown(design, name, value)}"
        for name, value in peaks_of(design, maneuver).items()
    ]
    return f"{maneuver.kind} ({pulse_width_text(maneuver)}), {', '.join(peaks)}"


def pulse_width_text(maneuver: DesignedManeuver) -> str:
    """Return the pulse width as the step of step maneuvers, as the highest frequency of others."""
    if PRINTED_AS[maneuver.kind] == "step":
        return f"step {maneuver.pulse_width:.3g} s"
    return f"up to {0.5 / maneuver.pulse_width:.3g} Hz"


def peaks_of(design: DesignResult, maneuver: DesignedManeuver) -> dict[str, float]:
    """Return the largest deflection from trim by input."""
    return {
        name: float(np.max(np.abs(row)))
        for name, row in zip(design.setting.trim_inputs, maneuver.flight.deflections, strict=True)
    }


def notes_of(design: DesignResult) -> list[str]:
    """Return the assumptions of the design: noise, limits, who flies, trim."""
    setting = design.setting
    noise = [f"{name} {_shown(design, name, value)}" for name, value in setting.noise.items()]
    limits = [
        f"{name} {_ends(design, name, ends)}" for name, ends in setting.limits.outputs.items()
    ]
    limits += [
        f"{name} {_shown(design, name, value)}" for name, value in setting.limits.amplitude.items()
    ]
    limits += [
        f"rate of {name} {_shown(design, name, value)}/s"
        for name, value in setting.limits.rate.items()
    ]
    notes = [
        f"noise (1 sigma): {', '.join(noise)}",
        f"limits: {', '.join(limits)}; load factors are totals, 1 in level flight",
        who_flies_text(design),
    ]
    trim = [
        f"{name} {_shown(design, name, value)}"
        for name, value in setting.trim_inputs.items()
        if value
    ]
    return notes + ([f"trim: {', '.join(trim)}"] if trim else [])


def acting_text(acting: ActingEffect) -> str:
    """Return an effect with its values."""
    units = {item.name: item.unit for item in acting.effect.parameters}
    sentences = []
    for name, value in acting.values.items():
        factor, unit = shown_in(units.get(name, "1"), name)
        sentences.append(f"{name} {factor * value:.3g}{spaced(unit)}")
    return f"{acting.effect.name} ({', '.join(sentences)})"


def percent(chance: float) -> str:
    """Return a probability in per cent, at most ``"more than 99 %"``."""
    return "more than 99 %" if chance > 0.995 else f"{100.0 * chance:.0f} %"


def extremes_text(design: DesignResult, maneuver: DesignedManeuver) -> str:
    """Return the extremes of all outputs in one line."""
    return ", ".join(
        f"{name} {_range(design, maneuver, name)}" for name in maneuver.flight.extremes
    )


def who_flies_text(design: DesignResult) -> str:
    """Return the sentence on pilot or computer, and on the margins."""
    flown = design.setting.flyer
    text = (
        f"flown by {flown.name} (--computer for a flight computer): {flown.text}"
        if flown.text
        else f"flown by {flown.name}"
    )
    return (
        f"{text}; motions are computed with rate-limited inputs; margin: by how much the real "
        "motion may exceed that of the model before it reaches a limit"
    )


def _range(design: DesignResult, maneuver: DesignedManeuver, name: str) -> str:
    low, high = maneuver.flight.extremes[name]
    factor, unit = shown_in(unit_in(design.setting.model, name), name)
    return f"{span_text(factor * low, factor * high)}{spaced(unit)}"


def _ends(design: DesignResult, name: str, ends: tuple[float, float]) -> str:
    factor, unit = shown_in(unit_in(design.setting.model, name), name)
    return f"{factor * ends[0]:.3g} to {factor * ends[1]:.3g}{spaced(unit)}"


def _value_cell(design: DesignResult, name: str, value: float) -> Cell:
    factor, unit = shown_in(unit_in(design.setting.model, name), name)
    return Number(factor * value, unit=unit, shown=_shown(design, name, value))


def _shown(design: DesignResult, name: str, value: float) -> str:
    factor, unit = shown_in(unit_in(design.setting.model, name), name)
    return f"{factor * value:.3g}{spaced(unit)}"


def si_units(design: DesignResult) -> Mapping[str, str]:
    """Return the SI unit of each input and measured output."""
    return {
        name: unit_in(design.setting.model, name)
        for name in (*design.setting.trim_inputs, *design.setting.noise)
    }


# ---- Tables

# outputs whose extremes are in the table, if the model has them
SHOWN = ("nz", "alpha", "q", "beta", "p", "r", "phi", "ny", "airspeed")


def maneuvers_table(design: DesignResult) -> Table:
    """Return the maneuvers of equal duration, the best first."""
    setting, maneuvers, with_rivals = design.setting, design.maneuvers, bool(design.acting)
    outputs = [name for name in SHOWN if name in setting.noise] or list(setting.noise)[:3]
    columns: list[tuple[Column, list[Cell]]] = [
        (Column("maneuver"), [each.kind for each in maneuvers]),
        (Column("step or band", right=True), [pulse_width_text(each) for each in maneuvers]),
    ]
    for name in setting.trim_inputs:
        peaks = [_value_cell(design, name, peaks_of(design, each)[name]) for each in maneuvers]
        columns.append((Column(f"peak {name}", right=True), peaks))
    shares = [_three_digits(100.0 * each.criterion) for each in maneuvers]
    heading = "geometric mean of sigma/value"
    columns.append((Column(heading, "%", printed=f"{heading} %"), shares))
    if with_rivals:
        likelihoods = [formatted(each.log_likelihood, ".1f") for each in maneuvers]
        chances = [formatted(100.0 * each.chance, ".0f") for each in maneuvers]
        columns.append((Column("log likelihood", PURE), likelihoods))
        columns.append((Column("chance to decide", "%", printed="chance to decide %"), chances))
    for name in outputs:
        ranges = list[Cell](_range(design, each, name) for each in maneuvers)
        columns.append((Column(f"{name} range", right=True), ranges))
    columns.append(
        (Column("limited by"), [each.flight.bound_by or "amplitude" for each in maneuvers])
    )
    return table(
        "Equal duration, each as large as requested or as the limits allow, the best first",
        *columns,
    )


def contest_table(design: DesignResult, caption: str) -> Table:
    """Return the table of the effects of the best maneuver: each against its rival."""
    contests = design.best.contests
    decisions = [contest.decision for contest in contests]

    def percent_column(heading: str) -> Column:
        return Column(heading, "%", printed=f"{heading} %")

    return table(
        caption,
        (Column("true effect"), [acting_text(contest.true) for contest in contests]),
        (Column("rival"), [contest.rival.effect.name for contest in contests]),
        (Column("gain over none", PURE), [formatted(contest.gain, ".1f") for contest in contests]),
        (Column("log likelihood", PURE), [formatted(d.log_likelihood, ".1f") for d in decisions]),
        # std is that of twice the log likelihood
        (
            Column("sigma of log likelihood", PURE),
            [formatted(0.5 * d.std, ".1f") for d in decisions],
        ),
        (
            percent_column("decided rightly"),
            [formatted(100.0 * contest.chance, ".1f") for contest in contests],
        ),
        (percent_column("decided wrongly"), [formatted(100.0 * d.wrong, ".2g") for d in decisions]),
    )


def _three_digits(value: float) -> Cell:
    """Return a number with three significant digits, trailing zeros kept."""
    if not math.isfinite(value):
        return formatted(value, "")
    return Number(value, shown=number_text(value, 0.1 * abs(value)))


def sigmas_table(design: DesignResult, caption: str) -> Table:
    """Return the expected standard deviations by parameter and maneuver."""
    parameters, names = design.setting.model.parameters, list(design.best.sigmas)

    def sigma(name: str, std: float) -> Cell:
        known = std < 1e3 * max(abs(parameters[name].value), 1e-3)
        return Number(std, shown=number_text(std, std)) if known else UNDETERMINED

    return table(
        caption,
        (Column("parameter"), names),
        (Column("value", BY_ROW), [Number(parameters[name].value) for name in names]),
        *(
            (Column(each.kind, BY_ROW), [sigma(name, each.sigmas[name]) for name in names])
            for each in design.maneuvers
        ),
        units=[parameters[name].unit for name in names],
    )


def responses_table(design: DesignResult, caption: str) -> Table:
    """Return the table of expected responses over the band, for each maneuver."""
    kinds = [(each.kind, each.responses) for each in design.maneuvers if each.responses is not None]
    first = kinds[0][1]
    places = [
        (m, q, f"{output}/{name}")
        for m, output in enumerate(first.outputs)
        for q, name in enumerate(first.inputs)
    ]
    columns: list[tuple[Column, list[Cell]]] = []
    for kind, result in kinds:
        usable, least, errors = list[Cell](), list[Cell](), list[Cell]()
        for m, q, _ in places:
            usable.append(Number(100.0 * float(result.usable[m, q]), digits=0))
            least.append(Number(float(result.coherence[m, q].min()), digits=2))
            error = 100.0 * float(np.median(result.random_error[m, q]))
            errors.append(Number(error, shown=f"{error:.2g}" if error < 100.0 else "above 100"))
        columns += [
            (Column(f"{kind}: usable", "%", printed=f"{kind}: usable %"), usable),
            (Column("coherence, least", PURE), least),
            (Column("random error, median", "%", printed="random error, median %"), errors),
        ]
    return table(caption, (Column("response"), [label for _, _, label in places]), *columns)


def margins_table(design: DesignResult, caption: str) -> Table:
    """Return the table of peaks of the best maneuver, their limits, and the margins."""
    setting, best = design.setting, design.best
    names = [name for name in best.flight.margins if name in setting.limits.outputs]
    ends = {name: setting.limits.outputs[name] for name in names}
    margins = [100.0 * best.flight.margins[name] for name in names]
    return table(
        caption,
        (Column("output"), names),
        (Column("reaches", right=True), [_range(design, best, name) for name in names]),
        (Column("limits", right=True), [_ends(design, name, ends[name]) for name in names]),
        (
            Column("margin", "%", printed="margin %"),
            [
                Number(each, shown=f"{each:.0f}" if each < 999.5 else "above 999")
                for each in margins
            ],
        ),
    )
