"""Data compatibility of records: check of the sensors by kinematics alone, without aerodynamics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.compatibility.fault_sets import (
    FaultSearch,
    clocks,
    confusable_loss,
    reference_sentence,
    search,
)
from ident.compatibility.fitting import KinematicFit, fit
from ident.compatibility.instruments import instruments_of, shortened, weigher
from ident.compatibility.kinematics import DRIFT, SensorFault, faults_of
from ident.compatibility.signals import (
    NO_AIRSPEED,
    measured_channels,
    relations,
    signals_of,
    smoothed_walk,
)
from ident.compatibility.six_degrees.check import channels_of, has_six_degrees
from ident.compatibility.six_degrees.check import check as six_degrees
from ident.compatibility.six_degrees.kinematics import LEVEL, misled_by_bank
from ident.compatibility.trials import (
    CheckResult,
    Compatibility,
    CompatibilitySettings,
    FaultTrial,
    Reconstruction,
    SensorEstimate,
    bias_estimates,
    estimate_of,
    tried,
    with_more_faults,
)
from ident.compatibility.unobservable import unobservable_sentences
from sim.errors import RecordError
from sim.record import LARGEST_MEASURED, Record, refuse_beyond_measure

# channels that the relation of a channel needs
_NEEDS = {
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
    records : the channels that all records have are used.
    settings : constants and limits.
    each : check each of several records alone too, which takes the same time again.
    six : use the relations of six degrees of freedom; None uses them where one of them exists that
        longitudinal motion does not have.

    Raises
    ------
    RecordError : where a record has fewer than 20 samples, or an unusable number.
    """
    try:
        return _compatibility(records, settings, each=each, six=six)
    finally:
        weigher.cache_clear()  # frees the records of this check
        shortened.cache_clear()


def _compatibility(
    records: Sequence[Record], settings: CompatibilitySettings, *, each: bool, six: bool | None
) -> Compatibility:
    """Return the result of `compatibility`."""
    for record in records:
        _refuse(record)
    if misled := misled_by_bank(records, settings.airspeed, settings.gravity):
        return _nothing_observable(records, misled)
    if has_six_degrees(records, settings) if six is None else six:
        return six_degrees(records, settings, each=each)
    records = [_longitudinal(record) for record in records]
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
    joined = relations(usable)
    notes += [LEVEL] if joined else []
    if not joined:
        return _without_relations(records, channels, notes)
    signals = [
        signals_of(record, usable, settings.airspeed, settings.gravity, settings.vane_arm)
        for record in records
    ]
    controls = [instruments_of(record) for record in records]
    if all(columns.shape[1] for columns in controls):
        signals = [
            replace(s, instruments=columns) for s, columns in zip(signals, controls, strict=True)
        ]
    for s in signals:
        notes += [
            f"{count} isolated wrong sample{'s' * (count > 1)} of {name} in {s.name} set aside"
            for name, count in s.spikes.items()
            if count
        ]
    used = tuple(name for name in usable if name in signals[0].channels)
    bases = [fit([s]) for s in signals]
    together = len(bases) > 1
    whole = fit(signals, begin=_together(bases)) if together else bases[0]
    search_result = search(
        whole, faults_of(used, drifts=not together, chord=settings.chord), bases, settings
    )
    joint = _result(search_result, bias_estimates(whole) if not together else ())
    single = [joint]
    if together:
        single = [_by_itself(base, search_result, settings, len(bases)) for base in bases if each]
    if search_result.early is not None:
        ahead = -1000.0 * search_result.early
        notes.append(
            f"nz recorded {ahead:.0f} ms before it happens would explain more than any sensor "
            "fault: something acts that the kinematics "
            "do not know, a gust on vane and load most likely, so that no further fault is named"
        )
    if reference := reference_sentence(search_result.fit.faults, clocks(signals)):
        notes.append(reference)
    standing = {finding.name for finding in joint.findings if finding.stands}
    chance = confusable_loss(settings.false_alarm, len(joint.estimates))
    unobservable = unobservable_sentences(whole, search_result.fit.noise, used, chance, standing)
    return Compatibility(
        channels,
        joined,
        joint,
        tuple(single),
        _reconstructions(whole, search_result.fit),
        (*_closed_by(channels, joined), *unobservable),
        tuple(notes),
    )


def _without_relations(
    records: Sequence[Record], channels: tuple[str, ...], notes: Sequence[str]
) -> Compatibility:
    """Return the result for channels that no relation joins."""
    empty = CheckResult(tuple(record.name for record in records), (), (), (), {})
    each = tuple(replace(empty, records=(record.name,)) for record in records)
    return Compatibility(channels, {}, empty, each, (), _closed_by(channels, {}), tuple(notes))


