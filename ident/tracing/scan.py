"""Scan of all candidates at a fitted set of effects: their gains of log evidence in closed form.

The outputs are linearised about the fit: a candidate adds its signatures, each multiplied by a
coefficient with a Gaussian prior. Signatures and residual are whitened, and the unknowns of the set
are projected out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from ident.tracing.evidence import ROUNDING_EIGENVALUE_SHARE, SetPrior
from ident.tracing.fitted_model import FittedModel, belongs_to_record
from ident.tracing.signatures import CandidateSignatures, coefficient_prior
from ident.whole_record.coloured_noise import ColouredNoise
from sim.declaration.effect import full_name
from sim.declaration.proposal import Probe, SearchContext, Traceable

SCANNED_ONSETS = 60  # onsets of an event that are tried, evenly over a record
SCANNED_STEP_ONSETS = 2000  # the same for an event that is a step of one output
KEPT_LEADS = 2  # most leads of a candidate with the same parameters in all records
LARGEST_BATCH = 250_000  # array elements of the signatures shifted at once: they fit the cache
RANKING_AVERAGE_TIME = 0.04  # s, samples are averaged over this time to rank onsets


@dataclass(frozen=True, eq=False)
class Lead:
    """A candidate with its signature at one placement: a probe in each record, and for an event the
    shift of its onset.

    Attributes
    ----------
    columns : ``(D, k)`` whitened signature, one column for each coefficient; the rows are the
        samples of all outputs and records.
    probes : probe in each record; None where the effect is absent.
    shifts : number of samples in each record by which the onset is later than in the probe.
    mean, sigma : ``(k,)`` prior of the coefficients.
    column_records : ``(k,)`` record of each coefficient; -1 if it is common to all records.
    log_placement_prior : log prior probability of the placement among those of the candidate.
    gain : gain of log evidence if the lead alone is added to the set.
    """

    effect: Traceable
    columns: np.ndarray
    probes: tuple[Probe | None, ...]
    shifts: tuple[int, ...]
    mean: np.ndarray
    sigma: np.ndarray
    column_records: np.ndarray
    log_placement_prior: float
    gain: float


@dataclass(frozen=True, eq=False)
class WhitenedFit:
    """A fitted set of effects with whitened residual and sensitivities.

    Attributes
    ----------
    hat_root : ``(D, n)`` square root of the hat matrix, which projects on the unknowns of the set:
        hat_root hat_root' = A P^-1 A' with whitened sensitivities A ``(D, n)`` and the precision P
        ``(n, n)`` of the posterior.
    residual : ``(D,)`` whitened residual at the mode of the posterior.
    record_rows : for each record, its part of the ``D`` rows.
    whiten : function that whitens signatures. Arguments: number of the record, signatures
        ``(c, a, N)``, their ``a`` outputs. Result: ``(c, a N)``.
    by_output : whether each output is whitened alone; with process noise all are together.
    noise : two-level noise of the residuals.
    ranking : the same fit with averages of neighbouring samples, which takes less work and serves
        to rank the onsets of smooth signatures; None if samples are far apart.
    """

    hat_root: np.ndarray
    residual: np.ndarray
    record_rows: tuple[slice, ...]
    whiten: Callable[[int, np.ndarray, np.ndarray | slice], np.ndarray]
    by_output: bool
    noise: ColouredNoise
    ranking: WhitenedFit | None = None


@dataclass(frozen=True, eq=False)
class Placement:
    """A probe of an effect in one record, with the shift of its onset.

    Attributes
    ----------
    gain : gain of log evidence in this record.
    probe : values of the parameters.
    signature : ``(m, N, k)`` signature of the probe without the shift, not whitened.
    shift : number of samples by which the onset is later than in the probe.
    prior : mean and sigma ``(k,)`` of the coefficients.
    """

    gain: float
    probe: Probe
    signature: np.ndarray
    shift: int
    prior: tuple[np.ndarray, np.ndarray]


def whitened_fit(fitted: FittedModel, prior: SetPrior, averaged: int = 1) -> WhitenedFit:
    """Return residual and sensitivities of a fitted set, whitened.

    Parameters
    ----------
    fitted : a fit with or without process noise.
    prior : of the unknowns of the set.
    averaged : number of neighbouring samples that are averaged.
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
    residual, A = np.concatenate(residuals), np.concatenate(sensitivities)
    precision = A.T @ A + np.diag(prior.precision)
    gradient = A.T @ residual + prior.precision * prior.mean
    scale = 1.0 / np.sqrt(np.maximum(np.diag(precision), 1e-300))
    lower = np.linalg.cholesky(
        precision * np.outer(scale, scale) + ROUNDING_EIGENVALUE_SHARE * np.eye(n)
    )
    hat_root = np.linalg.solve(lower, (A * scale).T).T
    offset = scale * np.linalg.solve(lower.T, np.linalg.solve(lower, scale * gradient))

    by_output = not fit.noise_model.names

    def whiten(r: int, columns: np.ndarray, outputs: np.ndarray | slice) -> np.ndarray:
        valid = layout.problems[r].valid[outputs]
        masked = columns if valid.all() else np.where(valid, columns, 0.0)
        if not by_output:
            masked = np.moveaxis(fit.whiten(r, np.moveaxis(masked, 0, 2)), 2, 0)
            masked = np.where(valid, masked, 0.0)
        masked = noise.whitened(r, masked, outputs)
        if by_output:
            masked /= np.sqrt(fit.variance)[outputs][:, None]
        return masked.reshape(len(columns), -1)

    ranking = None
    if averaged == 1:
        time = layout.problems[0].record.time
        averaged_samples = int(RANKING_AVERAGE_TIME * (len(time) - 1) / (time[-1] - time[0]))
        ranking = whitened_fit(fitted, prior, averaged_samples) if averaged_samples > 1 else None
    return WhitenedFit(
        hat_root, residual - A @ offset, tuple(rows), whiten, by_output, noise, ranking
    )


