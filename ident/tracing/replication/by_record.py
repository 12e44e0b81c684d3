"""Does an effect come out alike from each record? Chance and colour do not replicate; a cause does."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FitData, FittedModel, Start, Values, belongs_to_record, fit_set
from ident.tracing.candidate_model.problem import TraceProblem
from ident.tracing.candidate_model.quantities import quantities_with, sigmas_from_absence, squared_distance
from ident.tracing.diagnosis import Quantity
from ident.tracing.settings import TraceSettings
from ident.tracing.validation.held_out import HeldOutData
from ident.tracing.witness import Witness, silent
from ident.whole_record.layout import FitSettings
from ident.whole_record.output_error import fit_covariance
from sim.declaration.effect import full_name
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.record import Record


@dataclass(frozen=True, eq=False)
class Flight:
    """All records that speak on one aircraft, fitted or held out, with their masks ``(m, N)`` and the outputs they have.

    ``witness`` speaks of effects by other means than the model.
    """

    records: tuple[Record, ...]
    masks: tuple[np.ndarray, ...]
    model: Model
    outputs: tuple[str, ...]
    settings: TraceSettings
    witness: Witness = silent

    def fit(
        self,
        effects: Sequence[Traceable],
        which: Sequence[int],
        start: Values | None,
        added: Mapping[str, float] | None = None,
        apart: Collection[str] = (),
    ) -> FittedModel | None:
        """Fit a set to some of the records, from the values of a fit of all of them or, for what is ``added``, from there.

        Of the parameters in ``apart`` each record has its own.
        """
        settings = FitSettings(max_step=2.0 * self.settings.max_step, iterations=20, tolerance=0.02, enough=0.1)
        values = None if start is None else Values(start.shared, tuple(start.own[r] for r in which), tuple(start.states[r] for r in which))
        records, masks = [self.records[r] for r in which], [self.masks[r] for r in which]
        data = FitData(records, masks, self.model, self.outputs)
        return fit_set(data, effects, settings, Start(values, added or {}), apart=apart)

    def beside(self, base: FittedModel, effect: Traceable, start: Values, added: Mapping[str, float] | None = None) -> FittedModel | None:
        """Fit a set with one effect more to all records, as ``fit`` does."""
        return self.fit((*base.effects, effect), range(len(self.records)), start, added)


def every_record(problem: TraceProblem, held: HeldOutData) -> Flight:
    """All records that speak on the aircraft, fitted or not; without the others where these cannot be simulated."""
    others = held.records if held.masks is not None else ()
    return Flight(
        (*problem.records, *others),
        (*problem.masks, *(held.masks or ())),
        problem.model,
        tuple(problem.outputs),
        problem.settings,
        problem.witness,
    )


def choosing_records(problem: TraceProblem, held: HeldOutData) -> Flight:
    """The records that effects may be chosen by: those that are held out take no part where two or more are fitted."""
    return every_record(problem, held if held.choosing else HeldOutData())


def recordings(records: Sequence[Record]) -> int:
    """How many records are no mere continuation of another: the last part of one record is the same flight, of which nothing replicates."""
    return sum(not any(_goes_on(other, record) for other in records if other is not record) for record in records)


def _goes_on(first: Record, then: Record) -> bool:
    """Whether a record of the same name begins where the first one ends."""
    ends, interval = float(first.time[-1]), float(np.median(np.diff(first.time)))
    return first.name == then.name and 0.0 < float(then.time[0]) - ends < thresholds.GAP * interval


@dataclass(frozen=True, eq=False)
class Replication:
    """One effect's parameters as each record has them, by local name; ``agrees`` where they are one value but for their scatter."""

    values: tuple[Mapping[str, Quantity], ...]
    agrees: bool


def replicate(flight: Flight, joint: FittedModel, effect: Traceable) -> Replication:
    """Let each record have an effect's parameters for itself, the derivatives in common, and compare.

    A record by itself may not tell an effect from a derivative; all of them together do. Of an effect with more than two parameters, which
    trade off against each other, it is not each number that has to agree, but what all of them do (``_does_alike``).
    """
    everything, shared = range(len(flight.records)), joint.values.shared
    names = {full_name(effect, item.name) for item in effect.parameters if item.free}
    fitted = flight.fit(joint.effects, everything, joint.values, {name: shared[name] for name in names if name in shared}, names)
    if fitted is None:
        return Replication((), False)
    each = by_record(fitted, effect)
    if len(names) > 2:
        return Replication(each, _does_alike(fitted, joint, effect))
    return Replication(each, all(_alike([found[name] for found in each], effect.absent.get(name)) for name in each[0]))


