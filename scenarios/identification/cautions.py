"""Cautions about the results and the sigmas of an identification."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.filters.smoother import coloured_innovations
from ident.flying_qualities.modes import characteristics_at
from ident.statistics.residual_spectrum import common_disturbance
from ident.statistics.residuals import (
    MADE_BY_INPUTS,
    ResidualTest,
    contradiction,
    share_from_inputs,
    shortfall,
)
from ident.whole_record.layout import FitSettings, lay_out
from ident.whole_record.output_error import UNDETERMINED, failed_simulation, none_determined
from ident.whole_record.unstable_motion import MOST_EFOLDINGS_AT_ONCE, fastest_growth_rate, growth
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.assessment import IdentificationResult
from scenarios.identification.conditions import METHOD
from scenarios.identification.methods import forced
from scenarios.preparation.declared_model import LIFT_OUTPUTS, NO_LIFT, model_of_file
from scenarios.preparation.plan import Request, command_on_records
from scenarios.report.quantities import number_text, shown_in, spaced
from scenarios.report.summary import NEXT, residual_phrase
from scenarios.studies.declaration import Row
from sim.declaration.model import System
from sim.errors import DeclarationError
from sim.record import Record

# ---- Cautions about an identification

# Models whose declared derivatives are approximately known, unlike a ballistic coefficient.
AIRCRAFT = ("rigid", "flexible", "loes", "lateral", "longitudinal")
# Parameters of a low-order system that are not compared with their starts, which may be zero.
NOT_COMPARED = ("delay", "inv_tau")
# Coloured noise that widens a sigma by a larger factor causes a caution.
NOTABLE_WIDENING = 1.25
# By how much corrected sigmas may be too small: docs/estimators.md, Coverage.
REMAINING_SHORTFALL = "10 % (in gusts 30 %)"
CAUSES = "the model lacks something, a channel has a wrong sign or unit, or the file is wrong"


def advice(model: str, estimate: Estimate) -> str:
    """Return what to do after the outcome of an estimation; empty if nothing is needed."""
    not_identifiable = estimate.outcome is Outcome.NOT_IDENTIFIABLE
    lacks_lift = model in ("rigid", "flexible") and not LIFT_OUTPUTS & set(estimate.output_names)
    return NO_LIFT if not_identifiable and lacks_lift else estimate.outcome.hint


def cautions_of(vehicle: VehicleFile, estimate: Estimate, rows: Sequence[Row]) -> tuple[str, ...]:
    """Return sentences on the outcome, on coloured noise and on implausible derivatives, if any."""
    sentences = []
    outcome = estimate.outcome
    if outcome is not Outcome.CONVERGED:
        hint = advice(vehicle.model, estimate)
        sentences.append(f"{outcome.value}; {hint}" if hint else outcome.value)
    sentences.append(coloured(estimate))
    if vehicle.model in AIRCRAFT:
        sentences.append(contradicted(rows, vehicle.derivatives))
    return tuple(sentence for sentence in sentences if sentence)


def too_short(records: Sequence[Record], system: System) -> tuple[str, ...]:
    """Return a caution if every record is shorter than a period of the declared model.

    The period is that of the fastest oscillation.
    """
    p = np.array(system.parameters.values(), dtype=float)
    with np.errstate(all="ignore"):
        modes = characteristics_at(system, p)
    frequencies = [  # rad/s; a stiffness is the square of a frequency
        np.sqrt(value) if name.endswith("stiffness") else value
        for name, value in modes.items()
        if name.endswith(("frequency", "stiffness")) and np.isfinite(value) and value > 0.0
    ]
    longest = max(float(np.ptp(record.time)) for record in records)
    period = 2.0 * np.pi / max(frequencies) if frequencies else 0.0
    if longest >= period:
        return ()
    return (
        f"the record is {longest:.2g} s long, shorter than a period of the motion "
        f"({period:.2g} s with the values of the vehicle file): estimates may be far off although "
        "the residual is noise; give a record of several periods",
    )


def failed(
    records: Sequence[Record],
    estimate: Estimate,
    rows: Sequence[Row],
    declared: Mapping[str, float],
) -> tuple[str, ...]:
    """Return a sentence if an estimate by free simulation is useless; else nothing.

    It is useless if the simulation diverges or explains no output, or if no derivative is
    determined. ``declared``: starting values by derivative.
    """
    measured, residuals = [], []
    for i, name in enumerate(estimate.output_names):
        pairs = [
            (record[name].values[record[name].valid], rows_of_record[i][record[name].valid])
            for record, rows_of_record in zip(records, estimate.fitted, strict=False)
            if name in record.output_names and np.any(record[name].valid)
        ]
        measured.append(np.concatenate([z - np.mean(z) for z, _ in pairs] or [np.zeros(1)]))
        residuals.append(np.concatenate([z - y for z, y in pairs] or [np.zeros(1)]))
    units = {
        name: next(r[name].unit for r in records if name in r.output_names)
        for name in estimate.output_names
    }
    reason = ""
    if len(estimate.fitted) == len(records):
        reason = failed_simulation(units, measured, residuals)
    if not reason and none_determined(
        (row.std, declared[row.name]) for row in rows if row.name in declared
    ):
        reason = UNDETERMINED
    remedy = (
        "check units, signs and declared values, cut the record to single maneuvers, or use "
        "--method filter-error or equation-error"
    )
    return (f"the fit has failed: {reason}; {remedy}",) if reason else ()


def coloured(estimate: Estimate) -> str:
    """Return a sentence if coloured innovations of a filter widen the sigmas, or nothing."""
    found = coloured_innovations(estimate)
    if (
        found is None
        or not found.significant
        or not found.factor.size
        or found.factor.max() < NOTABLE_WIDENING
    ):
        return ""
    worst = int(np.argmax(found.factor))
    lag_one = ", ".join(f"{name} {value:.2f}" for name, value in found.lag_one.items())
    text = (
        f"the noise is not white (autocorrelation of the residuals one sample apart: {lag_one}): "
        "standard deviations for white noise "
    )
    text += f"would be up to {found.factor[worst]:.1f} times too small ({found.names[worst]})"
    corrected = estimate.sigma(found.names[worst]) >= 0.99 * float(
        np.sqrt(found.covariance[worst, worst])
    )
    if not corrected:
        return text.replace("would be", "are") + "; those given are for white noise"
    return (
        f"{text}; those given are corrected for it, and may still be up to {REMAINING_SHORTFALL} "
        "too small, as the colour is known from this record alone"
    )


def contradicted(rows: Sequence[Row], declared: Mapping[str, float]) -> str:
    """Return a sentence on the derivatives that contradict their starts by two sigmas; or nothing.

    They are too large, too small or of the other sign. ``declared``: starts by derivative.
    """
    phrases = []
    for row in rows:
        if row.name in NOT_COMPARED:
            continue
        start = declared.get(row.name, 0.0)
        reason = contradiction(row.estimate, row.std, start)
        reason = reason or shortfall(row.estimate, row.std, start)
        if reason:
            phrases.append(
                f"{row.name} {number_text(row.estimate, row.std)} +- "
                f"{number_text(row.std, row.std)} {reason} (vehicle file {start:.4g})"
            )
    if not phrases:
        return ""
    return f"implausible: {'; '.join(phrases)}; {CAUSES}; flightid diagnose looks for the cause"


# ---- Cautions on sigmas that are smaller than the errors

# Sigmas in gusts, by method, for the worst of several models: the factor by which they are too
# small, in the mean and for the worst derivative, and their two-sigma coverage
# (docs/estimators.md, Coverage).
SHORT_IN_GUSTS: Mapping[str, tuple[float, float, float]] = {
    "output-error": (1.25, 1.8, 0.91),
    METHOD: (1.5, 2.1, 0.85),
}
FILTER_ERROR = (1.15, 0.92)  # the same for filter error: factor and coverage
# A larger share of lost rows biases a method by more than half a sigma, since the inputs of the
# lost rows are unknown. Found by dropping random rows of flights with stepped inputs.
LOST_ROWS: Mapping[str, float] = {"equation-error": 0.1, "output-error": 0.05}
LONG_INTERVAL_RATIO = 1.5  # an interval of more usual intervals than this has a lost row
INTENSITY = "gust-turbulence.sigma"
MOST_ALONE = 8  # with more records, no record is fitted alone
CONTRADICTION_SIGMAS = 5.0  # two values of a parameter that differ by more contradict each other
MOST_NAMED = 3  # parameters that a caution names


def record_cautions(
    records: Sequence[Record],
    tests: Sequence[ResidualTest],
    alone: Callable[[Record], tuple[Estimate, Sequence[ResidualTest]]],
) -> tuple[str, ...]:
    """Return a caution if each record fits alone, but all records together do not.

    Then the records are of different conditions. ``tests``: of the fit to all records. ``alone``:
    returns the estimate from a single record, and its tests.
    """
    if not 2 <= len(records) <= MOST_ALONE or all(test.passed for test in tests):
        return ()
    estimates: list[Estimate] = []
    for record in records:
        estimate, own = alone(record)
        if estimate.outcome is not Outcome.CONVERGED or not all(test.passed for test in own):
            return ()
        estimates.append(estimate)
    differences = []
    for name in estimates[0].names:
        if name.startswith("bias_") or not all(name in single.names for single in estimates):
            continue
        low, high = (
            choose(range(len(estimates)), key=lambda k: estimates[k].value(name))
            for choose in (min, max)
        )
        sigma = math.hypot(estimates[low].sigma(name), estimates[high].sigma(name))
        distance = (estimates[high].value(name) - estimates[low].value(name)) / max(sigma, 1e-300)
        if distance > CONTRADICTION_SIGMAS:
            pairs = [(k, estimates[k].value(name), estimates[k].sigma(name)) for k in (low, high)]
            values = ", ".join(
                f"{number_text(value, std)} +- {number_text(std, std)} in {records[k].name}"
                for k, value, std in sorted(pairs)
            )
            differences.append((distance, f"{name} {values}"))
    if not differences:
        return ()
    shown = "; ".join(text for _, text in sorted(differences, reverse=True)[:MOST_NAMED])
    return (
        "the records contradict each other: each by itself leaves noise alone, all together do not "
        f"({shown}). Identify records of different aircraft, loadings or flight conditions "
        "separately, and check the sensors between the flights",
    )


def sigma_cautions(
    records: Sequence[Record],
    estimate: Estimate,
    system: System | None = None,
    tests: Sequence[ResidualTest] = (),
    local: Sequence[str] = (),
) -> tuple[str, ...]:
    """Return a sentence on each reason why errors are larger than the sigmas of the method.

    - Records are shorter than a period (``too_short``).
    - Rows are lost (``LOST_ROWS``).
    - The model is unstable at the estimate, and one cause moves the residuals of several outputs.
    - Gusts act on a stable model. In output error and the frequency domain one cause then moves the
      residuals of several outputs; in filter error the estimated intensity is above two sigmas.

    ``system``: the system of the fit, with the parameters ``local`` to each record. ``tests``: of
    the residuals.
    """
    short: tuple[str, ...] = ()
    unstable: tuple[str, ...] = ()
    if system is not None:
        short = too_short(records, system)
        unstable = _of_instability(records, estimate, system, tests, local)
    lost = _of_lost_rows(records, estimate)
    return (*short, *lost, *(unstable or _of_gusts(records, estimate, tests)))


def _of_instability(
    records: Sequence[Record],
    estimate: Estimate,
    system: System,
    tests: Sequence[ResidualTest],
    local: Sequence[str],
) -> tuple[str, ...]:
    """Return a caution if the model is unstable and one cause moves several outputs.

    Errors of a free simulation grow with its unstable mode. The sigmas of output error count only
    the noise of the sensors.
    """
    if not np.all(np.isfinite(estimate.values)) or not disturbed_outputs(records, estimate, tests):
        return ()
    values = {
        name: value for name, value in estimate.as_dict().items() if name in system.parameters
    }
    at_estimate = replace(system, parameters=system.parameters.with_values(values))
    layout = lay_out(records, at_estimate, FitSettings(), local=local)
    if not MOST_EFOLDINGS_AT_ONCE <= growth(layout) < np.inf:
        return ()
    return (
        f"the model is unstable at the estimate: its free simulation doubles small errors, such as "
        "those of inputs between samples and of rounding, every "
        f"{np.log(2.0) / fastest_growth_rate(layout):.2g} s; "
        f"sigmas of {estimate.method} count the noise of the sensors alone and are too small, and "
        "values "
        f"may be wrong by many of them; use --method filter-error, which allows for such errors",
    )


def _of_lost_rows(records: Sequence[Record], estimate: Estimate) -> tuple[str, ...]:
    """Return a caution if the records have lost so many rows that the method is biased."""
    least, share = LOST_ROWS.get(estimate.method), lost_rows(records)
    if least is None or share < least or not any(record.inputs for record in records):
        return ()
    return (
        f"rows are lost in {100 * share:.0f} % of the sample intervals, and with them the inputs: "
        f"from {100 * least:g} % "
        f"on that biases {estimate.method} by more than half a sigma where inputs step; where only "
        "outputs are missing, "
        f"keep the row and leave their cells empty",
    )


def lost_rows(records: Sequence[Record]) -> float:
    """Return the share of sample intervals, over all records, in which rows are lost.

    The usual interval is the lower quartile: rows may be lost in more than half of the intervals.
    """
    longer, count = 0, 0
    for record in records:
        gaps = np.diff(record.time)
        longer += int(np.count_nonzero(gaps > LONG_INTERVAL_RATIO * np.quantile(gaps, 0.25)))
        count += len(gaps)
    return longer / max(count, 1)


def _of_gusts(
    records: Sequence[Record], estimate: Estimate, tests: Sequence[ResidualTest]
) -> tuple[str, ...]:
    """Return a caution if the residuals, or the estimated intensity of filter error, show gusts."""
    failing = {test.channel for test in tests if not test.passed}
    if (
        estimate.method in SHORT_IN_GUSTS
        and not (tests and len(failing) < 2)  # a gust moves more than one output beyond its noise
        and _moved_together(records, estimate)
        and not made_by_inputs(records, estimate)
    ):
        factor, worst, coverage = SHORT_IN_GUSTS[estimate.method]
        return (
            "several outputs err together: gusts, a faulty sensor or an effect that the model "
            "lacks may be the cause (flightid diagnose looks for it). In gusts, multiply the "
            f"sigmas by {factor:g} (single derivatives need up to {worst:g}), or use --method "
            "equation-error, whose sigmas are right in gusts. In simulated gusts the true value "
            f"was within two sigmas of {estimate.method} in {100 * coverage:.0f} % of cases in "
            "place of 95 %",
        )
    if (
        estimate.method == "filter-error"
        and INTENSITY in estimate.names
        and estimate.value(INTENSITY) > 2.0 * estimate.sigma(INTENSITY)
    ):
        factor, coverage = FILTER_ERROR
        return (
            f"gusts act; multiply the sigmas by up to {factor:g} if their spectrum may not be "
            "Dryden's, or use --method equation-error, whose sigmas are right in gusts. In "
            "simulated gusts of another spectrum the true value was within two sigmas in "
            f"{100 * coverage:.0f} % of cases in place of 95 %",
        )
    return ()


def disturbed_outputs(
    records: Sequence[Record], estimate: Estimate, tests: Sequence[ResidualTest]
) -> tuple[str, ...]:
    """Return the outputs whose residuals are not white, if one cause moves several outputs.

    Process noise does so. In simulated flights of three models the result is not empty for none of
    120 with white sensor noise, for three of 120 with AR(1) noise, and for all of 240 in gusts.
    """
    if estimate.method not in SHORT_IN_GUSTS or not _moved_together(records, estimate):
        return ()
    failed = (
        test.channel for test in tests if not test.passed and test.channel in estimate.output_names
    )
    return tuple(dict.fromkeys(failed))  # an output may fail more than one test


def in_rough_air(
    records: Sequence[Record], estimate: Estimate, tests: Sequence[ResidualTest]
) -> tuple[str, ...]:
    """Return ``disturbed_outputs`` unless the inputs explain the residuals, as with a delay."""
    moved = disturbed_outputs(records, estimate, tests)
    return () if moved and made_by_inputs(records, estimate) else moved


def made_by_inputs(records: Sequence[Record], estimate: Estimate) -> bool:
    """Return whether the inputs explain much of the residual of an output.

    A response to the inputs is fitted to one half of the residual and predicts the other half.
    """
    for record, residual, valid in zip(records, *_residuals(records, estimate), strict=True):
        if not record.inputs or len(record.time) < 2:
            continue
        inputs = np.array([channel.values for channel in record.inputs])
        interval = float(np.median(np.diff(record.time)))
        shares = share_from_inputs(residual, valid, inputs, interval)
        if np.max(shares, initial=0.0) > MADE_BY_INPUTS:
            return True
    return False


def _moved_together(records: Sequence[Record], estimate: Estimate) -> bool:
    return common_disturbance(*_residuals(records, estimate))


def _residuals(
    records: Sequence[Record], estimate: Estimate
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Return residuals, zero if a sample is missing, and masks of the samples that are there.

    Both have shape ``(m, N)`` for each record.
    """
    measured = [record.output_array(estimate.output_names) for record in records]
    residuals = [
        np.where(valid, z - fitted, 0.0)
        for (z, valid), fitted in zip(measured, estimate.fitted, strict=True)
    ]
    return residuals, [valid for _, valid in measured]


