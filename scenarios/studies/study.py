"""Run a scenario: simulate its flight, estimate by every method, compare.

Also repeats flights, and finds what a record determines of the parameters.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.estimate import Estimate
from ident.flying_qualities.levels import ModeLevel, mode_levels
from ident.flying_qualities.modes import characteristics, modal_estimate
from ident.statistics.intervals import Determination, clustered_share, determination
from ident.statistics.residuals import ResidualTest, tests_of_records
from ident.whole_record.layout import weighted_sensitivities
from scenarios.files.declarations import CHANNEL_UNITS
from scenarios.files.user_models import moves_about_rest
from scenarios.report.quantities import in_hertz, shown_in, spaced
from scenarios.studies.declaration import (
    EMPTY,
    Estimation,
    Row,
    Scenario,
    Variation,
    published_values,
    rows_of,
    seen_by,
)
from scenarios.studies.estimating import (
    Result,
    biased_system,
    compiled,
    condensed_values,
    declared_for,
    estimate_record,
    flown_vehicle,
    fly_scenario,
    measured_again,
    true_model,
)
from scenarios.studies.sweep import Sweep
from sim.declaration.model import Model
from sim.errors import ModelError
from sim.record import Record
from sim.truth.flight import Truth
from sim.vehicles.factory import linearise
from sim.vehicles.flexibility import LARGEST_MISFIT, Flexibility, flexibility

# ---- Repeated flights of a scenario

RESAMPLING_SEED = 1  # fixed, so that the same runs give the same interval


@dataclass(frozen=True, eq=False)
class Scatter:
    """Results of one estimator on a flight that was simulated many times.

    Attributes
    ----------
    flight : label of the flight.
    estimation : the estimator.
    names, units : the n derivatives and their units.
    errors : estimate minus true value in the M runs that converged, shape ``(n, M)``.
    std : reported sigmas, shape ``(n, M)``.
    outcomes : number of runs by outcome code.
    """

    flight: str
    estimation: Estimation
    names: tuple[str, ...]
    units: tuple[str, ...]
    errors: np.ndarray
    std: np.ndarray
    outcomes: Mapping[str, int]

    @property
    def sigmas(self) -> np.ndarray:
        """Errors over reported standard deviations ``(n, M)``."""
        return np.asarray(self.errors / self.std)

    @property
    def rms_sigmas(self) -> np.ndarray:
        """Root mean square of ``sigmas`` ``(n,)``: one if the reported sigmas are correct."""
        return _rms(self.sigmas)

    @property
    def rms(self) -> np.ndarray:
        """Root mean square error by derivative ``(n,)``, in its unit."""
        return _rms(self.errors)

    @property
    def within_two(self) -> tuple[float, tuple[float, float]]:
        """Coverage of 2-sigma intervals over all derivatives, with its bootstrap 95 % interval."""
        hits = np.sum(np.abs(self.sigmas) <= 2.0, axis=0)
        if not hits.size:
            return 0.0, (0.0, 1.0)
        share = float(hits.mean()) / len(self.names)
        possible = np.full(len(hits), len(self.names))
        return share, clustered_share(hits, possible, np.random.default_rng(RESAMPLING_SEED))


def _rms(values: np.ndarray) -> np.ndarray:
    """Return the root mean square over runs of ``(n, M)``; NaN without a run."""
    if not values.shape[1]:
        return np.full(len(values), np.nan)
    return np.asarray(np.sqrt(np.mean(values**2, axis=1)))


def fly_repeatedly(
    scenario: Scenario,
    seed: int | None = None,
    progress: Callable[[str, float], None] = lambda stage, share: None,
) -> tuple[Scatter, ...]:
    """Return the results of all repeated flights of a scenario; run i has the seed ``seed + i``.

    Raises
    ------
    FlightidError : the declared flight or estimation is impossible.
    """
    if scenario.repeated is None:
        return ()
    first_seed = scenario.seed if seed is None else seed
    seeds = range(first_seed, first_seed + scenario.repeated.runs)
    scatters = []
    parts = [
        (flight, estimation)
        for flight in scenario.repeated.flights
        for estimation in scenario.estimations
        if estimation.name in flight.methods
    ]
    for number, (flight, estimation) in enumerate(parts):
        stage = f"{number + 1} of {len(parts)}, {flight.label}: {estimation.label}"
        progress(stage, number / len(parts))
        changed = replace(scenario, flight=flight.flight)
        flown = [fly_scenario(changed, run_seed) for run_seed in seeds]
        scatters.append(_scatter(scenario, flight, estimation, flown))
    return tuple(scatters)


def _scatter(
    scenario: Scenario,
    variation: Variation,
    estimation: Estimation,
    flown: list[tuple[Record, Truth]],
) -> Scatter:
    model = declared_for(scenario, estimation, variation.flight)
    names = tuple(estimation.start)
    with_batch_engine = replace(estimation, engine="batched")
    estimates = [estimate_record(with_batch_engine, record, model).estimate for record, _ in flown]
    true = np.array([[truth.parameters[name].value for name in names] for _, truth in flown])
    values = np.array([[estimate.value(name) for name in names] for estimate in estimates])
    std = np.array([[estimate.sigma(name) for name in names] for estimate in estimates])
    converged = np.array([estimate.outcome.code == "converged" for estimate in estimates])
    outcomes = Counter(estimate.outcome.code for estimate in estimates)
    units = tuple(model.parameters[name].unit for name in names)
    return Scatter(
        variation.label,
        estimation,
        names,
        units,
        (values - true)[converged].T,
        std[converged].T,
        dict(outcomes),
    )


# ---- Determination of parameters by a record, linearised at the estimate


@dataclass(frozen=True, eq=False)
class MethodDetermination:
    """What record and priors determine of the parameters of a method.

    Attributes
    ----------
    estimation : the method.
    found : information of record and priors.
    claimed : sigmas that the method reports, shape ``(n,)``.
    """

    estimation: Estimation
    found: Determination
    claimed: np.ndarray

    @property
    def overclaimed(self) -> tuple[str, ...]:
        """Parameters whose reported sigma is smaller than record and priors allow."""
        ratio = self.claimed / self.found.posterior_std
        return tuple(
            name
            for name, value in zip(self.found.names, ratio.tolist(), strict=True)
            if value < LEAST_SIGMA_RATIO
        )


# A smaller ratio of the reported to the attainable sigma is an overclaim. Nonlinearity and the
# estimated noise change the ratio by 10 %.
LEAST_SIGMA_RATIO = 0.8


def determine(
    estimation: Estimation, record: Record, model: Model, estimate: Estimate
) -> MethodDetermination:
    """Return how well a record and the priors of a model determine the parameters.

    The sensitivities are those at the estimate, the noise levels those of the model. Process noise
    is left out; it could only reduce the information. Sensor biases are unknown, as in fits of
    whole records.
    """
    system = biased_system(
        estimation, model.with_values(estimate.only(model.parameters.free_names).as_dict())
    )
    noise = np.array([model.noise.measurement_std[name] for name in system.output_names])
    names, slopes = weighted_sensitivities(record, system, noise)
    found = determination(names, slopes, np.array([estimation.start[name].std for name in names]))
    return MethodDetermination(
        estimation, found, np.array([estimate.sigma(name) for name in names])
    )


# ---- Notes on a study

# With a larger ratio of posterior to prior sigma, the record hardly determines the parameter.
LARGEST_SIGMA_SHARE_OF_PRIOR = 0.5


def prior_note(result: Result) -> str:
    """Return a note on parameters that the record hardly determines; empty if there are none.

    Parameters with process noise are left out.
    """
    estimation = result.estimation
    priors = {
        name: start
        for name, start in estimation.start.items()
        if not estimation.process_noise.get(name)
    }
    if result.estimate.history is None and not estimation.use_priors:
        return ""
    sigma = dict(zip(result.estimate.names, result.estimate.std.tolist(), strict=True))
    named = [
        f"{name} {value / priors[name].std:.2f}"
        for name, value in sigma.items()
        if name in priors and value > LARGEST_SIGMA_SHARE_OF_PRIOR * priors[name].std
    ]
    if not named:
        return ""
    return (
        f"{estimation.name}: determined by the prior more than by the record (sigma over prior "
        f"sigma): {', '.join(named)}"
    )


def residual_note(result: Result, model: Model) -> str:
    """Return a note on the power of the residuals near the elastic frequencies of ``model``.

    The note is empty for a rigid model. It has the share of the power between half the lowest and
    1.5 times the highest elastic frequency, in the periodogram of residuals or normalized
    innovations. If the share is above twice that of white noise, it names the strongest frequency.
    """
    elastic = elastic_frequencies(model)
    if not elastic:
        return ""
    low, high = 0.5 * min(elastic), 1.5 * max(elastic)
    shares, white = [], 0.0
    for name, row in zip(result.estimate.output_names, residuals_of(result), strict=True):
        omega, power = periodogram(row, float(np.median(np.diff(result.record.time))))
        inside = (omega >= low) & (omega <= high)
        share, white = float(power[inside].sum() / power.sum()), float(inside.mean())
        strongest = ""
        if share > 2.0 * white:
            strongest = f" (strongest at {_frequency(float(omega[np.argmax(power)]))})"
        shares.append(f"{name} {100 * share:.0f} %{strongest}")
    band = (
        f"between {low:.1f} and {high:.1f} rad/s ({low / (2.0 * math.pi):.2g} and "
        f"{high / (2.0 * math.pi):.2g} Hz), about the elastic modes"
    )
    return (
        f"{result.estimation.name}: share of the residual's power {band}: {', '.join(shares)}; "
        f"white noise has {100 * white:.0f} % there"
    )


def flexibility_sentences(found: Flexibility, noise_std: Mapping[str, float]) -> tuple[str, ...]:
    """Return sentences that compare the degree of flexibility with its threshold."""
    degree = (
        f"degree of flexibility {found.degree:.3g}: error of a quasi-static structure at the short "
        f"period of {_frequency(found.short_period)}; deflection takes "
        f"{100 * found.stiffness_loss:.0f} % of the rigid short period's stiffness"
    )
    if math.isfinite(found.separation):
        degree += f", the lowest elastic frequency is {found.separation:.2g} times its frequency"
    noise = ", ".join(_level(name, std) for name, std in noise_std.items())
    misfit = (
        f"the part of this maneuver that no rigid model explains is {found.misfit:.2g} times the "
        f"noise in rms (noise: {noise})"
    )
    if not found.rigid_serves:
        return degree, f"{misfit}; threshold {LARGEST_MISFIT:g}: a rigid model no longer serves"
    visibility = "and too small to be noticed"
    if found.misfit > found.detectable:
        visibility = f"yet the residual shows the structure from {found.detectable:.2g} on"
    verdict = f"threshold {LARGEST_MISFIT:g}: a rigid model still serves, {visibility}"
    return degree, f"{misfit}; {verdict}"


def _level(name: str, std: float) -> str:
    factor, unit = shown_in(CHANNEL_UNITS.get(name, ""), name)
    return f"{name} {factor * std:.3g}{spaced(unit)}"


def _frequency(omega: float) -> str:
    """Return a frequency in rad/s and in Hz."""
    return f"{omega:.3g} rad/s{in_hertz(omega, 'frequency', 'rad/s')}"


def elastic_frequencies(model: Model) -> list[float]:
    """Return the frequencies of the elastic modes of a model, rad/s, ascending.

    They are those of its oscillations without the slowest one, the short period.
    """
    roots = np.linalg.eigvals(linearise(model).A).tolist()
    return sorted(abs(root) for root in roots if root.imag > 0)[1:]


def residuals_of(result: Result) -> Sequence[np.ndarray]:
    """Return normalized innovations of a filter, or residuals of a fit, by output.

    Each has the shape ``(N,)`` and is zero where a sample is missing.
    """
    history = result.estimate.history
    if history is not None:
        return list(np.where(history.valid, history.innovation / history.innovation_std, 0.0))
    z, valid = result.record.output_array(result.estimate.output_names)
    return list(np.where(valid, z - result.estimate.fitted[0], 0.0))


def periodogram(row: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies above zero, rad/s, and the power of a series at each.

    The series has the sample interval ``step``, s. It gets a Hann window, and zeros up to four
    times its length.
    """
    size = 4 * len(row)
    power = np.abs(np.fft.rfft((row - row.mean()) * np.hanning(len(row)), size)) ** 2
    return 2.0 * np.pi * np.fft.rfftfreq(size, step)[1:], power[1:]


