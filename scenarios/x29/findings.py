"""Findings of a closed-loop study in sentences: the paper's numbers, parameters that are not
identifiable.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ident.banks.delays import DELAYS
from ident.estimate import Estimate
from scenarios.x29.declaration import (
    has_table,
    linear_sentence,
    printed_checks,
    printed_column,
    printed_density,
    printed_noise,
    printed_start,
    short_period,
)
from scenarios.x29.estimating import LoopMethodResult, between_grid_points, of_refined
from scenarios.x29.open_margins import FLIGHTS, has_equivalent, margins_sentence, targets
from scenarios.x29.study import HALF_FRAME, LoopStudy, verdicts
from sim.closed_loop.airframe import load_x29

# ---- Conclusions from the numbers of NASA TM-101722

# Parameters whose start is far enough from zero for the paper's rule of P0.
QUARTERED = ("L_alpha", "M_alpha", "M_delta", "M_q", "inv_tau")
# Parameters of lag and short period, which trade off against the delay.
COMPARED = ("M_alpha", "M_delta", "M_q", "inv_tau")
MISSED_SIGMAS = 3.0  # combined sigmas from the printed value that count as missed
SHORT_PERIOD = ("L_alpha", "M_alpha", "L_q", "M_q")
FREE_SHIFT = ("M_0", "delta_0")
RULE_HOLDS = 0.05  # share of a sigma, more than the rounding of three digits


def paper_sentences(study: LoopStudy) -> tuple[str, ...]:
    """Return all findings on the paper, in the order of its tables."""
    column = study.scenario.column
    out: list[str] = []
    if study.scenario.methods and has_table(column):
        out += [
            prior_sentence(),
            noise_sentence(column),
            density_sentence(study),
            *_shift(study, column),
            *_delay(study, column),
            *_damping(column),
            *_methods(study, column),
        ]
    return (*out, *_restarts(study))


def prior_sentence() -> str:
    """Return a sentence on how the printed P0 differs from the printed rule."""
    start, texts, others = printed_start("simulation"), [], []
    for name in QUARTERED:
        cell = start[name]
        assert cell.std is not None
        quarter = abs(cell.value) / 4.0
        if abs(cell.std / quarter - 1.0) > RULE_HOLDS:
            texts.append(f"{name} {cell.std:.3g} for {quarter:.3g}")
            others.append(f"{name} {4.0 * cell.std:.3g}")
    return (
        "the printed P0, the same in Tables 1 and 2, does not follow its own rule, a quarter of "
        "the start, as sigmas: "
        f"{', '.join(texts)}; it is a quarter of another start: {', '.join(others)} in size"
    )


def noise_sentence(column: str) -> str:
    """Return a sentence on the units of the printed R, and on the smaller R of the simulation."""
    flight, start = printed_noise("flight"), printed_start("flight")
    simulation = printed_noise("simulation")
    P0 = {name: (start[name].std or 0.0) ** 2 for name in ("alpha", "q")}
    share = (simulation["q"] / flight["q"]) ** 2
    final = (printed_column("simulation")["q"].std or 0.0) ** 2
    out = (
        "the printed R of alpha and q are degrees squared: in radians they are "
        f"{flight['alpha'] ** 2:.3g} and {flight['q'] ** 2:.3g}, the printed "
        f"P0 is {P0['alpha']:.3g} and {P0['q']:.3g}; noise of {1e3 * flight['alpha']:.2f} mrad, "
        f"{1e3 * flight['q']:.2f} mrad/s, {flight['nz']:.4f} g"
    )
    if column == "simulation":
        hundredth = flight["q"] ** 2 / 100.0
        word = "no filter leaves that" if final > hundredth else "which would be possible"
        out += (
            f"; Table 1 has {share:.2g} of it, the text a hundredth: the printed final variance of "
            f"q, {final:.3g}, stands against {hundredth:.3g} "
            f"by the text, {word}"
        )
    return out


def density_sentence(study: LoopStudy) -> str:
    """Return a sentence on the possible meaning of the printed process noise."""
    q = printed_density("flight")["q"]
    out = (
        f"the printed Q of q, {q:.1e}, times the sampling interval, {q / 40.0:.3g} (rad/s2)^2 s, "
        "is what is used here"
    )
    density = next((m for m in study.methods if m.name == "paper-density"), None)
    paper = next((m for m in study.methods if m.name == "paper"), None)
    if density is None or paper is None:
        return out
    printed = printed_column(study.scenario.column)["M_q"].std
    return (
        f"{out}: sigma of M_q {paper.std['M_q']:.2f}, printed {printed:.2f}; as a density itself "
        f"it would make {density.std['M_q']:.2f} of it"
    )


def _shift(study: LoopStudy, column: str) -> Iterator[str]:
    """Yield the sentence on the bias of the pseudo-control, confounded with M_0 and delta_0."""
    printed, estimate = printed_column(column), study.result.estimate
    first = study.single_pass.estimate
    texts = [
        f"{name} {printed[name].std:.2g} printed, {first.sigma(name):.2g} plain, "
        f"{estimate.sigma(name):.2g} refined"
        for name in FREE_SHIFT
    ]
    yield (
        "a shift of the pseudo-control is undone by L_0, M_0 and delta_0, so no output tells these "
        "apart: what a plain filter believes to know "
        f"of them comes from its changing points of linearisation; sigmas of {'; of '.join(texts)}"
    )


def _delay(study: LoopStudy, column: str) -> Iterator[str]:
    """Yield the sentence on the possible origin of the paper's range of delays."""
    printed_delay = printed_checks(column).get("delay")
    if printed_delay is None:
        return
    first, bank, cell = study.single_pass, study.result.bank, printed_column(column)["inv_tau"]
    assert cell.std is not None
    lag, half = 1.0 / cell.value, 2.0 * cell.std / cell.value**2
    pure = min(DELAYS, key=lambda d: abs(d + lag - 0.5 * (printed_delay.low + printed_delay.high)))
    gaps, step = np.sort(first.bank.log_likelihood)[::-1], DELAYS[1] - DELAYS[0]
    # Weight of the upper of two grid points whose weighted mean is an end of the printed range.
    weights = [
        (end - max(d for d in DELAYS if d <= end)) / step
        for end in (printed_delay.low, printed_delay.high)
    ]
    needed = max(abs(math.log(weight / (1.0 - weight))) for weight in weights)
    low, high = pure + lag - half, pure + lag + half
    miss = max(abs(low - printed_delay.low), abs(high - printed_delay.high))
    total = first.delay + 1.0 / first.estimate.value("inv_tau")
    yield (
        f"the paper's delay of {printed_delay.low:.3f} to {printed_delay.high:.3f} s lies between "
        f"grid points {1e3 * step:.0f} ms apart, so it is no most likely "
        f"delay of the bank. A likelihood-weighted sum would need two filters within {needed:.1f} "
        "of log-likelihood, the paper saw one much above "
        f"the others (here {gaps[0] - gaps[1]:.1f}, sum {first.weighted_mean:.4f} s). A parabola "
        "between the grid points gives "
        f"{between_grid_points(first):.4f} s here, refinement {bank.refined:.4f} s. Pure delay and "
        f"lag of its Table 2 together, {pure:.3f} + "
        f"1/{cell.value:g} s with two sigmas of the printed 1/tau, are {low:.4f} to {high:.4f} s, "
        f"within {1e3 * miss:.1f} ms of both ends and from "
        "printed numbers alone; the text counts the lag as a part of the delay. Its pure delay "
        f"was then {pure:.3f} s, that of the airframe here is "
        f"longer: pure delay and lag make {total:.3f} s"
    )


