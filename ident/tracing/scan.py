"""Scan of all candidates at a fitted set of effects: their signatures and gains of log evidence.

The model is linear-Gaussian. Signatures (changes of the outputs) are whitened, and the unknowns of
the set are projected out; their coefficients have Gaussian priors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ident.tracing.evidence import ROUNDING_EIGENVALUE_SHARE, SetPrior, set_prior
from ident.tracing.fitted_model import FittedModel, belongs_to_record
from ident.tracing.signatures import CandidateSignatures, candidate_signatures, coefficient_prior
from ident.whole_record.coloured_noise import ColouredNoise
from sim.declaration.effect import full_name
from sim.declaration.proposal import Probe, SearchContext, Traceable

SCANNED_PLACES = 60  # onsets tried over the record
SHARP_PLACES = 2000  # the same for a step of one output
KEPT_PLACES = 2  # best places kept of a candidate
LARGEST_BATCH = 250_000  # numbers of signatures moved together, so that they fit the cache
RANKING_AVERAGE_TIME = 0.04  # s, averaging time of samples where places are ranked


@dataclass(frozen=True, eq=False)
class Lead:
    """One placed alternative of a candidate.

    Attributes
    ----------
    columns : ``(D, k)`` whitened, all records and outputs below each other.
    probes : where it is placed, one a record; None where it is absent.
    shifts : in samples.
    mean, sigma : ``(k,)`` prior of the columns' coefficients.
    own : ``(k,)`` the record that a column belongs to, -1 where all share its factor.
    price : log prior probability of its place.
    gain : of log evidence, alone.
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
    """A fitted set, whitened.

    Attributes
    ----------
    root : ``(D, n)`` with root root' = A P^-1 A', A the sensitivities, P the posterior's precision.
    e : ``(D,)`` residual at the posterior's mode.
    rows : those of each record.
    whiten : of a record's number, columns ``(c, a, N)`` and the ``a`` outputs that they belong to
        makes whitened ones ``(c, a N)``.
    separate : whether outputs are whitened one by one.
    noise : of the residuals.
    ranking : the same set by averages of neighbouring samples, where that is less work; places of
        smooth signatures are ranked by it.
    """

    root: np.ndarray
    e: np.ndarray
    rows: tuple[slice, ...]
    whiten: Callable[[int, np.ndarray, np.ndarray | slice], np.ndarray]
    separate: bool
    noise: ColouredNoise
    ranking: Prepared | None = None


@dataclass(frozen=True, eq=False)
class Place:
    """A signature at one place of one record.

    Attributes
    ----------
    gain : of log evidence.
    probe : whose signature ``own (m, N, k)`` is, before it is moved.
    shift : samples by which it begins later.
    prior : mean and sigma ``(k,)`` of the coefficients.
    """

    gain: float
    probe: Probe
    own: np.ndarray
    shift: int
    prior: tuple[np.ndarray, np.ndarray]


