"""Terminal tables of a closed-loop study and of the paper."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.text import Text

from ident.flying_qualities.levels import UNITS as QUALITY_UNITS
from ident.flying_qualities.levels import Level, Quality
from scenarios.studies.comparison import bank_line, choice_lines
from scenarios.studies.text import print_choices
from scenarios.terminal.quantities import console, is_frequency, number_text, test_line, unit_cell
from scenarios.terminal.summary import BELOW, Summary, print_summary, residual_phrase, value_phrase
from scenarios.terminal.tables import TableColumn, print_paragraph, print_table
from scenarios.x29.content import correlation_content, noted_pairs, procedure_and_printed
from scenarios.x29.declaration import (
    Printed,
    has_table,
    printed_checks,
    printed_column,
    printed_correlation,
)
from scenarios.x29.estimating import LARGE, LoopMethodResult
from scenarios.x29.findings import COMPARED, off, own_method, sentences
from scenarios.x29.study import LoopStudy

# ---- Terminal tables of what the paper prints beside what its procedure

TITLES = {"simulation": "Table 1", "flight": "Table 2"}


def print_paper(study: LoopStudy, out: Console) -> None:
    """Tables 1 or 2 and their correlations beside the paper's procedure here, the methods, and
    restarts of plain filters.
    """
    column = study.scenario.published[0] if study.scenario.published else ""
    if study.scenario.methods and has_table(column):
        _states(study, column, out)
        _pairs(study, column, out)
        names, C = printed_correlation(column)
        print_triangle(
            out,
            f"correlations as published in {TITLES[column]}, * above {LARGE:g} in size",
            names,
            C,
        )
    if study.scenario.methods:
        _methods(study, column, out)
    _restarts(study, out)


def print_triangle(out: Console, title: str, names: tuple[str, ...], C: np.ndarray) -> None:
    """The lower triangle of a correlation matrix."""

    def cell(i: int, j: int) -> str:
        return f"{C[i, j]:+.2f}{'*' if i != j and abs(C[i, j]) > LARGE else ''}" if j <= i else ""

    columns = [TableColumn("", names, left=True)]
    columns += [
        TableColumn(
            name.replace("alpha", "al").replace("delta", "de"),
            [cell(i, j) for i in range(len(names))],
        )
        for j, name in enumerate(names)
    ]
    out.print()
    print_table(out, title, columns)


def _states(study: LoopStudy, column: str, out: Console) -> None:
    rows = procedure_and_printed(study, column)

    def cells(key: str) -> list[list[str]]:
        pairs = [row[key] for row in rows.values()]
        return [
            [f"{pair[side]:.2e}" if pair[side] is not None else "" for pair in pairs]
            for side in ("here", "published")
        ]

    def block(key: str, heading: str) -> list[TableColumn]:
        here, published = cells(key)
        return [
            TableColumn(f"{heading}, here", here),
            TableColumn("published", published, beside=True),
        ]

    columns = [
        TableColumn("state", list(rows), left=True),
        *block("initial", "initial"),
        *block("initial_variance", "P0"),
    ]
    further = [
        *block("final", "final"),
        *block("final_variance", "variance"),
        *block("R", "R"),
        *block("Q", "Q"),
    ]
    out.print()
    print_table(
        out,
        f"{TITLES[column]} and the paper's procedure on this record (plain bank, "
        f"{study.plain.delay:.3f} s)",
        [*columns, *further],
    )
    print_paragraph(
        out,
        "SI, in the paper's units R of alpha and q are deg2 and (deg/s)2; Q here is a spectral "
        "density; R of nz stands with nz_0",
    )


def _pairs(study: LoopStudy, column: str, out: Console) -> None:
    rows = noted_pairs(study, column)
    columns = [
        TableColumn("correlation of", [f"{a}, {b}" for a, b, *_ in rows], left=True),
        TableColumn("published", [f"{row[2]:+.3f}" for row in rows]),
        TableColumn("paper's procedure", [f"{row[3]:+.3f}" for row in rows]),
        TableColumn("ours, refined", [f"{row[4]:+.3f}" for row in rows]),
    ]
    out.print()
    print_table(out, f"largest correlations of {TITLES[column]}", columns)


def _methods(study: LoopStudy, column: str, out: Console) -> None:
    found: list[LoopMethodResult] = [*study.methods, own_method(study)]
    names = ("L_alpha", *COMPARED)
    printed = printed_column(column)
    columns = [
        TableColumn("method", [*(m.label for m in found), "published"], left=True),
        TableColumn("delay", [*(f"{m.delay:.4f}" for m in found), ""]),
        *(
            TableColumn(
                n, [*(number_text(m.values[n], m.std[n]) for m in found), f"{printed[n].value:g}"]
            )
            for n in names
        ),
        TableColumn(
            "rad/s",
            [
                *(f"{m.frequency:.2f}" for m in found),
                _printed_cell(printed, "natural_frequency", ".2f"),
            ],
        ),
        TableColumn(
            "damping",
            [*(f"{m.damping:.3f}" for m in found), _printed_cell(printed, "damping_ratio", ".3f")],
        ),
        TableColumn("off, %", [*(f"{100.0 * off(m, column):.0f}" for m in found), ""]),
    ]
    out.print()
    print_table(out, "methods by name", columns)
    print_paragraph(
        out,
        f"off: root mean square of the relative differences of {', '.join(COMPARED)} from the "
        "published ones",
    )


def _printed_cell(printed: Mapping[str, Printed], name: str, form: str) -> str:
    """A printed number, or a dash: the paper prints no frequency and no damping ratio of its Table
    3.
    """
    return format(printed[name].value, form) if name in printed else "-"


def _restarts(study: LoopStudy, out: Console) -> None:
    for label, found in study.restarts.items():
        rows = [(k, i) for k in range(len(found.delays)) for i in range(len(found.values["M_q"]))]
        columns = [
            TableColumn("delay", [f"{found.delays[k]:.4f}" for k, _ in rows]),
            TableColumn("pass", [str(i + 1) for _, i in rows]),
            *(
                TableColumn(n, [f"{found.values[n][i, k]:.4g}" for k, i in rows])
                for n in ("L_alpha", *COMPARED)
            ),
        ]
        out.print()
        print_table(out, f"plain filters started again from their own result: {label}", columns)


# ---- Tables of a closed-loop scenario for the terminal

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
    """Everything there is to read of a study: a summary, the estimate, the rest."""
    out = out or console()
    print_summary(out, loop_summary(study, details))
    scenario, record = study.scenario, study.result.setting.record
    out.print(Text.assemble((scenario.name, "bold"), f": {scenario.title}"))
    window = f"{record.time[0]:g} to {record.time[-1]:g} s"
    out.print(
        f"truth and model: {scenario.distance}; seed {study.seed}; {len(record)} samples, {window}",
        highlight=False,
    )
    out.print(bank_line(scenario.estimation.engine, study.second), highlight=False)
    _estimate(study, out)
    print_choices(out, choice_lines(scenario.choices))
    for table in list(TABLES.values())[1:]:
        table(study, out)
    out.print()
    for sentence in (*sentences(study), test_line(study.tests), scenario.findings):
        if sentence:
            print_paragraph(out, sentence, indent=0)


def loop_summary(study: LoopStudy, details: str = BELOW) -> Summary:
    """Scenario; outcome and delay; frequency and damping; what the fit leaves."""
    estimate, shown = study.result.estimate, ("natural_frequency", "damping_ratio", "delay")
    found = [
        value_phrase(WORDS[q.name], q.value, q.std, q.unit)
        for q in study.result.qualities
        if q.name in shown
    ]
    return Summary(
        f"{study.scenario.name}: {study.scenario.title}; seed {study.seed}; low-order equivalent "
        "by nine filters, delay refined",
        estimate.outcome.value,
        "; ".join(found),
        residual_phrase(study.tests),
        details,
    )


def _estimate(study: LoopStudy, out: Console) -> None:
    estimate, loop = study.result.estimate, study.check.loop
    printed = printed_column(study.scenario.published[0]) if study.scenario.published else {}
    names = [name for name in PARAMETERS if name in estimate.names]
    columns = [
        TableColumn("parameter", names, left=True),
        TableColumn(
            "unit",
            [unit_cell(estimate.units[estimate.names.index(name)]) for name in names],
            left=True,
        ),
        TableColumn(
            "estimate", [number_text(estimate.value(name), estimate.sigma(name)) for name in names]
        ),
        TableColumn(
            "+- sigma",
            [number_text(estimate.sigma(name), estimate.sigma(name)) for name in names],
            beside=True,
        ),
        TableColumn(
            "loop equivalent",
            [f"{getattr(loop, name):.5g}" if hasattr(loop, name) else "-" for name in names],
        ),
        TableColumn(
            "plain bank",
            [
                number_text(study.plain.estimate.value(n), estimate.sigma(n))
                if n != "delay"
                else f"{study.plain.delay:.3f}"
                for n in names
            ],
        ),
    ]
    further = []
    if printed:
        further = [
            TableColumn(
                "published",
                [f"{printed[name].value:.5g}" if name in printed else "" for name in names],
            ),
            TableColumn(
                "+- sigma",
                [
                    f"{s:.2g}" if name in printed and (s := printed[name].std) is not None else ""
                    for name in names
                ],
                beside=True,
            ),
        ]
    out.print()
    print_table(out, f"estimate, delay refined: {estimate.outcome.value}", [*columns, *further])


def _printing_states(study: LoopStudy, out: Console) -> None:
    history, system = study.result.estimate.history, study.result.setting.system
    assert history is not None
    noise, density = study.result.setting.noise_std, study.scenario.estimation.process_noise
    items = [
        system.initial[n] if n in system.state_names else system.parameters[n]
        for n in history.names
    ]
    columns = [
        TableColumn("state", list(history.names), left=True),
        TableColumn("initial", [f"{item.value:.3e}" for item in items]),
        TableColumn("final", [f"{v:.3e}" for v in history.mean[:, -1]]),
        TableColumn("initial variance", [f"{item.prior_std**2:.3e}" for item in items]),
        TableColumn("final variance", [f"{v:.3e}" for v in history.std[:, -1] ** 2]),
        TableColumn("R", [f"{noise[n] ** 2:.3e}" if n in noise else "" for n in history.names]),
        TableColumn("Q", [f"{density.get(n, 0.0):.1e}" for n in history.names]),
    ]
    out.print()
    print_table(
        out,
        f"states of the filter at the refined delay (R of nz {noise['nz'] ** 2:.3e} g2)",
        columns,
    )


def _correlation(study: LoopStudy, out: Console) -> None:
    content = correlation_content(study.result.estimate)
    title = f"correlations after the last sample, * above {LARGE:g} in size"
    print_triangle(out, title, tuple(content["names"]), np.array(content["matrix"]))


def _qualities(study: LoopStudy, out: Console) -> None:
    found = [
        each
        for q in study.result.qualities
        for each in ([q, _hertz(q)] if is_frequency(q.name, q.unit) else [q])
    ]
    columns = [
        TableColumn("quantity", [WORDS[q.name] for q in found], left=True),
        TableColumn("unit", [unit_cell(q.unit) for q in found], left=True),
        TableColumn("value", [number_text(q.value, q.std) for q in found]),
        TableColumn("from", [number_text(q.value - 2 * q.std, q.std) for q in found]),
        TableColumn("to (2 sigma)", [number_text(q.value + 2 * q.std, q.std) for q in found]),
    ]
    out.print()
    print_table(out, "flying qualities", columns)
    for row in study.levels:
        c = row.criterion
        category = "" if c.category == "all" else f", category {c.category}"
        print_paragraph(out, f"{WORDS[c.quantity]}{category}: level {_level(row)} ({c.source})")


def _hertz(q: Quality) -> Quality:
    return replace(q, value=q.value / (2.0 * math.pi), std=q.std / (2.0 * math.pi), unit="Hz")


def _level(row: Level) -> str:
    words = {1: "1", 2: "2", 3: "3", 4: "outside 3"}
    return words[row.level] + (
        f" ({words[row.best]} to {words[row.worst]} within 2 sigma)" if row.uncertain else ""
    )


def _check(study: LoopStudy, out: Console) -> None:
    loop, record, result = study.check.loop, study.check.record, study.result
    names = ("natural_frequency", "damping_ratio", "delay")
    own = {q.name: q for q in result.qualities}
    columns = [
        TableColumn("quantity", [WORDS[n] for n in names], left=True),
        TableColumn("unit", [unit_cell(QUALITY_UNITS[n]) for n in names], left=True),
        TableColumn(
            "filter", [number_text(own[n].value, own[n].std) if n in own else "-" for n in names]
        ),
        TableColumn("loop's response", [f"{getattr(loop, n):.4g}" for n in names]),
        TableColumn(
            "record's spectra", [f"{record[n]:.4g}" if record is not None else "-" for n in names]
        ),
    ]
    told = printed_checks(study.scenario.published[0]) if study.scenario.published else {}
    if told:
        columns.append(TableColumn("plain bank", _plain_cells(study, names)))
        columns.append(
            TableColumn(
                "published EKF",
                [f"{told[n].low:.4g} to {told[n].high:.4g}" if n in told else "" for n in names],
            )
        )
        columns.append(
            TableColumn(
                "its response",
                [f"{told[n].frequency_response:.4g}" if n in told else "" for n in names],
            )
        )
    out.print()
    print_table(out, "independent check by frequency response (0.35 to 14 rad/s)", columns)


def _plain_cells(study: LoopStudy, names: Sequence[str]) -> list[str]:
    v = study.plain.estimate.as_dict()
    frequency = np.sqrt(max(v["L_alpha"] * v["M_q"] - v["L_q"] * v["M_alpha"], 0.0))
    found = {
        "natural_frequency": frequency,
        "damping_ratio": -(v["L_alpha"] + v["M_q"]) / (2.0 * frequency) if frequency else np.nan,
    }
    return [f"{({**found, 'delay': study.plain.delay})[name]:.4g}" for name in names]


def _differences(study: LoopStudy, out: Console) -> None:
    if study.differences is None or study.scenario.against is None:
        return
    rows = study.differences.differences
    columns = [
        TableColumn("parameter", [d.name for d in rows], left=True),
        TableColumn("other", [number_text(d.first, d.first_std) for d in rows]),
        TableColumn("+- sigma", [number_text(d.first_std, d.first_std) for d in rows], beside=True),
        TableColumn("here", [number_text(d.second, d.second_std) for d in rows]),
        TableColumn(
            "+- sigma", [number_text(d.second_std, d.second_std) for d in rows], beside=True
        ),
        TableColumn("difference, sigmas", [f"{d.z:+.1f}" for d in rows]),
        TableColumn("", ["beyond" if d.beyond else "" for d in rows], left=True),
    ]
    out.print()
    print_table(out, f"against {study.scenario.against.label}", columns)
    words = ", ".join(f"{WORDS[name]} {z:+.2f}" for name, z in study.derived_differences)
    print_paragraph(out, f"in the larger of both sigmas: {words}")


def _together(study: LoopStudy, out: Console) -> None:
    if not study.together:
        return
    names = PARAMETERS[:10]
    columns = [TableColumn("parameter", [*names, "delay"], left=True)]
    columns += [
        TableColumn(
            key.removeprefix("x29-"),
            [*(f"{found.estimate.value(n):.4g}" for n in names), f"{found.delay:.3f}"],
        )
        for key, found in study.together.items()
    ]
    columns.append(
        TableColumn(
            "here, refined",
            [
                *(f"{study.result.estimate.value(n):.4g}" for n in names),
                f"{study.result.bank.refined:.3f}",
            ],
        )
    )
    printed = [(key, printed_column(key)) for key in study.scenario.published]
    further = [
        TableColumn(
            f"published {key.replace('_', ' ')}",
            [f"{c[n].value:.4g}" if n in c else "" for n in (*names, "delay")],
        )
        for key, c in printed
    ]
    out.print()
    print_table(
        out,
        "robustness: plain bank, most likely delay, side by side as the paper's Table 3",
        [*columns, *further],
    )


def _passes(study: LoopStudy, out: Console) -> None:
    if len(study.passes) < 2:
        return
    names = ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau")
    columns = [TableColumn("pass", [str(i + 1) for i in range(len(study.passes))])]
    columns += [
        TableColumn(n, [number_text(each.value(n), each.sigma(n)) for each in study.passes])
        for n in names
    ]
    out.print()
    print_table(out, "refined filter started again from its own result", columns)


def _variants(study: LoopStudy, out: Console) -> None:
    if not study.variants:
        return
    rows = [
        ("as declared, refined", study.result.bank.refined, study.misfit),
        *((v.label, v.delay, v.misfit) for v in study.variants),
    ]
    columns = [
        TableColumn("flown or estimated", [row[0] for row in rows], left=True),
        TableColumn("delay, s", [f"{row[1]:.4f}" for row in rows]),
    ]
    if study.scenario.peak is not None:
        columns.append(
            TableColumn("final peak, %", [f"{row[2].peak_percent:+.1f}" for row in rows])
        )
    if study.scenario.stretch is not None:
        columns.append(TableColumn("rms q, stretch", [f"{row[2].stretch:.2f}" for row in rows]))
        columns.append(TableColumn("elsewhere", [f"{row[2].elsewhere:.2f}" for row in rows]))
    columns += [
        TableColumn("rms q", _cells([row[2].rms["q"] for row in rows])),
        TableColumn("lag 1", [f"{row[2].lag_one:+.2f}" for row in rows]),
        TableColumn("Ljung-Box", [f"{row[2].q_box:.0f}" for row in rows]),
        TableColumn("low share", _cells([row[2].low_share for row in rows])),
        TableColumn("size", _cells([row[2].ratio for row in rows])),
    ]
    out.print()
    print_table(out, "the same with changes", columns)
    print_paragraph(
        out,
        "rms q: free simulation against the measurement over the sensor's sigma; lag 1, Ljung-Box "
        "(25 lags, white: 25 +- 7), low share "
        "(power below a fifth of the Nyquist frequency, white: 0.20) of the normalised pitch-rate "
        "innovations; size of all of them, 1 expected",
    )


def _over_seeds(study: LoopStudy, out: Console) -> None:
    found = study.over_seeds
    if found is None:
        return
    rows = [(f"{delay:.3f}", block) for delay, block in found.by_delay()]
    rows += [("all", found.values)] if len(rows) > 1 else []
    columns = [
        TableColumn("delay, s", [label for label, _ in rows], left=True),
        TableColumn("flights", [str(len(block)) for _, block in rows]),
    ]
    for name in ("L_alpha", "M_alpha", "M_delta", "L_q", "M_q", "inv_tau"):
        at = found.names.index(name)
        columns.append(TableColumn(name, [_mean_cell(block[:, at]) for _, block in rows]))
    out.print()
    print_table(
        out,
        f"the paper's bank on flights with seeds 1 to {len(found.seeds)}: delay chosen, mean +- "
        "standard deviation",
        columns,
    )


def _mean_cell(values: np.ndarray) -> str:
    """Mean and standard deviation over flights; a single flight has no deviation."""
    if len(values) < 2:
        return f"{float(values[0]):.4g}"
    std = float(values.std(ddof=1))
    return f"{number_text(float(values.mean()), std)} +- {number_text(std, std)}"


def _cells(values: Sequence[float]) -> list[str]:
    return [f"{value:.2f}" for value in values]


# What is printed, by the heading under which it stands on a page, the estimate first.
TABLES: Mapping[str, Callable[[LoopStudy, Console], None]] = {
    "Estimate": _estimate,
    "States of the filter": _printing_states,
    "Correlation": _correlation,
    "Flying qualities": _qualities,
    "Check by frequency response": _check,
    "The paper's numbers": print_paper,
    "Against the other study": _differences,
    "Side by side": _together,
    "Started again": _passes,
    "With changes": _variants,
    "Over seeds": _over_seeds,
}
