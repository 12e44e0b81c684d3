"""Conditions of an identification: frequency bands, recorded pitch attitude, cautions about results
and sigmas.

The equations of the effect phugoid with theta as an input: u_dot = -g (theta - alpha). The initial
flight-path angle is one further unknown of each record. The records decide whether the equations
apply; in a tunnel, on a rig or in a simulation at constant speed they do not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Estimate, Outcome
from ident.filters.smoother import coloured_innovations
from ident.flying_qualities.modes import characteristics_at
from ident.frequency_domain.output_error import (
    FrequencySettings,
    band_for,
    fit_frequency_domain,
    refuse_unfit,
)
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
from ident.whole_record.unstable_motion import MOST_EFOLDINGS_AT_ONCE, fastest, growth
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.assessment import simulated
from scenarios.preparation.declared_model import DECISIVE_LOG_LIKELIHOOD_RATIO, compared_readings
from scenarios.preparation.plan import ATTITUDE
from scenarios.report.quantities import number_text, shown_in, spaced
from scenarios.studies.published import Row
from sim.declaration.compile import compile_model
from sim.declaration.effect import full_name
from sim.declaration.model import Model, System
from sim.effects.disturbance.airspeed import Phugoid
from sim.effects.input_path.input_delay import InputDelay
from sim.errors import DeclarationError
from sim.record import Record

# ---- The frequency domain for a model and its records

METHOD = "frequency-domain"


def delays_of(model: Model) -> dict[str, str]:
    """Return the delay parameter of each delayed input."""
    return {
        effect.signal: full_name(effect, "delay")
        for effect in model.effects
        if isinstance(effect, InputDelay)
    }


def refuse_band(band: tuple[float, float] | None, method: str) -> None:
    """Raise DeclarationError for a band of another method, or one that is none."""
    if band is None:
        return
    if method != METHOD:
        raise DeclarationError(
            f"{method} has no band of frequencies",
            where="--band",
            remedy=f"use it with --method {METHOD}, or leave it out",
        )
    low, high = band
    if not (math.isfinite(high) and 0.0 <= low < high):
        raise DeclarationError(
            f"{low:g} to {high:g} Hz is no band",
            where="--band",
            remedy="give the lower frequency first, in Hz",
        )


def chosen_band(
    records: Sequence[Record],
    model: Model,
    outputs: Sequence[str],
    band: tuple[float, float] | None,
) -> tuple[float, float]:
    """Return the band that is requested, else the data's own, Hz. Raises ModelError if the model
    has no frequency response.
    """
    system = compile_model(model, outputs)
    refuse_unfit(records, system, delays_of(model))
    return band or band_for(records, system)


def estimated(
    records: Sequence[Record],
    system: System,
    settings: FitSettings,
    delays: Mapping[str, str],
    band: tuple[float, float] | None,
) -> Estimate:
    """Return the estimate with ``fitted`` outputs from a free simulation."""
    found = fit_frequency_domain(
        records, system, FrequencySettings(band, settings.use_priors), delays=delays
    )
    rows = [simulated(record, system, found.as_dict(), settings) for record in records]
    shown = tuple(
        blank if row is None else row for row, blank in zip(rows, found.fitted, strict=True)
    )
    return replace(found, fitted=tuple(np.asarray(row) for row in shown))


# ---- A recorded pitch attitude in the identification of a rigid aircraft

PATH = "phugoid.attitude"


def with_weight(model: Model) -> Model:
    """Return the model with the component of the weight along the flight path.

    The initial flight-path angle is free; the drag polar has typical values.
    """
    wider = model.with_effects(Phugoid(attitude_recorded=True))
    held = [name for name in wider.parameters.names if name.startswith("phugoid.") and name != PATH]
    return wider.with_parameters(wider.parameters.hold(held))


def with_weight_if_needed(
    model: Model, records: Sequence[Record], outputs: Sequence[str]
) -> tuple[Model, str]:
    """Return the model with the weight along the flight path if the records prefer it, and a note.

    The note is empty if no attitude is recorded.
    """
    if ATTITUDE not in {signal.name for signal in model.equations.inputs}:
        return model, ""
    wider = with_weight(model)
    found = compared_readings((model, list(records)), (wider, list(records)), outputs, local=[PATH])
    gain = found.gain
    if found.why_open:
        return (
            model,
            "the pitch attitude is measured and not used: fits with and without the weight along "
            f"the flight path decide nothing ({found.why_open})",
        )
    if gain < DECISIVE_LOG_LIKELIHOOD_RATIO:
        return (
            model,
            "the pitch attitude is measured and not used: the weight along the flight path "
            f"explains no more (likelihood ratio test: {gain:.1f}, "
            f"{DECISIVE_LOG_LIKELIHOOD_RATIO:g} needed)",
        )
    return (
        wider,
        "the pitch attitude is measured: the weight along the flight path changes speed and loads "
        f"(likelihood ratio test: {gain:.1f}, {DECISIVE_LOG_LIKELIHOOD_RATIO:g} needed)",
    )


def without_theta(model: Model, records: Sequence[Record]) -> tuple[Model, list[Record]]:
    """Return the model and records without an unused attitude input."""
    inputs = tuple(signal for signal in model.equations.inputs if signal.name != ATTITUDE)
    bare = [
        replace(
            record, inputs=tuple(channel for channel in record.inputs if channel.name != ATTITUDE)
        )
        for record in records
    ]
    return replace(model, equations=replace(model.equations, inputs=inputs)), bare  # type: ignore[type-var]


# ---- Cautions about an identification

# Models whose declared derivatives are known values, unlike a ballistic coefficient.
AIRCRAFT = ("rigid", "flexible", "loes", "lateral", "longitudinal")
FREE_OF_CHARGE = (
    "delay",
    "inv_tau",
)  # derivative of a low-order system, whose starting value may be zero
# factor on a sigma by coloured noise above which there is a caution
NOTABLE_WIDENING = 1.25
# what corrected standard deviations lack at most: docs/estimators.md, Coverage
STILL_SHORT = "10 % (in gusts 30 %)"
CAUSES = "the model lacks something, a channel has a wrong sign or unit, or the file is wrong"


# outputs that tell lift from moment; of a short period one of them is needed beside q
LIFT_OUTPUTS = frozenset(("alpha", "nz", "az"))
NO_LIFT = (
    "q alone does not tell the lift from the moment, whatever is flown: alpha, nz or az is needed; "
    "without a vane map az from the accelerometer of the IMU"
)


def advice(model: str, estimate: Estimate) -> str:
    """Return what to do after the outcome of an estimation; empty if nothing is needed."""
    undetermined = estimate.outcome is Outcome.NOT_IDENTIFIABLE
    without = model in ("rigid", "flexible") and not LIFT_OUTPUTS & set(estimate.output_names)
    return NO_LIFT if undetermined and without else estimate.outcome.hint


def cautions_of(vehicle: VehicleFile, estimate: Estimate, rows: Sequence[Row]) -> tuple[str, ...]:
    """Return the sentences, at most one on the outcome, one on coloured noise and one on all
    derivatives together.
    """
    sentences = []
    outcome = estimate.outcome
    if outcome is not Outcome.CONVERGED:
        hint = advice(vehicle.model, estimate)
        sentences.append(f"{outcome.value}; {hint}" if hint else outcome.value)
    sentences += [caution] if (caution := coloured(estimate)) else []
    if vehicle.model in AIRCRAFT:
        sentences += [caution] if (caution := contradicted(rows, vehicle.derivatives)) else []
    return tuple(sentences)


def too_short(records: Sequence[Record], system: System) -> tuple[str, ...]:
    """Return a caution if no record is as long as one period of the fastest oscillation of the
    declared model, else nothing.
    """
    p = np.array(system.parameters.values(), dtype=float)
    with np.errstate(all="ignore"):
        found = characteristics_at(system, p)
    pulsed = [
        np.sqrt(value) if name.endswith("stiffness") else value
        for name, value in found.items()
        if name.endswith(("frequency", "stiffness")) and np.isfinite(value) and value > 0.0
    ]
    longest = max(float(np.ptp(record.time)) for record in records)
    period = 2.0 * np.pi / max(pulsed) if pulsed else 0.0
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
    """Return a sentence if an estimate by free simulation is useless, else an empty text.

    It diverges, explains nothing, or determines no derivative.
    """
    measured, left = [], []
    for i, name in enumerate(estimate.output_names):
        of = [
            (record[name], row[i])
            for record, row in zip(records, estimate.fitted, strict=False)
            if name in record.output_names
        ]
        known = [
            (channel.values[channel.valid], row[channel.valid])
            for channel, row in of
            if np.any(channel.valid)
        ]
        measured.append(np.concatenate([z - np.mean(z) for z, _ in known] or [np.zeros(1)]))
        left.append(np.concatenate([z - y for z, y in known] or [np.zeros(1)]))
    units = {
        name: next(r[name].unit for r in records if name in r.output_names)
        for name in estimate.output_names
    }
    why = failed_simulation(units, measured, left) if len(estimate.fitted) == len(records) else ""
    if not why and none_determined(
        (row.std, declared[row.name]) for row in rows if row.name in declared
    ):
        why = UNDETERMINED
    remedy = (
        "check units, signs and declared values, cut the record to single maneuvers, or use "
        "--method filter-error or equation-error"
    )
    return (f"the fit has failed: {why}; {remedy}",) if why else ()


def coloured(estimate: Estimate) -> str:
    """Return one sentence on a filter whose innovations are coloured: by how much standard
    deviations for white noise are too small.
    """
    found = coloured_innovations(estimate)
    if (
        found is None
        or not found.significant
        or not found.factor.size
        or found.factor.max() < NOTABLE_WIDENING
    ):
        return ""
    worst = int(np.argmax(found.factor))
    apart = ", ".join(f"{name} {value:.2f}" for name, value in found.lag_one.items())
    text = (
        f"the noise is not white (autocorrelation of the residuals one sample apart: {apart}): "
        "standard deviations for white noise "
    )
    text += f"would be up to {found.factor[worst]:.1f} times too small ({found.names[worst]})"
    corrected = estimate.sigma(found.names[worst]) >= 0.99 * float(
        np.sqrt(found.covariance[worst, worst])
    )
    if not corrected:
        return text.replace("would be", "are") + "; those given are for white noise"
    return (
        f"{text}; those given are corrected for it, and may still be up to {STILL_SHORT} too "
        "small, as the colour is known from this record alone"
    )


def contradicted(rows: Sequence[Row], declared: Mapping[str, float]) -> str:
    """Return one sentence on all derivatives that the vehicle file contradicts by two sigmas, as
    too large, too small or of the other sign; or nothing.
    """
    found = []
    for row in rows:
        start = declared.get(row.name, 0.0)
        given = row.estimate, row.std, start
        why = "" if row.name in FREE_OF_CHARGE else contradiction(*given) or shortfall(*given)
        if why:
            found.append(
                f"{row.name} {number_text(row.estimate, row.std)} +- "
                f"{number_text(row.std, row.std)} {why} (vehicle file {start:.4g})"
            )
    return (
        f"implausible: {'; '.join(found)}; {CAUSES}; flightid diagnose looks for the cause"
        if found
        else ""
    )


# ---- Cautions on sigmas that are smaller than the errors

# Worst model in gusts: correction factor of the sigmas (mean, worst derivative), and two-sigma
# coverage without it. Measured: docs/estimators.md, Coverage.
SHORT_IN_GUSTS: Mapping[str, tuple[float, float, float]] = {
    "output-error": (1.25, 1.8, 0.91),
    METHOD: (1.5, 2.1, 0.85),
}
FILTER_ERROR = (1.15, 0.92)
# Share of lost rows above which the unknown inputs bias a method by more than half a sigma.
# Measured: rows dropped at random from flights with stepped inputs and white noise.
LOST_ROWS: Mapping[str, float] = {"equation-error": 0.1, "output-error": 0.05}
LONG_INTERVAL_RATIO = 1.5  # multiple of the usual interval that counts as a lost row
INTENSITY = "gust-turbulence.sigma"


MOST_ALONE = 8  # records that are fitted each by itself
DIFFERENT = 5.0  # difference of a parameter between two records, sigmas
MOST_NAMED = 3  # parameters that are named as different


def record_cautions(
    records: Sequence[Record],
    tests: Sequence[ResidualTest],
    alone: Callable[[Record], tuple[Estimate, Sequence[ResidualTest]]],
) -> tuple[str, ...]:
    """Return a caution if each record fits alone, but not all together: conditions differ.

    ``tests`` : of the fit to all records. ``alone`` : the estimate from one record, and its tests.
    """
    if not 2 <= len(records) <= MOST_ALONE or all(test.passed for test in tests):
        return ()
    found: list[Estimate] = []
    for record in records:
        estimate, own = alone(record)
        if estimate.outcome is not Outcome.CONVERGED or not all(test.passed for test in own):
            return ()
        found.append(estimate)
    apart = []
    for name in found[0].names:
        if name.startswith("bias_") or not all(name in each.names for each in found):
            continue
        low, high = (
            choose(range(len(found)), key=lambda k: found[k].value(name)) for choose in (min, max)
        )
        sigma = math.hypot(found[low].sigma(name), found[high].sigma(name))
        distance = (found[high].value(name) - found[low].value(name)) / max(sigma, 1e-300)
        if distance > DIFFERENT:
            values = ", ".join(
                f"{number_text(found[k].value(name), found[k].sigma(name))} +- "
                f"{number_text(found[k].sigma(name), found[k].sigma(name))} in {records[k].name}"
                for k in sorted((low, high))
            )
            apart.append((distance, f"{name} {values}"))
    if not apart:
        return ()
    shown = "; ".join(text for _, text in sorted(apart, reverse=True)[:MOST_NAMED])
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
    """Return a sentence on each reason for which sigmas of the method are smaller than its errors;
    else nothing.

    Records shorter than a period (``too_short``). Lost rows: see ``LOST_ROWS``.
    A model that is unstable at the estimate (of ``system``, with
    ``local`` parameters of each record) where one cause moves the residuals of several outputs,
    which are not white by their ``tests``. Where it is stable gusts, for output error and the
    frequency domain, by the same sign. Gusts, for filter error: their intensity is more than two
    of its sigmas.
    """
    unstable = (
        _of_instability(records, estimate, system, tests, local) if system is not None else ()
    )
    short = too_short(records, system) if system is not None else ()
    return (
        *short,
        *_of_lost_rows(records, estimate),
        *(unstable or _of_gusts(records, estimate, tests)),
    )


def _of_instability(
    records: Sequence[Record],
    estimate: Estimate,
    system: System,
    tests: Sequence[ResidualTest],
    local: Sequence[str],
) -> tuple[str, ...]:
    """Return the errors of a free simulation grow with its unstable mode, while sigmas of output
    error count the sensors' noise alone.
    """
    if not np.all(np.isfinite(estimate.values)) or not disturbed_outputs(records, estimate, tests):
        return ()
    known = {name: value for name, value in estimate.as_dict().items() if name in system.parameters}
    found = replace(system, parameters=system.parameters.with_values(known))
    layout = lay_out(records, found, FitSettings(), local=local)
    if not MOST_EFOLDINGS_AT_ONCE <= growth(layout) < np.inf:
        return ()
    return (
        f"the model is unstable at the estimate: its free simulation doubles small errors, such as "
        "those of inputs between samples and of rounding, every "
        f"{np.log(2.0) / fastest(layout):.2g} s; "
        f"sigmas of {estimate.method} count the noise of the sensors alone and are too small, and "
        "values "
        f"may be wrong by many of them; use --method filter-error, which allows for such errors",
    )


def _of_lost_rows(records: Sequence[Record], estimate: Estimate) -> tuple[str, ...]:
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
    """Return the share of sample intervals, over all records, with lost rows.

    The usual interval is the lower quartile, since more than half of the intervals may be longer.
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
    failing = {test.channel for test in tests if not test.passed}
    if (
        estimate.method in SHORT_IN_GUSTS
        and not (tests and len(failing) < 2)  # a gust moves more than one output beyond its noise
        and _moved_together(records, estimate)
        and not made_by_inputs(records, estimate)
    ):
        factor, worst, held = SHORT_IN_GUSTS[estimate.method]
        return (
            f"several outputs err together, as in gusts; multiply the sigmas by {factor:g} "
            f"(single derivatives need up to {worst:g}), or use --method equation-error, whose "
            "sigmas are right in gusts. In simulated gusts the true value was within two sigmas "
            f"of {estimate.method} in {100 * held:.0f} % of cases in place of 95 %",
        )
    if (
        estimate.method == "filter-error"
        and INTENSITY in estimate.names
        and estimate.value(INTENSITY) > 2.0 * estimate.sigma(INTENSITY)
    ):
        factor, held = FILTER_ERROR
        return (
            f"gusts act; multiply the sigmas by up to {factor:g} if their spectrum may not be "
            "Dryden's, or use --method equation-error, whose sigmas are right in gusts. In "
            "simulated gusts of another spectrum the true value was within two sigmas in "
            f"{100 * held:.0f} % of cases in place of 95 %",
        )
    return ()