def _damping(column: str) -> Iterator[str]:
    """Yield the sentence on the possible origin of the paper's range of damping ratios."""
    printed, cells = printed_checks(column).get("damping_ratio"), printed_column(column)
    if printed is None:
        return
    values = {name: cells[name].value for name in SHORT_PERIOD}
    _, middle = short_period(values)
    squares = 0.0
    for name in SHORT_PERIOD:
        std = cells[name].std or 0.0
        squares += (short_period({**values, name: values[name] + std})[1] - middle) ** 2
    half = 2.0 * math.sqrt(squares)
    others = {
        name: short_period({key: printed_column(name)[key].value for key in SHORT_PERIOD})[1]
        for name in ("time_shift", "convergence")
    }
    yield (
        f"the paper's damping ratio of {printed.low:.2f} to {printed.high:.2f} is wider than two "
        f"sigmas of its Table 2, {middle - half:.3f} to "
        f"{middle + half:.3f}; Table 3 has {others['time_shift']:.3f} with its time shift, "
        f"{others['convergence']:.3f} on convergence"
    )


def off(method: LoopMethodResult, column: str) -> float:
    """Return the rms of the relative differences from a printed column, over ``COMPARED``."""
    printed = printed_column(column)
    shares = [method.values[name] / printed[name].value - 1.0 for name in COMPARED]
    return float(np.sqrt(np.mean(np.square(shares))))


