"""Scatter of derivatives between records, and the factor on their sigmas that follows from it.

Mass, trim and speed differ from record to record. The residuals of one record do not show this; the
differences between records do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.estimate import Outcome
from ident.process_noise.filter_error import fit_with_fixed_noise, noise_levels
from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.intervals import (
    add_normal_equations,
    inverse_information,
    reduced_chi_square,
    scatter_factors,
    weighted_scatter,
)
from ident.tracing.diagnosis import Quantity
from ident.tracing.fitted_model import FitData, FittedModel, Start, fit_set
from ident.tracing.held_out import HeldOutData
from ident.tracing.problem import TraceProblem
from ident.whole_record.output_error import fit_covariance
from sim.declaration.effect import NoiseEffect, full_name
from sim.declaration.proposal import Refinable, Traceable
from sim.record import Record

FEWEST_RECORDS = 3  # fewest records for a scatter: two have a single degree of freedom


@dataclass(frozen=True)
class RecordScatter:
    """Scatter of the derivatives between records; both fields are empty with too few records.

    ``scatter`` : by derivative, standard deviation between fits of single records.

    ``inflation`` : by derivative, factor (at least one) on its corrected sigma.
    """

    scatter: Mapping[str, float] = field(default_factory=dict)
    inflation: Mapping[str, float] = field(default_factory=dict)


def scatter_between_records(
    problem: TraceProblem, fitted: FittedModel, held: HeldOutData
) -> RecordScatter:
    """Return the scatter of the derivatives between records, fitted and held out.

    Each record has its own derivatives; the effects of the set are shared. The scatter is empty
    with one record, whose held-out part is not a second record. With process noise each record is
    fitted alone, with the noise levels and effects of all.
    """
    others = held.records if held.masks is not None else ()
    records, masks = [*problem.records, *others], [*problem.masks, *(held.masks or ())]
    unpredictable = bool(held.records) and held.masks is None
    if unpredictable or len({record.name for record in records}) < 2:
        return RecordScatter()
    names = [name for name in fitted.values.shared if name in problem.model.parameters]
    found = (_values_by_single_fits if has_process_noise(fitted.system) else _values_by_common_fit)(
        problem, fitted, names, records, masks
    )
    if found is None:
        return RecordScatter()
    values, sigma = found
    factors = scatter_factors(values, sigma)
    spread = (
        dict(zip(names, weighted_scatter(values, sigma).tolist(), strict=True))
        if values.shape[1] >= FEWEST_RECORDS
        else {}
    )
    return RecordScatter(spread, dict(zip(names, factors.tolist(), strict=True)))


def _values_by_common_fit(
    problem: TraceProblem,
    fitted: FittedModel,
    names: Sequence[str],
    records: Sequence[Record],
    masks: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the values and sigmas ``(n, records)`` of the named parameters from one fit of all
    records, in which each record has its own values; None if it fails.
    """
    data = FitData(records, masks, problem.model, problem.outputs)
    apart = fit_set(
        data,
        fitted.effects,
        replace(problem.roughly, iterations=20),
        Start(added=fitted.values.shared),
        apart=names,
    )
    if apart is None:
        return None
    at = np.array(
        [
            [apart.fit.layout.names.index(f"{name}, record {r + 1}") for r in range(len(records))]
            for name in names
        ]
    )
    variance = np.maximum(np.diag(fit_covariance(apart.fit)[0]), 1e-300)
    return apart.fit.theta[at], np.sqrt(variance[at])