# ---- Run a scenario


@dataclass(frozen=True, eq=False, repr=False)
class MethodResult:
    """Result of one method.

    Attributes
    ----------
    result : estimation, record and estimate.
    rows : parameters beside true and published values.
    derived : value and sigma of modal quantities.
    fixed : value and unit of the fixed parameters.
    tests : tests of the residuals.
    levels : levels of flying qualities, if the scenario declares a flight phase.
    truth : truth of the flight.
    determination : what the record determines, if the scenario asks for it.
    """

    result: Result
    rows: tuple[Row, ...]
    derived: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, tuple[float, str]]
    tests: tuple[ResidualTest, ...]
    levels: tuple[ModeLevel, ...] = ()
    truth: Truth | None = None
    determination: MethodDetermination | None = None

    def __repr__(self) -> str:
        return f"<MethodResult {self.estimation.name}: {self.result.estimate!r}>"

    @property
    def estimation(self) -> Estimation:
        return self.result.estimation


def distinct_labels(estimations: Sequence[Estimation]) -> list[str]:
    """Return the label of each estimation, with its name where several have this label."""
    labels = [estimation.label for estimation in estimations]
    return [
        f"{label} ({estimation.name})" if labels.count(label) > 1 else label
        for label, estimation in zip(labels, estimations, strict=True)
    ]