def own_method(study: LoopStudy) -> LoopMethodResult:
    """Return the scenario's own result as a method."""
    word = (
        "the printed P0"
        if study.scenario.estimation.prior == "printed"
        else "P0 a quarter of the start"
    )
    return of_refined("own", f"ours: refined, {word}", study.first)


def _methods(study: LoopStudy, column: str) -> Iterator[str]:
    """Yield sentences on the paper's procedure against its own table, and on each refinement."""
    methods = {m.name: m for m in (*study.methods, own_method(study))}
    paper, printed = methods.get("paper"), printed_column(column)
    if paper is None:
        return
    table = {"simulation": "Table 1", "flight": "Table 2"}[column]
    sigmas = {
        name: (paper.values[name] - printed[name].value)
        / math.hypot(paper.std[name], printed[name].std or 0.0)
        for name in COMPARED
    }
    missed = [name for name in COMPARED if abs(sigmas[name]) > MISSED_SIGMAS]
    verdict = (
        f"misses {', '.join(missed)} of its own {table}"
        if missed
        else f"comes within {MISSED_SIGMAS:g} sigmas of its own {table}"
    )
    text = ", ".join(
        f"{name} {paper.values[name]:.4g} for {printed[name].value:g} ({sigmas[name]:+.1f} sigmas)"
        for name in COMPARED
    )
    yield (
        f"the paper's own procedure, the plain bank with the printed P0, {verdict} on this record, "
        f"at {1e3 * paper.delay:.0f} ms: {text}"
    )
    ranked = sorted(
        (m for m in methods.values() if m.name != "paper-density"), key=lambda m: off(m, column)
    )
    yield f"root mean square of these four against {table}: " + "; ".join(
        f"{m.label} {100.0 * off(m, column):.0f} %" for m in ranked
    )
    if {"held", "relinearised", "paper-other"} <= methods.keys():
        yield _reason(methods, study)


def _reason(methods: dict[str, LoopMethodResult], study: LoopStudy) -> str:
    """Return a sentence on the effects of grid, linearisation and P0 on 1/tau and M_alpha."""
    first, refined, loop = study.single_pass, study.result.bank.refined, study.check.flown

    def at(name: str) -> str:
        values = methods[name].values
        return f"inv_tau {values['inv_tau']:.3g}, M_alpha {values['M_alpha']:.3g}"

    off_by = 1e3 * (first.delay - refined)
    steps = [
        f"the bank's delay, {1e3 * first.delay:.0f} ms, is {abs(off_by):.0f} ms "
        f"{'longer' if off_by > 0 else 'shorter'} than the record's, "
        f"and lag, delay and short period trade: {at('paper')}, from the next grid point "
        f"{at('paper-other')}",
        f"the delay alone put right: {at('held')}",
        f"linearised anew alone: {at('relinearised')}",
    ]
    if "refined-printed" in methods and study.scenario.estimation.prior == "quarter":
        quarter = study.result.setting.system.parameters["M_q"].prior_std
        printed = printed_start("flight")["M_q"].std or 0.0
        word = "narrower" if quarter < printed else "wider"
        rule = f"P0 a quarter of the start, {word} on M_q (sigma {quarter:.2f} for {printed:.2f})"
        steps += [f"both: {at('refined-printed')}", f"and {rule}: {at('own')}"]
    return (
        f"taken apart: {'; '.join(steps)}; the loop's own equivalent with the flown L_q has "
        f"inv_tau {loop.inv_tau:.3g}, M_alpha {loop.M_alpha:.3g}"
    )


