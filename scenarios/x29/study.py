"""Runs a closed-loop scenario: fly, bank of filters, refine, flying qualities, frequency-response
check, comparison.

Verdicts on a study: a sentence each with the measured value, its bound and the conclusion.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.banks.delays import DelayBank
from ident.banks.engines import (
    BATCHED,
    BankDifferences,
    FilterpyDifferences,
    bank_differences,
    compare_with_filterpy,
)
from ident.estimate import Estimate
from ident.flying_qualities.levels import Quality, QualityLevel, levels, qualities
from ident.frequency_response.model_fit import estimate_response, fit_response
from ident.statistics.residuals import Comparison, ResidualTest, compare_estimates, tests_of_records
from scenarios.studies.catalogue import load_document
from scenarios.x29.declaration import (
    LinearCheck,
    LoopScenario,
    SimulatedLoop,
    fly_loop,
    linear_check,
    low_order_model,
    short_period,
    telemetry_noise,
)
from scenarios.x29.estimating import (
    SETTLED_SIGMAS,
    LoopMethodResult,
    MethodInputs,
    Misfit,
    OverSeeds,
    Restarts,
    SetUp,
    SinglePass,
    VariantResult,
    all_restarts,
    free_simulation,
    misfit,
    other_side,
    refined,
    run_methods,
    run_over_seeds,
    run_variant,
    sensor_noise,
    set_up,
    single_pass,
    started_again,
)
from scenarios.x29.open_margins import OpenMargins, margins_of, planned_margins
from sim.closed_loop.linear import EquivalentSystem, Margins, equivalent_system
from sim.declaration.compile import compile_model
from sim.declaration.model import Noise
from sim.errors import DeclarationError, RecordError

FREE_IN_RESPONSE = ("L_alpha", "M_alpha", "L_delta", "M_delta", "M_q", "inv_tau", "delay")
MOST_CHAINED_SCENARIOS = 4  # scenarios that start from one another


@dataclass(frozen=True, eq=False)
class LoopResult:
    """A refined estimate with derived quantities."""

    scenario: LoopScenario
    simulated: SimulatedLoop
    setting: SetUp
    bank: DelayBank
    qualities: tuple[Quality, ...]

    @property
    def estimate(self) -> Estimate:
        return self.bank.estimate

    def quality(self, name: str) -> Quality | None:
        """Return a flying-qualities parameter by name, None if it does not exist."""
        return next((item for item in self.qualities if item.name == name), None)


@dataclass(frozen=True, eq=False)
class ResponseCheck:
    """Low-order equivalents found without a filter.

    From the loop's frequency response: with the paper's L_q (``loop``), and with the ``flown``
    one, since L_alpha depends on L_q. From the record's spectral estimate; None if not possible.
    """

    loop: EquivalentSystem
    flown: EquivalentSystem
    record: Mapping[str, float] | None
    coherence: float


@dataclass(frozen=True, eq=False)
class LoopStudy:
    """A closed-loop scenario that has been run.

    Attributes
    ----------
    paper : filter with the paper's settings.
    single_pass : the paper's procedure.
    first : refined bank before any restart.
    passes : estimates after each restart.
    restarts : estimates of restarted plain filters, by label.
    methods : further methods, as named in the scenario.
    other : result to compare with.
    together : plain results of several scenarios, by name.
    margins : by airframe.
    engines : differences between another engine's filters and the batched ones.
    second : difference between filterpy and the most likely filter of the batched plain bank; None
        under another engine.
    linear : nonlinear loop against the linear one.
    open_margins : margins over unpublished values; None if none is varied.
    over_seeds : the paper's bank on flights with other seeds; None if not requested.
    """

    scenario: LoopScenario
    seed: int
    result: LoopResult
    paper: SetUp
    single_pass: SinglePass
    methods: tuple[LoopMethodResult, ...]
    restarts: Mapping[str, Restarts]
    first: DelayBank
    passes: tuple[Estimate, ...]
    simulated: np.ndarray
    misfit: Misfit
    check: ResponseCheck
    levels: tuple[QualityLevel, ...]
    tests: tuple[ResidualTest, ...]
    other: LoopResult | None
    other_simulated: np.ndarray | None
    differences: Comparison | None
    derived_differences: tuple[tuple[str, float], ...]
    together: Mapping[str, SinglePass]
    variants: tuple[VariantResult, ...]
    margins: Mapping[str, Margins]
    engines: BankDifferences | None = None
    linear: LinearCheck | None = None
    open_margins: OpenMargins | None = None
    second: FilterpyDifferences | None = None
    over_seeds: OverSeeds | None = None


def loop_scenario(name: str, changes: Sequence[str] = ()) -> LoopScenario:
    """Return a closed-loop scenario of the catalogue, or a user's by the path of its file, with
    changes as ``--set`` makes them.

    Raises DeclarationError as ``load_document`` does, and for a scenario of another kind.
    """
    from scenarios.x29.schema import loop_scenario_of

    document, short, where = load_document(name, changes)
    if document.get("kind") != "x29":
        raise DeclarationError(
            f"{short} does not fly the closed loop",
            where=where,
            remedy='name a scenario of kind "x29"',
        )
    return loop_scenario_of(document, short, where)


def run_loop(scenario: LoopScenario, seed: int | None = None) -> LoopStudy:
    """Simulate, estimate and compare; the same seed gives the same numbers.

    The scenario to compare with uses the same seed, hence the same noise. Scenarios for starting
    values, or shown together, use their own seeds.

    Raises
    ------
    FlightidError : the scenario declares something that cannot be flown or estimated.
    """
    chosen = scenario.seed if seed is None else seed
    simulated_flight = fly_loop(scenario.flight, chosen)
    start = starting_values(scenario)
    setting = set_up(scenario.estimation, simulated_flight, start)
    paper = set_up(scenario.estimation, simulated_flight, start, prior=_papers_rule(scenario))
    first_estimate = single_pass(paper)
    first = _result(scenario, simulated_flight, setting)
    result, passes = _restarted(scenario, simulated_flight, first)
    beyond = other_side(first_estimate, first.bank.refined)
    restart_delays = sorted(
        [first_estimate.delay, first.bank.refined, float(first_estimate.delays[beyond])]
    )
    inputs = MethodInputs(
        paper,
        first_estimate,
        scenario.estimation,
        first.bank,
        lambda estimation: set_up(estimation, simulated_flight, start),
    )
    setting = result.setting
    simulated = free_simulation(setting, result.estimate, result.bank.refined)
    other, other_simulated, differences, derived = _against(scenario, chosen, result, first)
    found_margins = margins_of(
        [scenario.flight.airframe, *([] if other is None else [other.simulated.x29.name])],
        scenario.margins,
    )
    estimate = result.estimate
    return LoopStudy(
        scenario,
        chosen,
        result,
        paper,
        first_estimate,
        run_methods(scenario.methods, inputs),
        all_restarts(inputs, restart_delays) if scenario.estimation.restarts else {},
        first.bank,
        passes,
        simulated,
        misfit(
            setting.record,
            simulated,
            estimate,
            sensor_noise(simulated_flight),
            scenario.stretch,
            scenario.peak,
        ),
        response_check(result),
        levels(result.qualities),
        tests_of_records(estimate, [setting.record]),
        other,
        other_simulated,
        differences,
        derived,
        {name: _single_pass_of(loop_scenario(name)) for name in scenario.together},
        tuple(run_variant(scenario, variant, chosen, start) for variant in scenario.variants),
        found_margins,
        None
        if setting.engine is BATCHED
        else bank_differences(
            single_pass(replace(paper, engine=BATCHED)).bank, first_estimate.bank
        ),
        None
        if simulated_flight.truth is None or not simulated_flight.truth.stick.any()
        else linear_check(simulated_flight.x29, simulated_flight.truth),
        planned_margins(scenario.margins, found_margins),
        compare_with_filterpy(
            paper.record, paper.system, first_estimate.bank, first_estimate.delays
        )
        if paper.engine is BATCHED
        else None,
        run_over_seeds(scenario, start, _papers_rule(scenario)),
    )


def _restarted(
    scenario: LoopScenario, simulated: SimulatedLoop, result: LoopResult
) -> tuple[LoopResult, tuple[Estimate, ...]]:
    """Return the result of a filter restarted from its own result until it settles.

    Also returns the estimates of all passes.
    """
    passes = [result.estimate]
    for _ in range(scenario.estimation.restarts):
        again = _result(
            scenario, simulated, started_again(scenario.estimation, simulated, result.estimate)
        )
        moved = (
            again.estimate.values[: len(result.estimate.names)]
            - result.estimate.values[: len(again.estimate.names)]
        )
        settled = bool(np.max(np.abs(moved / again.estimate.std[: len(moved)])) < SETTLED_SIGMAS)
        result = again
        passes.append(result.estimate)
        if settled:
            break
    return result, tuple(passes)


def response_check(result: LoopResult) -> ResponseCheck:
    """Return the low-order equivalent by frequency response, of the loop and of the record."""
    x29 = result.simulated.x29
    loop = equivalent_system(x29)
    # A low-order flight has the equivalent ``loop`` itself.
    equivalent = (
        loop if result.simulated.truth is None else equivalent_system(x29, x29.airframe.L_q)
    )
    std = telemetry_noise(x29)
    try:
        response = estimate_response(result.setting.record)
    except RecordError:
        return ResponseCheck(loop, equivalent, None, 0.0)
    start = {
        name: result.estimate.value(name)
        for name in ("L_alpha", "M_alpha", "L_delta", "M_delta", "L_q", "M_q", "inv_tau")
    }
    system = compile_model(
        low_order_model(x29, {**start, "delay": result.bank.refined}).with_noise(Noise(std))
    )
    fit = fit_response(response, system, FREE_IN_RESPONSE)
    values = {**fit.values, "L_q": start["L_q"]}
    frequency, damping = short_period(values)
    coherence = float(response.coherence.mean())
    if not fit.converged or math.isnan(frequency):
        return ResponseCheck(loop, equivalent, None, coherence)
    values |= {"natural_frequency": frequency, "damping_ratio": damping}
    return ResponseCheck(loop, equivalent, values, coherence)


def starting_values(scenario: LoopScenario, depth: int = 0) -> Mapping[str, float]:
    """Return declared starting values, or the estimates of another scenario's bank."""
    estimation = scenario.estimation
    if estimation.start:
        return estimation.start
    if depth == MOST_CHAINED_SCENARIOS:
        raise DeclarationError(
            "scenarios start from one another in a circle",
            where=f"scenario {scenario.name}",
            remedy="declare start in one of them",
        )
    values = _single_pass_of(loop_scenario(estimation.start_from), depth + 1).estimate.as_dict()
    return {
        name: value
        for name, value in values.items()
        if name not in ("L_0", "M_0", "delta_0", "nz_0")
    }


