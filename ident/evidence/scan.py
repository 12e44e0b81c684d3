"""Every candidate at a linearised set of effects: what it would add to the outputs, and its gain."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ident.evidence.priors import SetPrior, prior_of
from ident.tracing.candidate_model.fitted_model import belongs_to_record
from ident.tracing.screening.score_test import _motions, _signatures
from sim.declaration.effect import NoiseEffect
from sim.declaration.proposal import Probe, SearchContext, Traceable, fitted_to
from sim.errors import ModelError

PLACES = 60  # of an event over a record
AMPLITUDE = 0.4  # one sigma of a placed size about the place, as a share


@dataclass(frozen=True, eq=False)
class Lead:
    """One placed alternative of a candidate.

    ``columns`` : whitened, ``(D, k)``, all records and outputs below each other. ``probes`` : where it
    is placed, a record each (None: absent there); ``shifts`` in samples. ``mean``, ``sigma (k,)`` : prior of
    the columns' factors. ``price`` : log prior of its place. ``gain`` : of log evidence, alone.
    ``own`` : ``(k,)``, the record that a column belongs to, or -1 where all share its factor.
    """

    effect: Traceable
    columns: np.ndarray
    probes: tuple[Probe | None, ...]
    shifts: tuple[int, ...]
    mean: np.ndarray
    sigma: np.ndarray
    own: np.ndarray
    price: float
    gain: float


@dataclass(frozen=True, eq=False)
class Prepared:
    """A linearised set, whitened: ``A (D, n)`` scaled by the posterior's root, ``e (D,)``, ``rows`` of each record."""

    root: np.ndarray
    e: np.ndarray
    rows: tuple[slice, ...]
    whiten: Callable[[int, np.ndarray], np.ndarray]


def prepared(fitted: FittedModel, prior: SetPrior) -> Prepared:
    """The same of a fit under white noise, or of one with process noise, whose innovations are white."""
    fit, layout = fitted.fit, fitted.fit.layout
    n = len(fit.theta)
    blocks_e, blocks_A, rows, at = [], [], [], 0
    for r, problem in enumerate(layout.problems):
        weight = np.where(problem.valid, 1.0 / np.sqrt(fit.variance)[:, None], 0.0)
        blocks_e.append((fit.residuals[r] * weight).ravel())
        A = np.zeros((problem.valid.size, n))
        A[:, layout.columns(r)] = (fit.jacobians[r] * weight[:, :, None]).reshape(problem.valid.size, -1)
        blocks_A.append(A)
        rows.append(slice(at, at + problem.valid.size))
        at += problem.valid.size
    e, A = np.concatenate(blocks_e), np.concatenate(blocks_A)
    precision = A.T @ A + np.diag(prior.precision)
    right = A.T @ e + prior.precision * prior.mean
    scale = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-300))
    lower = np.linalg.cholesky(precision * np.outer(scale, scale) + 1e-10 * np.eye(n))
    root = np.linalg.solve(lower, (A * scale).T).T
    offset = scale * np.linalg.solve(lower.T, np.linalg.solve(lower, scale * right))

    def whiten(r: int, columns: np.ndarray) -> np.ndarray:
        valid = layout.problems[r].valid[:, :, None]
        made = fit.whiten(r, np.where(valid, columns, 0.0))
        return np.asarray(np.where(valid, made, 0.0).reshape(-1, columns.shape[2]))

    return Prepared(root, e - A @ offset, tuple(rows), whiten)