def _restarts(study: LoopStudy) -> Iterator[str]:
    """Yield sentences on the direction in which repeated passes move, for each fixed delay."""
    if not study.restarts:
        return
    before, after = printed_column("flight"), printed_column("convergence")
    names, refined = ("M_q", "inv_tau", "M_alpha"), study.first.refined
    paper = ", ".join(f"{name} {before[name].value:g} to {after[name].value:g}" for name in names)
    # Whether all parameters move as in the paper: by delay, for each kind of restart.
    as_paper: dict[float, list[bool]] = {}
    for restarts in study.restarts.values():
        for k, delay in enumerate(restarts.delays):
            moves_as_paper = all(
                (values[-1, k] - values[0, k]) * (after[name].value - before[name].value) > 0.0
                for name, values in ((name, restarts.values[name]) for name in names)
            )
            as_paper.setdefault(delay, []).append(moves_as_paper)
    first = next(iter(study.restarts.values()))
    texts = []
    for k, delay in enumerate(first.delays):
        moves = ", ".join(
            f"{name} {first.values[name][0, k]:.3g} to {first.values[name][-1, k]:.3g}"
            for name in names
        )
        texts.append(
            f"held at {delay:.4f} s {moves} "
            f"({'as the paper' if as_paper[delay][0] else 'the other way'})"
        )
    times = len(first.values["M_q"]) - 1
    yield (
        f"the paper's restarts go {paper}. Plain filters with the printed R and P0, started again "
        f"{times} times: {'; '.join(texts)}"
    )
    grid = {delay: moves for delay, moves in as_paper.items() if delay != refined}
    alike = all(len(set(moves)) == 1 for moves in grid.values())
    cause = (
        "another P0 or another R turns neither grid point's direction"
        if alike
        else "P0 or R turns the direction at a grid point"
    )
    if all(moves[0] == (delay > refined) for delay, moves in grid.items()):
        cause += (
            f". The record's delay is {refined:.4f} s: held longer, the lag grows shorter from "
            "pass to pass, held shorter it grows longer, and M_q and M_alpha follow. The direction "
            "is that of the grid point which the bank has taken; the paper's is that of a delay "
            "longer than its aircraft's"
        )
    delay = study.single_pass.delay
    direction = "as the paper's" if as_paper[delay][0] else "the other way than the paper's"
    yield f"{cause}; the bank here takes {delay:.3f} s and goes {direction}"


# ---- Sentences on a study of the closed loop

NOTABLE_SIGMAS = 2.0
DISAGREEING_FREQUENCY_SHARE = 0.1


@dataclass(frozen=True)
class BiasRow:
    """An estimate that differs significantly from the loop's low-order equivalent.

    The equivalent has the true L_q.
    """

    name: str
    estimate: float
    equivalent: float
    sigmas: float


def bias_rows(study: LoopStudy) -> tuple[BiasRow, ...]:
    """Return the differences from the loop's equivalent beyond two sigmas.

    They are the bias of a low-order model, since the sigmas assume white innovations. The
    equivalent has the flown L_q, because L_alpha depends on L_q. L_q itself is left out.
    """
    estimate, rows = study.result.estimate, []
    for name, value, std in zip(
        estimate.names, estimate.values.tolist(), estimate.std.tolist(), strict=True
    ):
        equivalent = getattr(study.check.flown, name, None)
        if equivalent is None or name == "L_q":
            continue
        expected = equivalent - HALF_FRAME if name == "delay" else equivalent
        sigmas = (value - expected) / std
        if abs(sigmas) > NOTABLE_SIGMAS:
            rows.append(BiasRow(name, value, expected, sigmas))
    return tuple(rows)


def not_identifiable(estimate: Estimate) -> tuple[tuple[str, str, float], ...]:
    """Return the parameters that are not identifiable, each with its largest correlation.

    They are those smaller than two of their sigmas, and always L_delta.
    """
    out = []
    for i, name in enumerate(estimate.names):
        if name in ("L_0", "M_0", "delta_0", "nz_0"):
            continue
        small = abs(estimate.values[i]) < NOTABLE_SIGMAS * estimate.std[i]
        if small or name == "L_delta":
            row = estimate.correlation[i].copy()
            row[i] = 0.0
            j = int(abs(row).argmax())
            out.append((name, estimate.names[j], float(row[j])))
    return tuple(out)


