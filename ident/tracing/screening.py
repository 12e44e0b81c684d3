"""Ranks all candidates at a node by projected score: what each could explain that the node's own parameters cannot.

The residual and the candidates' signatures are whitened and projected off the node's Jacobian: a refit would eat
the rest. gain = -(N/2) ln(1 - explained share) (score test with nuisance parameters projected out).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing.node import Node, belongs_to_record, compiled_with
from ident.tracing.responses import alternative_outputs
from ident.whole_record import record_problem
from sim.effect import Effect, full_name
from sim.errors import ModelError
from sim.tracing import Occasion, Probe, fitted_to

SLOPE_STEP = 1e-4  # of a parameter's declared size
PLACES = 120  # over the record, for effects that may begin anywhere


@dataclass(frozen=True, eq=False)
class Finding:
    """A candidate's best places at a node.

    ``gain`` of the log likelihood at the best; ``starts`` full name -> value, the best places first, the amplitudes as the
    projection has them; ``contribution`` what the best would add to the whitened, projected outputs, ``(D,)``.
    """

    effect: Effect
    gain: float
    parameters: int
    starts: tuple[Mapping[str, float], ...]
    gains: tuple[float, ...]
    contribution: np.ndarray


@dataclass(frozen=True, eq=False)
class _Whitened:
    """The node's residual ``e (D,)``, orthonormal basis of its Jacobian ``Q (D, n)``, and where each record stands."""

    e: np.ndarray
    Q: np.ndarray
    weight: tuple[np.ndarray, ...]
    rows: tuple[slice, ...]


def screen(node: Node, candidates: Sequence[Effect], occasion: Occasion, most: int = 3) -> list[Finding]:
    """Findings for all candidates that can act on the node's model, the largest gain first.

    An effect whose signature is nothing, or points the unphysical way, is left out.
    """
    white = _whitened(node)
    findings = []
    for candidate in candidates:
        if candidate.name in node.names:
            continue
        found = _find(node, white, fitted_to(candidate, occasion), occasion, most)
        if found is not None:
            findings.append(found)
    return sorted(findings, key=lambda finding: -finding.gain)


def collinear(a: Finding, b: Finding) -> float:
    """Cosine between what two candidates would add to the projected outputs."""
    size = np.linalg.norm(a.contribution) * np.linalg.norm(b.contribution)
    return float(abs(a.contribution @ b.contribution) / size) if size > 0 else 0.0


def _whitened(node: Node) -> _Whitened:
    fit, layout = node.fit, node.fit.layout
    weight, rows, parts, at = [], [], [], 0
    n = len(fit.theta)
    J = np.zeros((int(sum(problem.valid.size for problem in layout.problems)), n))
    for r, (problem, line) in enumerate(zip(layout.problems, fit.lines, strict=True)):
        w = np.where(problem.valid, 1.0 / np.sqrt(fit.variance)[:, None], 0.0)
        size = w.size
        weight.append(w)
        rows.append(slice(at, at + size))
        parts.append((fit.residuals[r] * w).ravel())
        J[at : at + size, layout.columns(r)] = (line.jacobian * w[:, :, None]).reshape(size, -1)
        at += size
    scale = np.linalg.norm(J, axis=0)
    Q, _ = np.linalg.qr(J / np.where(scale > 0, scale, 1.0))
    e = np.concatenate(parts)
    return _Whitened(e - Q @ (Q.T @ e), Q, tuple(weight), tuple(rows))


def _find(node: Node, white: _Whitened, effect: Effect, occasion: Occasion, most: int) -> Finding | None:
    probes = tuple(effect.probes(occasion))  # type: ignore[attr-defined]
    if not probes:
        return None
    try:
        signatures = _signatures(node, effect, probes)
    except ModelError:
        return None
    apart = belongs_to_record(effect) and len(white.rows) > 1
    total = float(white.e @ white.e)
    N = float(node.fit.counts.sum())
    results = []
    for probe, C in _placed(node, white, effect, probes, signatures):
        gain, amplitudes, contribution = 0.0, np.zeros(C.shape[1]), np.zeros(len(white.e))
        for rows in white.rows if apart else (slice(None),):
            block = np.zeros_like(C)
            block[rows] = C[rows]
            block -= white.Q @ (white.Q.T @ block)
            share, a, f = _explained(white.e, block, total)
            if share * N > 2.0 * gain:
                amplitudes = a
            gain += -0.5 * N * np.log1p(-min(share, 0.999999))
            contribution += f
        start = _start(effect, probe, amplitudes)
        if start is not None and gain > 0:
            results.append((gain, start, contribution))
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
    starts, gains = tuple(result[1] for result in distinct), tuple(float(result[0]) for result in distinct)
    return Finding(effect, gains[0], count, starts, gains, distinct[0][2])


