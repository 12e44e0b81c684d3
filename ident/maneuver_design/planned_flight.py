"""A flight that is planned: what a model with effects does in it, and what a fit of it would determine."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ident.maneuver_design.known_levels import KnownLevels
from ident.statistics.information import inverse_information
from ident.tracing.candidate_model.fitted_model import FittedModel, known_beforehand
from ident.whole_record.gauss_newton import Fit, evaluate, fit_whole_records, without_sensitivities
from ident.whole_record.layout import FitLayout, FitProblem, FitSettings, lay_out
from sim.declaration.compile import compile_model
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable
from sim.errors import ModelError
from sim.record import Channel, Record

CLOSED = 1e-9  # of a state's size: gaps of a trajectory that is simulated
PASSES = 12  # of Newton's method on the trajectory, which doubles the digits


@dataclass(frozen=True, eq=False)
class Planned:
    """A maneuver as a record would have it, and what would measure it.

    Attributes
    ----------
    record : inputs to be flown; its outputs only say which are measured, and from where a simulation begins.
    model : the declared model with its biases, at the values that it is believed to have.
    noise : standard deviation of each measured output, ``(m,)`` in the order of ``outputs``.
    settings : of the fits.
    """

    record: Record
    model: Model
    outputs: tuple[str, ...]
    noise: np.ndarray
    settings: FitSettings = field(default_factory=FitSettings)

    def measuring(self, y: np.ndarray) -> Planned:
        """The same maneuver, its record holding outputs ``(m, N)`` without noise."""
        rows = zip(self.outputs, y, strict=True)
        return replace(self, record=replace(self.record, outputs=tuple(Channel.of(name, self.record[name].unit, row) for name, row in rows)))


def simulated(planned: Planned, effects: Sequence[Traceable] = (), values: Mapping[str, float] | None = None, *, slopes: bool = True) -> FittedModel:
    """The model with effects in the maneuver, nothing fitted; ``values`` by full name where they are not the model's and the effects' own.

    Its residual is measured minus simulated. ``slopes`` False: without sensitivities, which are most of the work.

    Raises ModelError where the motion leaves all measure.
    """
    layout = _laid_out(planned, effects, values)
    problem = FitProblem(layout, KnownLevels(planned.noise**2))
    bare = without_sensitivities(problem)
    fit = evaluate(bare, layout.start, layout.guesses(layout.start))
    for _ in range(PASSES):
        if fit is None or (_gap(fit) < CLOSED and (fit.problem is problem or not slopes)):
            break
        fit = evaluate(problem if slopes else bare, layout.start, [line.states for line in fit.lines])
    if fit is None:
        raise ModelError("the simulation leaves all measure", where=planned.record.name, remedy="give starting values of a motion that stays finite")
    return _as_model(planned, effects, layout, fit)


def fitted(planned: Planned, effects: Sequence[Traceable], values: Mapping[str, float] | None = None) -> FittedModel | None:
    """The model with effects fitted to what the record of the maneuver holds, from ``values``; None where no cost is finite."""
    layout = _laid_out(planned, effects, values)
    fit = fit_whole_records(FitProblem(layout, KnownLevels(planned.noise**2)))
    return None if fit is None else _as_model(planned, effects, layout, fit)


def expected_sigmas(planned: Planned) -> dict[str, float]:
    """Cramer-Rao bounds of the free parameters of the declared model: standard deviations that no unbiased fit of the flight undercuts.

    Initial states and biases are unknown beside them, as in a fit. Infinite where the flight determines nothing of a parameter.
    """
    fit = simulated(planned).fit
    return sigmas_of(fit)


def sigmas_of(fit: Fit) -> dict[str, float]:
    """Standard deviations of the shared parameters by name, from the information of a fit or a simulation."""
    information, _ = fit.normal_equations()
    inverse, _ = inverse_information(information, fit.theta)
    told = np.diag(information) > 0.0
    std = np.where(told, np.sqrt(np.maximum(np.diag(inverse), 0.0)), np.inf)
    return dict(zip(fit.layout.shared, std.tolist(), strict=False))


def _laid_out(planned: Planned, effects: Sequence[Traceable], values: Mapping[str, float] | None) -> FitLayout:
    model = planned.model.with_effects(*effects)
    system = compile_model(model.with_values(values) if values else model, planned.outputs)
    plain = lay_out([planned.record], system, planned.settings)
    # Not where the record begins, which a plan does not know, but where the model does.
    items = [system.parameters[name] for name in (*plain.shared, *plain.local)] + [system.initial.items[i] for i in plain.starts]
    layout = replace(plain, start=np.clip(np.array([item.value for item in items], dtype=float), plain.low, plain.high))
    return replace(layout, prior=known_beforehand(planned.model, effects, layout))


def _as_model(planned: Planned, effects: Sequence[Traceable], layout: FitLayout, fit: Fit) -> FittedModel:
    return FittedModel(tuple(effects), planned.model, planned.model.with_effects(*effects), layout.system, fit)


def _gap(fit: Fit) -> float:
    gaps = (np.max(np.abs(line.states - guess), initial=0.0) for line, guess in zip(fit.lines, fit.guesses, strict=True))
    size = max(np.max(np.abs(line.states), initial=0.0) for line in fit.lines)
    return float(max(gaps) / max(size, 1e-300))
