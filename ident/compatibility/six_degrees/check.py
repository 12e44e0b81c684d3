"""Check of data compatibility in six degrees of freedom: estimates, findings and results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.compatibility.fault_sets import (
    delay_same_channel,
    largest_chance_loss,
    penalty_per_fault,
    probabilities,
)
from ident.compatibility.fitting import (
    KinematicFit,
    difference_in_sigmas,
    instruments_of,
    projected_whitener,
)
from ident.compatibility.kinematics import BIAS, BOOM, DELAY, DRIFT, LAG, PACKAGE, SensorFault
from ident.compatibility.signals import NO_AIRSPEED, KinematicSignals, spike_notes, whitener
from ident.compatibility.six_degrees.fitting import (
    FaultLinearisation,
    NormalEquations,
    fit,
    gradient_covariance,
    linearise_faults,
    output_error_equations,
    output_error_gram,
    sum_of_equations,
)
from ident.compatibility.six_degrees.kinematics import (
    BEYOND_LONGITUDINAL,
    WINGS_LEVEL_NOTE,
    faults_of,
    prepared_signals,
    relations,
    unknowns_of,
    usable_channels,
)
from ident.compatibility.six_degrees.search import (
    SECANT_STEP,
    SixDegreeSearch,
    confusable_faults,
    fit_sets,
    search,
    timed_channels,
)
from ident.compatibility.trials import (
    CheckResult,
    Compatibility,
    CompatibilitySettings,
    FaultQuantity,
    SensorEstimate,
    SensorFinding,
    p_value,
    reconstructions_of,
)
from ident.compatibility.unobservable import unobservable_faults
from ident.statistics.intervals import bounded_inverse
from sim.record import Record

# ---- Biases of the sensors in each record


def bias_estimates(kinematic_fit: KinematicFit, r: int) -> tuple[SensorEstimate, ...]:
    """Return the biases of record ``r`` by output error and by the smoother. Output error starts
    at the smoother fit and does one step.
    """
    s, unknown_values = kinematic_fit.signals[r], kinematic_fit.unknown_values[r]
    unknowns, n = unknowns_of(s), len(unknown_values)
    prior = np.array([item.prior**-2 for item in unknowns] + [0.0] * len(kinematic_fit.faults))
    slopes = np.where(s.valid[:, :, None], kinematic_fit.jacobians[r], 0.0)
    white = projected_whitener(s, kinematic_fit.noise)(slopes)
    innovations = whitener(s, kinematic_fit.noise)(kinematic_fit.residuals[r][:, :, None])[:, :, 0]
    flat = white.reshape(-1, white.shape[2])
    inverse = bounded_inverse(flat.T @ flat + np.diag(prior))
    scatter = np.diag(prior) + sum(
        gradient_covariance(columns, e) for columns, e in zip(white, innovations, strict=True)
    )
    variances = np.maximum(np.diag(inverse @ scatter @ inverse), np.diag(inverse))
    gram, gradient, output_error_scatter = output_error_gram(
        s,
        kinematic_fit,
        r,
        np.concatenate([slopes, kinematic_fit.residuals[r][:, :, None]], axis=2),
    )
    gradient[:n] -= prior[:n] * unknown_values
    output_error_inverse = bounded_inverse(gram + np.diag(prior))
    step = output_error_inverse @ gradient
    output_error_variances = np.diag(
        output_error_inverse @ (output_error_scatter + np.diag(prior)) @ output_error_inverse
    )
    estimates = []
    for i, item in enumerate(unknowns):
        if item.key[1] == BIAS:
            fault = SensorFault(item.key[0], BIAS)
            value, variance = float(unknown_values[i]), float(variances[i])
            output_error_value = float(unknown_values[i] + step[i])
            output_error_variance = max(float(output_error_variances[i]), variance)
            determined = 0.0 < variance < fault.plausible**2
            gain = 0.5 * value**2 / variance if variance > 0 else 0.0
            estimates.append(
                _estimate_by_both(
                    fault,
                    (output_error_value, output_error_variance),
                    (value, variance),
                    gain,
                    determined=determined,
                )
            )
    return tuple(estimates)


def bias_findings(
    linear: FaultLinearisation, r: int, estimates: Sequence[SensorEstimate], false_alarm: float
) -> tuple[SensorFinding, ...]:
    """Return the biases of record ``r`` that are large and significant, each with the faults that
    explain the record equally well. ``false_alarm`` is the probability of any false finding.
    """
    findings = []
    for item in estimates:
        fault, size = SensorFault(item.channel, BIAS), item.smoother
        # Only the excess over the smallest finding counts: the rotation and curvature of the earth
        # and the decrease of gravity with height cause smaller biases.
        excess = max(abs(size.value) - fault.smallest_finding, 0.0)
        p = p_value(0.5 * (excess / size.std) ** 2, excess, fault)
        if item.determined and item.agrees and p * len(estimates) < false_alarm:
            group = faults_instead_of_bias(linear, r, item.channel, false_alarm)
            findings.append(SensorFinding.of(fault, size, item.gain, supported=True, group=group))
    return tuple(findings)


def faults_instead_of_bias(
    linear: FaultLinearisation, r: int, channel: str, false_alarm: float
) -> tuple[str, ...]:
    """Return the names of the faults that explain record ``r``, in addition to the accepted ones,
    as well as the bias of a channel does.
    """
    information, gradient = linear.full_equations[r]
    unknown_values, faults = linear.fit.unknown_values[r], linear.faults
    n = len(unknown_values)
    b = [item.key for item in unknowns_of(linear.fit.signals[r])].index((channel, BIAS))
    members = [n + faults.index(fault) for fault in linear.fit.faults]
    gain_with_bias, _, _ = _gain_value_variance([*range(n), *members], information, gradient)
    # The bias is set to zero by a step of minus its value.
    others = [*(i for i in range(n) if i != b), *members]
    gradient_without = gradient + information[:, b] * unknown_values[b]
    loss_without = (
        gradient[b] * unknown_values[b] + 0.5 * information[b, b] * unknown_values[b] ** 2
    )
    losses = []
    for j, fault in enumerate(faults):
        if n + j not in members and information[n + j, n + j] > 0:
            gain, size, variance = _gain_value_variance(
                [*others, n + j], information, gradient_without
            )
            notable = fault.smallest_finding < abs(size) < fault.largest
            possible_sign = size > 0 or not fault.one_sided
            if notable and possible_sign and variance < fault.plausible**2:
                losses.append((gain_with_bias - gain + loss_without, fault.name))
    chance_loss = largest_chance_loss(false_alarm, len(faults))
    return tuple(name for loss, name in sorted(losses) if loss <= chance_loss)


def _gain_value_variance(
    free: Sequence[int], information: np.ndarray, gradient: np.ndarray
) -> tuple[float, float, float]:
    """Return the gain of log likelihood by ``free``, and value and variance of the last one."""
    inverse = bounded_inverse(information[np.ix_(free, free)])
    values = inverse @ gradient[list(free)]
    return 0.5 * float(values @ gradient[list(free)]), float(values[-1]), float(inverse[-1, -1])


_REGULARISATION = 1e-9  # added to the unit diagonal of scaled information before its inversion

# ---- Estimates of all faults by both methods


def estimates_and_findings(
    search_result: SixDegreeSearch,
) -> tuple[tuple[SensorEstimate, ...], tuple[SensorFinding, ...]]:
    """Return the estimates of every fault by both methods, and all findings, accepted first."""
    linear, faults = search_result.linear, search_result.linear.faults
    accepted_and_loss = _accepted_and_loss(search_result)
    output_error = sum_of_equations(search_result.output_error)
    estimates: dict[int, SensorEstimate] = {}
    losses: dict[int, float | None] = {}
    for j in search_result.common:
        context, losses[j] = _context(search_result, j, accepted_and_loss)
        estimates[j] = _estimate(linear.joint, output_error, faults, context, j)
    findings, named = [], set()
    for group in search_result.groups:
        names = [faults[j].name for j, _ in group]
        shares = probabilities([(faults[j], estimates[j].smoother, loss) for j, loss in group])
        for j, loss in group:
            if j not in named and accepted_and_loss[j][0] == group[0][0]:
                finding = SensorFinding.of(
                    faults[j],
                    estimates[j].smoother,
                    estimates[j].gain,
                    supported=True,
                    group=tuple(name for name in names if name != faults[j].name),
                    lost=loss,
                    probabilities=shares,
                    instead_of="" if j == group[0][0] else names[0],
                )
                findings.append(finding)
                named.add(j)
    not_accepted = sorted(
        (j for j in search_result.common if j not in named), key=lambda j: estimates[j].p_value
    )
    for j in not_accepted:
        same_delay = [i for i in search_result.accepted if delay_same_channel(faults[i], faults[j])]
        finding = SensorFinding.of(
            faults[j],
            estimates[j].smoother,
            estimates[j].gain,
            supported=False,
            group=(),
            lost=losses[j],
            instead_of=faults[same_delay[0]].name if same_delay else "",
            replicates=j not in search_result.refused,
        )
        findings.append(finding)
    return tuple(estimates.values()), tuple(findings)


def _accepted_and_loss(search_result: SixDegreeSearch) -> dict[int, tuple[int, float]]:
    """Return for each grouped fault its accepted fault and the loss of log likelihood."""
    groups = list(zip(search_result.accepted, search_result.groups, strict=True))
    confusable = {j: (i, loss) for i, group in reversed(groups) for j, loss in group}
    return confusable | {i: (i, 0.0) for i in search_result.accepted}


def _context(
    search_result: SixDegreeSearch, j: int, accepted_and_loss: dict[int, tuple[int, float]]
) -> tuple[list[int], float | None]:
    """Return the set in which fault ``j`` is tested, ``j`` last, and its loss as replacement."""
    faults, accepted = search_result.linear.faults, search_result.accepted
    if j in accepted_and_loss:
        replaced, loss = accepted_and_loss[j]
        return [*(k for k in accepted if k != replaced and k != j), j], loss
    same_delay = [i for i in accepted if delay_same_channel(faults[i], faults[j])]
    if not same_delay:
        return [*accepted, j], None
    i = same_delay[0]
    members = [*(k for k in accepted if k != i), j]
    if (i, j) in search_result.exchange_losses:
        return members, max(search_result.exchange_losses[i, j], 0.0) / search_result.widening
    pair = fit_sets(search_result.linear.joint, faults, [[*members[:-1], i], members])
    return members, float(pair.gain[0] - pair.gain[1]) / search_result.widening


def _estimate(
    smoother: NormalEquations,
    output_error: NormalEquations,
    faults: Sequence[SensorFault],
    context: Sequence[int],
    j: int,
) -> SensorEstimate:
    """Return the estimate of fault ``j``, the last of the set ``context``, by both methods."""
    fault, members = faults[j], np.array([context])
    with_fault = fit_sets(smoother, faults, members)
    without = fit_sets(smoother, faults, members[:, :-1])
    other_estimate = fit_sets(output_error, faults, members)
    size, variance = float(with_fault.sizes[0, -1]), float(with_fault.variances[0, -1])
    determined = 0.0 < variance < fault.plausible**2 and smoother.information[j, j] > 0
    widening = float(with_fault.widening[0, -1])
    other_variance = max(_sandwich(output_error, context), 0.0) * widening
    gain = max(float(with_fault.gain[0] - without.gain[0]), 0.0) / widening
    other_size = float(np.clip(other_estimate.sizes[0, -1], -fault.largest, fault.largest))
    size = float(np.clip(size, -fault.largest, fault.largest))
    return _estimate_by_both(
        fault, (other_size, other_variance), (size, variance), gain, determined=determined
    )


def _estimate_by_both(
    fault: SensorFault,
    output_error: tuple[float, float],
    smoother: tuple[float, float],
    gain: float,
    *,
    determined: bool,
) -> SensorEstimate:
    """Return the estimate of a fault from its size and variance by each of the methods."""
    difference = difference_in_sigmas(*output_error, *smoother) if determined else 0.0
    return SensorEstimate.of(
        fault,
        FaultQuantity.of(fault, *output_error),
        FaultQuantity.of(fault, *smoother),
        difference,
        gain,
        p_value(gain, smoother[0], fault),
        determined,
    )


def _sandwich(normal: NormalEquations, context: Sequence[int]) -> float:
    """Return the variance of the last fault of a set, from the scatter of the gradient."""
    block = np.ix_(context, context)
    diagonal = np.diag(normal.information[block])
    scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    inverse = np.linalg.inv(
        normal.information[block] * np.outer(scale, scale) + _REGULARISATION * np.eye(len(scale))
    ) * np.outer(scale, scale)
    return float(inverse[-1] @ normal.scatter[block] @ inverse[-1])


def estimates_of_record(search_result: SixDegreeSearch, r: int) -> tuple[SensorEstimate, ...]:
    """Return the estimates of all faults from record ``r`` alone, each in the same set as in the
    joint check.
    """
    linear = search_result.linear
    accepted_and_loss = _accepted_and_loss(search_result)
    smoother, output_error = linear.smoother[r], search_result.output_error[r]
    return tuple(
        _estimate(
            smoother,
            output_error,
            linear.faults,
            _context(search_result, j, accepted_and_loss)[0],
            j,
        )
        for j in search_result.common
    )


def drift_finding(
    search_result: SixDegreeSearch, r: int, false_alarm: float
) -> tuple[SensorFinding, ...]:
    """Return the finding of a drift in record ``r`` in addition to all accepted faults, or no
    finding. ``false_alarm`` is the probability of a false drift.
    """
    linear, members = search_result.linear, search_result.accepted
    faults = linear.faults
    drifts = [j for j, fault in enumerate(faults) if fault.kind == DRIFT]
    # This selection takes the noise as white: a drift itself makes residuals coloured.
    sets = fit_sets(
        linear.smoother[r]._replace(scatter=linear.smoother[r].information),
        faults,
        [[*members, j] for j in drifts],
    )
    gains = np.where(sets.sound, sets.gain, 0.0)
    j = drifts[int(np.argmax(gains))]
    penalty = penalty_per_fault(false_alarm, len(drifts))
    if float(np.max(gains) - fit_sets(linear.smoother[r], faults, [members]).gain[0]) < penalty:
        return ()
    record_fit = replace(
        linear.fit, signals=(linear.fit.signals[r],), unknown_values=(linear.fit.unknown_values[r],)
    )
    with_drift = linearise_faults(
        fit(record_fit.signals, [faults[i] for i in (*members, j)], record_fit),
        faults,
        np.full(len(faults), SECANT_STEP),
    )
    item = _estimate(
        with_drift.joint, output_error_equations(with_drift, 0), faults, [*members, j], j
    )
    if (
        not item.determined
        or item.gain < penalty
        or abs(item.smoother.value) < faults[j].smallest_finding
    ):
        return ()
    rivals = confusable_faults(
        with_drift, (*members, j), j, largest_chance_loss(false_alarm, len(drifts)), drifts
    )
    group = tuple(faults[k].name for k in rivals)
    return (
        SensorFinding.of(
            faults[j], item.smoother, item.gain, supported=True, group=group, lost=0.0
        ),
    )


# ---- Data compatibility in six degrees of freedom of records of one set of sensors

STEADY_WIND = (
    "a steady wind along the ground is not observable: no channel is measured against the ground"
)


def channels_of(records: Sequence[Record]) -> tuple[str, ...]:
    """Return the channels of six-degree kinematics that all records have."""
    first, *others = (usable_channels(record) for record in records)
    return tuple(name for name in first if all(name in names for names in others))


def has_six_degrees(records: Sequence[Record], settings: CompatibilitySettings) -> bool:
    """Return whether the channels have a relation beyond longitudinal motion: of sideslip, bank,
    heading or height.
    """
    channels = channels_of(records)
    known_speed = settings.airspeed is not None or "airspeed" in channels
    return any(name in BEYOND_LONGITUDINAL for name in relations(channels, speed=known_speed))


def check(
    records: Sequence[Record], settings: CompatibilitySettings, *, each: bool
) -> Compatibility:
    """Return the result of `ident.compatibility.check.compatibility` for records with six degrees
    of freedom. Where ``each`` is True, every one of several records is also checked alone.
    """
    channels = channels_of(records)
    known_speed = settings.airspeed is not None or "airspeed" in channels
    related = relations(channels, speed=known_speed)
    signals, notes = _signals_and_notes(records, channels, related, settings)
    base = fit(signals)
    search_result = search(signals, base, faults_of(signals[0], settings.chord), settings)
    joint, single = _joint_and_single(search_result, settings.false_alarm, each=each)
    notes += _notes(search_result, signals)
    final = search_result.linear.fit
    named = {name for names in related.values() for name in names}
    unobservable = (
        *(
            f"{name}: cannot be checked, no relation among the recorded channels contains it"
            for name in channels
            if name not in named
        ),
        *_unobservable(search_result, signals[0], settings.false_alarm),
        STEADY_WIND,
    )
    return Compatibility(
        channels,
        related,
        joint,
        single,
        reconstructions_of(base, final),
        unobservable,
        tuple(notes),
    )


def _signals_and_notes(
    records: Sequence[Record],
    channels: Sequence[str],
    related: dict[str, tuple[str, ...]],
    settings: CompatibilitySettings,
) -> tuple[tuple[KinematicSignals, ...], list[str]]:
    """Return the signals of each record, and sentences on channels and missing relations."""
    prepared = [
        prepared_signals(record, channels, settings.airspeed, settings.gravity, settings.vane_arm)
        for record in records
    ]
    signals = tuple(s for s, _ in prepared)
    notes = [note for _, changes in prepared for note in changes]
    controls = [instruments_of(record, every=2) for record in records]
    if all(columns.shape[1] for columns in controls):
        signals = tuple(
            replace(s, instruments=columns) for s, columns in zip(signals, controls, strict=True)
        )
    notes += spike_notes(signals)
    lacking = [name for name in relations(channels, speed=True) if name not in related]
    if lacking:
        notes.append(
            f"{NO_AIRSPEED}, without which these relations cannot be used: {', '.join(lacking)}"
        )
    if "phi" not in channels:
        notes.append(WINGS_LEVEL_NOTE)
    return signals, notes


def _joint_and_single(
    search_result: SixDegreeSearch, false_alarm: float, *, each: bool
) -> tuple[CheckResult, tuple[CheckResult, ...]]:
    """Return the result of all records together and, where wanted, those of single records."""
    estimates, findings = estimates_and_findings(search_result)
    final = search_result.linear.fit
    noise, names = final.noise, tuple(s.name for s in final.signals)
    # A channel that is an input of another relation has its own white noise as an output.
    levels = dict(
        zip(
            (*noise.inputs, *noise.outputs),
            np.sqrt([*noise.density, *noise.white]).tolist(),
            strict=True,
        )
    )
    biases = [bias_estimates(final, r) for r in range(len(names))]
    if len(names) == 1:
        found_biases = bias_findings(search_result.linear, 0, biases[0], false_alarm)
        joint = CheckResult(names, estimates, biases[0], (*found_biases, *findings), levels)
        return joint, (joint,)
    joint = CheckResult(names, estimates, (), findings, levels)
    single = tuple(
        CheckResult(
            (names[r],),
            estimates_of_record(search_result, r),
            biases[r],
            _findings_of_record(search_result, r, biases[r], false_alarm, len(names)),
            levels,
        )
        for r in (range(len(names)) if each else ())
    )
    return joint, single


def _findings_of_record(
    search_result: SixDegreeSearch,
    r: int,
    biases: Sequence[SensorEstimate],
    false_alarm: float,
    count: int,
) -> tuple[SensorFinding, ...]:
    """Return the drift of record ``r``, and the biases that are not confusable with it."""
    drift = drift_finding(search_result, r, false_alarm / count)
    drifts = {finding.name for finding in drift}
    return (
        *(
            bias
            for bias in bias_findings(search_result.linear, r, biases, false_alarm)
            if not drifts.intersection(bias.group)
        ),
        *drift,
    )


def _notes(search_result: SixDegreeSearch, signals: Sequence[KinematicSignals]) -> list[str]:
    """Return sentences on a load that is early and on the time reference."""
    notes = []
    if search_result.early is not None:
        channel, ahead = search_result.early
        notes.append(
            f"{channel} recorded {-1000.0 * ahead:.0f} ms before it happens would explain more "
            "than any sensor fault: most likely a gust on vane and load, which the kinematics do "
            "not include, so that no further fault is named"
        )
    accepted = [search_result.linear.faults[i] for i in search_result.accepted]
    delayed = {fault.channel for fault in accepted if fault.kind in (DELAY, LAG)}
    on_time = [name for name in timed_channels(tuple(signals[0].channels)) if name not in delayed]
    if delayed & set(timed_channels(tuple(signals[0].channels))) and on_time:
        notes.append(
            f"delays are relative to {', '.join(on_time)}, which agree: a delay common to "
            "all channels cannot be detected from kinematics"
        )
    return notes


def _unobservable(
    search_result: SixDegreeSearch, s: KinematicSignals, false_alarm: float
) -> tuple[str, ...]:
    """Return sentences on faults that the records do not determine."""
    faults = (*search_result.linear.faults, *search_result.linear.biases)
    size = np.array([fault.plausible for fault in faults])
    mounts = [name for name in (PACKAGE, BOOM) if _has_fault(name, faults)]
    channels = (*s.channels, *mounts, "wind")
    return unobservable_faults(
        search_result.linear.information_with_biases * np.outer(size, size),
        faults,
        [name for name in channels if _has_fault(name, faults)],
        largest_chance_loss(false_alarm, len(search_result.common)),
        {search_result.linear.faults[j].name for group in search_result.groups for j, _ in group},
    )


def _has_fault(name: str, faults: Sequence[SensorFault]) -> bool:
    return any(fault.channel == name for fault in faults)