def innovations_phrase(method: str, records: Sequence[Record], estimate: Estimate) -> str:
    """Return a phrase on the rms innovations of filter error; empty for other methods."""
    if method != "filter-error" or len(estimate.fitted) != len(records):
        return ""
    parts = []
    for row, name in enumerate(estimate.output_names):
        innovations = [
            (record[name].values - fitted[row])[record[name].valid]
            for record, fitted in zip(records, estimate.fitted, strict=True)
            if name in record.output_names
        ]
        errors = np.concatenate(innovations) if innovations else np.zeros(0)
        if not errors.size or not np.all(np.isfinite(errors)):
            continue
        unit = next(r[name].unit for r in records if name in r.output_names)
        factor, shown = shown_in(unit, name)
        size = factor * float(np.sqrt(np.mean(errors**2)))
        parts.append(f"{name} {size:.3g}{spaced(shown)}")
    if not parts:
        return ""
    return f"errors of one-step prediction, the measure in gusts: {', '.join(parts)} rms; "


# ---- What to do if the residuals are more than noise


def filter_error_proposed(
    request: Request, vehicle: VehicleFile, found: IdentificationResult
) -> tuple[str, ...]:
    """Return a sentence that proposes filter error if the residuals look like process noise."""
    disturbed = in_rough_air([found.record, *found.others], found.estimate, found.tests)
    if not disturbed:
        return ()
    try:
        forced(model_of_file(vehicle), [found.record])
    except DeclarationError:
        return ()
    command = command_on_records(request, "identify", ["--method", "filter-error"])
    listed = (
        f"{', '.join(disturbed[:-1])} and {disturbed[-1]}" if len(disturbed) > 1 else disturbed[0]
    )
    return (
        f"one cause moves the residuals of {listed}, as turbulence does; {command} estimates such "
        "noise together with the parameters",
    )


