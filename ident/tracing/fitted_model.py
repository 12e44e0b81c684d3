"""A fitted model of the search: the declared model with a set of effects, fitted to all records."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ident.estimate import Estimate
from ident.process_noise.filter_error import (
    filter_error_estimate,
    fit_with_process_noise,
    noise_levels,
)
from ident.process_noise.innovations_model import has_process_noise
from ident.statistics.intervals import inverse_information
from ident.tracing.diagnosis import Quantity, Trained
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitLayout, FitProblem, FitSettings, Prior, lay_out
from ident.whole_record.output_error import estimate_of, fit_from_best_start, grows_little
from ident.whole_record.unstable_motion import fit_projected, projectable
from sim.declaration.compile import compile_model
from sim.declaration.effect import Effect, full_name
from sim.declaration.model import Model, System
from sim.declaration.proposal import Traceable, Underdetermined
from sim.record import Record


@dataclass(frozen=True, eq=False)
class Values:
    """Values of the unknowns of a fit by name, to start the fit of another model.

    Attributes
    ----------
    shared : values of the parameters that all records share.
    own : for each record, values of its own parameters and of its initial states ``STATE(0)``.
    states : for each record, trajectories of the states at the nodes, ``(K + 1,)``.
    """

    shared: Mapping[str, float]
    own: tuple[Mapping[str, float], ...]
    states: tuple[Mapping[str, np.ndarray], ...]

    def with_added(self, added: Sequence[Mapping[str, float]]) -> Values:
        """Return these values with those of further parameters, one mapping a record."""
        shared = {name: value for one in added for name, value in one.items()}
        own = tuple({**mine, **one} for mine, one in zip(self.own, added, strict=True))
        return Values({**shared, **self.shared}, own, self.states)

    def with_shared(self, shared: Mapping[str, float]) -> Values:
        """Return these values with other ones of shared parameters."""
        return Values({**self.shared, **shared}, self.own, self.states)

    def with_shifted(self, name: str, record: int, shift: float) -> Values:
        """Return these values, one of them increased by ``shift``: a shared value, or the value of
        one record.
        """
        if name in self.shared:
            return self.with_shared({name: self.shared[name] + shift})
        own = list(self.own)
        own[record] = {**own[record], name: own[record][name] + shift}
        return Values(self.shared, tuple(own), self.states)


@dataclass(frozen=True, eq=False)
class FitData:
    """Data that sets of effects are fitted to: records, masks ``(m, N)`` of the samples used, the
    declared model, its outputs by name.

    ``least_noise`` : smallest measurement noise by output, for fits with process noise.
    """

    records: Sequence[Record]
    masks: Sequence[np.ndarray]
    model: Model
    outputs: Sequence[str]
    least_noise: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Start:
    """Start of a fit.

    Attributes
    ----------
    values : values of another fit; None starts from the declared values.
    added : values of parameters, which replace those of ``values``.
    levels : noise levels, for a fit with process noise.
    """

    values: Values | None = None
    added: Mapping[str, float] = field(default_factory=dict)
    levels: Mapping[str, float] | None = None


@dataclass(frozen=True, eq=False)
class FittedModel:
    """A fitted set of effects.

    Attributes
    ----------
    effects : the set. declared : the model without them. model : the model with them.
    system : the compiled ``model``. fit : its fit to all records.
    """

    effects: tuple[Traceable, ...]
    declared: Model
    model: Model
    system: System
    fit: Fit

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects of the set."""
        return tuple(effect.name for effect in self.effects)

    @property
    def guards(self) -> tuple[str, ...]:
        """Names of the catch-all terms of the set, which compete and are never claimed."""
        return tuple(effect.name for effect in self.effects if effect.traits.guard)

    @property
    def background(self) -> tuple[Traceable, ...]:
        """Nuisance dynamics of the set: motion that any record may have."""
        return tuple(effect for effect in self.effects if effect.traits.background)

    @cached_property
    def estimate(self) -> Estimate:
        """Values with sigmas corrected for coloured residuals."""
        process_noise = has_process_noise(self.system)
        return filter_error_estimate(self.fit) if process_noise else estimate_of(self.fit)

    @property
    def trained(self) -> Trained:
        """Estimates that a free simulation of another record uses."""
        values = self.values
        return Trained(
            self.effects,
            self.system.output_names,
            values.shared,
            values.own,
            self.fit.layout.settings,
        )

    @property
    def values(self) -> Values:
        """All unknowns and trajectories by name."""
        fit, layout = self.fit, self.fit.layout
        n = len(layout.shared)
        own, states = [], []
        for r in range(len(layout.problems)):
            mine = fit.theta[layout.columns(r)][n:]
            names = [
                *layout.local,
                *(f"{layout.system.state_names[i]}(0)" for i in layout.free_initial),
            ]
            own.append(dict(zip(names, mine.tolist(), strict=True)))
            states.append(
                dict(zip(layout.system.state_names, fit.linearisations[r].states, strict=True))
            )
        return Values(
            dict(zip(layout.shared, fit.theta[:n].tolist(), strict=True)), tuple(own), tuple(states)
        )