def disturbed_outputs(
    records: Sequence[Record], estimate: Estimate, tests: Sequence[ResidualTest]
) -> tuple[str, ...]:
    """Outputs of a free simulation whose residuals are not white, where one cause moves several of
    them as process noise does.

    Measured on flights of three models: of 120 with white noise of each sensor none is called so,
    of 120 with AR(1) noise three, of 240 in gusts all.
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
    """Return whether the inputs predict much of an output's residual in the half not fitted."""
    for record, residual, known in zip(records, *_residuals(records, estimate), strict=True):
        if not record.inputs or len(record.time) < 2:
            continue
        inputs = np.array([channel.values for channel in record.inputs])
        interval = float(np.median(np.diff(record.time)))
        shares = share_from_inputs(residual, known, inputs, interval)
        if np.max(shares, initial=0.0) > MADE_BY_INPUTS:
            return True
    return False


def _moved_together(records: Sequence[Record], estimate: Estimate) -> bool:
    return common_disturbance(*_residuals(records, estimate))


def _residuals(
    records: Sequence[Record], estimate: Estimate
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Measured minus fitted ``(m, N)`` a record, zero if a sample is missing, and which samples
    there are.
    """
    measured = [record.output_array(estimate.output_names) for record in records]
    residuals = [
        np.where(known, z - fitted, 0.0)
        for (z, known), fitted in zip(measured, estimate.fitted, strict=True)
    ]
    return residuals, [known for _, known in measured]


def innovations_phrase(method: str, records: Sequence[Record], estimate: Estimate) -> str:
    """Return the size of the innovations of filter error, the measure of a fit in turbulence; empty
    for other methods.
    """
    if method != "filter-error" or len(estimate.fitted) != len(records):
        return ""
    parts = []
    for row, name in enumerate(estimate.output_names):
        apart = [
            (record[name].values - fitted[row])[record[name].valid]
            for record, fitted in zip(records, estimate.fitted, strict=True)
            if name in record.output_names
        ]
        errors = np.concatenate(apart) if apart else np.zeros(0)
        if not errors.size or not np.all(np.isfinite(errors)):
            continue
        unit = next(r[name].unit for r in records if name in r.output_names)
        factor, shown = shown_in(unit, name)
        size = factor * float(np.sqrt(np.mean(errors**2)))
        parts.append(f"{name} {size:.3g}{spaced(shown)}")
    return (
        f"errors of one-step prediction, the measure in gusts: {', '.join(parts)} rms; "
        if parts
        else ""
    )
