"""Ranks all candidates at a fitted model by projected score: what each could explain that the fitted model's own parameters cannot.

The residual and the candidates' signatures are whitened and projected off the fitted model's Jacobian: a refit would absorb
the rest. gain = -(N/2) ln(1 - explained share) (score test with nuisance parameters projected out).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel, belongs_to_record, compiled_with
from ident.tracing.screening.alternative_outputs import alternative_outputs
from ident.whole_record.record_problem import record_problem
from sim.declaration.effect import full_name
from sim.declaration.proposal import Probe, SearchContext, Traceable, fitted_to
from sim.errors import ModelError


@dataclass(frozen=True, eq=False)
class Finding:
    """A candidate's best places at a fitted model.

    ``gain`` of the log likelihood at the best; ``starts`` full name -> value, the best places first, the amplitudes as the
    projection has them; ``contribution`` what the best would add to the whitened, projected outputs, ``(D,)``.
    """

    effect: Traceable
    gain: float
    parameters: int
    starts: tuple[Mapping[str, float], ...]
    gains: tuple[float, ...]
    contribution: np.ndarray


@dataclass(frozen=True, eq=False)
class _Whitened:
    """The fitted model's residual ``e (D,)``, orthonormal basis of its Jacobian ``Q (D, n)``, and the rows of each record."""

    e: np.ndarray
    Q: np.ndarray
    rows: tuple[slice, ...]


def screen(fitted: FittedModel, candidates: Sequence[Traceable], context: SearchContext, most: int = 3) -> list[Finding]:
    """Findings for all candidates that can act on the fitted model, the largest gain first.

    An effect whose signature is nothing, or points the unphysical way, is left out.
    """
    white = _whitened(fitted)
    findings = []
    for candidate in candidates:
        if candidate.name in fitted.names:
            continue
        found = _find(fitted, white, fitted_to(candidate, context), context, most)
        if found is not None:
            findings.append(found)
    return sorted(findings, key=lambda finding: -finding.gain)


def collinear(a: Finding, b: Finding) -> float:
    """Cosine between what two candidates would add to the projected outputs."""
    size = np.linalg.norm(a.contribution) * np.linalg.norm(b.contribution)
    return float(abs(a.contribution @ b.contribution) / size) if size > 0 else 0.0


def _whitened(fitted: FittedModel) -> _Whitened:
    fit, layout = fitted.fit, fitted.fit.layout
    sizes = [problem.valid.size for problem in layout.problems]
    ends = np.cumsum(sizes)
    rows = tuple(slice(int(end - size), int(end)) for size, end in zip(sizes, ends, strict=True))
    J = np.zeros((int(ends[-1]), len(fit.theta)))
    e = np.zeros(int(ends[-1]))
    for r, (problem, at) in enumerate(zip(layout.problems, rows, strict=True)):
        w = np.where(problem.valid, 1.0 / np.sqrt(fit.variance)[:, None], 0.0)
        J[at, layout.columns(r)] = (fit.jacobians[r] * w[:, :, None]).reshape(sizes[r], -1)
        e[at] = (fit.residuals[r] * w).ravel()
    scale = np.linalg.norm(J, axis=0)
    acting = scale > 0
    Q, _ = np.linalg.qr(J[:, acting] / scale[acting])
    return _Whitened(e - Q @ (Q.T @ e), Q, rows)


