"""Data compatibility in six degrees of freedom of records of one set of sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ident.compatibility.faults import BOOM, PACKAGE, SensorFault
from ident.compatibility.fitting import Fit
from ident.compatibility.instruments import instruments_of
from ident.compatibility.noise import smoothed_walk
from ident.compatibility.observability import untold
from ident.compatibility.result import CheckResult, Compatibility, CompatibilitySettings, Reconstruction, SensorEstimate, SensorFinding
from ident.compatibility.signals import Signals
from ident.compatibility.six_degrees.biases import bias_estimates, bias_findings
from ident.compatibility.six_degrees.channels import BEYOND, ready, recorded, relations
from ident.compatibility.six_degrees.findings import by_itself, drift_of, estimates_and_findings, late
from ident.compatibility.six_degrees.fitting import fit
from ident.compatibility.six_degrees.level_wings import LEVEL
from ident.compatibility.six_degrees.search import Searched, search
from ident.compatibility.six_degrees.selection import clocks
from ident.compatibility.six_degrees.unknowns import faults_of
from sim.record import Record

STEADY_WIND = "a steady wind along the ground leaves no trace: no channel is measured against the ground"


def channels_of(records: Sequence[Record]) -> tuple[str, ...]:
    """Channels that the kinematics of six degrees of freedom know and all records have."""
    all_of = [recorded(record) for record in records]
    return tuple(name for name in all_of[0] if all(name in names for names in all_of[1:]))


def has_six_degrees(records: Sequence[Record], settings: CompatibilitySettings) -> bool:
    """Whether some relation closes that longitudinal motion does not have: of sideslip, bank, heading or height."""
    channels = channels_of(records)
    return any(name in BEYOND for name in relations(channels, speed=settings.airspeed is not None or "airspeed" in channels))


def check(records: Sequence[Record], settings: CompatibilitySettings, *, each: bool) -> Compatibility:
    """As ``ident.compatibility.check.compatibility``, for records of which ``has_six_degrees`` says so."""
    channels = channels_of(records)
    known_speed = settings.airspeed is not None or "airspeed" in channels
    joined = relations(channels, speed=known_speed)
    made = [ready(record, channels, settings.airspeed, settings.gravity, settings.vane_arm) for record in records]
    signals, notes = tuple(s for s, _ in made), [note for _, told in made for note in told]
    controls = [instruments_of(record, every=2) for record in records]
    if all(columns.shape[1] for columns in controls):
        signals = tuple(replace(s, instruments=columns) for s, columns in zip(signals, controls, strict=True))
    for s in signals:
        notes += [f"{count} isolated wrong sample{'s' * (count > 1)} of {name} in {s.name} set aside" for name, count in s.spikes.items() if count]
    if not known_speed:
        notes.append(
            "neither a recorded nor a given airspeed: the relations of alpha and beta cannot be used; record it, or name a vehicle file that has it"
        )
    if "phi" not in channels:
        notes.append(LEVEL)
    together = len(signals) > 1
    base = fit(signals)
    faults = faults_of(signals[0], settings.chord)
    found = search(signals, base, faults, settings)
    estimates, findings = estimates_and_findings(found)
    final = found.lines.found
    names = tuple(s.name for s in signals)
    biases = [bias_estimates(final, r) for r in range(len(signals))]
    noise = final.noise
    # An output that is integrated elsewhere has its own white noise here.
    levels = dict(zip((*noise.inputs, *noise.outputs), np.sqrt([*noise.density, *noise.white]).tolist(), strict=True))
    if together:
        joint = CheckResult(names, estimates, (), findings, levels)
        single = tuple(
            CheckResult((names[r],), by_itself(found, r), biases[r], _of_one(found, r, biases[r], settings.false_alarm, len(signals)), levels)
            for r in (range(len(signals)) if each else ())
        )
    else:
        joint = CheckResult(names, estimates, biases[0], (*bias_findings(found.lines, 0, biases[0], settings.false_alarm), *findings), levels)
        single = (joint,)
    notes += _notes(found, signals)
    told = (*_unreached(channels, joined), *_untold(found, signals[0]), STEADY_WIND)
    return Compatibility(channels, joined, joint, single, _reconstructions(base, final), told, tuple(notes))


def _of_one(found: Searched, r: int, biases: Sequence[SensorEstimate], false_alarm: float, count: int) -> tuple[SensorFinding, ...]:
    """Biases and the drift of one record of several."""
    drift = drift_of(found, r, false_alarm / count)
    drifts = {finding.name for finding in drift}
    return (*(bias for bias in bias_findings(found.lines, r, biases, false_alarm) if not drifts.intersection(bias.group)), *drift)


def _notes(found: Searched, signals: Sequence[Signals]) -> list[str]:
    out = []
    if found.early is not None:
        channel, ahead = found.early
        out.append(
            f"{channel} recorded {-1000.0 * ahead:.0f} ms before it happens would explain more than any sensor fault: something acts that the "
            "kinematics do not know, a gust on vane and load most likely, so that nothing more stands"
        )
    behind = late([found.lines.faults[i] for i in found.standing])
    on_time = [name for name in clocks(tuple(signals[0].channels)) if name not in behind]
    if behind & set(clocks(tuple(signals[0].channels))) and on_time:
        out.append(f"times count from {', '.join(on_time)}, which agree: what all channels are late by against the inputs, kinematics cannot see")
    return out


def _untold(found: Searched, s: Signals) -> tuple[str, ...]:
    faults = (*found.lines.faults, *found.lines.biases)
    size = np.array([fault.plausible for fault in faults])
    several = [name for name in (PACKAGE, BOOM) if _has_fault(name, faults)]
    channels = (*s.channels, *several, "wind")
    return untold(found.lines.free * np.outer(size, size), faults, [name for name in channels if _has_fault(name, faults)])


def _has_fault(name: str, faults: Sequence[SensorFault]) -> bool:
    return any(fault.channel == name for fault in faults)


def _unreached(channels: Sequence[str], joined: dict[str, tuple[str, ...]]) -> tuple[str, ...]:
    reached = {name for names in joined.values() for name in names}
    return tuple(f"{name}: nothing can be told, no relation that these channels close has it" for name in channels if name not in reached)


def _reconstructions(base: Fit, final: Fit) -> tuple[Reconstruction, ...]:
    out = []
    for s, plain, y, residual in zip(final.signals, base.outputs, final.outputs, final.residuals, strict=True):
        smooth = y + smoothed_walk(s, final.noise, residual)
        rows = list(enumerate(s.outputs))
        measured = {name: s.channels[name] for name in s.outputs}
        shown = [{name: values[i] for i, name in rows} for values in (plain, y, smooth, s.valid)]
        out.append(Reconstruction(s.name, s.time, measured, *shown))
    return tuple(out)
