"""Data compatibility of records: check of the sensors by kinematics alone, without aerodynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.compatibility.fault_sets import FaultSearch, largest_chance_loss, search
from ident.compatibility.fitting import (
    KinematicFit,
    fit,
    instruments_of,
    projected_whitener,
    reduced_whitener,
)
from ident.compatibility.kinematics import BIAS, DRIFT, SensorFault, faults_of
from ident.compatibility.signals import (
    NO_AIRSPEED,
    KinematicSignals,
    measured_channels,
    relations,
    signals_of,
    spike_notes,
)
from ident.compatibility.six_degrees.check import channels_of, has_six_degrees
from ident.compatibility.six_degrees.check import check as six_degrees
from ident.compatibility.six_degrees.kinematics import WINGS_LEVEL_NOTE
from ident.compatibility.trials import (
    CheckResult,
    Compatibility,
    CompatibilitySettings,
    FaultTrial,
    SensorEstimate,
    bias_estimates,
    reconstructions_of,
    reference_sentence,
    refitted_with_faults,
    sensor_estimate,
    time_references,
    try_faults,
)
from ident.compatibility.unobservable import unobservable_sentences
from sim.errors import RecordError
from sim.record import LARGEST_MEASURED, Record, refuse_beyond_measure

# channels that the relation of each channel needs in addition to the channel itself
_NEEDED_CHANNELS = {
    "alpha": ("q", "nz"),
    "theta": ("q",),
    "airspeed": ("ax", "theta", "alpha", "nz"),
    "nz": ("alpha", "q"),
    "q": ("theta",),
    "ax": ("airspeed",),
}
FEWEST_SAMPLES = 20  # fewest samples of a record
LATERAL_CONTROLS = ("aileron", "rudder")


def compatibility(
    records: Sequence[Record],
    settings: CompatibilitySettings,
    *,
    each: bool = True,
    six: bool | None = None,
) -> Compatibility:
    """Check the data compatibility of records of one set of sensors by flight-path reconstruction.

    Outputs (alpha, theta, airspeed) are integrated from measured inputs (q, nz or az, ax). Biases
    of each record, and sensor faults common to all records, explain the differences. They are
    estimated by output error and by a smoother. No model of the vehicle is needed. Where the
    channels have a relation of sideslip, bank, heading or height, the relations of six degrees of
    freedom are used.

    Parameters
    ----------
    records : records, of which the common channels are used.
    settings : constants and limits.
    each : whether each of several records is also checked alone, which doubles the computing time.
    six : whether the relations of six degrees of freedom are used; None uses them if the channels
        have a relation that longitudinal motion does not have.

    Raises
    ------
    RecordError : if a record has fewer than 20 samples, or an unusable number.
    """
    try:
        return _compatibility(records, settings, each=each, six=six)
    finally:
        projected_whitener.cache_clear()  # frees the records of this check
        reduced_whitener.cache_clear()


def _compatibility(
    records: Sequence[Record], settings: CompatibilitySettings, *, each: bool, six: bool | None
) -> Compatibility:
    """Return the result of `compatibility`, without clearing the caches."""
    for record in records:
        _refuse_unusable(record)
    if warnings := bank_angle_warnings(records, settings.airspeed, settings.gravity):
        return _without_estimates(records, channels_of(records), warnings)
    if has_six_degrees(records, settings) if six is None else six:
        return six_degrees(records, settings, each=each)
    records = [_without_lateral_controls(record) for record in records]
    channels = tuple(
        name
        for name in measured_channels(records[0])
        if all(name in measured_channels(record) for record in records[1:])
    )
    notes = [
        f"az serves as nz = -az/g0 ({record.name})"
        for record in records
        if "nz" in channels and "nz" not in record.output_names
    ]
    usable = channels
    if settings.airspeed is None and "airspeed" not in channels:
        usable = tuple(name for name in channels if name not in ("alpha", "nz"))
        if "alpha" in relations(channels):
            notes.append(
                f"{NO_AIRSPEED}, without which the relation of alpha, q and nz cannot be used"
            )
    related = relations(usable)
    notes += [WINGS_LEVEL_NOTE] if related else []
    if not related:
        sentences = _channels_without_relation(channels, {})
        return _without_estimates(records, channels, sentences, notes)
    signals = [
        signals_of(record, usable, settings.airspeed, settings.gravity, settings.vane_arm)
        for record in records
    ]
    controls = [instruments_of(record) for record in records]
    if all(columns.shape[1] for columns in controls):
        signals = [
            replace(s, instruments=columns) for s, columns in zip(signals, controls, strict=True)
        ]
    notes += spike_notes(signals)
    used = tuple(name for name in usable if name in signals[0].channels)
    bases = [fit([s]) for s in signals]
    several = len(bases) > 1
    base = fit(signals, begin=_joint_start(bases)) if several else bases[0]
    # A drift belongs to one record, so that several records have no common drift.
    faults = faults_of(used, drifts=not several, chord=settings.chord)
    search_result = search(base, faults, bases, settings)
    joint = _result(search_result, bias_estimates(base) if not several else ())
    single = [joint]
    if several:
        single = [
            _result_of_record(record_base, search_result, settings, len(bases))
            for record_base in bases
            if each
        ]
    notes += _timing_notes(search_result, signals)
    supported = {finding.name for finding in joint.findings if finding.supported}
    chance_loss = largest_chance_loss(settings.false_alarm, len(joint.estimates))
    unobservable = (
        *_channels_without_relation(channels, related),
        *unobservable_sentences(base, search_result.fit.noise, used, chance_loss, supported),
    )
    return Compatibility(
        channels,
        related,
        joint,
        tuple(single),
        reconstructions_of(base, search_result.fit),
        unobservable,
        tuple(notes),
    )


def _timing_notes(search_result: FaultSearch, signals: Sequence[KinematicSignals]) -> list[str]:
    """Return sentences on a load that is early and on the time reference."""
    notes = []
    if search_result.early is not None:
        ahead = -1000.0 * search_result.early
        notes.append(
            f"nz recorded {ahead:.0f} ms before it happens would explain more than any sensor "
            "fault: most likely a gust on vane and load, which the kinematics do not include, so "
            "that no further fault is named"
        )
    if reference := reference_sentence(search_result.fit.faults, time_references(signals)):
        notes.append(reference)
    return notes


def _without_estimates(
    records: Sequence[Record],
    channels: tuple[str, ...],
    unobservable: tuple[str, ...],
    notes: Sequence[str] = (),
) -> Compatibility:
    """Return the result without a relation that can be checked; ``unobservable`` says why."""
    empty = CheckResult(tuple(record.name for record in records), (), (), (), {})
    single = tuple(replace(empty, records=(record.name,)) for record in records)
    return Compatibility(channels, {}, empty, single, (), unobservable, tuple(notes))


def _result(search_result: FaultSearch, biases: tuple[SensorEstimate, ...]) -> CheckResult:
    """Return the result of a search for faults."""
    noise = search_result.fit.noise
    levels = dict(
        zip(
            (*noise.outputs, *noise.inputs),
            np.sqrt([*noise.white, *noise.density]).tolist(),
            strict=True,
        )
    )
    names = tuple(s.name for s in search_result.fit.signals)
    return CheckResult(
        names,
        tuple(sensor_estimate(trial) for trial in search_result.trials),
        biases,
        search_result.findings,
        levels,
    )


def _result_of_record(
    base: KinematicFit, joint: FaultSearch, settings: CompatibilitySettings, count: int
) -> CheckResult:
    """Return the result of one of ``count`` records, from its fit without faults, ``base``.

    Each fault is tried in addition to the same faults as in the ``joint`` search of all records.
    Drifts, which belong to single records, are tried in addition to all accepted faults.
    """
    with_accepted = refitted_with_faults(base, joint.fit.faults, joint.fit.sizes)
    trial_by_fault: dict[SensorFault, FaultTrial] = {}
    contexts = {trial.fit.faults[:-1]: trial.fit.sizes[:-1] for trial in joint.trials}
    for context, sizes in contexts.items():
        if context == joint.fit.faults:
            start = with_accepted
        else:
            start = refitted_with_faults(base, context, sizes)
        faults = [trial.fault for trial in joint.trials if trial.fit.faults[:-1] == context]
        trial_by_fault |= {trial.fault: trial for trial in try_faults(start, faults)}
    trials = [trial_by_fault[trial.fault] for trial in joint.trials]
    channels = list(dict.fromkeys(trial.fault.channel for trial in joint.trials))
    drifts = [fault for fault in faults_of(channels, drifts=True) if fault.kind == DRIFT]
    one_drift = replace(settings, false_alarm=settings.false_alarm / count, max_faults=1)
    drift_search = search(with_accepted, drifts, [], one_drift)
    return _result(
        replace(drift_search, trials=(*trials, *drift_search.trials)), bias_estimates(with_accepted)
    )


def _joint_start(bases: Sequence[KinematicFit]) -> KinematicFit:
    """Return the unknowns of single records, with the geometric means of their noise."""
    white = np.exp(np.mean([np.log(base.noise.white) for base in bases], axis=0))
    density = np.exp(np.mean([np.log(base.noise.density) for base in bases], axis=0))
    return replace(
        bases[0],
        unknown_values=tuple(base.unknown_values[0] for base in bases),
        noise=replace(bases[0].noise, white=white, density=density),
    )


def _channels_without_relation(
    channels: Sequence[str], related: dict[str, tuple[str, ...]]
) -> tuple[str, ...]:
    """Return a sentence on each channel without a relation, with the channels that it needs."""
    in_relation = {name for names in related.values() for name in names}
    sentences = []
    for name in channels:
        if name not in in_relation and not (name == "airspeed" and "alpha" in related):
            missing = [needed for needed in _NEEDED_CHANNELS[name] if needed not in channels]
            reason = "its relation needs an airspeed"
            if missing:
                reason = f"its relation needs {' and '.join(missing)} too"
            if name == "alpha" and "nz" in missing and "q" in channels:
                reason += ": without the load the lift between alpha and q is unknown"
            sentences.append(f"{name}: cannot be checked, {reason}")
    return tuple(sentences)


def _without_lateral_controls(record: Record) -> Record:
    """Return the record without the controls of lateral motion."""
    inputs = tuple(control for control in record.inputs if control.name not in LATERAL_CONTROLS)
    return record if len(inputs) == len(record.inputs) else replace(record, inputs=inputs)


def _refuse_unusable(record: Record) -> None:
    """Raise RecordError for a record that is too short or has unusable values."""
    if len(record) < FEWEST_SAMPLES:
        raise RecordError(
            f"{len(record)} samples are too few to check",
            where=record.name,
            remedy=f"give at least {FEWEST_SAMPLES}",
        )
    refuse_beyond_measure(record, record.output_names, LARGEST_MEASURED)
    if "airspeed" in record.output_names:
        channel = record["airspeed"]
        if np.any(channel.values[channel.valid] <= 0):
            raise RecordError(
                "an airspeed that is not above zero",
                where=f"{record.name}, channel airspeed",
                remedy="cut the record there with --from and --to",
            )


# ---- Records without a bank angle

_RATES = ("p", "r")


def bank_angle_warnings(
    records: Sequence[Record], airspeed: float | None, gravity: float
) -> tuple[str, ...]:
    """Return a sentence on each record without a bank angle in which the wings were not level, so
    that the relations of alpha and theta are wrong.

    An approximate bank angle is the integral of p about its median, or the bank of a coordinated
    turn at the yaw rate r. A record is named if this bank changes the integrals of the rates of
    theta and alpha, after removal of a constant and a trend, by more than the smallest finding of a
    bias.

    ``airspeed`` in m/s, where none is recorded; ``gravity`` in m/s2.
    """
    sentences = []
    for record in records:
        rates = [
            name
            for name in _RATES
            if name in record.output_names and np.count_nonzero(record[name].valid) > 1
        ]
        if "phi" in record.output_names or "q" not in record.output_names or not rates:
            continue
        phi = _bank(record, rates, airspeed, gravity)
        largest = max(
            np.std(_detrended_integral(record.time, error))
            for error in _wrong_rates(record, rates, phi, airspeed, gravity)
        )
        if largest > SensorFault("alpha", BIAS).smallest_finding:
            bank, verb = np.degrees(np.max(np.abs(phi))), "show" if len(rates) > 1 else "shows"
            sentences.append(
                f"no bank angle is recorded in {record.name}, and {' and '.join(rates)} {verb} "
                f"that the wings were up to {bank:.0f} deg from level: "
                "alpha, q, theta and the loads, whose relations need it, cannot be checked"
            )
    return tuple(sentences)


def _bank(
    record: Record, rates: Sequence[str], airspeed: float | None, gravity: float
) -> np.ndarray:
    """Return an approximate bank angle ``(N,)``, rad."""
    from scipy.integrate import cumulative_trapezoid

    turn = np.zeros(len(record))
    speed = _speed(record, airspeed)
    if "r" in rates and speed is not None:
        turn = np.arctan(_filled(record, "r") * speed / gravity)
    if "p" not in rates:
        return turn
    p = _filled(record, "p")
    rolled = cumulative_trapezoid(p - np.median(p), record.time, initial=0.0)
    return np.asarray(rolled - np.median(rolled) + np.median(turn))


def _wrong_rates(
    record: Record, rates: Sequence[str], phi: np.ndarray, airspeed: float | None, gravity: float
) -> tuple[np.ndarray, ...]:
    """Return the errors ``(N,)``, rad/s, of the rates of theta and alpha if wings are not level."""
    speed = _speed(record, airspeed)
    q = _filled(record, "q") if "q" in record.output_names else np.zeros(len(record))
    if "r" in rates:
        r = _filled(record, "r")
    else:  # a coordinated turn
        r = np.tan(phi) * (gravity / speed if speed is not None else 0.0)
    pitch = q * (np.cos(phi) - 1.0) - r * np.sin(phi)
    return (pitch,) if speed is None else (pitch, gravity / speed * (np.cos(phi) - 1.0))


def _speed(record: Record, airspeed: float | None) -> float | None:
    """Return the mean airspeed of a record, m/s, or the given one; None without any."""
    if "airspeed" in record.output_names:
        return float(
            np.nanmean(np.where(record["airspeed"].valid, record["airspeed"].values, np.nan))
        )
    return airspeed


def _filled(record: Record, name: str) -> np.ndarray:
    """Return a channel ``(N,)`` with its gaps bridged by straight lines."""
    channel = record[name]
    return np.interp(record.time, record.time[channel.valid], channel.values[channel.valid])


def _detrended_integral(time: np.ndarray, rate: np.ndarray) -> np.ndarray:
    """Return the integral ``(N,)`` of a rate, less a straight line fitted to it."""
    from scipy.integrate import cumulative_trapezoid

    whole = cumulative_trapezoid(rate, time, initial=0.0)
    return np.asarray(whole - np.polynomial.Polynomial.fit(time, whole, 1)(time))