def _placed(
    node: Node, white: _Whitened, effect: Effect, probes: Sequence[Probe], signatures: Sequence[Sequence[np.ndarray]]
) -> Iterator[tuple[Probe, np.ndarray]]:
    """Every probe with its whitened columns ``(D, k)``; one with an onset at all its places over the record.

    A later onset only shifts a signature, by whole samples here: the fit that follows moves it by fractions.
    """
    onset = getattr(effect, "onset", "")
    times = [problem.record.time for problem in node.fit.layout.problems]
    for probe, parts in zip(probes, signatures, strict=True):
        shifts = [0]
        if probe.shifts:
            shifts = list(range(0, max(len(time) for time in times) - 2, max(1, max(len(time) for time in times) // PLACES)))
        for shift in shifts:
            moved = [_later(part, shift) for part in parts]
            columns = np.concatenate([(part * w[:, :, None]).reshape(-1, part.shape[2]) for part, w in zip(moved, white.weight, strict=True)])
            values = dict(probe.values)
            if probe.shifts:
                step = float(np.median(np.diff(times[0])))
                values[onset] = values[onset] + shift * step
            yield Probe(values, probe.slopes, probe.shifts), columns


def _later(part: np.ndarray, shift: int) -> np.ndarray:
    """A signature ``(m, N, k)`` later by whole samples, nothing before it."""
    if shift == 0:
        return part
    out = np.zeros_like(part)
    out[:, shift:] = part[:, :-shift] if shift < part.shape[1] else 0.0
    return out


def _explained(e: np.ndarray, block: np.ndarray, total: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Share of the residual that the columns explain, their amplitudes, and what they add."""
    size = np.linalg.norm(block, axis=0)
    if not np.all(np.isfinite(size)) or np.max(size, initial=0.0) <= 1e-9 * np.sqrt(len(e)):
        return 0.0, np.zeros(block.shape[1]), np.zeros(len(e))
    scaled = block / np.where(size > 0, size, 1.0)
    gram = scaled.T @ scaled + 1e-9 * np.eye(block.shape[1])
    b = np.linalg.solve(gram, scaled.T @ e)
    f = scaled @ b
    return max(0.0, min(1.0, float(f @ e) / total)), b / np.where(size > 0, size, 1.0), f


def _signatures(node: Node, effect: Effect, probes: Sequence[Probe]) -> list[list[np.ndarray]]:
    """For each probe the columns ``(m, N, k)`` of every record."""
    outputs = [signal.name for signal in node.system.outputs]
    _, system = compiled_with(node.model, [effect], outputs)
    layout = node.fit.layout
    columns, where = _alternatives(effect, probes, system.parameters.names)
    blocks: list[list[np.ndarray]] = [[] for _ in probes]
    for r, old in enumerate(layout.problems):
        p, _ = layout.split(node.fit.theta, r)
        known = dict(zip(layout.system.parameters.names, p.tolist(), strict=True))
        base = np.array([known.get(item.name, item.value) for item in system.parameters])
        for local, value in effect.absent.items():
            base[system.parameters.index(full_name(effect, local))] = value
        alternatives = np.repeat(base[:, None], len(columns), axis=1)
        for column, values in enumerate(columns):
            for name, value in values.items():
                alternatives[system.parameters.index(name), column] = value
        problem = record_problem(old.record, system, layout.settings.max_step, (), (), valid=old.valid)
        states = dict(zip(layout.system.state_names, node.fit.lines[r].states, strict=True))
        trajectory = np.array([states[name] if name in states else np.zeros(len(old.grid.nodes)) for name in system.state_names])
        y, changed = alternative_outputs(problem, base, trajectory, alternatives)
        for number, (first, count, reference, step) in enumerate(where):
            zero = y[:, :, None] if reference < 0 else changed[:, :, reference : reference + 1]
            blocks[number].append((changed[:, :, first : first + count] - zero) / step)
    return blocks


def _alternatives(
    effect: Effect, probes: Sequence[Probe], names: Sequence[str]
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
        steps = np.array([SLOPE_STEP * size[local] for local in probe.slopes])
        where.append((len(columns), len(steps), reference, steps))
        columns += [{**full, full_name(effect, local): probe.values[local] + step} for local, step in zip(probe.slopes, steps.tolist(), strict=True)]
    return columns, where


def _start(effect: Effect, probe: Probe, amplitudes: np.ndarray) -> dict[str, float] | None:
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
    return bool(size > 0 and abs(a @ b) < 0.95 * size)