@dataclass(frozen=True, eq=False, repr=False)
class StudyResult:
    """Results of a scenario.

    Attributes
    ----------
    scenario, seed : the scenario and the seed of its flight.
    record, truth : the flight.
    methods : results of the methods, the main one first.
    notes : sentences on the results.
    flexibility : degree of flexibility, if the scenario asks for it.
    repeated : results of repeated flights, if declared.
    sweep : results of a sweep, if declared.
    """

    scenario: Scenario
    seed: int
    record: Record
    truth: Truth
    methods: tuple[MethodResult, ...]
    notes: tuple[str, ...] = ()
    flexibility: Flexibility | None = None
    repeated: tuple[Scatter, ...] = ()
    sweep: Sweep | None = None

    def __repr__(self) -> str:
        return (
            f"<Study {self.scenario.name}, seed {self.seed}: "
            f"{', '.join(method.estimation.name for method in self.methods)}>"
        )

    @property
    def main(self) -> MethodResult:
        return self.methods[0]

    @property
    def determinations(self) -> list[MethodDetermination]:
        """What the record determines, by method; empty if the scenario does not ask for it."""
        found = (method.determination for method in self.methods)
        return [determination for determination in found if determination is not None]


def run_scenario(scenario: Scenario, seed: int | None = None) -> StudyResult:
    """Simulate, estimate and compare; the same seed gives the same numbers.

    Raises
    ------
    FlightidError : the declared flight or estimation is impossible.
    """
    chosen = scenario.seed if seed is None else seed
    record, truth = fly_scenario(scenario, chosen)
    methods = []
    for estimation in scenario.estimations:
        # A method may have a flight or noise levels of its own.
        own_scenario = seen_by(scenario, estimation)
        own_record, own_truth = record, truth
        if own_scenario is not scenario:
            where = f"method {estimation.name}, key flight"
            own_record, own_truth = fly_scenario(own_scenario, chosen, where)
        if estimation.flown_noise_std:
            own_record = measured_again(own_record, own_truth, estimation.flown_noise_std, chosen)
        condensed = references(own_scenario, estimation)
        methods.append(_method(own_scenario, estimation, own_record, own_truth, condensed))
    return StudyResult(
        scenario,
        chosen,
        record,
        truth,
        tuple(methods),
        _notes(scenario, methods),
        _flexibility(scenario, record),
    )