def _papers_rule(scenario: LoopScenario) -> str:
    """Return the rule of P0: the printed P0 in scenarios that are compared with the paper."""
    return "printed" if scenario.published else scenario.estimation.prior


def _single_pass_of(scenario: LoopScenario, depth: int = 0) -> SinglePass:
    simulated = fly_loop(scenario.flight, scenario.seed)
    return single_pass(
        set_up(
            scenario.estimation,
            simulated,
            starting_values(scenario, depth),
            prior=_papers_rule(scenario),
        )
    )


def _result(scenario: LoopScenario, simulated: SimulatedLoop, setting: SetUp) -> LoopResult:
    bank = refined(setting)
    airframe = simulated.x29.airframe
    known = {"delay": bank.refined}
    found = qualities(bank.estimate, airframe.airspeed, airframe.gravity, known)
    return LoopResult(scenario, simulated, setting, bank, found)


def _against(
    scenario: LoopScenario, seed: int, result: LoopResult, first: LoopResult
) -> tuple[LoopResult | None, np.ndarray | None, Comparison | None, tuple[tuple[str, float], ...]]:
    """Return the other scenario's result, its free simulation, and the differences from it.

    The differences are those of the parameters, and those of flying qualities in sigmas.
    """
    against = scenario.against
    if against is None:
        return None, None, None, ()
    other_scenario = loop_scenario(against.scenario, against.changes)
    if other_scenario.flight == scenario.flight and other_scenario.estimation == replace(
        scenario.estimation, restarts=0
    ):
        other = first  # the first pass of a restarted study is that scenario's result
    else:
        simulated = fly_loop(other_scenario.flight, seed)
        other = _result(
            replace(other_scenario, seed=seed),
            simulated,
            set_up(other_scenario.estimation, simulated, starting_values(other_scenario)),
        )
    derived = []
    for item in result.qualities:
        before = other.quality(item.name)
        if before is not None:
            # Results from the same data are correlated: compare with the larger sigma.
            derived.append(
                (item.name, (item.value - before.value) / max(item.std, before.std, 1e-300))
            )
    return (
        other,
        free_simulation(other.setting, other.estimate, other.bank.refined),
        compare_estimates(other.estimate, result.estimate),
        tuple(derived),
    )


