"""Run a tracing scenario: simulate, diagnose, compare with the truth that a fit can find.

Estimates of a simplified model scatter about its pseudo-true value, the minimum of the expected
cost (White, Econometrica 50, 1982). It is found by a fit of the same model with the same priors to
two copies of the noise-free training record. One copy has a draw of sensor noise added, the other
has it subtracted: the sum of squares of both is twice that of the noise-free record plus twice the
noise, so that every output keeps its weight.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.modes import modal_estimate, propagated
from ident.process_noise.innovations_model import has_process_noise
from ident.tracing.diagnosis import Diagnosis, Quantity, Trained
from ident.tracing.fitted_model import (
    compiled_with,
    declared_priors,
    fit_as_declared,
    local_names,
    start_and_guesses,
)
from ident.tracing.predictive import Predicted, predict
from ident.whole_record.gauss_newton import Fit
from ident.whole_record.layout import FitLayout, FitSettings, Prior, lay_out
from ident.whole_record.output_error import estimate_of
from scenarios.diagnosis.diagnose import SPIKES, Tracing, diagnose_files
from scenarios.files.declarations import read_toml_source
from scenarios.files.vehicles import ALSO_READ
from scenarios.preparation.plan import Request
from scenarios.trials.planted_declaration import (
    CLOSED_LOOP,
    Grade,
    TraceScenario,
    grade,
    true_vehicle,
)
from scenarios.trials.planted_flights import (
    SimulatedTrace,
    elastic_modes,
    fly_loop,
    fly_trace,
    loop_of,
    modes_of_truth,
    with_outputs,
    write_simulated,
)
from sim.declaration.effect import DynamicsEffect, full_name
from sim.declaration.model import Model, System
from sim.record import Record
from sim.vehicles.flexibility import condense

# ---- Reference values: fit of the model to the same flight without sensor noise

_NONE: Mapping[str, float] = MappingProxyType({})
NOISE_FREE_SETTINGS = FitSettings(iterations=120, tolerance=3e-3, enough=2e-4, coloured=False)
# Prior of undetermined parameters, in sigmas of the estimate.
OPEN_PRIOR_SIGMAS = 100.0
# A parameter with a larger sigma, in sigmas of the estimate, is not determined by the noise-free
# flight.
UNDETERMINED_SIGMAS = 3.0
TURBULENCE = "gust-turbulence"
NOTABLE_SIGMAS = 1.0  # a larger difference, in sigmas of the estimate, is reported
NUMERICAL_SIGMAS = 0.1  # error of integration and sampling
NOISE_SEED = 7  # any draw gives the same sum of squares


@dataclass(frozen=True)
class Comparable:
    """Reference values of the estimates of a fitted model.

    Attributes
    ----------
    values : by parameter, SI; those of an effect by its full name.
    derived : frequencies and damping ratios of the fitted model at these values, by name.
    open : parameters that this flight does not determine. Their reference is the condensed value
        of a derivative, or the best fitting value nearest to the estimate.
    basis : source of the values, in words.
    """

    values: Mapping[str, float]
    derived: Mapping[str, float] = field(default_factory=lambda: _NONE)
    open: tuple[str, ...] = ()
    basis: str = ""


NOISE_FREE = "the same model fitted to the training flight without sensor noise"
TRUE = "the true values: a model with process noise has no noise-free fit"
NO_FIT = "the true values: the fit to the training flight without sensor noise found no minimum"


@dataclass(frozen=True)
class DeclaredTruth:
    """True values that are known by declaration.

    Attributes
    ----------
    values : true values by parameter, SI; those of an effect by its full name.
    condensed : derivatives of the rigid aircraft with the elastic modes statically condensed.
    modes : number of elastic modes of the true aircraft.
    """

    values: Mapping[str, float]
    condensed: Mapping[str, float] = field(default_factory=lambda: _NONE)
    modes: int = 0


def comparable_to(tracing: Tracing, simulated: SimulatedTrace, truth: DeclaredTruth) -> Comparable:
    """Return the reference values for the model with the found effects."""
    d = tracing.diagnosis
    assert d.trained_after is not None
    return _comparable(tracing.model, d.trained_after, quantities_of(d), simulated, truth)


def quantities_of(d: Diagnosis) -> dict[str, Quantity]:
    """Return the estimates of a diagnosis by parameter, those of an effect by its full name."""
    effects = d.trained_after.effects if d.trained_after is not None else ()
    of_effects = {
        full_name(effect, local): quantity
        for claim in d.effects
        for effect in effects
        if effect.name == claim.name
        for local, quantity in claim.parameters.items()
    }
    return {**d.after, **of_effects}


def _comparable(
    model: Model,
    trained: Trained,
    estimates: Mapping[str, Quantity],
    simulated: SimulatedTrace,
    truth: DeclaredTruth,
) -> Comparable:
    if has_process_noise(compiled_with(model, trained.effects, trained.outputs)[1]):
        return Comparable(truth.values, basis=TRUE)
    fit = noise_free_fit(model, trained, estimates, simulated)
    if fit is None:
        return Comparable(truth.values, basis=NO_FIT)
    estimate, layout = estimate_of(fit), fit.layout
    # Two copies of a record double the information.
    std = dict(zip(estimate.names, math.sqrt(2.0) * estimate.std, strict=True))
    values = dict(zip(estimate.names, estimate.values.tolist(), strict=True))
    # Parameters of single records are averaged over the copies, whose noise is opposite.
    local = np.mean([fit.theta[layout.columns(r)][len(layout.shared) :] for r in range(2)], axis=0)
    values |= dict(zip(layout.local, local[: len(layout.local)].tolist(), strict=True))
    values |= {
        name: true
        for name, true in truth.values.items()
        if name in values
        and name in estimates
        and abs(values[name] - true) <= NUMERICAL_SIGMAS * estimates[name].std
    }
    undetermined = tuple(
        name
        for name in std
        if name in estimates and std[name] > UNDETERMINED_SIGMAS * estimates[name].std
    )
    values |= {name: truth.condensed[name] for name in undetermined if name in truth.condensed}
    derived = modes_of(layout.system, estimate, slow_states(trained), truth.modes)
    return Comparable(
        values, {name: value for name, (value, _) in derived.items()}, undetermined, NOISE_FREE
    )


def noise_free_fit(
    model: Model, trained: Trained, estimates: Mapping[str, Quantity], simulated: SimulatedTrace
) -> Fit | None:
    """Return the fit of a model to both copies of the noise-free training record.

    It starts from the estimates. None if it finds no minimum.
    """
    rng = np.random.default_rng(NOISE_SEED)
    clean = simulated.noise_free
    with_noise = [
        (channel.values, simulated.noise_std[channel.name] * rng.standard_normal(len(clean)))
        for channel in clean.outputs
    ]
    pair = [
        with_outputs(clean, [values + sign * noise for values, noise in with_noise])
        for sign in (1.0, -1.0)
    ]
    return refit(model, trained, pair, fixed=estimates)


def refit(
    model: Model,
    trained: Trained,
    records: Sequence[Record],
    fixed: Mapping[str, Quantity] | None = None,
) -> Fit | None:
    """Return a trained model fitted to records, started at its values; None without a finite cost.

    Declared priors count once per record. ``fixed``: estimates for a weak prior of
    ``OPEN_PRIOR_SIGMAS`` sigmas on undetermined parameters.
    """
    _, system = compiled_with(model, trained.effects, trained.outputs)
    local = [name for effect in trained.effects for name in local_names(effect)]
    settings = replace(NOISE_FREE_SETTINGS, max_step=trained.settings.max_step)
    free_layout = lay_out(records, system, settings, local=local)
    begin, guesses = start_and_guesses(free_layout, None, {**trained.shared, **trained.own[0]})
    layout = lay_out(records, system, settings, local=local, start=begin)
    prior = declared_priors(model, trained.effects, layout)
    if prior is not None:
        prior = replace(prior, information=len(records) * prior.information)
    prior = _with_weak_prior(layout, prior, fixed or {})
    return fit_as_declared(replace(layout, prior=prior), guesses, None)


def _with_weak_prior(
    layout: FitLayout, prior: Prior | None, fixed: Mapping[str, Quantity]
) -> Prior | None:
    """Return a prior with a weak one about ``fixed`` added for the shared parameters."""
    at = [i for i, name in enumerate(layout.shared) if name in fixed]
    if not at:
        return prior
    means = np.array([fixed[layout.shared[i]].value for i in at])
    weights = np.array(
        [(OPEN_PRIOR_SIGMAS * max(fixed[layout.shared[i]].std, 1e-150)) ** -2 for i in at]
    )
    if prior is None:
        return Prior(np.array(at), means, np.diag(weights))
    n = len(layout.names)
    information, slope = np.zeros((n, n)), np.zeros(n)
    information[np.ix_(prior.positions, prior.positions)] += prior.information
    slope[prior.positions] += prior.information @ prior.mean
    information[at, at] += weights
    slope[at] += weights * means
    positions = np.array(sorted({*prior.positions.tolist(), *at}))
    joint = information[np.ix_(positions, positions)]
    return Prior(positions, np.linalg.solve(joint, slope[positions]), joint)


def reasons_for(
    scenario: TraceScenario,
    tracing: Tracing,
    simulated: SimulatedTrace,
    truth: DeclaredTruth,
    comparable: Comparable,
) -> tuple[str, ...]:
    """Return sentences on why reference values differ from the true ones."""
    d = tracing.diagnosis
    out = []
    open_derivatives = [
        name for name in comparable.open if name in truth.condensed and name in d.after
    ]
    if open_derivatives:
        out.append(
            f"{', '.join(open_derivatives)}: this flight leaves open which share of these loads "
            "the elastic mode takes; compared with the value by static condensation, the share of "
            "the mode at rest included"
        )
    others = [name for name in comparable.open if name not in open_derivatives]
    if others:
        out.append(
            f"{', '.join(others)}: left open by this flight with or without noise; compared with "
            "the nearest value that fits it"
        )
    out += _of_turbulence(tracing, simulated)
    if scenario.flight.vehicle.startswith(CLOSED_LOOP) and comparable.basis == NOISE_FREE:
        out += _of_the_gearing(scenario, tracing, simulated, truth, comparable)
    return tuple(out)


def _of_turbulence(tracing: Tracing, simulated: SimulatedTrace) -> list[str]:
    """Return a sentence on the number of scale lengths of hidden turbulence in the record.

    It is about the number of independent gusts from which the level is estimated.
    """
    length = simulated.hidden.get(TURBULENCE, {}).get("length", 0.0)
    if not length or "airspeed" not in tracing.model.parameters:
        return []
    time = simulated.train.time
    count = tracing.model.parameters["airspeed"].value * float(time[-1] - time[0]) / length
    return [
        f"{TURBULENCE}: the true values are those of very long records; this one holds {count:.0f} "
        "scale lengths, whose own level and length differ from them, and standard deviations "
        "shrink with the estimate"
    ]


def _of_the_gearing(
    scenario: TraceScenario,
    tracing: Tracing,
    simulated: SimulatedTrace,
    truth: DeclaredTruth,
    comparable: Comparable,
) -> list[str]:
    """Return sentences on the part of each difference that the stick gearing causes.

    It is found by a second noise-free fit with linear gearing.
    """
    curvature, d = loop_of(scenario).stick.curvature, tracing.diagnosis
    _, straight = fly_loop(
        scenario, scenario.flight.train, "key flight.train", np.random.default_rng(0), curvature=0.0
    )
    assert d.trained_after is not None
    linear = _comparable(
        tracing.model,
        d.trained_after,
        quantities_of(d),
        replace(simulated, noise_free=straight),
        truth,
    )
    estimates, by_gearing, by_order = quantities_of(d), [], []
    for name, true in truth.values.items():
        if name not in comparable.values or name not in estimates:
            continue
        notable = NOTABLE_SIGMAS * estimates[name].std
        if abs(comparable.values[name] - linear.values[name]) > notable:
            by_gearing.append(
                f"{name} {linear.values[name]:.4g} with a straight gearing, "
                f"{comparable.values[name]:.4g} as flown"
            )
        if abs(linear.values[name] - true) > notable:
            by_order.append(
                f"{name} {true:.4g} by the frequency response, {linear.values[name]:.4g} in this "
                "flight"
            )
    out = []
    if by_gearing:
        out.append(
            f"the stick's gearing steepens by {100.0 * curvature:.3g} % an inch, and one gain is "
            f"fitted: {'; '.join(by_gearing)}"
        )
    if by_order:
        reason = (
            "the model has a lower order than the loop, and the flight weighs frequencies unlike "
            "the fit to the frequency response"
        )
        out.append(
            f"{reason} (the recorded stick is held, which takes half a frame from the delay): "
            f"{'; '.join(by_order)}"
        )
    return out


def estimated_modes(tracing: Tracing, modes: int) -> dict[str, Quantity]:
    """Return frequencies and damping ratios of the elastic modes of the fitted model.

    They include all couplings. Empty without elastic modes.
    """
    trained = tracing.diagnosis.trained_after
    if not modes or trained is None:
        return {}
    _, system = compiled_with(tracing.model, trained.effects, trained.outputs)
    fit = None if has_process_noise(system) else refit(tracing.model, trained, tracing.records)
    if fit is None:
        return {}
    found = modes_of(fit.layout.system, estimate_of(fit), slow_states(trained), modes)
    return {
        name: Quantity(value, max(std, 1e-300), "rad/s" if name.endswith("frequency") else "1")
        for name, (value, std) in found.items()
        if name.startswith("elastic_mode")
    }


def slow_states(trained: Trained) -> set[str]:
    """Return the names of the states of nuisance dynamics, such as the phugoid."""
    return {
        state.name
        for effect in trained.effects
        if effect.traits.background and isinstance(effect, DynamicsEffect)
        for state in effect.states
    }


def modes_of(
    system: System, estimate: Estimate, fixed_states: Collection[str] = (), modes: int = 0
) -> dict[str, tuple[float, float]]:
    """Return frequencies and damping ratios of an estimated model and their sigmas, by name.

    They are those of ``modal_estimate``. If the aircraft has elastic ``modes``, those of the
    further oscillations with all couplings are added: ``elastic_mode_1_frequency`` (rad/s),
    ``elastic_mode_1_damping`` and so on.
    """
    result = modal_estimate(system, estimate, fixed_states)
    if not modes:
        return result
    names, centre, gradient = propagated(
        lambda p: elastic_modes(system, p, fixed_states), system, estimate
    )
    spread = np.sqrt(
        np.maximum(np.einsum("ki,ij,kj->k", gradient, estimate.covariance, gradient), 0.0)
    )
    rows = zip(names, centre, spread, strict=True)
    return result | {name: (float(value), float(std)) for name, value, std in rows}


# ---- Run a tracing scenario


@dataclass(frozen=True)
class Scored:
    """Estimates of a derivative, parameter of an effect or modal quantity, with true values.

    Attributes
    ----------
    true : true value; None if the truth has no such number.
    comparable : reference value: the value that the fitted model should find.
    before, after : estimate of the declared model, None if it has none; with the effects.
    condensed : condensed value of a rigid derivative of a flexible aircraft, else None.
    open : whether the flight does not determine this parameter, with or without noise.
    comparable_before : reference value of ``before``.
    """

    name: str
    unit: str
    true: float | None
    comparable: float
    before: Quantity | None
    after: Quantity
    condensed: float | None = None
    open: bool = False
    comparable_before: float | None = None

    @property
    def sigmas(self) -> float:
        """Error of ``after`` against the reference value, in reported standard deviations."""
        if not self.after.std > 0:
            return math.nan
        return (self.after.value - self.comparable) / self.after.std


@dataclass(frozen=True, eq=False)
class TraceStudy:
    """A tracing scenario that has been run.

    Attributes
    ----------
    derivatives, effects, modes : estimates with reference values.
    basis : origin of the reference values.
    reasons : sentences on reference values that differ from the true ones.
    test : prediction of the third record, not used for fitting or model selection.
    """

    scenario: TraceScenario
    seed: int
    simulated: SimulatedTrace
    tracing: Tracing
    grade: Grade
    derivatives: tuple[Scored, ...]
    effects: tuple[Scored, ...]
    modes: tuple[Scored, ...]
    basis: str
    reasons: tuple[str, ...]
    test: Predicted


def run_trace(
    scenario: TraceScenario,
    seed: int | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> TraceStudy:
    """Simulate the records, diagnose their files, compare with the truth.

    Raises
    ------
    FlightidError : the declared flight is impossible.
    """
    chosen = scenario.seed if seed is None else seed
    progress("flying", 0.0)
    simulated = fly_trace(scenario, chosen)
    with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
        train, validate, written = write_simulated(simulated, Path(folder))
        # Messages name the file of the study, not the temporary one.
        vehicle = replace(read_toml_source(written), path=Path(written.name))
        tracing = diagnose_files(
            Request((train,), scenario.model, vehicle, (validate,), effort=scenario.effort),
            progress,
        )
        # Notes on temporary files mean nothing to the user.
        notes = tuple(note for note in tracing.notes if not note.startswith(ALSO_READ))
        tracing = replace(tracing, notes=notes)
    progress("comparing with the truth", 0.98)
    return scored(scenario, chosen, simulated, tracing)


def scored(
    scenario: TraceScenario, seed: int, simulated: SimulatedTrace, tracing: Tracing
) -> TraceStudy:
    """Return a diagnosis compared with the truth, and the third record predicted by it."""
    truth, d = truth_of(scenario, simulated), tracing.diagnosis
    assert d.trained_before is not None
    after = comparable_to(tracing, simulated, truth)
    before = _comparable(tracing.model, d.trained_before, d.before, simulated, truth)
    return TraceStudy(
        scenario,
        seed,
        simulated,
        tracing,
        grade(scenario.expect, tracing),
        _derivatives(simulated, tracing, truth, after, before),
        _effects(tracing, truth, after),
        _modes(scenario, tracing, truth, after),
        after.basis,
        reasons_for(scenario, tracing, simulated, truth, after),
        predicted_test(simulated, tracing),
    )


def truth_of(scenario: TraceScenario, simulated: SimulatedTrace) -> DeclaredTruth:
    """Return the true values that the scenario declares."""
    hidden = {
        f"{name}.{local}": value
        for name, values in simulated.hidden.items()
        for local, value in values.items()
    }
    modes, condensed = scenario.flight.modes, {}
    if modes and scenario.model == "rigid":
        values = {item.name: item.value for item in true_vehicle(scenario.flight).parameters}
        condensed = dict(condense(values, modes).derivatives)
    return DeclaredTruth({**simulated.derivatives, **hidden}, condensed, modes)


def predicted_test(simulated: SimulatedTrace, tracing: Tracing) -> Predicted:
    """Return the third record predicted by the declared model, and with the effects found.

    The prediction is that of `flightid predict`.
    """
    d, inputs = tracing.diagnosis, {channel.name for channel in simulated.test.inputs}
    assert d.trained_before is not None and d.trained_after is not None
    spiked = [
        name
        for claim in d.effects
        if claim.claimed and (name := claim.name.removeprefix(SPIKES)) in inputs
    ]
    record = replace(simulated.test, hold=tracing.records[0].hold, name="test.csv")
    return predict(d.trained_before, d.trained_after, tracing.model, [record], spiked)


def _derivatives(
    simulated: SimulatedTrace,
    tracing: Tracing,
    truth: DeclaredTruth,
    comparable: Comparable,
    before: Comparable,
) -> tuple[Scored, ...]:
    d = tracing.diagnosis
    return tuple(
        Scored(
            name,
            after.unit,
            simulated.derivatives[name],
            comparable.values.get(name, simulated.derivatives[name]),
            d.before.get(name),
            after,
            truth.condensed.get(name),
            name in comparable.open,
            before.values.get(name, simulated.derivatives[name]),
        )
        for name, after in d.after.items()
        if name in simulated.derivatives
    )


def _effects(tracing: Tracing, truth: DeclaredTruth, comparable: Comparable) -> tuple[Scored, ...]:
    d = tracing.diagnosis
    return tuple(
        Scored(
            name,
            q.unit,
            truth.values.get(name),
            comparable.values[name],
            None,
            q,
            open=name in comparable.open,
        )
        for name, q in quantities_of(d).items()
        if name not in d.after and name in comparable.values
    )


def _modes(
    scenario: TraceScenario, tracing: Tracing, truth: DeclaredTruth, comparable: Comparable
) -> tuple[Scored, ...]:
    """Return frequencies and damping ratios; elastic modes with all couplings."""
    d, true = tracing.diagnosis, modes_of_truth(scenario)
    after = {**d.derived_after, **estimated_modes(tracing, truth.modes)}
    references = {**true, **comparable.derived}
    before = d.derived_before
    return tuple(
        Scored(name, q.unit, true.get(name), references[name], before.get(name), q)
        for name, q in after.items()
        if name in comparable.derived or (name in true and scenario.flight.own is None)
    )
