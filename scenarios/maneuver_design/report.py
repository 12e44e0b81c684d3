"""A design in the terminal, in design.json, on its page and in its folder; its tables."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.maneuver_design import ActingEffect, Contest
from scenarios.files.declarations import TIME
from scenarios.files.sources import versions
from scenarios.files.user_models import unit_in
from scenarios.files.vehicles import vehicle_with_file
from scenarios.files.writing import csv_text, study_folder, write_json, write_record, write_text
from scenarios.maneuver_design.design import DesignedManeuver, DesignResult
from scenarios.maneuver_design.limits import offset_of
from scenarios.plots import draw_into
from scenarios.report.document import (
    BY_ROW,
    PURE,
    UNDETERMINED,
    Bullets,
    Cell,
    Column,
    Number,
    Page,
    Prose,
    Table,
    as_sentence,
    capital,
    formatted,
    now,
    reproduction,
    section,
    table,
)
from scenarios.report.figure_formats import USUAL, Drawn, Formats
from scenarios.report.folder import figures, write_page
from scenarios.report.quantities import number_text, shown_in, spaced, span_text
from scenarios.report.summary import BELOW, WIDTH, Summary, summary_lines, wrapped
from scenarios.report.terminal import table_as_lines
from sim.record import Record

if TYPE_CHECKING:
    from scenarios.plots.drawing import Named


# ---- Phrases


def maneuver_text(design: DesignResult, maneuver: DesignedManeuver) -> str:
    """Return kind, pulse width and peaks: ``"3-2-1-1 (step 0.48 s), elevator 3.2 deg"``."""
    peaks = ", ".join(_values(design, peaks_of(design, maneuver)))
    return f"{maneuver.kind} ({maneuver.pace_text}), {peaks}"


def peaks_of(design: DesignResult, maneuver: DesignedManeuver) -> dict[str, float]:
    """Return the largest deflection from trim by input."""
    return {
        name: float(np.max(np.abs(row)))
        for name, row in zip(design.setting.trim_inputs, maneuver.flight.deflections, strict=True)
    }


def notes_of(design: DesignResult) -> list[str]:
    """Return the assumptions of the design: noise, limits, who flies, trim."""
    setting = design.setting
    limits = [
        *(f"{name} {_ends(design, name, ends)}" for name, ends in setting.limits.outputs.items()),
        *_values(design, setting.limits.amplitude),
        *(f"rate of {text}/s" for text in _values(design, setting.limits.rate)),
    ]
    trim = _values(design, {name: value for name, value in setting.trim_inputs.items() if value})
    return [
        f"noise (1 sigma): {', '.join(_values(design, setting.noise))}",
        f"limits: {', '.join(limits)}; load factors are totals, 1 in level flight",
        f"{setting.flyer.text}; motions are computed with rate-limited inputs; margin: by how much "
        "the real motion may exceed that of the model before it reaches a limit",
        *([f"trim: {', '.join(trim)}"] if trim else []),
    ]


def acting_text(acting: ActingEffect) -> str:
    """Return an effect with its values."""
    units = {item.name: item.unit for item in acting.effect.parameters}
    sentences = []
    for name, value in acting.values.items():
        factor, unit = shown_in(units.get(name, "1"), name)
        sentences.append(f"{name} {factor * value:.3g}{spaced(unit)}")
    return f"{acting.effect.name} ({', '.join(sentences)})"


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


def _values(design: DesignResult, values: Mapping[str, float]) -> list[str]:
    return [f"{name} {_shown(design, name, value)}" for name, value in values.items()]


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
        (Column("step or band", right=True), [each.pace_text for each in maneuvers]),
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
    limits = [_ends(design, name, setting.limits.outputs[name]) for name in names]
    margins = [100.0 * best.flight.margins[name] for name in names]
    texts = [f"{each:.0f}" if each < 999.5 else "above 999" for each in margins]
    return table(
        caption,
        (Column("output"), names),
        (Column("reaches", right=True), [_range(design, best, name) for name in names]),
        (Column("limits", right=True), limits),
        (
            Column("margin", "%", printed="margin %"),
            [Number(each, shown=text) for each, text in zip(margins, texts, strict=True)],
        ),
    )


# ---- A design in lines for the terminal

LEAST_DECIDING_PROBABILITY = 0.05  # chance, below which no maneuver is said to decide


def design_text(design: DesignResult, width: int = WIDTH, details: str = BELOW) -> str:
    """Return the text of the design for a terminal of this width."""
    lines = [*summary_lines(summary_of(design, details), width), ""]
    lines += table_as_lines(replace(maneuvers_table(design), caption=_title(design)), width)
    if design.setting.limits.outputs:
        caption = f"{design.best.kind}: margins to the limits"
        lines += ["", *table_as_lines(margins_table(design, caption), width)]
    if design.acting:
        caption = f"{design.best.kind}: which effects are told apart"
        lines += ["", *table_as_lines(contest_table(design, caption), width, keys=2)]
    caption = "expected standard deviations (Cramer-Rao)"
    lines += ["", *table_as_lines(sigmas_table(design, caption), width, keys=2)]
    if design.best.responses is not None:
        caption = (
            "frequency responses expected of one flight, share of the band with a coherence of 0.6 "
            "or more, and random error"
        )
        lines += ["", *table_as_lines(responses_table(design, caption), width)]
    for note in (*notes_of(design), f"command: {design.request.command()}"):
        lines += wrapped(note, width)
    return "\n".join(lines) + "\n"


def summary_of(design: DesignResult, details: str = BELOW) -> Summary:
    """Return the summary: vehicle and limits; the best maneuver; its sigmas and peaks."""
    setting, best = design.setting, design.best
    seconds = setting.maneuver_limits.time[-1]
    kinds = "one kind" if len(design.maneuvers) == 1 else f"{len(design.maneuvers)} kinds"
    peaks = ", ".join(f"{name} {_range(design, best, name)}" for name in best.flight.extremes)
    vehicle = vehicle_with_file(setting.vehicle.name, setting.vehicle.identity)
    study = (
        f"{vehicle}, {setting.model.name} model: {kinds} of maneuver flown by "
        f"{setting.flyer.name}, {seconds:g} s at {setting.rate:g} Hz"
    )
    return Summary(study, verdict_of(design), f"{_tells(design)}; peaks {peaks}", details=details)


def verdict_of(design: DesignResult) -> str:
    """Return the best maneuver in a sentence."""
    best, names = design.best, " or ".join(each.effect.name for each in design.acting)
    if not names:
        return f"FLY: {maneuver_text(design, best)}"
    if best.chance < LEAST_DECIDING_PROBABILITY:
        return f"NONE DECIDES: within these limits no maneuver tells {names}"
    chance = "more than 99 %" if best.chance > 0.995 else f"{100.0 * best.chance:.0f} %"
    return f"FLY: {maneuver_text(design, best)} tells {names} with a chance of {chance}"


def _title(design: DesignResult) -> str:
    if design.best.responses is not None:
        return (
            "maneuvers over the band within the limits, the one with the least random errors first"
        )
    remark = "; log likelihood and chance: the least over the true effects" if design.acting else ""
    return (
        "maneuvers of equal duration, each as large as requested or as the limits allow, the best "
        f"first{remark}"
    )


def _tells(design: DesignResult) -> str:
    best = design.best
    if best.responses is not None:
        share = 100.0 * float(np.mean(best.responses.usable))
        low, high = best.responses.frequency[[0, -1]]
        error = 100.0 * best.responses.criterion
        return (
            f"responses from {low:.3g} to {high:.3g} Hz usable in {share:.0f} % of the band, mean "
            f"random error {error:.2g} %"
        )
    if not design.acting:
        return f"expected sigmas {100.0 * best.criterion:.3g} % of the derivatives (geometric mean)"
    return (
        f"expected log likelihood {best.log_likelihood:.1f}; "
        f"{'; '.join(acting_text(each) for each in design.acting)}"
    )


# ---- The content of design.json: SI, load factors in g and as totals

SCHEMA = "flightid/design/1"


def design_content(design: DesignResult) -> dict[str, Any]:
    """Return everything of a design but its time series."""
    setting = design.setting
    files = {"vehicle": setting.vehicle.identity, "model": setting.vehicle.own_file}
    return {
        "schema": SCHEMA,
        "model": setting.model.name,
        "vehicle": setting.vehicle.name,
        "verdict": verdict_of(design),
        "best": design.best.kind,
        "chance": design.best.chance,
        "command": design.request.command(),
        "tell": [_acting(each) for each in design.acting],
        "maneuvers": [maneuver_content(design, each) for each in design.maneuvers],
        "duration": float(setting.maneuver_limits.time[-1]),
        "rate": setting.rate,
        "hold": "previous",
        "flown_by": setting.flyer.name,
        "noise": dict(setting.noise),
        "trim": dict(setting.trim_inputs),
        "limits": {
            "outputs": {
                name: [value for value in ends if math.isfinite(value)]
                for name, ends in setting.limits.outputs.items()
            },
            "amplitude": dict(setting.limits.amplitude),
            "rate": dict(setting.limits.rate),
        },
        "units": dict(si_units(design)),
        "warnings": [],
        "notes": notes_of(design),
        "inputs": {
            key: value
            for name, file in files.items()
            if file is not None
            for key, value in ((name, file.name), (f"{name}_sha256", file.sha256))
        },
        "versions": versions(),
    }


def maneuver_content(design: DesignResult, maneuver: DesignedManeuver) -> dict[str, Any]:
    """Return the JSON content of one maneuver: pulse width, peaks, expected sigmas (finite ones),
    and results on the effects.
    """
    content: dict[str, Any] = {
        "kind": maneuver.kind,
        "pace": maneuver.pulse_width,
        "amplitude": peaks_of(design, maneuver),
        "scale": maneuver.flight.scale,
        "held_by": maneuver.flight.bound_by or "amplitude",
        "extremes": {name: list(ends) for name, ends in maneuver.flight.extremes.items()},
        "margins": dict(maneuver.flight.margins),
        "mean_sigma": maneuver.criterion,
        "sigmas": {name: std for name, std in maneuver.sigmas.items() if math.isfinite(std)},
    }
    if maneuver.responses is not None:
        content["responses"] = maneuver.responses.content
    if maneuver.contests:
        content |= {
            "chance": maneuver.chance,
            "log_likelihood": maneuver.log_likelihood,
            "contests": [_contest(each) for each in maneuver.contests],
        }
    return content


def _acting(acting: ActingEffect) -> dict[str, Any]:
    units = {item.name: item.unit for item in acting.effect.parameters}
    return {
        "name": acting.effect.name,
        "parameters": {
            name: {"value": value, "unit": units.get(name, "1")}
            for name, value in acting.values.items()
        },
    }


def _contest(contest: Contest) -> dict[str, Any]:
    d = contest.decision
    return {
        "acts": _acting(contest.true),
        "rival": _acting(contest.rival),
        "gain_over_none": contest.gain,
        "log_likelihood": d.log_likelihood,
        "std": 0.5 * d.std,
        "price": d.price,
        "found": contest.shown,
        "right": d.right,
        "wrong": d.wrong,
        "chance": contest.chance,
    }


# ---- What the figure of a design is given


def design_figures(design: DesignResult) -> Iterator[Named]:
    """Yield the figure of a design: inputs and responses of all kinds with the limits near them."""
    from scenarios.plots.maneuvers import ManeuverCourse, figure_coherence, figure_maneuvers

    setting = design.setting
    courses = []
    for each in design.maneuvers:
        inputs = {channel.name: channel.values for channel in each.flight.planned.record.inputs}
        outputs = each.flight.outputs.items()
        totals = {name: row + offset_of(setting.model, name) for name, row in outputs}
        courses.append(ManeuverCourse(f"{each.kind}, {each.pace_text}", inputs, totals))
    limits = {
        name: (setting.trim_inputs[name] - size, setting.trim_inputs[name] + size)
        for name, size in setting.limits.amplitude.items()
    }
    if design.best.responses is not None:
        kinds = [(each.kind, each.responses) for each in design.maneuvers]
        title = (
            f"{setting.vehicle.name}: coherence expected of one flight\ndotted: 0.6, from which a "
            "response is usable"
        )
        yield "coherence", partial(figure_coherence, kinds, title)
    title = (
        f"{setting.vehicle.name}: maneuvers of equal duration\nthe best: "
        f"{design.best.kind}; dashed: limits, where they are near the motion"
    )
    yield (
        "maneuvers",
        partial(
            figure_maneuvers,
            setting.maneuver_limits.time,
            courses,
            {**limits, **setting.limits.outputs},
            si_units(design),
            title,
        ),
    )


# ---- The page of a design: best maneuver, expected result, limits

RULE = (
    "A maneuver decides where the loop would find the effect that acts and prefer it to the other "
    "by more than the three units of twice the log likelihood below which it calls two names "
    "ambiguous."
)


def design_page(design: DesignResult, figure_files: Sequence[Drawn] = ()) -> Page:
    """Return the page of a design with the figures ``figure_files``."""
    setting, with_rivals = design.setting, bool(design.acting)
    word, _, rest = verdict_of(design).partition(": ")
    files = {"vehicle": setting.vehicle.identity, "model": setting.vehicle.own_file}
    inputs = [(use, file.name, file.sha256) for use, file in files.items() if file]
    return Page(
        title=f"{setting.vehicle.name}: maneuver design",
        kind=f"{setting.model.name} model, {setting.maneuver_limits.time[-1]:g} s at "
        f"{setting.rate:g} Hz",
        verdict=capital(word.lower()),
        tone="open" if with_rivals and design.best.chance < LEAST_DECIDING_PROBABILITY else "good",
        sentence=as_sentence(rest),
        summary=(),
        warnings=(),
        sections=(
            *section("Figures", *figures(figure_files)),
            *section("Maneuvers", maneuvers_table(design)),
            *section("Margins to the limits", margins_table(design, f"The {design.best.kind}")),
            *section(
                "Which effects are told apart",
                contest_table(design, f"The {design.best.kind}") if with_rivals else None,
                Prose(RULE, "note") if with_rivals else None,
            ),
            *section(
                "Expected frequency responses",
                responses_table(design, "Of one flight") if design.best.responses else None,
            ),
            *section("Expected standard deviations", sigmas_table(design, "Cramer-Rao bounds")),
            *section(
                "Assumptions", Bullets(tuple(map(as_sentence, map(capital, notes_of(design)))))
            ),
        ),
        reproduction=reproduction(shlex.split(design.request.command()), "", inputs),
        created=now(),
    )


# ---- The folder of a design

MAIN = "design.json"
FLOWN = "maneuver"  # file stem of the input to fly
EXPECTED = "expected"


def write_design(design: DesignResult, folder: str | Path, *, figures: Formats = USUAL) -> Path:
    """Write ``maneuver.csv`` (the best), ``maneuver_KIND.csv`` of each kind, ``expected.csv``,
    figures, the page, ``design.json``; the folder.

    The CSV have ``time`` and the inputs in SI, held between samples, as the JSON beside each says;
    of a model of totals the trim is in them.
    """
    with study_folder(folder, MAIN) as scratch:
        write_maneuver(scratch, design.best, FLOWN)
        for each in design.maneuvers:
            write_maneuver(scratch, each, f"{FLOWN}_{each.kind}")
        write_text(scratch / f"{EXPECTED}.csv", _expected(design))
        figure_files = draw_into(scratch, design_figures(design), figures)
        write_page(scratch, design_page(design, figure_files))
        write_json(scratch / MAIN, design_content(design))
    return Path(folder)


def input_of(maneuver: DesignedManeuver) -> Record:
    """Return the maneuver alone, as a record without outputs."""
    return replace(maneuver.flight.planned.record, outputs=(), name=f"{maneuver.kind}, designed")


def write_maneuver(folder: Path, maneuver: DesignedManeuver, stem: str = FLOWN) -> None:
    """Write the inputs of a maneuver as ``stem.csv`` and their meaning as ``stem.json``."""
    write_record(folder, input_of(maneuver), stem, simulated=True)


def _expected(design: DesignResult) -> str:
    """Return inputs and simulated outputs of the best maneuver, as a fit uses them.

    Load factors of perturbation models do not include the weight.
    """
    flight = design.best.flight
    columns = {
        TIME: design.setting.maneuver_limits.time,
        **{channel.name: channel.values for channel in flight.planned.record.inputs},
        **flight.outputs,
    }
    rows = zip(*columns.values(), strict=True)
    return csv_text(columns, ([f"{value:.9g}" for value in row] for row in rows))
