"""A fitted model of the search: the declared model with a set of effects, fitted to all records."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.process_noise.filter_error import fit_with_process_noise, noise_levels
from ident.process_noise.innovations_model import has_process_noise
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitLayout, FitSettings, Prior, lay_out
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, full_name
from sim.declaration.model import Model
from sim.declaration.proposal import Traceable, Underdetermined
from sim.declaration.system import System
from sim.record import Record


@dataclass(frozen=True, eq=False)
class Values:
    """Values of unknowns by name, so that they can be carried from one model to another.

    ``shared`` by parameter; ``own`` by parameter and ``STATE(0)``, one mapping a record; ``states`` trajectories at the nodes
    by state, one mapping a record.
    """

    shared: Mapping[str, float]
    own: tuple[Mapping[str, float], ...]
    states: tuple[Mapping[str, np.ndarray], ...]


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A fitted set of effects.

    ``declared`` is the model without them, ``model`` that with them. ``criterion`` is twice the cost plus what the added
    parameters cost; a lower one is better. ``added`` counts parameters of the effects over all records.
    """

    effects: tuple[Traceable, ...]
    declared: Model
    model: Model
    system: System
    fit: Fit
    criterion: float
    added: int

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(effect.name for effect in self.effects)

    @property
    def guards(self) -> tuple[str, ...]:
        """Names of those of its effects that compete and can never be claimed."""
        return tuple(effect.name for effect in self.effects if effect.traits.guard)

    @property
    def values(self) -> Values:
        """All unknowns and trajectories by name."""
        fit, layout = self.fit, self.fit.layout
        n = len(layout.shared)
        own, states = [], []
        for r in range(len(layout.problems)):
            mine = fit.theta[layout.columns(r)][n:]
            names = [*layout.local, *(f"{layout.system.state_names[i]}(0)" for i in layout.starts)]
            own.append(dict(zip(names, mine.tolist(), strict=True)))
            states.append(dict(zip(layout.system.state_names, fit.lines[r].states, strict=True)))
        return Values(dict(zip(layout.shared, fit.theta[:n].tolist(), strict=True)), tuple(own), tuple(states))


def belongs_to_record(effect: Traceable) -> bool:
    """Whether an effect's parameters are fitted for each record by itself."""
    return effect.traits.per_record


def is_event(effect: Traceable) -> bool:
    """Whether an effect's position was searched for over the record."""
    return bool(effect.traits.onset)


def free_names(effect: Effect) -> list[str]:
    """Full names of an effect's free parameters."""
    return [full_name(effect, item.name) for item in effect.parameters if item.free]


def compiled_with(model: Model, effects: Sequence[Traceable], outputs: Sequence[str]) -> tuple[Model, System]:
    """The model with effects, and its System."""
    full = model.with_effects(*effects)
    return full, compile_model(full, outputs)


def fit_set(
    records: Sequence[Record],
    model: Model,
    effects: Sequence[Traceable],
    outputs: Sequence[str],
    settings: FitSettings,
    masks: Sequence[np.ndarray],
    event_cost: float,
    values: Values | None = None,
    added: Mapping[str, float] | None = None,
    levels: Mapping[str, float] | None = None,
    apart: Collection[str] = (),
) -> FittedModel | None:
    """Fit a set of effects, starting from another set's values and, for parameters it lacks, from ``added``.

    ``levels`` of the noise, of a set with process noise, are a warm start for another such set. Of the parameters in ``apart`` each record
    has its own although all of them would share it.

    None where the fit found no finite cost.
    """
    full, system = compiled_with(model, effects, outputs)
    local = [name for effect in effects if belongs_to_record(effect) for name in free_names(effect)]
    local += [name for name in apart if name not in local]
    plain = lay_out(records, system, settings, local=local, masks=masks)
    start, guesses = plain.start, None
    if values is not None or added:
        start, guesses = carried(plain, values, added or {})
        plain = lay_out(records, system, settings, local=local, masks=masks, start=start)
    fit = fit_as_declared(replace(plain, prior=known_beforehand(model, effects, plain)), guesses, levels)
    if fit is None:
        return None
    count = sum(len(free_names(effect)) * (len(records) if belongs_to_record(effect) else 1) for effect in effects)
    events = sum(1 for effect in effects if is_event(effect))
    criterion = 2.0 * fit.cost + count * np.log(float(fit.counts.sum())) + event_cost * events
    return FittedModel(tuple(effects), model, full, system, fit, float(criterion), count)


def fit_as_declared(layout: FitLayout, guesses: list[np.ndarray] | None, levels: Mapping[str, float] | None) -> Fit | None:
    """A whole-record fit, with a filter where process noise forces a state."""
    if has_process_noise(layout.system):
        return fit_with_process_noise(layout, guesses, levels)
    return fit_whole_records(layout, guesses)


def levels_of(fitted: FittedModel) -> Mapping[str, float] | None:
    """Noise levels of a fitted model with process noise; None where there is none."""
    return noise_levels(fitted.fit) if fitted.fit.layout.noise_model.names else None


def known_beforehand(model: Model, effects: Sequence[Traceable], layout: FitLayout) -> Prior | None:
    """Gaussian priors that a fit without process noise needs to be determined at all; None where it needs none.

    Effects declare some for their parameters, which keeps what no record excites from running away. A model with
    structural modes takes all that are declared: several directions of its parameters leave no trace in alpha, q and nz.
    """
    known = {
        full_name(effect, item.name): (effect.absent.get(item.name, item.value), item.prior_std)
        for effect in effects
        for item in effect.parameters
        if item.free and np.isfinite(item.prior_std)
    }
    if any(isinstance(effect, Underdetermined) and effect.needs_priors for effect in model.effects):
        known |= {
            item.name: (item.value, item.prior_std)
            for item in model.parameters
            if item.free and np.isfinite(item.prior_std) and not item.name.startswith("bias_")
        }
    at, means, weights = [], [], []
    for position, name in enumerate(layout.names):
        item = known.get(name.partition(", record")[0])
        if item is not None:
            at.append(position)
            means.append(item[0])
            weights.append(item[1] ** -2)
    return Prior(np.array(at), np.array(means), np.diag(weights)) if at else None


def carried(layout: FitLayout, values: Values | None, added: Mapping[str, float]) -> tuple[np.ndarray, list[np.ndarray] | None]:
    """Start and trajectory guesses for a layout from values by name."""
    start = layout.start.copy()
    n = len(layout.shared)
    known = dict(values.shared) if values is not None else {}
    for i, name in enumerate(layout.shared):
        start[i] = added.get(name, known.get(name, start[i]))
    guesses: list[np.ndarray] | None = [] if values is not None else None
    for r in range(len(layout.problems)):
        mine = values.own[r] if values is not None else {}
        names = [*layout.local, *(f"{layout.system.state_names[i]}(0)" for i in layout.starts)]
        at = layout.columns(r)[n:]
        for position, name in zip(at, names, strict=True):
            start[position] = added.get(name, mine.get(name, start[position]))
        if guesses is not None and values is not None:
            states = values.states[r]
            fitted_models = len(layout.problems[r].grid.nodes)
            guesses.append(np.array([states[name] if name in states else np.zeros(fitted_models) for name in layout.system.state_names]))
    return start, guesses