def _nothing_observable(records: Sequence[Record], why: tuple[str, ...]) -> Compatibility:
    """Return the result where nothing is observable, with the sentences ``why``."""
    empty = CheckResult(tuple(record.name for record in records), (), (), (), {})
    single = tuple(replace(empty, records=(record.name,)) for record in records)
    return Compatibility(channels_of(records), {}, empty, single, (), why, ())


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
        tuple(estimate_of(trial) for trial in search_result.trials),
        biases,
        search_result.findings,
        levels,
    )


def _by_itself(
    base: KinematicFit, joint: FaultSearch, settings: CompatibilitySettings, count: int
) -> CheckResult:
    """Return the result of one record of several. Each fault is tried with the same other faults as
    in all records, and a drift, which belongs to a single record, with all accepted faults.
    """
    current = with_more_faults(base, joint.fit.faults, joint.fit.sizes)
    by_fault: dict[SensorFault, FaultTrial] = {}
    for before, sizes in {
        trial.fit.faults[:-1]: trial.fit.sizes[:-1] for trial in joint.trials
    }.items():
        start = current if before == joint.fit.faults else with_more_faults(base, before, sizes)
        by_fault |= {
            trial.fault: trial
            for trial in tried(
                start, [t.fault for t in joint.trials if t.fit.faults[:-1] == before]
            )
        }
    trials = [by_fault[trial.fault] for trial in joint.trials]
    channels = list(dict.fromkeys(trial.fault.channel for trial in joint.trials))
    faults = [fault for fault in faults_of(channels, drifts=True) if fault.kind == DRIFT]
    drifts = search(
        current, faults, [], replace(settings, false_alarm=settings.false_alarm / count, most=1)
    )
    return _result(replace(drifts, trials=(*trials, *drifts.trials)), bias_estimates(current))


def _together(bases: Sequence[KinematicFit]) -> KinematicFit:
    """Return the start of a joint fit from the fits of single records."""
    white = np.exp(np.mean([np.log(base.noise.white) for base in bases], axis=0))
    density = np.exp(np.mean([np.log(base.noise.density) for base in bases], axis=0))
    return replace(
        bases[0],
        own=tuple(base.own[0] for base in bases),
        noise=replace(bases[0].noise, white=white, density=density),
    )


def _reconstructions(base: KinematicFit, final: KinematicFit) -> tuple[Reconstruction, ...]:
    """Return the reconstructions by the fit without faults, ``base``, and with them, ``final``."""
    reconstructions = []
    for s, plain, y, residual in zip(
        final.signals, base.outputs, final.outputs, final.residuals, strict=True
    ):
        smooth = y + smoothed_walk(s, final.noise, residual)
        rows = range(len(s.outputs))
        reconstructions.append(
            Reconstruction(
                s.name,
                s.time,
                {s.outputs[i]: s.channels[s.outputs[i]] for i in rows},
                {s.outputs[i]: plain[i] for i in rows},
                {s.outputs[i]: y[i] for i in rows},
                {s.outputs[i]: smooth[i] for i in rows},
                {s.outputs[i]: s.valid[i] for i in rows},
            )
        )
    return tuple(reconstructions)


def _closed_by(channels: Sequence[str], joined: dict[str, tuple[str, ...]]) -> tuple[str, ...]:
    """Return a sentence on each channel without a relation, with the channels that it needs."""
    reached = {name for names in joined.values() for name in names}
    sentences = []
    for name in channels:
        if name not in reached and not (name == "airspeed" and "alpha" in joined):
            missing = [other for other in _NEEDS[name] if other not in channels]
            why = (
                f"its relation needs {' and '.join(missing)} too"
                if missing
                else "its relation needs an airspeed"
            )
            lift = (
                ": without the load the lift between alpha and q is unknown"
                if name == "alpha" and "nz" in missing and "q" in channels
                else ""
            )
            sentences.append(f"{name}: nothing can be told, {why}{lift}")
    return tuple(sentences)


def _longitudinal(record: Record) -> Record:
    """Return the record without the controls of lateral motion."""
    inputs = tuple(control for control in record.inputs if control.name not in LATERAL_CONTROLS)
    return record if len(inputs) == len(record.inputs) else replace(record, inputs=inputs)


def _refuse(record: Record) -> None:
    """Raise an error for a record that is too short or has unusable values."""
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