def unusable_sigmas(
    request: Request, vehicle: VehicleFile, found: IdentificationResult
) -> tuple[str, ...]:
    """Return a warning that the sigmas are unusable if the residuals are more than noise.

    It names the command for a diagnosis if ``diagnose`` takes the model. Empty for good residuals.
    """
    failed_in = residual_phrase([test for test in found.tests if not test.passed])
    if not failed_in:
        return ()
    records = [found.record, *found.others]
    whole = len(found.estimate.fitted) == len(records)
    unless = ""
    if whole and made_by_inputs(records, found.estimate):
        kind = " and follow the inputs: the model lacks a part of the response"
    elif disturbed_outputs(records, found.estimate, found.tests):
        kind = (
            "; in rough air a simulation cannot follow: judge by the one-step prediction errors of "
            "--method filter-error"
        )
    elif whole and vehicle.model != "loes":
        # Only the sigmas of the bank of delays are not corrected for coloured sensor noise.
        unless = " unless the sensor noise itself is coloured, for which they are corrected"
        kind = " but do not follow the inputs"
    else:
        kind = ""
    second = "; a second record (--validate) would check the diagnosis"
    if request.validate:
        second = ""
    elif len(request.records) > 1:
        # A diagnosis holds out the last of several records; the command says which.
        *fitted, last = request.records
        request, second = replace(request, records=tuple(fitted), validate=(last,)), ""
    follows = (
        f"{second}{NEXT}{command_on_records(request, 'diagnose')}"
        if vehicle.model != "loes"
        else ""
    )
    return (f"do not use these sigmas{unless}: the residuals are {failed_in}{kind}{follows}",)