def belongs_to_record(effect: Traceable) -> bool:
    """Return whether each record has its own parameters of an effect."""
    return effect.traits.per_record


def local_names(effect: Traceable) -> list[str]:
    """Return the full names of an effect's free parameters that are fitted for each record."""
    if not belongs_to_record(effect):
        return []
    shared = {full_name(effect, local) for local in effect.traits.of_aircraft}
    return [name for name in free_names(effect) if name not in shared]


def added_parameters(effect: Traceable, records: int) -> int:
    """Return the number of parameters that an effect adds to a fit of ``records`` records, without
    those that every aircraft has.
    """
    known = {full_name(effect, local) for local in effect.traits.of_aircraft}
    own = local_names(effect)
    return len(own) * records + sum(
        1 for name in free_names(effect) if name not in known and name not in own
    )


def is_event(effect: Traceable) -> bool:
    """Return whether an effect's position was searched for over the record."""
    return bool(effect.traits.onset)


def compatible(one: Traceable, other: Traceable) -> bool:
    """Return whether two effects may be in one set.

    Two names of one fault may not, nor two laws of which a record shows at most one.
    """
    return one.name != other.name and not any(
        name in (*each.traits.twins, *each.traits.never_beside)
        for each, name in ((one, other.name), (other, one.name))
    )


def free_names(effect: Effect) -> list[str]:
    """Return the full names of the free parameters of an effect."""
    return [full_name(effect, item.name) for item in effect.parameters if item.free]


def compiled_with(
    model: Model, effects: Sequence[Traceable], outputs: Sequence[str]
) -> tuple[Model, System]:
    """Return the model with the effects, and its compiled system."""
    full = model.with_effects(*effects)
    return full, compile_model(full, outputs)


def fit_set(
    data: FitData,
    effects: Sequence[Traceable],
    settings: FitSettings,
    start: Start | None = None,
    *,
    apart: Collection[str] = (),
) -> FittedModel | None:
    """Return the fit of a set of effects; None if it found no finite cost.

    ``apart`` : names of parameters of which each record has its own value, even if their effect is
    shared.
    """
    start = start or Start()
    full, system = compiled_with(data.model, effects, data.outputs)
    local = [name for effect in effects for name in local_names(effect)]
    local += [name for name in apart if name not in local]
    plain = lay_out(data.records, system, settings, local=local, masks=data.masks)
    guesses = None
    if start.values is not None or start.added:
        first, guesses = start_and_guesses(plain, start.values, start.added)
        plain = lay_out(data.records, system, settings, local=local, masks=data.masks, start=first)
    fit = fit_as_declared(
        replace(plain, prior=declared_priors(data.model, effects, plain)),
        guesses,
        start.levels,
        data.least_noise,
    )
    return None if fit is None else FittedModel(tuple(effects), data.model, full, system, fit)


def fit_as_declared(
    layout: FitLayout,
    guesses: list[np.ndarray] | None,
    levels: Mapping[str, float] | None,
    least: Mapping[str, float] | None = None,
) -> Fit | None:
    """Return a whole-record fit, with a filter where the system has process noise."""
    if has_process_noise(layout.system):
        return fit_with_process_noise(layout, guesses, levels, least)
    if projectable(layout) and not grows_little(layout):
        return (
            fit_from_best_start(layout)
            if guesses is None and layout.prior is None
            else fit_projected(layout, guesses)
        )
    return fit_whole_records(FitProblem(layout), guesses)


def start_from(fitted: FittedModel | None, added: Mapping[str, float] | None = None) -> Start:
    """Return a start from another fitted model, or from the declared values where there is none."""
    return (
        Start(added=added or {})
        if fitted is None
        else Start(fitted.values, added or {}, levels_of(fitted))
    )


def levels_of(fitted: FittedModel) -> Mapping[str, float] | None:
    """Return the noise levels of a fitted model with process noise; None without process noise."""
    return noise_levels(fitted.fit) if fitted.fit.noise_model.names else None


