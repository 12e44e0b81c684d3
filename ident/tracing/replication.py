"""Does an effect come out alike from each record by itself? Chance and colour do not replicate; a cause does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.fit_layout import FitSettings
from ident.output_error import fit_covariance
from ident.tracing.diagnosis import Quantity
from ident.tracing.node import Node, Values, fit_set
from ident.tracing.settings import TraceSettings
from sim.effect import Effect, full_name
from sim.model import Model
from sim.record import Record

AGREE = 3.0  # corrected sigmas that two records may differ by
ALIKE = 0.4  # of the mean, a difference that no one would call another value
STANDS = 2.0  # corrected sigmas from absence


@dataclass(frozen=True, eq=False)
class Flight:
    """All records that speak on one aircraft, fitted or held out, with their masks ``(m, N)`` and the outputs they have."""

    records: tuple[Record, ...]
    masks: tuple[np.ndarray, ...]
    model: Model
    outputs: tuple[str, ...]
    settings: TraceSettings

    def fit(self, effects: Sequence[Effect], which: Sequence[int], start: Values | None, added: Mapping[str, float] | None = None) -> Node | None:
        """Fit a set to some of the records, from the values of a fit of all of them or, for what is ``added``, from there."""
        settings = FitSettings(max_step=2.0 * self.settings.max_step, iterations=20, tolerance=0.02, enough=0.1)
        values = None if start is None else Values(start.shared, tuple(start.own[r] for r in which), tuple(start.states[r] for r in which))
        records, masks = [self.records[r] for r in which], [self.masks[r] for r in which]
        return fit_set(records, self.model, effects, list(self.outputs), settings, masks, 0.0, values, added)


@dataclass(frozen=True, eq=False)
class Replication:
    """One effect's parameters from each record by itself, by local name; ``agrees`` where they are one value but for their scatter."""

    values: tuple[Mapping[str, Quantity], ...]
    agrees: bool


def replicate(flight: Flight, effects: Sequence[Effect], effect: Effect, alone: Sequence[Node | None]) -> Replication:
    """Compare an effect's parameters over fits of single records.

    A curve's shapes trade off against each other and against the derivatives: for effects with more than two parameters it is
    the held-out errors that have to agree, not the numbers.
    """
    each = tuple(own_quantities(node, effect) if node is not None else {} for node in alone)
    agrees = all(node is not None for node in alone)
    if agrees and sum(item.free for item in effect.parameters) <= 2:
        agrees = all(_alike([found[name] for found in each], effect.absent.get(name)) for name in each[0])
    return Replication(each, agrees)


def own_quantities(node: Node, effect: Effect) -> dict[str, Quantity]:
    """An effect's parameters in a fit, with sigmas corrected for coloured residuals."""
    covariance, _ = fit_covariance(node.fit)
    places = {name: i for i, name in enumerate(node.fit.layout.names)}
    found = {}
    for item in effect.parameters:
        at = places.get(full_name(effect, item.name))
        if at is not None:
            found[item.name] = Quantity(float(node.fit.theta[at]), float(np.sqrt(max(covariance[at, at], 1e-300))), item.unit)
    return found


def _alike(found: Sequence[Quantity], absent: float | None) -> bool:
    """Whether values from several records are one value, and, where there is an absence, stand off it in most of the records."""
    values, std = np.array([q.value for q in found]), np.array([q.std for q in found])
    zero = 0.0 if absent is None else absent
    weight = 1.0 / np.maximum(std, 0.05 * np.abs(values - zero) + 1e-300) ** 2
    mean = float(values @ weight / weight.sum())
    if absent is None:
        return True
    agree = np.abs(values - mean) <= np.maximum(AGREE * std, ALIKE * abs(mean - zero))
    side = np.sign(values - zero) == np.sign(mean - zero)
    stand = np.abs(values - zero) > STANDS * std
    return bool(np.all(agree) and np.all(side | (np.abs(values - zero) < std)) and np.count_nonzero(stand) >= max(1, len(found) - 1))