def closed_form(gram: np.ndarray, with_e: np.ndarray, mean: np.ndarray, sigma: np.ndarray) -> tuple[float, np.ndarray]:
    """Gain of log evidence by columns with factors N(mean, sigma^2), and the factors' posterior mean.

    ``gram (k, k)`` and ``with_e (k,)`` are projected off the set's own unknowns.
    """
    S = gram + np.diag(sigma**-2.0)
    h = with_e + mean / sigma**2
    scale = 1.0 / np.sqrt(np.diag(S))
    try:
        root = np.linalg.cholesky(S * np.outer(scale, scale) + 1e-10 * np.eye(len(S)))
    except np.linalg.LinAlgError:
        return -1e9, np.zeros(len(S))
    half = np.linalg.solve(root, scale * h)
    logdet = 2.0 * float(np.sum(np.log(np.diag(root))) - np.sum(np.log(scale)))
    gain = 0.5 * float(half @ half) - 0.5 * float(np.sum((mean / sigma) ** 2))
    return gain - 0.5 * logdet - float(np.sum(np.log(sigma))), scale * np.linalg.solve(root.T, half)


def closed_forms(
    grams: np.ndarray, with_e: np.ndarray, mean: np.ndarray, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same for many places at once: ``grams (p, k, k)``, ``with_e (p, k)``; gains ``(p,)`` and factors ``(p, k)``."""
    S = grams + np.diag(sigma**-2.0)
    h = with_e + mean / sigma**2
    scale = 1.0 / np.sqrt(np.einsum("pkk->pk", S))
    inside = S * scale[:, :, None] * scale[:, None, :] + 1e-10 * np.eye(S.shape[1])
    values, vectors = np.linalg.eigh(inside)
    values = np.maximum(values, 1e-12)
    turned = np.einsum("pji,pj->pi", vectors, scale * h)
    gain = 0.5 * np.sum(turned**2 / values, axis=1) - 0.5 * float(np.sum((mean / sigma) ** 2))
    gain -= 0.5 * np.sum(np.log(values), axis=1) - np.sum(np.log(scale), axis=1) + float(np.sum(np.log(sigma)))
    return gain, scale * np.einsum("pij,pj->pi", vectors, turned / values)


def scan(fitted: FittedModel, several: Sequence[Prepared], candidates: Sequence[Traceable], context: SearchContext, keep: int = 2) -> list[list[Lead]]:
    """Leads of all candidates, a list for each of ``several`` noise laws: of each the best ``keep`` places."""
    motions = _motions(fitted)
    present = {effect.name for effect in fitted.effects}
    found: list[list[Lead]] = [[] for _ in several]
    for candidate in candidates:
        if candidate.name in present or isinstance(candidate, NoiseEffect):
            continue
        effect = fitted_to(candidate, context)
        probes = tuple(effect.probes(context))
        if not probes:
            continue
        try:
            parts = _signatures(fitted, motions, effect, probes)
        except (ModelError, FloatingPointError):
            continue
        usable = [(p, x) for p, x in zip(probes, parts, strict=True) if all(np.all(np.isfinite(y)) and np.max(np.abs(y), initial=0.0) < 1e6 for y in x)]
        if not usable:
            continue
        for leads, ready in zip(found, several, strict=True):
            leads += _leads(ready, effect, usable, context, keep)
    return found


def amplitude_prior(effect: Traceable, probe: Probe, context: SearchContext) -> tuple[np.ndarray, np.ndarray]:
    """Mean and sigma of the factors of a probe's columns."""
    if not probe.slopes:
        return np.ones(1), np.full(1, AMPLITUDE)
    items = {item.name: item for item in effect.parameters}
    means, sigmas = [], []
    for local in probe.slopes:
        known = prior_of(effect, items[local], probe.values[local], context)
        means.append(known.mean - probe.values[local] if known else 0.0)
        sigmas.append(known.sigma if known else 1e3 * max(abs(items[local].value), 1e-6))
    return np.array(means), np.array(sigmas)


def _leads(ready: Prepared, effect: Traceable, usable: Sequence[tuple[Probe, list[np.ndarray]]], context: SearchContext, keep: int) -> list[Lead]:
    records = len(ready.rows)
    if belongs_to_record(effect):
        options = [_placed(ready, effect, usable, context, r) for r in range(records)]
        return _joined(ready, effect, options, len(ready.e))
    out = []
    for probe, part in usable:
        W = np.concatenate([ready.whiten(r, part[r]) for r in range(records)])
        mean, sigma = amplitude_prior(effect, probe, context)
        B = ready.root.T @ W
        gain, factors = closed_form(W.T @ W - B.T @ B, W.T @ ready.e, mean, sigma)
        if possible(effect, probe, factors):
            own = np.full(len(sigma), -1)
            out.append(Lead(effect, W, (probe,) * records, (0,) * records, mean, sigma, own, -math.log(len(usable)), gain))
    out.sort(key=lambda lead: -lead.gain)
    return out[:keep]


def possible(effect: Traceable, probe: Probe, factors: np.ndarray) -> bool:
    """Whether factors point the physical way."""
    if not probe.slopes:
        return bool(factors[0] > 0.0)
    if len(probe.slopes) > 1:
        return True
    item = next(item for item in effect.parameters if item.name == probe.slopes[0])
    low, high = item.bounds
    value = probe.values[item.name]
    return not (value <= low and factors[0] < 0.0) and not (value >= high and factors[0] > 0.0)


def _placed(ready: Prepared, effect: Traceable, usable: Sequence[tuple[Probe, list[np.ndarray]]], context: SearchContext, r: int) -> list[tuple]:
    """Places of an effect in one record: gain, probe, shift, whitened columns, mean, sigma."""
    out = []
    rows = ready.rows[r]
    root, e = ready.root[rows], ready.e[rows]
    for probe, part in usable:
        own = part[r]
        k, count = own.shape[2], own.shape[1]
        mean, sigma = amplitude_prior(effect, probe, context)
        shifts = list(range(0, count - 3, max(1, count // PLACES))) if probe.shifts else [0]
        moved = np.zeros((own.shape[0], count, len(shifts) * k))
        for number, shift in enumerate(shifts):
            moved[:, shift:, number * k : (number + 1) * k] = own[:, : count - shift]
        W = np.ascontiguousarray(ready.whiten(r, moved).T).reshape(len(shifts), k, -1)
        inside = (W.reshape(len(shifts) * k, -1) @ root).reshape(len(shifts), k, -1)
        grams = W @ W.swapaxes(1, 2) - inside @ inside.swapaxes(1, 2)
        gains, factors = closed_forms(grams, W @ e, mean, sigma)
        for number, shift in enumerate(shifts):
            if possible(effect, probe, factors[number]):
                out.append((float(gains[number]), probe, shift, W[number].T, mean, sigma))
    return out


def _joined(ready: Prepared, effect: Traceable, options: Sequence[list[tuple]], rows: int) -> list[Lead]:
    """The best place in each record as one lead; in a record where an event brings nothing it is absent."""
    event = bool(effect.traits.onset)
    probes: list[Probe | None] = []
    shifts, blocks, means, sigmas, owners, price, gain = [], [], [], [], [], 0.0, 0.0
    for r, places in enumerate(options):
        if not places and not event:
            return []
        best = max(places, key=lambda place: place[0]) if places else None
        mean_gain = float(np.logaddexp.reduce([place[0] for place in places])) - math.log(len(places)) if places else -1.0
        if event:
            price += math.log(0.5)
            if mean_gain <= 0.0 or best is None:
                probes.append(None)
                shifts.append(0)
                continue
        assert best is not None
        price += mean_gain - best[0]
        gain += best[0]
        block = np.zeros((rows, best[3].shape[1]))
        block[ready.rows[r]] = best[3]
        blocks.append(block)
        probes.append(best[1])
        shifts.append(best[2])
        means.append(best[4])
        sigmas.append(best[5])
        owners.append(np.full(len(best[5]), r))
    if not blocks:
        return []
    joined = [np.concatenate(each) for each in (means, sigmas, owners)]
    return [Lead(effect, np.concatenate(blocks, axis=1), tuple(probes), tuple(shifts), joined[0], joined[1], joined[2], price, gain)]
