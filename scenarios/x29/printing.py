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
    Table,
    formatted,
    known,
    table,
)
from scenarios.report.quantities import (
    Shown,
    console,
    is_frequency,
    number_text,
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
    correlated_pairs,
    correlation_content,
    procedure_and_printed,
    units_of,
)
from scenarios.x29.declaration import (
    has_table,
    printed_checks,
    printed_column,
    printed_correlation,
    short_period,
)
from scenarios.x29.estimating import LARGE_CORRELATION, LoopMethodResult, Misfit, start_of
from scenarios.x29.findings import COMPARED, off, own_method, sentences
from scenarios.x29.study import LoopStudy

TITLES = {"simulation": "Table 1", "flight": "Table 2"}
PER_ROOT_SECOND = "unit/√s"  # square root of a spectral density; the row names the unit


def paper_blocks(study: LoopStudy) -> list[Block]:
    """Return the blocks of the published tables, all methods and restarts."""
    column = study.scenario.column
    out: list[Block] = []
    if study.scenario.methods and has_table(column):
        names, C = printed_correlation(column)
        title = (
            f"correlations as published in {TITLES[column]}, * above {LARGE_CORRELATION:g} in size"
        )
        out += [*_states(study, column), _pairs(study, column), _triangle(title, names, C)]
    if study.scenario.methods:
        out += _methods(study, column)
    return [*out, *_restarts(study)]


def _bare(heading: str, unit: str) -> Column:
    """Return a column whose unit is shown on pages only."""
    return Column(heading, unit, printed=heading)


def _triangle(title: str, names: tuple[str, ...], C: np.ndarray) -> Table:
    def cell(i: int, j: int) -> Cell:
        if j > i:
            return ""
        mark = "*" if i != j and abs(C[i, j]) > LARGE_CORRELATION else ""
        return Number(float(C[i, j]), shown=f"{C[i, j]:+z.2f}{mark}")

    columns = [
        (
            Column(name, PURE, printed=name.replace("alpha", "al").replace("delta", "de")),
            [cell(i, j) for i in range(len(names))],
        )
        for j, name in enumerate(names)
    ]
    return table(title, (Column("name", printed=" "), names), *columns)


def _states(study: LoopStudy, column: str) -> list[Block]:
    rows = procedure_and_printed(study, column)
    shown = {name: shown_in(unit, name) for name, unit in units_of(study).items()}

    def both(key: str, heading: str) -> list[tuple[Column, list[Cell]]]:
        """Return values with their sigmas, here and as published."""
        here, published = (
            [
                _with_variance(row[key][side], row[f"{key}_variance"][side], shown[name])
                for name, row in rows.items()
            ]
            for side in ("here", "published")
        )
        return [
            (Column(f"{heading}, here", BY_ROW), here),
            (Column(f"{heading}, published", BY_ROW), published),
        ]

    values = table(
        f"{TITLES[column]} and the published method on this record (plain bank, "
        f"{study.single_pass.delay:.3f} s)",
        (Column("state"), list(rows)),
        *both("initial", "initial"),
        *both("final", "final"),
        units=[shown[name].unit for name in rows],
    )
    noisy = {
        name: row
        for name, row in rows.items()
        if any(row[key][side] for key in ("R", "Q") for side in ("here", "published"))
    }

    def sigma(key: str, side: str) -> list[Cell]:
        return [
            formatted(shown[name].factor * math.sqrt(variance), ".3g") if variance else ""
            for name, variance in ((name, row[key][side]) for name, row in noisy.items())
        ]

    noise = table(
        f"noise in {TITLES[column]} and here",
        (Column("state"), list(noisy)),
        (Column("sensor noise, here", BY_ROW), sigma("R", "here")),
        (Column("sensor noise, published", BY_ROW), sigma("R", "published")),
        (_bare("process noise, here", PER_ROOT_SECOND), sigma("Q", "here")),
        (_bare("process noise, published", PER_ROOT_SECOND), sigma("Q", "published")),
        units=[shown[name].unit for name in noisy],
    )
    note = (
        "the publication prints variances; standard deviations are shown here; process noise is "
        "the square root of the spectral density; the sensor noise of nz is in the row of nz_0"
    )
    return [values, noise, Prose(note, "note")]