def declared_priors(model: Model, effects: Sequence[Traceable], layout: FitLayout) -> Prior | None:
    """Return the Gaussian priors that a fit without process noise needs to be determinate; None if
    it needs none.

    Some effects declare priors for their parameters, and some models for their biases. A model with
    structural modes uses all declared priors: alpha, q and nz leave several directions of its
    parameters undetermined.
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
    known |= {
        f"bias_{name}": (0.0, std)
        for name in model.biases
        if np.isfinite(std := model.parameters[f"bias_{name}"].prior_std)
    }
    tried = {full_name(effect, local) for effect in effects for local in effect.traits.tried}
    at, means, weights = [], [], []
    for position, name in enumerate(layout.names):
        plain = name.partition(", record")[0]
        item = known.get(plain)
        if item is not None:
            at.append(position)
            means.append(float(layout.start[position]) if plain in tried else item[0])
            weights.append(item[1] ** -2)
    return Prior(np.array(at), np.array(means), np.diag(weights)) if at else None


def start_and_guesses(
    layout: FitLayout, values: Values | None, added: Mapping[str, float]
) -> tuple[np.ndarray, list[np.ndarray] | None]:
    """Return the start and trajectory guesses for a layout from values by name."""
    start = layout.start.copy()
    n = len(layout.shared)
    known = dict(values.shared) if values is not None else {}
    for i, name in enumerate(layout.shared):
        start[i] = added.get(name, known.get(name, start[i]))
    guesses: list[np.ndarray] | None = [] if values is not None and values.states else None
    for r in range(len(layout.problems)):
        mine = values.own[r] if values is not None else {}
        names = [
            *layout.local,
            *(f"{layout.system.state_names[i]}(0)" for i in layout.free_initial),
        ]
        at = layout.columns(r)[n:]
        for position, name in zip(at, names, strict=True):
            start[position] = added.get(name, mine.get(name, start[position]))
        if guesses is not None and values is not None:
            states = values.states[r]
            nodes = len(layout.problems[r].grid.nodes)
            guesses.append(
                np.array(
                    [
                        states[name] if name in states else np.zeros(nodes)
                        for name in layout.system.state_names
                    ]
                )
            )
    return start, guesses


# ---- Parameters of an effect in a fitted model

# sigmas from absence at which an effect acts in a record; by chance one in 16,000
ABSENCE_SIGMAS = 4.0


def quantities(fitted: FittedModel, effect: Traceable) -> dict[str, Quantity]:
    """Return the free parameters of an effect in a fitted model, by local name.

    If each record has its own, they are from the record in which they differ most from absence.
    """
    return max(
        _quantities_by_record(fitted, effect), key=lambda found: sigmas_from_absence(effect, found)
    )


def records_of(fitted: FittedModel, effect: Traceable) -> tuple[int, ...]:
    """Return the numbers, from 0, of the records on which a record-specific effect acts; empty if
    it acts on all.
    """
    each = _quantities_by_record(fitted, effect)
    seen = tuple(
        r for r, found in enumerate(each) if sigmas_from_absence(effect, found) > ABSENCE_SIGMAS
    )
    return seen if 0 < len(seen) < len(each) else ()


def _quantities_by_record(fitted: FittedModel, effect: Traceable) -> list[dict[str, Quantity]]:
    """Return the free parameters of an effect in every record; equal where the parameters are
    shared.
    """
    normal, _ = fitted.fit.normal_equations()
    covariance, _ = inverse_information(normal, fitted.fit.theta)
    return quantities_with(fitted, effect, covariance)


def quantities_with(
    fitted: FittedModel, effect: Traceable, covariance: np.ndarray
) -> list[dict[str, Quantity]]:
    """Return an effect's parameters in each record of a fitted model, with sigmas from a covariance
    ``(n, n)`` of all unknowns.
    """
    positions = {name: i for i, name in enumerate(fitted.fit.layout.names)}
    out: list[dict[str, Quantity]] = []
    for r in range(len(fitted.fit.layout.problems)):
        found = {}
        for item in effect.parameters:
            full = full_name(effect, item.name)
            at = positions.get(full, positions.get(f"{full}, record {r + 1}"))
            if at is not None:
                found[item.name] = Quantity(
                    float(fitted.fit.theta[at]),
                    float(np.sqrt(max(covariance[at, at], 1e-300))),
                    item.unit,
                )
        out.append(found)
    return out


def sigmas_from_absence(effect: Traceable, found: Mapping[str, Quantity]) -> float:
    """Return the largest number of standard deviations by which an effect's parameters differ from
    its absence; infinite if no parameter can be absent.
    """
    known = [
        abs(found[local].value - value) / found[local].std
        for local, value in effect.absent.items()
        if local in found
    ]
    return max(known, default=np.inf)


def absent_values(effects: Iterable[Traceable]) -> dict[str, float]:
    """Return the values by full name at which effects do not act, such as a delay of zero."""
    return {
        full_name(each, local): value for each in effects for local, value in each.absent.items()
    }