def _find(fitted: FittedModel, white: _Whitened, effect: Traceable, context: SearchContext, most: int) -> Finding | None:
    probes = tuple(effect.probes(context))
    if not probes:
        return None
    try:
        signatures = _signatures(fitted, effect, probes)
    except ModelError:
        return None
    apart, onset = belongs_to_record(effect) and len(white.rows) > 1, effect.traits.onset
    total = float(white.e @ white.e)
    N = float(fitted.fit.counts.sum())
    results = []
    spans = white.rows if apart else (slice(None),)
    for probe, parts in zip(probes, signatures, strict=True):
        places = _places(fitted, probe, onset)
        flat = _placed(fitted, parts, white, places)
        k = len(flat) // len(places)
        gains, amplitudes, each = np.zeros(len(places)), np.zeros((len(places), k)), []
        for rows in spans:
            share, a = _explained(white, rows, flat, k, total)
            gain = -0.5 * N * np.log1p(-np.minimum(share, 0.999999))
            amplitudes = np.where((gain > gains)[:, None], a, amplitudes)
            gains = gains + gain
            each.append((rows, a))
        for place in np.argsort(-gains)[: 2 * most]:
            values = dict(probe.values)
            if probe.shifts:
                values[onset] = values[onset] + places[place] * context.interval
            start = _start(effect, Probe(values, probe.slopes), amplitudes[place])
            if start is not None and gains[place] > 0:
                results.append((float(gains[place]), start, _added(white, flat[place * k : (place + 1) * k], each, int(place))))
    if not results:
        return None
    results.sort(key=lambda result: -result[0])
    distinct: list[tuple[float, Mapping[str, float], np.ndarray]] = []
    for result in results:
        if all(_differs(result[2], other[2]) for other in distinct):
            distinct.append(result)
        if len(distinct) == most:
            break
    count = sum(1 for item in effect.parameters if item.free) * (len(white.rows) if apart else 1)
    return Finding(effect, distinct[0][0], count, tuple(r[1] for r in distinct), tuple(r[0] for r in distinct), distinct[0][2])