def _values_by_single_fits(
    problem: TraceProblem,
    fitted: FittedModel,
    names: Sequence[str],
    records: Sequence[Record],
    masks: Sequence[np.ndarray],
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the values and sigmas ``(n, records)`` of the named parameters from fits of single
    records, with the noise levels and effects of all; None if fewer than two fits succeed.
    """
    own = [
        name
        for name in fitted.fit.layout.local
        if name in fitted.system.parameters and not name.startswith("bias_")
    ]
    levels, own_values = noise_levels(fitted.fit), (*fitted.values.own, *({} for _ in records))
    settings = replace(problem.roughly, iterations=20)
    values, sigma = [], []
    for record, mask, begin in zip(records, masks, own_values, strict=False):
        shared = fitted.values.shared
        fit = fit_with_fixed_noise(
            [record],
            fitted.system,
            shared,
            levels,
            settings,
            local=own,
            masks=[mask],
            begin=[begin],
            freed=names,
        )
        if fit is None or fit.outcome is not Outcome.CONVERGED:
            continue
        variance = np.maximum(np.diag(fit_covariance(fit)[0]), 1e-300)
        at = [fit.layout.names.index(name) for name in names]
        values.append(fit.theta[at])
        sigma.append(np.sqrt(variance[at]))
    return (np.transpose(values), np.transpose(sigma)) if len(values) > 1 else None


# ---- Parameters of an effect in each record


def parameters_by_record(
    fitted: FittedModel, effect: Traceable
) -> tuple[Mapping[str, Quantity], ...]:
    """Return estimates of the shared parameters of an effect from each record, by local name.

    One Gauss-Newton step gives each record its own values of these parameters; derivatives and all
    other effects stay shared.

    Returns
    -------
    One mapping a record, with sigmas; empty with one record, with process noise, and where the
    effect has no shared parameter.
    """
    fit, layout = fitted.fit, fitted.fit.layout
    count, names = len(layout.problems), list(layout.names)
    items = [item for item in effect.parameters if full_name(effect, item.name) in layout.shared]
    if count < 2 or not items or isinstance(effect, NoiseEffect):
        return ()
    at = [names.index(full_name(effect, item.name)) for item in items]
    size, k = len(fit.theta), len(at)
    normal, gradient = np.zeros((size + count * k,) * 2), np.zeros(size + count * k)
    for r, problem in enumerate(layout.problems):
        own = {position: size + r * k + number for number, position in enumerate(at)}
        columns = np.array([own.get(int(c), int(c)) for c in np.arange(size)[layout.columns(r)]])
        weight = np.where(problem.valid, 1.0 / fit.variance[:, None], 0.0)
        add_normal_equations(normal, gradient, columns, fit.jacobians[r], fit.residuals[r], weight)
    kept = np.array([i for i in range(len(normal)) if i not in at])
    start = np.concatenate([fit.theta, np.tile(fit.theta[at], count)])[kept]
    covariance, _ = inverse_information(normal[np.ix_(kept, kept)], start)
    step = covariance @ gradient[kept]
    first = len(kept) - count * k
    found = []
    for r in range(count):
        positions = first + r * k + np.arange(k)
        sigma = np.sqrt(np.maximum(np.diag(covariance)[positions], 1e-300))
        values = start[positions] + step[positions]
        found.append(
            {
                item.name: Quantity(float(value), float(std), item.unit)
                for item, value, std in zip(items, values, sigma, strict=True)
            }
        )
    return tuple(found)


def widened_by_scatter(
    sizes: Mapping[str, Quantity], by_record: Sequence[Mapping[str, Quantity]]
) -> dict[str, Quantity]:
    """Return the parameters of an effect with sigmas widened by their scatter between records.

    The factor is Birge's ratio, at least one: the square root of chi-squared over its degrees of
    freedom.
    """
    widened = dict(sizes)
    for name in set(sizes) & set(by_record[0] if by_record else ()):
        values = np.array([[found[name].value for found in by_record]])
        sigma = np.array([[found[name].std for found in by_record]])
        ratio = float(np.sqrt(reduced_chi_square(values, sigma)[0]))
        widened[name] = replace(sizes[name], std=max(1.0, ratio) * sizes[name].std)
    return widened


# ---- Uncertainty from the form of an effect


def form_spread(problem: TraceProblem, fitted: FittedModel) -> dict[str, float]:
    """Return the change of each declared parameter, beyond chance, if every effect of a set takes
    its refined form; empty if no effect has one.

    Sigmas include noise alone, and the base form of an effect is an approximation. The change is
    reduced by the part that the larger sigma of the refined form explains: sqrt(max(0, change^2 -
    (sigma_refined^2 - sigma_base^2))).
    """
    refined_forms = tuple(
        effect.finer() if isinstance(effect, Refinable) else effect for effect in fitted.effects
    )
    if refined_forms == fitted.effects or has_process_noise(fitted.system):
        return {}
    refit = problem.fit(refined_forms, fitted)
    if refit is None or refit.fit.cost > fitted.fit.cost:
        return {}
    base, refined = fitted.estimate, refit.estimate
    spread = {}
    for name in base.names:
        if name in problem.model.parameters and name in refined.names:
            chance = max(0.0, refined.sigma(name) ** 2 - base.sigma(name) ** 2)
            spread[name] = float(
                np.sqrt(max(0.0, (refined.value(name) - base.value(name)) ** 2 - chance))
            )
    return {name: value for name, value in spread.items() if np.isfinite(value)}