def sentences(study: LoopStudy) -> tuple[str, ...]:
    """Return the findings beyond the tables, each sentence with the study's own numbers."""
    bank, out = study.result.bank, []
    sigma = (
        f" +- {bank.refined_std:.4f}" if bank.refined_std > 0 else " (no maximum inside the grid)"
    )
    out.append(
        f"delay: most likely of the bank {bank.most_likely:.3f} s, likelihood-weighted sum "
        f"{bank.weighted_mean:.4f} s, "
        f"refined between the grid points {bank.refined:.4f}{sigma} s; one delay holds "
        f"{100 * float(bank.weights.max()):.1f} % of the weight"
    )
    rows = bias_rows(study) if study.result.simulated.truth is not None else ()
    if study.result.simulated.truth is not None:
        listed = "; ".join(
            f"{r.name} {r.estimate:.4g} against {r.equivalent:.4g} ({r.sigmas:+.1f} sigmas)"
            for r in rows
        )
        equivalent = f"the loop's own equivalent with the flown L_q, {study.check.flown.L_q:g}"
        out.append(
            f"bias of a model of low order against {equivalent}, beyond two sigmas of white "
            f"innovations: {listed or 'none'}"
        )
    contradicted_parameters = [f"{name} ({sigmas:+.1f})" for name, sigmas in bank.contradicted]
    if contradicted_parameters:
        out.append(
            "P0 contradicts the record, ends in its sigmas from the start: "
            f"{', '.join(contradicted_parameters)}; the start holds these back, a restart moves on"
        )
    for name, other, r in not_identifiable(study.result.estimate):
        holds = (
            "; it holds the bias of the model's order" if name in {row.name for row in rows} else ""
        )
        out.append(
            f"{name} is not identifiable on this record: its correlation with {other} is "
            f"{r:+.2f}{holds}"
        )
    record, own_frequency = study.check.record, study.result.quality("natural_frequency")
    if (
        record is not None
        and own_frequency is not None
        and abs(record["natural_frequency"] / own_frequency.value - 1.0)
        > DISAGREEING_FREQUENCY_SHARE
    ):
        off = 100.0 * (record["natural_frequency"] / own_frequency.value - 1.0)
        out.append(
            f"the record's spectra give a frequency of {record['natural_frequency']:.3f} rad/s, "
            f"{off:+.0f} % from the filter's: noise, a spike, "
            "a window that begins in motion or a stick that is not linear may disturb them; "
            f"the loop's own response says {study.check.loop.natural_frequency:.3f} rad/s"
        )
    if study.linear is not None:
        out.append(linear_sentence(study.linear))
    if study.engines is not None:
        engines = study.engines
        out.append(
            f"{study.scenario.estimation.engine}, filter by filter, against the batched bank at "
            f"the same {len(bank.delays)} delays: means differ by "
            f"{engines.mean:.0e} sigmas at most, sigmas by {engines.std:.0e} and "
            f"log-likelihoods by {engines.log_likelihood:.0e} of themselves"
        )
    out += _margins(study)
    if study.scenario.published:
        out.append(
            "published L_delta, M_delta and delta_0 are shown with the opposite sign, as "
            "the published pseudo-control has it"
        )
    return (*out, *verdicts(study))


def _margins(study: LoopStudy) -> list[str]:
    """Return sentences on the margins of the loops, and the effects of unpublished values."""
    if len(study.margins) < 2:
        return []
    (name, margins), (other_name, other), *further = study.margins.items()
    texts = [
        f"{airframe} {each.gain_decrease:.1f}/{each.gain_increase:+.1f} dB and {each.phase:.1f} deg"
        for airframe, each in study.margins.items()
    ]
    word = "larger" if margins.phase > other.phase else "smaller"
    out = (
        f"margins of the loop broken at the command: {', '.join(texts)}; the phase margin of "
        f"{name} is {word} than that of {other_name}"
    )
    column = study.scenario.column
    for name, margins in further:
        larger = "larger" if margins.phase > other.phase else "smaller"
        same = column in FLIGHTS and has_equivalent(load_x29(name), targets(column))
        out += (
            ", that of "
            f"{name}{', whose low-order equivalent is the published one as well,' if same else ''} "
            f"{larger}"
        )
    return [out, *([] if study.open_margins is None else [margins_sentence(study.open_margins)])]