# ---- Verdicts on a study

# s: offset between the loop's frames and the recorded stick, held between samples of 40 Hz
HALF_FRAME = 0.00625
FREQUENCY = 0.05  # tolerance, share of the frequency
DAMPING = 0.05  # tolerance of the damping ratio
DELAY = 0.015  # tolerance, s
DERIVATIVES = ("L_alpha", "M_alpha", "M_delta", "M_q")
SHARE = {False: 0.10, True: 0.20}  # tolerance of a derivative, without and with noise
MOVED = 3.0  # sigmas that a disturbance of the record may move frequency and damping
STANDS_OUT = 1.5  # a stretch stands out with a larger ratio of its misfit to that elsewhere
PEAK_SAMPLES = 5  # samples that a peak is averaged over
LEAST_PEAK = 1.0  # percent: smaller peaks count as zero, also without noise


def verdicts(study: LoopStudy) -> tuple[str, ...]:
    """Return all verdicts on a study, in the order of its tables."""
    return tuple(
        sentence
        for part in (_equivalent, _against_other, _restarts, _peak, _stretch, _whiteness)
        for sentence in part(study)
    )


def _equivalent(study: LoopStudy) -> Iterator[str]:
    result, loop = study.result, study.check.loop
    frequency, damping = result.quality("natural_frequency"), result.quality("damping_ratio")
    if frequency is None or damping is None:
        yield (
            "the estimate's short period does not oscillate: it has no frequency to hold against "
            "the loop's own"
        )
        return
    share = SHARE[study.scenario.flight.noise]
    off = {
        "frequency": (frequency.value / loop.natural_frequency - 1.0, FREQUENCY),
        "damping": (damping.value - loop.damping_ratio, DAMPING),
        "delay": (result.bank.refined - loop.delay, DELAY),
        **{
            name: (result.estimate.value(name) / float(getattr(loop, name)) - 1.0, share)
            for name in DERIVATIVES
        },
    }
    largest = max(DERIVATIVES, key=lambda name: abs(off[name][0]))
    beyond = [name for name, (value, bound) in off.items() if abs(value) > bound]
    verdict = f"beyond the bound: {', '.join(beyond)}" if beyond else "all within"
    yield (
        f"against the loop's own low-order equivalent: frequency {_percent(off['frequency'][0])} "
        f"(bound {_bound(FREQUENCY)}), "
        f"damping ratio {off['damping'][0]:+.3f} (bound {DAMPING:g}), delay "
        f"{1e3 * off['delay'][0]:+.1f} ms (bound {1e3 * DELAY:g} ms, "
        f"{1e3 * HALF_FRAME:.0f} ms of it the hold of the recorded stick), of "
        f"{', '.join(DERIVATIVES)} {largest} differs most, "
        f"{_percent(off[largest][0])} (bound {_bound(share)}): {verdict}"
    )