def references(scenario: Scenario, estimation: Estimation) -> Mapping[str, float]:
    """Return ``condensed_values`` if the scenario asks for condensation, else nothing."""
    return condensed_values(scenario.flight, estimation) if scenario.condensed else EMPTY


def _flexibility(scenario: Scenario, record: Record) -> Flexibility | None:
    """Return the flexibility of a scenario with key ``condensed``.

    None without the key, or if the condensed aircraft has no short period.
    """
    flight = scenario.flight
    if not scenario.condensed or not flight.modes or "elevator" not in record.input_names:
        return None
    try:
        return flexibility(
            flown_vehicle(flight),
            record["elevator"].values,
            1.0 / flight.rate,
            flight.noise_std,
            flight.modes,
        )
    except ModelError:
        return None


def _notes(scenario: Scenario, methods: Sequence[MethodResult]) -> tuple[str, ...]:
    """Return the notes on priors and, for a condensed aircraft, on residuals."""
    notes = [] if scenario.determination else [prior_note(method.result) for method in methods]
    if scenario.condensed:
        notes += [
            residual_note(method.result, true_model(seen_by(scenario, method.estimation).flight))
            for method in methods
        ]
    return tuple(note for note in notes if note)


def _method(
    scenario: Scenario,
    estimation: Estimation,
    record: Record,
    truth: Truth,
    condensed: Mapping[str, float],
) -> MethodResult:
    """Run a method on a record; ``condensed``: the coefficients of ``references``."""
    model = declared_for(scenario, estimation)
    result = estimate_record(estimation, record, model)
    estimate = result.estimate
    units = dict(zip(estimate.names, estimate.units, strict=True))
    published = published_values(estimation.published, units) if estimation.published else {}
    true = {item.name: item.value for item in truth.parameters}
    rows = tuple(
        replace(
            row,
            true=true.get(row.name),
            condensed=condensed.get(row.name),
            published=published.get(row.name),
        )
        for row in rows_of(estimate)
    )
    tests = tests_of_records(estimate, [record])
    is_about_rest = estimation.model != "ballistic" and moves_about_rest(model)
    without_biases = estimate.only(model.parameters.names)
    derived = modal_estimate(compiled(estimation, model), without_biases) if is_about_rest else {}
    levels: tuple[ModeLevel, ...] = ()
    if scenario.flown is not None:
        modes = characteristics(compiled(estimation, model), without_biases)
        levels = mode_levels(modes, scenario.flown) if modes is not None else ()
    fixed = {item.name: (item.value, item.unit) for item in model.parameters if not item.free}
    found = determine(estimation, record, model, estimate) if scenario.determination else None
    return MethodResult(result, rows, derived, fixed, tests, levels, truth, found)