def prepared(fitted: FittedModel, prior: SetPrior, averaged: int = 1) -> Prepared:
    """Whiten a set that is fitted under white noise, or with process noise; of the averages of
    ``averaged`` neighbouring samples.
    """
    fit, layout = fitted.fit, fitted.fit.layout
    n = len(fit.theta)
    noise = ColouredNoise(fit, averaged)
    residuals, sensitivities, rows, at = [], [], [], 0
    for r, problem in enumerate(layout.problems):
        size = len(problem.valid) * noise.samples(problem.valid.shape[1])
        residuals.append(noise.residual(r).ravel())
        block = np.zeros((size, n))
        block[:, layout.columns(r)] = noise.sensitivities(r).reshape(size, -1)
        sensitivities.append(block)
        rows.append(slice(at, at + size))
        at += size
    e, A = np.concatenate(residuals), np.concatenate(sensitivities)
    precision = A.T @ A + np.diag(prior.precision)
    right = A.T @ e + prior.precision * prior.mean
    scale = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-300))
    lower = np.linalg.cholesky(
        precision * np.outer(scale, scale) + ROUNDING_EIGENVALUE_SHARE * np.eye(n)
    )
    root = np.linalg.solve(lower, (A * scale).T).T
    offset = scale * np.linalg.solve(lower.T, np.linalg.solve(lower, scale * right))

    separate = not fit.noise_model.names

    def whiten(r: int, columns: np.ndarray, outputs: np.ndarray | slice) -> np.ndarray:
        valid = layout.problems[r].valid[outputs]
        made = columns if valid.all() else np.where(valid, columns, 0.0)
        if not separate:
            made = np.moveaxis(fit.whiten(r, np.moveaxis(made, 0, 2)), 2, 0)
            made = np.where(valid, made, 0.0)
        made = noise.whitened(r, made, outputs)
        if separate:
            made /= np.sqrt(fit.variance)[outputs][:, None]
        return made.reshape(len(columns), -1)

    ranking = None
    if averaged == 1:
        time = layout.problems[0].record.time
        most = int(RANKING_AVERAGE_TIME * (len(time) - 1) / (time[-1] - time[0]))
        ranking = prepared(fitted, prior, most) if most > 1 else None
    return Prepared(root, e - A @ offset, tuple(rows), whiten, separate, noise, ranking)