def _against_other(study: LoopStudy) -> Iterator[str]:
    against, moved = study.scenario.against, dict(study.derived_differences)
    if against is None or study.other is None:
        return
    names = {"natural_frequency": "frequency", "damping_ratio": "damping ratio"}
    if any(name not in moved for name in names):
        yield f"against {against.label}: one of the two does not oscillate"
        return
    texts, beyond = [], []
    for name, word in names.items():
        now, before = study.result.quality(name), study.other.quality(name)
        assert now is not None and before is not None
        texts.append(f"{word} {before.value:.4g} to {now.value:.4g} ({moved[name]:+.2f} sigmas)")
        if abs(moved[name]) >= MOVED:
            beyond.append(word)
    most = max(abs(moved[name]) for name in names)
    verdict = "both by less than a sigma" if most < 1.0 else f"both by less than {MOVED:g} sigmas"
    spectra, record = "", study.check.record
    if beyond:
        verdict = f"{', '.join(beyond)} by more than {MOVED:g} sigmas"
        if record is not None:
            spectra = (
                f"; the record's spectra give a damping ratio of {record['damping_ratio']:.3f} "
                "without a filter"
            )
    yield f"against {against.label}: {', '.join(texts)}: {verdict}{spectra}"


def _restarts(study: LoopStudy) -> Iterator[str]:
    if len(study.passes) < 2:
        return
    before, last = study.passes[-2], study.passes[-1]
    n = min(len(before.names), len(last.names))
    moved = np.abs(last.values[:n] - before.values[:n]) / last.std[:n]
    at, count = int(np.argmax(moved)), len(study.passes) - 1
    times = f"{count} restart{'s' * (count != 1)}"
    if moved[at] < SETTLED_SIGMAS:
        yield (
            f"settled after {times}: the last one moves nothing by more than {moved[at]:.2f} "
            f"sigmas ({last.names[at]})"
        )
    else:
        yield (
            f"not settled after {times}: the last one still moves {last.names[at]} by "
            f"{moved[at]:.2f} sigmas"
        )