def _with_variance(value: float | None, variance: float | None, shown: Shown) -> Cell:
    """Return a value with its standard deviation in display units; empty without a value."""
    if value is None:
        return ""
    std = math.sqrt(variance) if variance else None
    if std is None:
        return Number(shown.factor * value)
    return Number(shown.factor * value, shown.factor * std)


def _pairs(study: LoopStudy, column: str) -> Table:
    rows = correlated_pairs(study, column)
    return table(
        f"largest correlations of {TITLES[column]}",
        (Column("correlation of"), [f"{a}, {b}" for a, b, *_ in rows]),
        (Column("published", PURE), [formatted(value, "+.3f") for _, _, value, _, _ in rows]),
        (Column("its method, here", PURE), [formatted(value, "+.3f") for *_, value, _ in rows]),
        (Column("ours, refined", PURE), [formatted(value, "+.3f") for *_, value in rows]),
    )


def _methods(study: LoopStudy, column: str) -> list[Block]:
    methods: list[LoopMethodResult] = [*study.methods, own_method(study)]
    printed, units = printed_column(column), units_of(study)

    def published(name: str, form: str) -> Cell:
        """Return a printed number; Table 3 of the paper has no frequency and damping ratio."""
        return formatted(printed[name].value if name in printed else None, form)

    shown = table(
        "methods by name",
        (Column("method"), [*(m.label for m in methods), "published"]),
        (_bare("delay", "s"), [*(formatted(m.delay, ".4f") for m in methods), ""]),
        *(
            (
                _bare(n, units[n]),
                [_by_sigma(m.values[n], m.std[n]) for m in methods] + [published(n, "g")],
            )
            for n in ("L_alpha", *COMPARED)
        ),
        (
            Column("frequency", "rad/s", printed="rad/s"),
            [
                *(formatted(m.frequency, ".2f") for m in methods),
                published("natural_frequency", ".2f"),
            ],
        ),
        (
            Column("damping", PURE),
            [*(formatted(m.damping, ".3f") for m in methods), published("damping_ratio", ".3f")],
        ),
        (Column("off", "%"), [*(formatted(100.0 * off(m, column), ".0f") for m in methods), ""]),
    )
    note = (
        f"off: root mean square of the relative differences of {', '.join(COMPARED)} from the "
        "published ones"
    )
    return [shown, Prose(note, "note")]


def _by_sigma(value: float, std: float) -> Cell:
    """Return a number with digits by its sigma, which is not shown."""
    return Number(value, shown=number_text(value, std))


def _restarts(study: LoopStudy) -> list[Block]:
    units, out = units_of(study), list[Block]()
    for label, restarted in study.restarts.items():
        rows = [
            (k, i)
            for k in range(len(restarted.delays))
            for i in range(len(restarted.values["M_q"]))
        ]
        columns = [
            (
                Column(n, units[n], printed=n),
                [formatted(restarted.values[n][i, k], ".4g") for k, i in rows],
            )
            for n in ("L_alpha", *COMPARED)
        ]
        out.append(
            table(
                f"plain filters started again from their own result: {label}",
                (
                    Column("delay", "s", printed="delay"),
                    [formatted(restarted.delays[k], ".4f") for k, _ in rows],
                ),
                (Column("pass", PURE), [Number(i + 1, digits=0) for _, i in rows]),
                *columns,
            )
        )
    return out


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
        return _by_sigma(study.single_pass.estimate.value(name), estimate.sigma(name))

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
            _bare("process noise", PER_ROOT_SECOND),
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
    return [_triangle(title, tuple(content["names"]), np.array(content["matrix"]))]


def _qualities(study: LoopStudy) -> list[Block]:
    qualities = []
    for q in study.result.qualities:
        qualities.append(q)
        if is_frequency(q.name, q.unit):
            qualities.append(replace(q, value=q.value / math.tau, std=q.std / math.tau, unit="Hz"))

    def at(q: Quality, sigmas: float) -> Cell:
        return _by_sigma(q.value + sigmas * q.std, q.std)

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
                _by_sigma(filtered[n].value, filtered[n].std) if n in filtered else MISSING
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
                [_by_sigma(estimate.value(n), estimate.sigma(n)) for estimate in study.passes],
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