def closed_form_gains(
    grams: np.ndarray, residual_products: np.ndarray, mean: np.ndarray, sigma: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gains of log evidence by signatures with coefficients N(mean, sigma^2), at several
    placements.

    Parameters
    ----------
    grams : ``(p, k, k)`` products of the ``k`` whitened columns with each other at ``p``
        placements, the unknowns of the set projected out.
    residual_products : ``(p, k)`` products of these columns with the whitened residual.
    mean, sigma : ``(k,)`` prior of the coefficients.

    Returns
    -------
    Gains ``(p,)`` and posterior means ``(p, k)`` of the coefficients.
    """
    S = grams + np.diag(sigma**-2.0)
    h = residual_products + mean / sigma**2
    scale = 1.0 / np.sqrt(np.maximum(np.einsum("pkk->pk", S), 1e-300))
    fine_onsets = S * scale[:, :, None] * scale[:, None, :] + ROUNDING_EIGENVALUE_SHARE * np.eye(
        S.shape[1]
    )
    values, vectors = np.linalg.eigh(fine_onsets)
    values = np.maximum(values, 1e-2 * ROUNDING_EIGENVALUE_SHARE)
    turned = np.einsum("pji,pj->pi", vectors, scale * h)
    gain = 0.5 * np.sum(turned**2 / values, axis=1) - 0.5 * float(np.sum((mean / sigma) ** 2))
    gain -= 0.5 * np.sum(np.log(values), axis=1) - np.sum(np.log(scale), axis=1)
    gain -= float(np.sum(np.log(sigma)))
    return gain, scale * np.einsum("pij,pj->pi", vectors, turned / values)


def leads_of(
    fitted: FittedModel,
    whitened: WhitenedFit,
    signatures: Sequence[CandidateSignatures],
    context: SearchContext,
) -> list[Lead]:
    """Return the leads of all candidates that are not in the set: their best placements."""
    absent = [
        (effect, by_probe) for effect, by_probe in signatures if effect.name not in fitted.names
    ]
    return [
        lead for effect, by_probe in absent for lead in _leads(whitened, effect, by_probe, context)
    ]


def _has_physical_sign(effect: Traceable, probe: Probe, coefficients: np.ndarray) -> bool:
    """Return whether the coefficients ``(k,)`` have the physical sign: an event has the sign of its
    probe, and a single parameter at its bound does not leave it.
    """
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
    whitened: WhitenedFit,
    effect: Traceable,
    by_probe: Sequence[tuple[Probe, list[np.ndarray]]],
    context: SearchContext,
) -> list[Lead]:
    """Return the leads of one candidate."""
    records = len(whitened.record_rows)
    if belongs_to_record(effect):
        placements = [
            _placements_in_record(whitened, effect, by_probe, context, r) for r in range(records)
        ]
        return _one_lead(whitened, effect, placements)
    leads = []
    for probe, by_record in by_probe:
        rows = [
            whitened.whiten(r, np.moveaxis(signature, 2, 0), slice(None))
            for r, signature in enumerate(by_record)
        ]
        W = np.concatenate(rows, axis=1)
        mean, sigma = coefficient_prior(effect, probe, context)
        gains, coefficients = _gains(whitened, W[None], slice(None), (mean, sigma))
        if _has_physical_sign(effect, probe, coefficients[0]):
            leads.append(
                Lead(
                    effect,
                    W.T,
                    probes=(probe,) * records,
                    shifts=(0,) * records,
                    mean=mean,
                    sigma=sigma,
                    column_records=np.full(len(sigma), -1),
                    log_placement_prior=-math.log(len(by_probe)),
                    gain=float(gains[0]),
                )
            )
    return sorted(leads, key=lambda lead: -lead.gain)[:KEPT_LEADS]


def _placements_in_record(
    whitened: WhitenedFit,
    effect: Traceable,
    by_probe: Sequence[tuple[Probe, list[np.ndarray]]],
    context: SearchContext,
    r: int,
) -> list[Placement]:
    """Return the placements of an effect in record ``r``."""
    out: list[Placement] = []
    for probe, by_record in by_probe:
        prior = coefficient_prior(effect, probe, context)
        count = by_record[r].shape[1]
        # The likelihood of an event has local optima: neighbours of the best placement are tried,
        # finely for a step of one output.
        sharp = probe.sharp and whitened.by_output
        step = max(1, count // (SCANNED_STEP_ONSETS if sharp else SCANNED_ONSETS))
        coarse_onsets = list(range(0, count - 3, step)) if probe.shifts else [0]
        if not np.any(by_record[r]):
            continue
        gains_at: Callable[[Sequence[int]], tuple[np.ndarray, np.ndarray]] = (
            _gains_at_every_shift(whitened, r, by_record[r], prior)
            if sharp
            else partial(_gains_at, whitened.ranking or whitened, r, by_record[r], prior)
        )
        placements = _placements_at_shifts(
            gains_at, effect, by_record[r], probe, prior, coarse_onsets
        )
        if probe.shifts and placements and step > 1:
            best = max(placements, key=lambda placement: placement.gain).shift
            fine_step = max(1, 2 * step // SCANNED_ONSETS)
            neighbours = range(max(best - step + 1, 0), min(best + step, count - 3), fine_step)
            fine_onsets = [each for each in neighbours if each != best]
            refined = _placements_at_shifts(
                gains_at, effect, by_record[r], probe, prior, fine_onsets
            )
            placements += sorted(refined, key=lambda placement: -placement.gain)[:1]
        out += placements
    return out


def _shifted_columns(
    whitened: WhitenedFit, r: int, signature: np.ndarray, shifts: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the whitened columns of a signature ``(m, N, k)`` in record ``r`` with later onsets.

    ``shifts`` : ``s`` numbers of samples by which the onset is later.

    Returns
    -------
    Columns ``(s, k, d)`` for the ``d`` samples of the outputs that the signature changes; their
    rows ``(d,)`` in the whitened fit.
    """
    m, count, k = signature.shape
    outputs = (
        np.flatnonzero(np.any(signature != 0.0, axis=(1, 2)))
        if whitened.by_output
        else np.arange(m)
    )
    moved = np.zeros((len(shifts), k, len(outputs), count))
    columns = np.moveaxis(signature[outputs], 2, 0)
    for number, shift in enumerate(shifts):
        moved[number, :, :, shift:] = columns[:, :, : count - shift]
    W = whitened.whiten(r, moved.reshape(-1, len(outputs), count), outputs)
    size = (whitened.record_rows[r].stop - whitened.record_rows[r].start) // m
    rows = whitened.record_rows[r].start + (outputs[:, None] * size + np.arange(size)).ravel()
    return W.reshape(len(shifts), k, -1), rows


def _gains(
    whitened: WhitenedFit,
    W: np.ndarray,
    rows: np.ndarray | slice,
    prior: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Return gains and coefficients (``closed_form_gains``) of whitened columns ``W (s, k, d)``.

    ``rows`` : the ``d`` rows of the whitened fit to which the columns belong.
    """
    hat_products = (W.reshape(-1, W.shape[-1]) @ whitened.hat_root[rows]).reshape(*W.shape[:2], -1)
    grams = W @ W.swapaxes(1, 2) - hat_products @ hat_products.swapaxes(1, 2)
    return closed_form_gains(grams, W @ whitened.residual[rows], *prior)


def _gains_at(
    whitened: WhitenedFit,
    r: int,
    signature: np.ndarray,
    prior: tuple[np.ndarray, np.ndarray],
    shifts: Sequence[int],
) -> tuple[np.ndarray, np.ndarray]:
    """Return gains and coefficients (``closed_form_gains``) of a signature ``(m, N, k)`` in record
    ``r`` with its onset later by each of ``shifts`` samples.
    """
    batch = max(1, LARGEST_BATCH // signature.size)
    batches = [
        _gains(
            whitened,
            *_shifted_columns(whitened, r, signature, shifts[first : first + batch]),
            prior,
        )
        for first in range(0, len(shifts), batch)
    ]
    gains, coefficients = zip(*batches, strict=True)
    return np.concatenate(gains), np.concatenate(coefficients)


def _gains_at_every_shift(
    whitened: WhitenedFit, r: int, signature: np.ndarray, prior: tuple[np.ndarray, np.ndarray]
) -> Callable[[Sequence[int]], tuple[np.ndarray, np.ndarray]]:
    """Return a function of ``shifts`` with the same result as ``_gains_at``.

    All shifts are computed at once, which is faster if nearly every one is needed. It requires
    ``whitened.by_output``.
    """
    m, count, k = signature.shape
    grams = np.zeros((count, k, k))
    # products of the signature with the residual and with the columns of hat_root
    all_products = np.zeros((count, k, 1 + whitened.hat_root.shape[1]))
    for output in range(m):
        used_columns = np.flatnonzero(np.any(signature[output] != 0.0, axis=0))
        rows = whitened.record_rows[r].start + output * count + np.arange(count)
        regressors = np.vstack([whitened.residual[rows], whitened.hat_root[rows].T])
        if used_columns.size:
            squares, products = whitened.noise.products_at_all_shifts(
                r, output, signature[output].T[used_columns], regressors
            )
            grams[:, used_columns[:, None], used_columns] += squares
            all_products[:, used_columns] += products
    hat_products = all_products[..., 1:]
    grams -= hat_products @ hat_products.swapaxes(1, 2)
    return lambda shifts: closed_form_gains(grams[shifts], all_products[shifts, :, 0], *prior)


def _placements_at_shifts(
    gains_at: Callable[[Sequence[int]], tuple[np.ndarray, np.ndarray]],
    effect: Traceable,
    signature: np.ndarray,
    probe: Probe,
    prior: tuple[np.ndarray, np.ndarray],
    shifts: Sequence[int],
) -> list[Placement]:
    """Return the placements of a probe with signature ``(m, N, k)`` in one record, one for each of
    ``shifts``; those with coefficients of unphysical sign are omitted.
    """
    if not shifts:
        return []
    gains, coefficients = gains_at(shifts)
    return [
        Placement(gain, probe, signature, shift, prior)
        for gain, shift, fitted in zip(gains.tolist(), shifts, coefficients, strict=True)
        if _has_physical_sign(effect, probe, fitted)
    ]


def _one_lead(
    whitened: WhitenedFit, effect: Traceable, placements: Sequence[Sequence[Placement]]
) -> list[Lead]:
    """Return one lead with the best placement in each record, in a list; an empty list if there is
    none.

    In each record an event acts with a prior probability of one half. It is absent where its gain,
    averaged over the placements, is not positive. ``placements`` : by record.
    """
    event = bool(effect.traits.onset)
    chosen: list[Placement | None] = []
    log_placement_prior = 0.0
    for options in placements:
        if not options and not event:
            return []
        best = max(options, key=lambda placement: placement.gain, default=None)
        mean_gain = -1.0  # logarithm of the mean Bayes factor of the placements
        if options:
            gains = [placement.gain for placement in options]
            mean_gain = float(np.logaddexp.reduce(gains)) - math.log(len(gains))
        log_placement_prior += math.log(0.5) if event else 0.0
        if best is None or (event and mean_gain <= 0.0):
            chosen.append(None)
            continue
        log_placement_prior += mean_gain - best.gain
        chosen.append(best)
    present = [(r, placement) for r, placement in enumerate(chosen) if placement is not None]
    if not present:
        return []
    blocks, gain = [], 0.0
    for r, placement in present:
        W, rows = _shifted_columns(whitened, r, placement.signature, [placement.shift])
        gain += float(_gains(whitened, W, rows, placement.prior)[0][0])
        block = np.zeros((len(whitened.residual), W.shape[1]))
        block[rows] = W[0].T
        blocks.append(block)
    return [
        Lead(
            effect,
            np.concatenate(blocks, axis=1),
            tuple(placement.probe if placement is not None else None for placement in chosen),
            tuple(placement.shift if placement is not None else 0 for placement in chosen),
            np.concatenate([placement.prior[0] for _, placement in present]),
            np.concatenate([placement.prior[1] for _, placement in present]),
            np.concatenate([np.full(len(placement.prior[0]), r) for r, placement in present]),
            log_placement_prior,
            gain,
        )
    ]


def start_values(
    lead: Lead, coefficients: np.ndarray, records: int, interval: float
) -> list[dict[str, float]]:
    """Return the starting values of the parameters of a lead for a fit, by full name, one mapping a
    record.

    Parameters
    ----------
    coefficients : ``(k,)`` of the columns of the lead.
    records : number of records. interval : between samples, s.
    """
    effect = lead.effect
    bounds = {item.name: item.bounds for item in effect.parameters}
    absent = {item.name: effect.absent.get(item.name, item.value) for item in effect.parameters}
    out = []
    for r in range(records):
        probe = lead.probes[r]
        values = dict(absent)
        if probe is not None:
            own_coefficients = (
                coefficients
                if not belongs_to_record(effect)
                else coefficients[lead.column_records == r]
            )
            values |= dict(probe.values)
            if probe.shifts:
                values[effect.traits.onset] += lead.shifts[r] * interval
            for local, change in zip(probe.slopes, own_coefficients.tolist(), strict=False):
                values[local] += change
        out.append(
            {
                full_name(effect, local): float(np.clip(value, *bounds[local]))
                for local, value in values.items()
            }
        )
    return out