def _peak(study: LoopStudy) -> Iterator[str]:
    if study.scenario.peak is None or not study.misfit.peak_measured:
        return
    noise = sensor_noise(study.result.simulated)[1] if study.scenario.flight.noise else 0.0
    bound = max(
        200.0 * noise / math.sqrt(PEAK_SAMPLES) / abs(study.misfit.peak_measured), LEAST_PEAK
    )
    verdict = (
        "too small"
        if study.misfit.peak_percent < -bound
        else "too large"
        if study.misfit.peak_percent > bound
        else "met"
    )
    yield (
        f"the final peak of q is {verdict} in free simulation: {study.misfit.peak_percent:+.1f} % "
        "of the measured one, "
        f"where two sigmas of a peak of {PEAK_SAMPLES} samples are {bound:.1f} %"
    )
    if study.variants:
        off = {v.label: abs(v.misfit.peak_percent) > bound for v in study.variants}
        shown = {v.label: f"{v.label} ({v.misfit.peak_percent:+.1f} %)" for v in study.variants}
        yield f"with one thing changed: {_split('missed', 'met', off, shown)}"


def _stretch(study: LoopStudy) -> Iterator[str]:
    span = study.scenario.stretch
    if span is None:
        return
    yield (
        f"from {span[0]:g} to {span[1]:g} s the free simulation misses q by "
        f"{study.misfit.stretch:.2f} of the sensor's sigmas (root mean square), "
        f"elsewhere by {study.misfit.elsewhere:.2f}: the stretch "
        f"{'stands out' if _stands_out(study.misfit) else 'does not stand out'}"
    )
    if study.variants:
        off = {v.label: _stands_out(v.misfit) for v in study.variants}
        shown = {
            v.label: f"{v.label} ({v.misfit.stretch:.2f} against {v.misfit.elsewhere:.2f})"
            for v in study.variants
        }
        yield f"with one thing changed: {_split('stands out', 'does not stand out', off, shown)}"


def _whiteness(study: LoopStudy) -> Iterator[str]:
    if not study.variants or study.scenario.peak is not None or study.scenario.stretch is not None:
        return
    band = 2.0 / math.sqrt(len(study.result.setting.record))
    word = "white" if abs(study.misfit.lag_one) <= band else "structured"
    yield (
        f"pitch-rate innovations are {word}: lag-one correlation {_signed(study.misfit.lag_one)}, "
        f"where white ones stay within {band:.2f}"
    )
    off = {v.label: abs(v.misfit.lag_one) > band for v in study.variants}
    shown = {v.label: f"{v.label} ({_signed(v.misfit.lag_one)})" for v in study.variants}
    yield f"with one thing changed: {_split('structured', 'white', off, shown)}"


def _stands_out(misfit: Misfit) -> bool:
    return misfit.stretch > STANDS_OUT * misfit.elsewhere


def _split(yes: str, no: str, off: dict[str, bool], shown: dict[str, str]) -> str:
    """Return the variants with and without a property in words, joined by a semicolon."""
    groups = (
        (word, [shown[label] for label, has_property in off.items() if has_property == wanted])
        for word, wanted in ((yes, True), (no, False))
    )
    return "; ".join(f"{word} with {', '.join(labels)}" for word, labels in groups if labels)


def _signed(value: float) -> str:
    """Return two decimals with a sign; a value that rounds to zero is positive."""
    return f"{round(value, 2) + 0.0:+.2f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:+.1f} %"


def _bound(share: float) -> str:
    return f"{100.0 * share:g} %"