def closed_forms(
    grams: np.ndarray, with_e: np.ndarray, mean: np.ndarray, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gains of log evidence by columns with coefficients N(mean, sigma^2), at several
    places.

    Parameters
    ----------
    grams, with_e : ``(p, k, k)`` and ``(p, k)`` of ``k`` columns at ``p`` places, projected off
        the set's own unknowns.
    mean, sigma : ``(k,)``.

    Returns
    -------
    Gains ``(p,)`` and posterior means ``(p, k)`` of the coefficients.
    """
    S = grams + np.diag(sigma**-2.0)
    h = with_e + mean / sigma**2
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("pkk->pk", S), 1e-300))
    inside = S * scale[:, :, None] * scale[:, None, :] + ROUNDING_EIGENVALUE_SHARE * np.eye(
        S.shape[1]
    )
    values, vectors = np.linalg.eigh(inside)
    values = np.maximum(values, 1e-2 * ROUNDING_EIGENVALUE_SHARE)
    turned = np.einsum("pji,pj->pi", vectors, scale * h)
    gain = 0.5 * np.sum(turned**2 / values, axis=1) - 0.5 * float(np.sum((mean / sigma) ** 2))
    gain -= 0.5 * np.sum(np.log(values), axis=1) - np.sum(np.log(scale), axis=1)
    gain -= float(np.sum(np.log(sigma)))
    return gain, scale * np.einsum("pij,pj->pi", vectors, turned / values)


def leads_of(
    fitted: FittedModel,
    ready: Prepared,
    shown: Sequence[CandidateSignatures],
    context: SearchContext,
) -> list[Lead]:
    """Return the leads (best places) of all signatures of effects that are not in the set."""
    absent = [(effect, usable) for effect, usable in shown if effect.name not in fitted.names]
    return [lead for effect, usable in absent for lead in _leads(ready, effect, usable, context)]


def _has_physical_sign(effect: Traceable, probe: Probe, coefficients: np.ndarray) -> bool:
    """Return whether the coefficients have the physical sign."""
    if not probe.slopes:
        return bool(coefficients[0] > 0.0)
    if len(probe.slopes) > 1:
        return True
    item = next(item for item in effect.parameters if item.name == probe.slopes[0])
    low, high = item.bounds
    value = probe.values[item.name]
    return not (value <= low and coefficients[0] < 0.0) and not (
        value >= high and coefficients[0] > 0.0
    )


def _leads(
    ready: Prepared,
    effect: Traceable,
    usable: Sequence[tuple[Probe, list[np.ndarray]]],
    context: SearchContext,
) -> list[Lead]:
    records = len(ready.rows)
    if belongs_to_record(effect):
        places = [_places_in_record(ready, effect, usable, context, r) for r in range(records)]
        return _one_lead(ready, effect, places)
    out = []
    for probe, parts in usable:
        rows = [
            ready.whiten(r, np.moveaxis(part, 2, 0), slice(None)) for r, part in enumerate(parts)
        ]
        W = np.concatenate(rows, axis=1)
        mean, sigma = coefficient_prior(effect, probe, context)
        gains, coefficients = _gains(ready, W[None], slice(None), (mean, sigma))
        if _has_physical_sign(effect, probe, coefficients[0]):
            own = np.full(len(sigma), -1)
            price = -math.log(len(usable))
            same, still = (probe,) * records, (0,) * records
            out.append(Lead(effect, W.T, same, still, mean, sigma, own, price, float(gains[0])))
    return sorted(out, key=lambda lead: -lead.gain)[:KEPT_PLACES]


def _places_in_record(
    ready: Prepared,
    effect: Traceable,
    usable: Sequence[tuple[Probe, list[np.ndarray]]],
    context: SearchContext,
    r: int,
) -> list[Place]:
    """Return the places of an effect in one record."""
    out: list[Place] = []
    for probe, parts in usable:
        known = coefficient_prior(effect, probe, context)
        count = parts[r].shape[1]
        # The likelihood of an event has local optima: neighbours of the best place are tried,
        # finely for a step of one output.
        sharp = probe.sharp and ready.separate
        step = max(1, count // (SHARP_PLACES if sharp else SCANNED_PLACES))
        coarse = list(range(0, count - 3, step)) if probe.shifts else [0]
        if not np.any(parts[r]):
            continue
        gains_at: Callable[[Sequence[int]], tuple[np.ndarray, np.ndarray]] = (
            _gains_at_every_shift(ready, r, parts[r], known)
            if sharp
            else partial(_gains_at, ready.ranking or ready, r, parts[r], known)
        )
        found = _places_at_shifts(gains_at, effect, parts[r], probe, known, coarse)
        if probe.shifts and found and step > 1:
            best = max(found, key=lambda place: place.gain).shift
            apart = max(1, 2 * step // SCANNED_PLACES)
            near = range(max(best - step + 1, 0), min(best + step, count - 3), apart)
            inside = [each for each in near if each != best]
            fine = _places_at_shifts(gains_at, effect, parts[r], probe, known, inside)
            found += sorted(fine, key=lambda place: -place.gain)[:1]
        out += found
    return out


def _shifted_columns(
    ready: Prepared, r: int, own: np.ndarray, shifts: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return a signature ``own (m, N, k)`` of record ``r`` begun later by some numbers of samples.

    Returns
    -------
    Whitened columns ``(s, k, D)`` of the outputs that it changes, and the rows ``(D,)`` of the set
    that they belong to.
    """
    m, count, k = own.shape
    outputs = np.flatnonzero(np.any(own != 0.0, axis=(1, 2))) if ready.separate else np.arange(m)
    moved = np.zeros((len(shifts), k, len(outputs), count))
    columns = np.moveaxis(own[outputs], 2, 0)
    for number, shift in enumerate(shifts):
        moved[number, :, :, shift:] = columns[:, :, : count - shift]
    W = ready.whiten(r, moved.reshape(-1, len(outputs), count), outputs)
    size = (ready.rows[r].stop - ready.rows[r].start) // m
    rows = ready.rows[r].start + (outputs[:, None] * size + np.arange(size)).ravel()
    return W.reshape(len(shifts), k, -1), rows


def _gains(
    ready: Prepared,
    W: np.ndarray,
    rows: np.ndarray | slice,
    prior: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Return gains and coefficients (``closed_forms``) of whitened columns ``W (s, k, D)`` of some
    rows.
    """
    inside = (W.reshape(-1, W.shape[-1]) @ ready.root[rows]).reshape(*W.shape[:2], -1)
    grams = W @ W.swapaxes(1, 2) - inside @ inside.swapaxes(1, 2)
    return closed_forms(grams, W @ ready.e[rows], *prior)


def _gains_at(
    ready: Prepared,
    r: int,
    own: np.ndarray,
    prior: tuple[np.ndarray, np.ndarray],
    shifts: Sequence[int],
) -> tuple[np.ndarray, np.ndarray]:
    """Return gains and coefficients (``closed_forms``) of a signature ``own (m, N, k)`` of record
    ``r`` that begins later by some numbers of samples.
    """
    batch = max(1, LARGEST_BATCH // own.size)
    parts = [
        _gains(ready, *_shifted_columns(ready, r, own, shifts[first : first + batch]), prior)
        for first in range(0, len(shifts), batch)
    ]
    return np.concatenate([gains for gains, _ in parts]), np.concatenate([f for _, f in parts])


def _gains_at_every_shift(
    ready: Prepared, r: int, own: np.ndarray, prior: tuple[np.ndarray, np.ndarray]
) -> Callable[[Sequence[int]], tuple[np.ndarray, np.ndarray]]:
    """Return ``_gains_at`` of a signature ``own (m, N, k)`` that is moved to nearly every sample,
    where outputs are whitened one by one.
    """
    m, count, k = own.shape
    grams, inside = np.zeros((count, k, k)), np.zeros((count, k, 1 + ready.root.shape[1]))
    for output in range(m):
        acting = np.flatnonzero(np.any(own[output] != 0.0, axis=0))
        rows = ready.rows[r].start + output * count + np.arange(count)
        others = np.vstack([ready.e[rows], ready.root[rows].T])
        if acting.size:
            squares, products = ready.noise.products_at_all_shifts(
                r, output, own[output].T[acting], others
            )
            grams[:, acting[:, None], acting] += squares
            inside[:, acting] += products
    with_root = inside[..., 1:]
    grams -= with_root @ with_root.swapaxes(1, 2)
    return lambda shifts: closed_forms(grams[shifts], inside[shifts, :, 0], *prior)


def _places_at_shifts(
    gains_at: Callable[[Sequence[int]], tuple[np.ndarray, np.ndarray]],
    effect: Traceable,
    own: np.ndarray,
    probe: Probe,
    prior: tuple[np.ndarray, np.ndarray],
    shifts: Sequence[int],
) -> list[Place]:
    """Return the places of a signature ``own (m, N, k)`` of one record begun later by some numbers
    of samples; none where its sign is unphysical.
    """
    if not shifts:
        return []
    gains, coefficients = gains_at(shifts)
    return [
        Place(gain, probe, own, shift, prior)
        for gain, shift, made in zip(gains.tolist(), shifts, coefficients, strict=True)
        if _has_physical_sign(effect, probe, made)
    ]


def _one_lead(ready: Prepared, effect: Traceable, places: Sequence[Sequence[Place]]) -> list[Lead]:
    """Return the best place in each record as one lead.

    An event has even prior odds in each record, and is left out where it has no gain.
    """
    event = bool(effect.traits.onset)
    chosen: list[Place | None] = []
    price = 0.0
    for options in places:
        if not options and not event:
            return []
        best = max(options, key=lambda place: place.gain, default=None)
        mean = -1.0
        if options:
            gains = [place.gain for place in options]
            mean = float(np.logaddexp.reduce(gains)) - math.log(len(gains))
        price += math.log(0.5) if event else 0.0
        if best is None or (event and mean <= 0.0):
            chosen.append(None)
            continue
        price += mean - best.gain
        chosen.append(best)
    there = [(r, place) for r, place in enumerate(chosen) if place is not None]
    if not there:
        return []
    blocks, gain = [], 0.0
    for r, place in there:
        W, rows = _shifted_columns(ready, r, place.own, [place.shift])
        gain += float(_gains(ready, W, rows, place.prior)[0][0])
        block = np.zeros((len(ready.e), W.shape[1]))
        block[rows] = W[0].T
        blocks.append(block)
    return [
        Lead(
            effect,
            np.concatenate(blocks, axis=1),
            tuple(place.probe if place is not None else None for place in chosen),
            tuple(place.shift if place is not None else 0 for place in chosen),
            np.concatenate([place.prior[0] for _, place in there]),
            np.concatenate([place.prior[1] for _, place in there]),
            np.concatenate([np.full(len(place.prior[0]), r) for r, place in there]),
            price,
            gain,
        )
    ]


def starts_of(
    lead: Lead, coefficients: np.ndarray, records: int, interval: float
) -> list[dict[str, float]]:
    """Return starting values of a lead's parameters, by full name, one mapping a record."""
    effect = lead.effect
    bounds = {item.name: item.bounds for item in effect.parameters}
    absent = {item.name: effect.absent.get(item.name, item.value) for item in effect.parameters}
    out = []
    for r in range(records):
        probe = lead.probes[r]
        values = dict(absent)
        if probe is not None:
            mine = coefficients if not belongs_to_record(effect) else coefficients[lead.own == r]
            values |= dict(probe.values)
            if probe.shifts:
                values[effect.traits.onset] += lead.shifts[r] * interval
            for local, change in zip(probe.slopes, mine.tolist(), strict=False):
                values[local] += change
        out.append(
            {
                full_name(effect, local): float(np.clip(value, *bounds[local]))
                for local, value in values.items()
            }
        )
    return out


# ---- Evidence of sets of leads in closed form

BEAM_WIDTH = 10  # sets of each size that are extended
MOST_LEADS = 30  # leads that take part


@dataclass(frozen=True, eq=False)
class LinearSet:
    """A set of leads.

    Attributes
    ----------
    gain : of log evidence.
    weight : the same with the prior odds of the leads and their places.
    coefficients : posterior means of the coefficients of each lead's columns.
    """

    leads: tuple[Lead, ...]
    gain: float
    weight: float
    coefficients: tuple[np.ndarray, ...]

    @property
    def names(self) -> frozenset[str]:
        """Names of the effects that it adds."""
        return frozenset(lead.effect.name for lead in self.leads)


def weighed_sets(
    ready: Prepared,
    leads: Sequence[Lead],
    odds: Callable[[Lead], float],
    together: Callable[[Lead, Lead], bool],
    depth: int,
) -> tuple[list[LinearSet], Mapping[frozenset[str], float]]:
    """Return sets of up to ``depth`` leads, the most probable first, and the similarity of pairs of
    effects.

    Parameters
    ----------
    ready : the fitted set at which the leads were found.
    odds : log prior odds of a lead.
    together : whether two leads may be in one set.

    Returns
    -------
    The sets, and the largest cosine of two effects' signatures, by their names.
    """
    ranked = sorted(leads, key=lambda lead: -(lead.gain + lead.price + odds(lead)))[:MOST_LEADS]
    if not ranked:
        return [], {}
    columns = np.concatenate([lead.columns for lead in ranked], axis=1)
    B = ready.root.T @ columns
    gram, with_e = columns.T @ columns - B.T @ B, columns.T @ ready.e
    ends = np.cumsum([lead.columns.shape[1] for lead in ranked])
    at = [
        np.arange(end - lead.columns.shape[1], end) for end, lead in zip(ends, ranked, strict=True)
    ]
    prior = [lead.price + odds(lead) for lead in ranked]

    def made(members: tuple[int, ...]) -> LinearSet:
        where = np.concatenate([at[i] for i in members])
        mean = np.concatenate([ranked[i].mean for i in members])
        sigma = np.concatenate([ranked[i].sigma for i in members])
        gains, coefficients = closed_forms(
            gram[np.ix_(where, where)][None], with_e[where][None], mean, sigma
        )
        cuts = np.cumsum([len(at[i]) for i in members])[:-1]
        gain = float(gains[0])
        weight = gain + sum(prior[i] for i in members)
        chosen = tuple(ranked[i] for i in members)
        return LinearSet(chosen, gain, weight, tuple(np.split(coefficients[0], cuts)))

    count = range(len(ranked))
    allowed = [[together(ranked[i], ranked[j]) for j in count] for i in count]
    singles = [made((i,)) for i in count]
    found: dict[frozenset[int], LinearSet] = {frozenset((i,)): singles[i] for i in count}
    beam: list[tuple[int, ...]] = [(i,) for i in list(count)[:BEAM_WIDTH]]
    for _ in range(depth - 1):
        level: dict[frozenset[int], tuple[tuple[int, ...], LinearSet]] = {}
        for members in beam:
            for i in count:
                key = frozenset((*members, i))
                if key not in level and all(allowed[i][j] for j in members):
                    level[key] = ((*members, i), made((*members, i)))
        best = sorted(level.items(), key=lambda each: -each[1][1].weight)[:BEAM_WIDTH]
        found |= {key: one for key, (_, one) in best}
        beam = [members for _, (members, _) in best]
    sets = sorted(found.values(), key=lambda each: -each.weight)
    return sets, _cosines(ranked, singles, at, gram)


def starts_at(
    fitted: FittedModel, effect: Traceable, context: SearchContext
) -> list[tuple[Traceable, list[dict[str, float]]]]:
    """Return an effect's best places at a fitted set as starts of fits, the likeliest first.

    Returns
    -------
    The effect in its form for these records, and the values of its parameters by full name, one
    mapping a record.
    """
    ready = prepared(fitted, set_prior(fitted, context))
    shown = [*candidate_signatures(fitted, [effect], context).values()]
    leads = leads_of(fitted, ready, shown, context)
    singles, _ = weighed_sets(ready, leads, lambda lead: 0.0, lambda one, other: False, 1)
    count = len(fitted.values.own)
    return [
        (one.leads[0].effect, starts_of(one.leads[0], one.coefficients[0], count, context.interval))
        for one in singles
    ]


def _cosines(
    ranked: Sequence[Lead],
    singles: Sequence[LinearSet],
    at: Sequence[np.ndarray],
    gram: np.ndarray,
) -> dict[frozenset[str], float]:
    sides = np.zeros((len(gram), len(ranked)))
    for i, single in enumerate(singles):
        sides[at[i], i] = single.coefficients[0]
    inner = sides.T @ gram @ sides
    size = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    cosines = np.abs(inner / np.outer(size, size))
    found: dict[frozenset[str], float] = {}
    for i, a in enumerate(ranked):
        for j, b in enumerate(ranked[:i]):
            key = frozenset((a.effect.name, b.effect.name))
            if len(key) == 2:
                found[key] = max(found.get(key, 0.0), float(cosines[i, j]))
    return found


def leading_sets(
    sets: Sequence[LinearSet], singles: Collection[LinearSet], deeper: int, most: int
) -> list[LinearSet]:
    """Return the most probable single leads, and larger sets that exceed all smaller ones.

    Parameters
    ----------
    sets : the most probable first. singles : the best set of each effect alone.
    deeper : most effects of a set. most : number of single leads; half as many larger sets.
    """
    chosen: list[LinearSet] = []
    bar = 0.0
    for size in range(1, deeper + 1):
        best: dict[frozenset[str], LinearSet] = {}
        for each in sets:
            if len(each.leads) == size and each.weight > bar:
                best.setdefault(each.names, each)
        chosen += list(best.values())[: most if size == 1 else most // 2]
        if size == 1:
            # Nuisance dynamics are always tried: drifts and steps imitate them, and their gain
            # grows in a fit.
            usual = [one for one in singles if one.leads[0].effect.traits.background]
            chosen += [each for each in usual if each not in chosen]
        bar = max([bar, *(each.weight for each in chosen)])
    return chosen
