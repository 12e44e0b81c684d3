"""A closed-loop study in tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.text import Text

from ident.estimate import Estimate
from ident.flying_qualities.levels import UNITS as QUALITY_UNITS
from ident.flying_qualities.levels import Quality, QualityLevel
from scenarios.report.document import (
    BY_ROW,
    MISSING,
    PURE,
    SIGMAS,
    Block,
    Cell,
    Column,
    Number,
    Prose,
    formatted,
    known,
    table,
)
from scenarios.report.quantities import (
    console,
    is_frequency,
    shown_in,
    test_line,
)
from scenarios.report.summary import (
    BELOW,
    Summary,
    print_paragraph,
    print_summary,
    residual_phrase,
    value_phrase,
)
from scenarios.report.terminal import show_blocks
from scenarios.studies.comparison import SEE_PAPERS, bank_line, choice_lines
from scenarios.studies.text import print_choices, rest_of
from scenarios.x29.content import (
    correlation_content,
    units_of,
)
from scenarios.x29.declaration import (
    printed_checks,
    printed_column,
    short_period,
)
from scenarios.x29.estimating import LARGE_CORRELATION, Misfit, start_of
from scenarios.x29.findings import sentences
from scenarios.x29.published_tables import (
    PER_ROOT_SECOND,
    bare,
    by_sigma,
    paper_blocks,
    triangle,
)
from scenarios.x29.study import LoopStudy

# ---- Tables of a closed-loop study

PARAMETERS = (
    "L_alpha",
    "M_alpha",
    "L_delta",
    "M_delta",
    "L_q",
    "M_q",
    "inv_tau",
    "L_0",
    "M_0",
    "delta_0",
    "nz_0",
    "delay",
)
WORDS = {
    "natural_frequency": "undamped natural frequency",
    "damping_ratio": "damping ratio",
    "delay": "equivalent delay, pure",
    "total_delay": "equivalent delay with the lag",
    "load_factor_slope": "n_z/alpha",
    "control_anticipation": "control anticipation parameter",
}


def print_loop(study: LoopStudy, out: Console | None = None, details: str = BELOW) -> None:
    """Print a study in full: summary, estimate, further tables, findings."""
    out = out or console()
    print_summary(out, loop_summary(study, details))
    scenario, record = study.scenario, study.result.setting.record
    out.print(Text.assemble((scenario.name, "bold"), f": {scenario.title}"))
    window = f"{record.time[0]:g} to {record.time[-1]:g} s"
    out.print(
        f"flight and model: {scenario.distance}; seed {study.seed}; {len(record)} samples, "
        f"{window}",
        highlight=False,
    )
    out.print(bank_line(scenario.estimation.engine, study.second), highlight=False)
    first, *others = BLOCKS.values()
    show_blocks(out, first(study), apart=True)
    print_choices(out, choice_lines(scenario.choices))
    for blocks in others:
        show_blocks(out, blocks(study), apart=True)
    out.print()
    for sentence in (*sentences(study), test_line(study.tests), scenario.findings):
        if sentence:
            print_paragraph(out, sentence, indent=0)
    if scenario.published:
        print_paragraph(out, SEE_PAPERS, indent=0)


def print_loop_brief(study: LoopStudy, out: Console | None = None, details: str = BELOW) -> None:
    """Print a study in brief: summary, estimate, findings."""
    out = out or console()
    print_summary(out, loop_summary(study, rest_of(details)))
    show_blocks(out, _estimate(study))
    if study.scenario.findings:
        out.print()
        print_paragraph(out, study.scenario.findings, indent=0)


def loop_summary(study: LoopStudy, details: str = BELOW) -> Summary:
    """Return the summary: scenario, outcome, frequency, damping and delay, residuals."""
    estimate, shown = study.result.estimate, ("natural_frequency", "damping_ratio", "delay")
    phrases = [
        value_phrase(WORDS[q.name], q.value, q.std, q.unit)
        for q in study.result.qualities
        if q.name in shown
    ]
    return Summary(
        f"{study.scenario.name}: {study.scenario.title}; seed {study.seed}; low-order equivalent "
        "by nine filters, delay refined",
        estimate.outcome.value,
        "; ".join(phrases),
        residual_phrase(study.tests),
        details,
    )


def _estimate(study: LoopStudy) -> list[Block]:
    estimate, loop = study.result.estimate, study.check.loop
    printed = printed_column(study.scenario.column)
    names = [name for name in PARAMETERS if name in estimate.names]

    def plain(name: str) -> Cell:
        if name == "delay":
            return formatted(study.single_pass.delay, ".3f")
        return by_sigma(study.single_pass.estimate.value(name), estimate.sigma(name))

    def published(name: str) -> Cell:
        if name not in printed:
            return ""
        value, std = printed[name].value, printed[name].std
        return Number(value, std, shown="" if std else f"{value:.5g}")

    shown = table(
        f"estimate, delay refined: {estimate.outcome.value}",
        (Column("parameter"), names),
        (Column("estimate", BY_ROW), [Number(estimate.value(n), estimate.sigma(n)) for n in names]),
        (
            Column("loop equivalent", BY_ROW),
            [known(getattr(loop, name)) if hasattr(loop, name) else MISSING for name in names],
        ),
        (Column("plain bank", BY_ROW), [plain(name) for name in names]),
        (Column("published", BY_ROW), [published(name) for name in names]) if printed else None,
        units=[estimate.units[estimate.names.index(name)] for name in names],
    )
    return [shown]


def _filter_states(study: LoopStudy) -> list[Block]:
    history, system = study.result.estimate.history, study.result.setting.system
    assert history is not None
    noise, density = study.result.setting.noise_std, study.scenario.estimation.process_noise
    units = units_of(study)
    items = [start_of(system, name) for name in history.names]

    shown = {name: shown_in(units[name], name) for name in history.names}

    def by_row(values: Iterable[float], sigmas: Iterable[float]) -> list[Cell]:
        return [
            Number(each.factor * float(value), each.factor * float(sigma) or None)
            for each, value, sigma in zip(shown.values(), values, sigmas, strict=True)
        ]

    states = table(
        f"states of the filter at the refined delay (sensor noise of nz {noise['nz']:.3g} g)",
        (Column("state"), list(history.names)),
        (
            Column("initial", BY_ROW),
            by_row([item.value for item in items], [item.prior_std for item in items]),
        ),
        (Column("final", BY_ROW), by_row(history.mean[:, -1], history.std[:, -1])),
        (
            Column("sensor noise", BY_ROW),
            [
                formatted(each.factor * noise[n], ".3g") if n in noise else ""
                for n, each in shown.items()
            ],
        ),
        (
            bare("process noise", PER_ROOT_SECOND),
            [
                formatted(each.factor * math.sqrt(density.get(n, 0.0)), ".3g")
                for n, each in shown.items()
            ],
        ),
        units=[each.unit for each in shown.values()],
    )
    return [states]


def _correlation(study: LoopStudy) -> list[Block]:
    content = correlation_content(study.result.estimate)
    title = f"correlations after the last sample, * above {LARGE_CORRELATION:g} in size"
    return [triangle(title, tuple(content["names"]), np.array(content["matrix"]))]


def _qualities(study: LoopStudy) -> list[Block]:
    qualities = []
    for q in study.result.qualities:
        qualities.append(q)
        if is_frequency(q.name, q.unit):
            qualities.append(replace(q, value=q.value / math.tau, std=q.std / math.tau, unit="Hz"))

    def at(q: Quality, sigmas: float) -> Cell:
        return by_sigma(q.value + sigmas * q.std, q.std)

    shown = table(
        "flying qualities",
        (Column("quantity"), [WORDS[q.name] for q in qualities]),
        (Column("value", BY_ROW), [at(q, 0.0) for q in qualities]),
        (Column("from", BY_ROW), [at(q, -2.0) for q in qualities]),
        (Column("to (2 sigma)", BY_ROW), [at(q, 2.0) for q in qualities]),
        units=[q.unit for q in qualities],
    )
    criteria = [row.criterion for row in study.levels]
    levels = table(
        "levels",
        (Column("quantity"), [WORDS[each.quantity] for each in criteria]),
        (Column("category"), [each.category for each in criteria]),
        (Column("level"), [_level(row) for row in study.levels]),
        (Column("requirement"), [each.source for each in criteria]),
    )
    return [shown, levels] if levels.rows else [shown]


def _level(row: QualityLevel) -> str:
    words = {1: "level 1", 2: "level 2", 3: "level 3", 4: "outside level 3"}
    between = f" ({words[row.best]} to {words[row.worst]} within 2 sigma)"
    return words[row.level] + (between if row.uncertain else "")


def _check(study: LoopStudy) -> list[Block]:
    loop, record, result = study.check.loop, study.check.record, study.result
    names = ("natural_frequency", "damping_ratio", "delay")
    filtered = {q.name: q for q in result.qualities}
    printed = printed_checks(study.scenario.column)
    further: list[tuple[Column, list[Cell]]] = []
    if printed:
        bands = [
            f"{printed[n].low:.4g} to {printed[n].high:.4g}" if n in printed else "" for n in names
        ]
        responses = [
            formatted(printed[n].frequency_response, ".4g") if n in printed else "" for n in names
        ]
        further = [
            (Column("plain bank", BY_ROW), _plain_cells(study, names)),
            (Column("published EKF", right=True), list[Cell](bands)),
            (Column("its response", BY_ROW), responses),
        ]
    shown = table(
        "independent check by frequency response (0.35 to 14 rad/s)",
        (Column("quantity"), [WORDS[n] for n in names]),
        (
            Column("filter", BY_ROW),
            [
                by_sigma(filtered[n].value, filtered[n].std) if n in filtered else MISSING
                for n in names
            ],
        ),
        (Column("loop's response", BY_ROW), [formatted(getattr(loop, n), ".4g") for n in names]),
        (
            Column("record's spectra", BY_ROW),
            [formatted(record[n] if record is not None else None, ".4g") for n in names],
        ),
        *further,
        units=[QUALITY_UNITS[n] for n in names],
    )
    return [shown]


def _plain_cells(study: LoopStudy, names: Sequence[str]) -> list[Cell]:
    """Return quantities of the plain bank; empty cells if its short period does not oscillate."""
    frequency, damping = short_period(study.single_pass.estimate.as_dict())
    values: dict[str, float | None] = {"delay": study.single_pass.delay}
    if not math.isnan(frequency):
        values |= {"natural_frequency": frequency, "damping_ratio": damping}
    return [formatted(values.get(name), ".4g") for name in names]


def _differences(study: LoopStudy) -> list[Block]:
    if study.differences is None or study.scenario.against is None:
        return []
    rows, units = study.differences.differences, units_of(study)
    shown = table(
        f"against {study.scenario.against.label}",
        (Column("parameter"), [d.name for d in rows]),
        (Column("other", BY_ROW), [Number(d.first, d.first_std) for d in rows]),
        (Column("here", BY_ROW), [Number(d.second, d.second_std) for d in rows]),
        (Column("difference", SIGMAS), [formatted(d.z, "+.1f") for d in rows]),
        (Column("remark", printed=" "), ["beyond" if d.beyond else "" for d in rows]),
        units=[units[d.name] for d in rows],
    )
    words = ", ".join(f"{WORDS[name]} {z:+.2f}" for name, z in study.derived_differences)
    return [shown, Prose(f"in the larger of both sigmas: {words}", "note")]


def _together(study: LoopStudy) -> list[Block]:
    if not study.together:
        return []
    names, units = (*PARAMETERS[:10], "delay"), units_of(study)

    def cells(estimate: Estimate, delay: float) -> list[Cell]:
        values = [formatted(estimate.value(n), ".4g") for n in names[:-1]]
        return [*values, formatted(delay, ".3f")]

    printed = [(key, printed_column(key)) for key in study.scenario.published]
    shown = table(
        "robustness: plain bank, most likely delay, side by side",
        (Column("parameter"), names),
        *(
            (Column(key.removeprefix("x29-"), BY_ROW), cells(found.estimate, found.delay))
            for key, found in study.together.items()
        ),
        (Column("here, refined", BY_ROW), cells(study.result.estimate, study.result.bank.refined)),
        *(
            (
                Column(f"published {key.replace('_', ' ')}", BY_ROW),
                [formatted(c[n].value, ".4g") if n in c else "" for n in names],
            )
            for key, c in printed
        ),
        units=[units[name] for name in names],
    )
    return [shown]


def _passes(study: LoopStudy) -> list[Block]:
    if len(study.passes) < 2:
        return []
    names, units = ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau"), units_of(study)
    shown = table(
        "refined filter started again from its own result",
        (Column("pass", PURE), [Number(i + 1, digits=0) for i in range(len(study.passes))]),
        *(
            (
                Column(n, units[n], printed=n),
                [by_sigma(estimate.value(n), estimate.sigma(n)) for estimate in study.passes],
            )
            for n in names
        ),
    )
    return [shown]


def _variants(study: LoopStudy) -> list[Block]:
    if not study.variants:
        return []
    rows = [
        ("as declared, refined", study.result.bank.refined, study.misfit),
        *((v.label, v.delay, v.misfit) for v in study.variants),
    ]

    def cells(value: Callable[[Misfit], float | None], form: str) -> list[Cell]:
        return [formatted(value(misfit), form) for _, _, misfit in rows]

    peak, stretch = study.scenario.peak is not None, study.scenario.stretch is not None
    shown = table(
        "the same with changes",
        (Column("flown or estimated"), [row[0] for row in rows]),
        (Column("delay", "s"), [formatted(row[1], ".4f") for row in rows]),
        (Column("final peak", "%"), cells(lambda m: m.peak_percent, "+.1f")) if peak else None,
        (Column("rms q, stretch", PURE), cells(lambda m: m.stretch, ".2f")) if stretch else None,
        (Column("elsewhere", PURE), cells(lambda m: m.elsewhere, ".2f")) if stretch else None,
        (Column("rms q", PURE), cells(lambda m: m.rms["q"], ".2f")),
        (Column("lag 1", PURE), cells(lambda m: m.lag_one, "+.2f")),
        (Column("Ljung-Box", PURE), cells(lambda m: m.q_box, ".0f")),
        (Column("low share", PURE), cells(lambda m: m.low_share, ".2f")),
        (Column("size", PURE), cells(lambda m: m.ratio, ".2f")),
    )
    note = (
        "rms q: free simulation against the measurement over the sensor's sigma; lag 1, Ljung-Box "
        "(25 lags, white: 25 +- 7), low share (power below a fifth of the Nyquist frequency, "
        "white: 0.20) of the normalised pitch-rate innovations; size of all of them, 1 expected"
    )
    return [shown, Prose(note, "note")]


def _over_seeds(study: LoopStudy) -> list[Block]:
    statistics = study.over_seeds
    if statistics is None:
        return []
    rows = [block for _, block in statistics.by_delay()]
    delays = list[Cell](formatted(delay, ".3f") for delay, _ in statistics.by_delay())
    if len(rows) > 1:
        rows, delays = [*rows, statistics.values], [*delays, "all"]
    units = units_of(study)
    columns = [
        (
            Column(name, units[name], printed=name, together=True),
            [_mean_cell(block[:, statistics.names.index(name)]) for block in rows],
        )
        for name in ("L_alpha", "M_alpha", "M_delta", "L_q", "M_q", "inv_tau")
    ]
    return [
        table(
            f"the plain bank on flights with seeds 1 to {len(statistics.seeds)}: delay chosen, "
            "mean +- standard deviation",
            (Column("delay", "s", left=True), delays),
            (Column("flights", PURE), [Number(len(block), digits=0) for block in rows]),
            *columns,
        )
    ]


def _mean_cell(values: np.ndarray) -> Cell:
    """Return the mean and standard deviation over flights; a single flight has no deviation."""
    if len(values) < 2:
        return formatted(float(values[0]), ".4g")
    return Number(float(values.mean()), float(values.std(ddof=1)))


# Heading on a page -> blocks of a study, the estimate first.
BLOCKS: Mapping[str, Callable[[LoopStudy], list[Block]]] = {
    "Estimate": _estimate,
    "States of the filter": _filter_states,
    "Correlation": _correlation,
    "Flying qualities": _qualities,
    "Check by frequency response": _check,
    "Against the other study": _differences,
    "Side by side": _together,
    "Started again": _passes,
    "With changes": _variants,
    "Over seeds": _over_seeds,
    "Published values": paper_blocks,
}