def _places(fitted: FittedModel, probe: Probe, onset: str) -> list[int]:
    """By how many samples a probe's signature is moved: over the whole record where it merely shifts with the onset."""
    if not (probe.shifts and onset):
        return [0]
    longest = max(len(problem.record) for problem in fitted.fit.layout.problems)
    return list(range(0, longest - 2, max(1, longest // thresholds.PLACES)))


def _placed(fitted: FittedModel, parts: Sequence[np.ndarray], white: _Whitened, places: Sequence[int]) -> np.ndarray:
    """Whitened signature at each place, ``(places k, D)``, the columns of a place one behind the other.

    A later onset only shifts a signature, by whole samples here: the fit that follows moves it by fractions.
    """
    k = parts[0].shape[2]
    out = np.zeros((len(places) * k, len(white.e)))
    for r, (part, rows) in enumerate(zip(parts, white.rows, strict=True)):
        m, N = part.shape[:2]
        turned = part.transpose(2, 0, 1)
        moved = np.zeros((len(places), k, m, N))
        for number, shift in enumerate(places):
            if shift < N:
                moved[number, :, :, shift:] = turned[:, :, : N - shift]
        whitened = fitted.fit.whiten(r, moved.reshape(-1, m, N).transpose(1, 2, 0))
        out[:, rows] = whitened.transpose(2, 0, 1).reshape(-1, m * N)
    return out


def _explained(white: _Whitened, rows: slice, flat: np.ndarray, k: int, total: float) -> tuple[np.ndarray, np.ndarray]:
    """For each place, acting on ``rows`` alone: share of the residual that its columns explain, and their amplitudes ``(places, k)``.

    The residual is orthogonal to the fitted model's Jacobian, so that only sizes of the projected columns are needed.
    """
    block, Q, e = flat[:, rows], white.Q[rows], white.e[rows]
    places = len(block) // k
    columns, inside = block.reshape(places, k, -1), (block @ Q).reshape(places, k, -1)
    whole = columns @ columns.swapaxes(1, 2)
    raw, gram = np.einsum("pii->pi", whole), whole - inside @ inside.swapaxes(1, 2)
    size = np.sqrt(np.maximum(np.einsum("pii->pi", gram), 0.0))
    # What the fitted model's own parameters explain but for rounding is no signature.
    sound = np.isfinite(size) & (size > 1e-5 * np.sqrt(raw)) & (size > 0)
    scale = np.where(sound, 1.0 / np.where(sound, size, 1.0), 0.0)
    b = (block @ e).reshape(places, k) * scale
    unit = gram * scale[:, :, None] * scale[:, None, :] + np.eye(k) * (1e-9 + ~sound[:, None, :])
    coefficients = np.linalg.solve(np.where(np.isfinite(unit), unit, 0.0) + np.eye(k) * ~np.isfinite(unit), np.nan_to_num(b)[:, :, None])[:, :, 0]
    share = np.clip(np.einsum("pk,pk->p", coefficients, np.nan_to_num(b)) / total, 0.0, 1.0)
    return share, coefficients * scale


def _added(white: _Whitened, columns: np.ndarray, each: Sequence[tuple[slice, np.ndarray]], place: int) -> np.ndarray:
    """What one place adds to the projected outputs, ``(D,)``."""
    out = np.zeros(len(white.e))
    for rows, amplitudes in each:
        out[rows] += amplitudes[place] @ columns[:, rows]
    return out - white.Q @ (white.Q.T @ out)


def _signatures(fitted: FittedModel, effect: Traceable, probes: Sequence[Probe]) -> list[list[np.ndarray]]:
    """For each probe the columns ``(m, N, k)`` of every record."""
    outputs = [signal.name for signal in fitted.system.outputs]
    _, system = compiled_with(fitted.model, [effect], outputs)
    layout = fitted.fit.layout
    columns, where = _alternatives(effect, probes, system.parameters.names)
    blocks: list[list[np.ndarray]] = [[] for _ in probes]
    for r, old in enumerate(layout.problems):
        p, _ = layout.split(fitted.fit.theta, r)
        known = dict(zip(layout.system.parameters.names, p.tolist(), strict=True))
        base = np.array([known.get(item.name, item.value) for item in system.parameters])
        for local, value in effect.absent.items():
            base[system.parameters.index(full_name(effect, local))] = value
        alternatives = np.repeat(base[:, None], len(columns), axis=1)
        for column, values in enumerate(columns):
            for name, value in values.items():
                alternatives[system.parameters.index(name), column] = value
        problem = record_problem(old.record, system, max(layout.settings.max_step, thresholds.COARSE), (), (), valid=old.valid)
        states = dict(zip(layout.system.state_names, fitted.fit.lines[r].states, strict=True))
        trajectory = np.array([states[name] if name in states else np.zeros(len(old.grid.nodes)) for name in system.state_names])
        y, changed = alternative_outputs(problem, base, trajectory, alternatives, len(layout.system.states))
        for number, (first, count, reference, step) in enumerate(where):
            zero = y[:, :, None] if reference < 0 else changed[:, :, reference : reference + 1]
            blocks[number].append((changed[:, :, first : first + count] - zero) / step)
    return blocks


def _alternatives(
    effect: Traceable, probes: Sequence[Probe], names: Sequence[str]
) -> tuple[list[dict[str, float]], list[tuple[int, int, int, np.ndarray]]]:
    """Parameter values of every column, and for each probe: its first column, their number, the reference's column (-1: the base), steps."""
    size = {item.name: abs(item.value) or 1.0 for item in effect.parameters}
    columns: list[dict[str, float]] = []
    where = []
    for probe in probes:
        full = {full_name(effect, local): value for local, value in probe.values.items()}
        if not probe.slopes:
            where.append((len(columns), 1, -1, np.ones(1)))
            columns.append(full)
            continue
        reference = -1
        if any(probe.values.get(local) != value for local, value in effect.absent.items()):
            reference = len(columns)
            columns.append(full)
        steps = np.array([thresholds.SLOPE_STEP * size[local] for local in probe.slopes])
        where.append((len(columns), len(steps), reference, steps))
        columns += [{**full, full_name(effect, local): probe.values[local] + step} for local, step in zip(probe.slopes, steps.tolist(), strict=True)]
    return columns, where


def _start(effect: Traceable, probe: Probe, amplitudes: np.ndarray) -> dict[str, float] | None:
    """Where a full fit begins; None where the projection points the unphysical way."""
    bounds = {item.name: item.bounds for item in effect.parameters}
    values = dict(probe.values)
    if not probe.slopes and amplitudes[0] <= 0.0:
        return None
    for local, amplitude in zip(probe.slopes, amplitudes.tolist(), strict=False):
        low, high = bounds[local]
        moved = values[local] + amplitude
        if len(probe.slopes) == 1 and (moved < low or moved > high) and not low < values[local] < high and (amplitude < 0) == (values[local] <= low):
            return None
        values[local] = float(np.clip(moved, low, high))
    return {full_name(effect, local): float(np.clip(value, *bounds[local])) for local, value in values.items()}


def _differs(a: np.ndarray, b: np.ndarray) -> bool:
    size = np.linalg.norm(a) * np.linalg.norm(b)
    return bool(size > 0 and abs(a @ b) < thresholds.DISTINCT * size)
