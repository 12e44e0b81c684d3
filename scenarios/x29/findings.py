"""What a study of the closed loop says beyond its tables: bias of the model's order, what is not identifiable, margins, delays."""

from __future__ import annotations

from dataclasses import dataclass

from ident.estimate import Estimate
from scenarios.x29.loop.linear_check import linear_sentence
from scenarios.x29.loop.matching import FLIGHTS, has_equivalent, targets
from scenarios.x29.loop.open_margins import margins_sentence
from scenarios.x29.paper.sentences import paper_sentences
from scenarios.x29.study import LoopStudy
from scenarios.x29.verdicts import HALF_FRAME, verdicts
from sim.closed_loop.airframe import load_x29

BEYOND = 2.0  # sigmas
DISAGREE = 0.1  # of a frequency
PAPER_PHASE = "the paper saw its larger damping in flight as a larger phase margin too"


@dataclass(frozen=True)
class BiasRow:
    """An estimate that differs from the loop's low-order equivalent with the flown L_q by more than its sigma tells."""

    name: str
    estimate: float
    equivalent: float
    sigmas: float


def bias_rows(study: LoopStudy) -> tuple[BiasRow, ...]:
    """Differences beyond two sigmas. Sigmas are those of white innovations: the rest is the bias of a model of low order.
    The equivalent holds L_q at what flies, which the filter finds: held elsewhere it has another L_alpha. L_q itself is left out."""
    estimate, rows = study.result.estimate, []
    for name, value, std in zip(estimate.names, estimate.values.tolist(), estimate.std.tolist(), strict=True):
        equivalent = getattr(study.check.flown, name, None)
        if equivalent is None or name == "L_q":
            continue
        expected = equivalent - HALF_FRAME if name == "delay" else equivalent
        sigmas = (value - expected) / std
        if abs(sigmas) > BEYOND:
            rows.append(BiasRow(name, value, expected, sigmas))
    return tuple(rows)


def not_identifiable(estimate: Estimate) -> tuple[tuple[str, str, float], ...]:
    """Parameters smaller than two of their sigmas, or L_delta, whatever its size, each with its strongest correlation."""
    out = []
    for i, name in enumerate(estimate.names):
        if name in ("L_0", "M_0", "delta_0", "nz_0"):
            continue
        small = abs(estimate.values[i]) < BEYOND * estimate.std[i]
        if small or name == "L_delta":
            row = estimate.correlation[i].copy()
            row[i] = 0.0
            j = int(abs(row).argmax())
            out.append((name, estimate.names[j], float(row[j])))
    return tuple(out)


def sentences(study: LoopStudy) -> tuple[str, ...]:
    """What the tables do not say by themselves, each sentence from the study's own numbers."""
    bank, out = study.result.bank, []
    sure = f" +- {bank.refined_std:.4f}" if bank.refined_std > 0 else " (no maximum inside the grid)"
    out.append(
        f"delay: most likely of the bank {bank.most_likely:.3f} s, likelihood-weighted sum {bank.weighted_mean:.4f} s, "
        f"refined between the grid points {bank.refined:.4f}{sure} s; one delay holds {100 * float(bank.weights.max()):.1f} % of the weight"
    )
    rows = bias_rows(study) if study.result.flown.truth is not None else ()
    if study.result.flown.truth is not None:
        listed = "; ".join(f"{r.name} {r.estimate:.4g} against {r.equivalent:.4g} ({r.sigmas:+.1f} sigmas)" for r in rows)
        held = f"the loop's own equivalent with the flown L_q, {study.check.flown.L_q:g}"
        out.append(f"bias of a model of low order against {held}, beyond two sigmas of white innovations: {listed or 'none'}")
    held_back = [f"{name} ({sigmas:+.1f})" for name, sigmas in bank.contradicted]
    if held_back:
        out.append(
            f"P0 contradicts the record, ends in its sigmas from the start: {', '.join(held_back)}; the start holds these back, a restart moves on"
        )
    for name, other, r in not_identifiable(study.result.estimate):
        holds = "; it holds the bias of the model's order" if name in {row.name for row in rows} else ""
        out.append(f"{name} is not identifiable on this record: its correlation with {other} is {r:+.2f}{holds}")
    record, own_frequency = study.check.record, study.result.quality("natural_frequency")
    if record is not None and own_frequency is not None and abs(record["natural_frequency"] / own_frequency.value - 1.0) > DISAGREE:
        off = 100.0 * (record["natural_frequency"] / own_frequency.value - 1.0)
        out.append(
            f"the record's spectra give a frequency of {record['natural_frequency']:.3f} rad/s, {off:+.0f} % from the filter's: noise, a spike, "
            "a window that begins in motion or a stick that is not linear may disturb them; "
            f"the loop's own response says {study.check.loop.natural_frequency:.3f} rad/s"
        )
    if study.linear is not None:
        out.append(linear_sentence(study.linear))
    if study.engines is not None:
        apart = study.engines
        out.append(
            f"{study.scenario.estimation.engine}, filter by filter, against the batched bank at the same {len(bank.delays)} delays: means differ by "
            f"{apart.mean:.0e} sigmas at most, sigmas by {apart.std:.0e} and log-likelihoods by {apart.log_likelihood:.0e} of themselves"
        )
    out += _margins(study)
    if study.scenario.published:
        out.append("published L_delta, M_delta and delta_0 are shown with the sign turned: the paper's pseudo-control is minus ours")
    return (*out, *verdicts(study), *paper_sentences(study))


def _margins(study: LoopStudy) -> list[str]:
    """Margins of the two loops and of one beside them, against what the paper saw, and what it leaves open."""
    if len(study.margins) < 2:
        return []
    (own, mine), (against, theirs), *beside = study.margins.items()
    told = [f"{name} {each.gain_decrease:.1f}/{each.gain_increase:+.1f} dB and {each.phase:.1f} deg" for name, each in study.margins.items()]
    word = "larger" if mine.phase > theirs.phase else "smaller"
    out = f"margins of the loop broken at the command: {', '.join(told)}; {PAPER_PHASE}: that of {own} is {word} than that of {against}"
    for name, each in beside:
        larger = "larger" if each.phase > theirs.phase else "smaller"
        column = study.scenario.published[0] if study.scenario.published else ""
        same = column in FLIGHTS and has_equivalent(load_x29(name), targets(column))
        out += f", that of {name}{', whose low-order equivalent is the published one as well,' if same else ''} {larger}"
    return [out, *([] if study.open_margins is None else [margins_sentence(study.open_margins)])]