def by_record(fitted: FittedModel, effect: Traceable) -> tuple[dict[str, Quantity], ...]:
    """An effect's parameters in each record of a fit, with sigmas corrected for coloured residuals; alike where they are shared."""
    covariance, _ = fit_covariance(fitted.fit)
    return tuple(quantities_with(fitted, effect, covariance))


def distance_from_absence(fitted: FittedModel, effect: Traceable) -> float:
    """How far an effect's parameters, all together, stand off their absence, in corrected sigmas (the root of Wald's statistic, per parameter)."""
    covariance, _ = fit_covariance(fitted.fit)
    names = fitted.fit.layout.names
    absent = {full_name(effect, local): value for local, value in effect.absent.items()}
    at = [i for i, name in enumerate(names) if name in absent]
    if not at:
        return np.inf
    away = fitted.fit.theta[at] - np.array([absent[names[i]] for i in at])
    return float(np.sqrt(max(0.0, squared_distance(covariance, at, away)) / len(at)))


def most_telling(fitted: FittedModel, effect: Traceable) -> dict[str, Quantity]:
    """An effect's parameters in a fit, sigmas corrected for coloured residuals; of the record in which it stands out most where each has its own."""
    each = by_record(fitted, effect)
    return max(each, key=lambda found: sigmas_from_absence(effect, found)) if belongs_to_record(effect) else each[0]


def _does_alike(fitted: FittedModel, joint: FittedModel, effect: Traceable) -> bool:
    """Whether the common parameters of an effect do in each record what its own do.

    In twice the log likelihood of a record, expanded about its own parameters: what the common ones lose there, over what the effect as a
    whole brings. ``thresholds.ALIKE`` of it may differ, squared, or what ``thresholds.AGREE`` sigmas a parameter are. Of many records one may
    differ by more, where the common ones still do most of it or it hardly moves what the effect needs: it tells less than half of what the
    middle one of the others does.
    """
    odd: list[int] = []
    told: list[tuple[float, float]] = []
    covariance, _ = fit_covariance(fitted.fit)
    names = fitted.fit.layout.names
    absent = {full_name(effect, local): value for local, value in effect.absent.items()}
    for r in range(len(fitted.fit.layout.problems)):
        places = {name.partition(", record")[0]: i for i, name in enumerate(names) if name.endswith(f", record {r + 1}")}
        mine = [full_name(effect, item.name) for item in effect.parameters if item.free and full_name(effect, item.name) in places]
        at = [places[name] for name in mine]
        own, common = fitted.fit.theta[at], np.array([joint.values.shared.get(name, fitted.fit.theta[places[name]]) for name in mine])
        lost = squared_distance(covariance, at, common - own)
        acting = [i for i, name in enumerate(mine) if name in absent]
        whole = squared_distance(covariance, [at[i] for i in acting], own[acting] - np.array([absent[mine[i]] for i in acting]))
        told.append((lost, whole))
        if lost > max(thresholds.AGREE**2 * len(at), thresholds.ALIKE**2 * whole):
            odd.append(r)
    return not odd or (len(told) >= thresholds.MANY_RECORDS and len(odd) == 1 and _may_differ(told, odd[0]))


def _may_differ(told: Sequence[tuple[float, float]], odd: int) -> bool:
    """Whether one record of many may have values of its own: what is lost with the common ones and what the effect brings, of each.

    That the common values do harm there is asked apart, by its error when it is left out.
    """
    lost, whole = told[odd]
    others = float(np.median([each for r, (_, each) in enumerate(told) if r != odd]))
    return lost < thresholds.STILL_MOST * whole or whole < thresholds.HALF_OF_IT * others


def _alike(found: Sequence[Quantity], absent: float | None) -> bool:
    """Whether values from several records are one value, and, where there is an absence, stand off it in most of the records."""
    values, std = np.array([q.value for q in found]), np.array([q.std for q in found])
    zero = 0.0 if absent is None else absent
    weight = 1.0 / np.maximum(std, thresholds.LEAST_SIGMA * np.abs(values - zero) + 1e-300) ** 2
    mean = float(values @ weight / weight.sum())
    agree = np.abs(values - mean) <= np.maximum(thresholds.AGREE * std, thresholds.ALIKE * abs(mean - zero))
    if absent is None:
        # A limit, or a frequency: records that do not reach it say nothing, but one alone is no replication.
        return bool(np.all(agree) and np.count_nonzero(std < thresholds.KNOWN * np.abs(values)) >= min(2, len(found)))
    side = np.sign(values - zero) == np.sign(mean - zero)
    stand = np.abs(values - zero) > thresholds.OFF_ABSENCE * std
    return bool(np.all(agree) and np.all(side | (np.abs(values - zero) < std)) and np.count_nonzero(stand) >= max(1, len(found) - 1))
