"""Parameters that end at a bound, and parameters that follow others."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.statistics.information import variance_along
from scenarios.files.constraints import side_at
from scenarios.studies.rows import Row
from sim.declaration.model import Model, System


@dataclass(frozen=True)
class AtBound:
    """A parameter that a fit pressed against its ``"lower"`` or ``"upper"`` bound."""

    name: str
    value: float
    unit: str
    side: str

    @property
    def words(self) -> str:
        """``"Cm_q is at its lower bound, -30 1/rad"``."""
        return f"{self.name} is at its {self.side} bound, {self.value:g}{'' if self.unit == '1' else f' {self.unit}'}"


def within_bounds(
    model: Model, estimated: Callable[[Model], tuple[System, Estimate]], *, kept: bool = True
) -> tuple[Model, System, Estimate, tuple[AtBound, ...]]:
    """An estimate whose sigmas are those of what is free: parameters that end at a bound are held there, and the rest estimated again.

    Its outcome is ``AT_BOUND`` where there are such and the rest has settled. The model comes back with them held. ``kept``: the method keeps
    bounds; what one does not keep cannot end at one.
    """
    system, estimate = estimated(model)
    found: list[AtBound] = []
    while kept and (pressed := _pressed(model, estimate)):
        if len(pressed) == sum(name in model.parameters for name in estimate.names):
            break  # nothing would be left to estimate
        found += pressed
        sound = {name: value for name, value in estimate.as_dict().items() if name in model.parameters and np.isfinite(value)}
        parameters = model.parameters.with_values({**sound, **{each.name: each.value for each in pressed}})
        model = model.with_parameters(parameters.hold([each.name for each in pressed]))
        system, estimate = estimated(model)
    if found and estimate.outcome is Outcome.CONVERGED:
        estimate = replace(estimate, outcome=Outcome.AT_BOUND)
    return model, system, estimate, tuple(found)


def tied_rows(model: Model, estimate: Estimate) -> tuple[Row, ...]:
    """A row for each parameter that follows others, its sigma from theirs."""
    rows = []
    known: Mapping[str, float] = {**{item.name: item.value for item in model.parameters}, **estimate.as_dict()}
    for tie in model.ties:
        slope = np.zeros(len(estimate.names))
        for source, factor in tie.terms:
            if source in estimate.names:
                slope[estimate.names.index(source)] += factor
        std = float(np.sqrt(variance_along(estimate.covariance, slope[None])[0]))
        rows.append(Row(tie.name, model.parameters[tie.name].unit, float(tie.of(known.__getitem__)), std))
    return tuple(rows)


def _pressed(model: Model, estimate: Estimate) -> list[AtBound]:
    out = []
    for name, value in estimate.as_dict().items():
        if name not in model.parameters or not np.isfinite(value):
            continue
        item = model.parameters[name]
        side = side_at(value, item.bounds)
        if side:
            out.append(AtBound(name, item.bounds[0 if side == "lower" else 1], item.unit, side))
    return out
