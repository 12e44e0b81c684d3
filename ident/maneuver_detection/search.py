"""Search for maneuvers in a long record: controls, motion, excitation, trim points.

The acceleration of an axis is regressed on a constant and the regressors of its moment (Klein and
Morelli, Aircraft System Identification, 2nd ed., chapter 5),

    q_dot = c + M_alpha alpha + M_q q + M_de elevator,

and each derivative gets the absolute value of its estimate over its standard deviation. The t value
does not depend on the units of the regressors, and equals that of the non-dimensional derivative.
Residuals that are correlated in time carry less information: with rho the correlation of
neighbours, the variance is multiplied by (1 + rho) / (1 - rho).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d, uniform_filter1d

from ident.maneuver_detection.signals import (
    AXES,
    HALF_WAVE_EDGE_SHARE,
    Activity,
    DetectedManeuver,
    EvenSegment,
    FlightSignals,
    Lobe,
    Shape,
    activity_of,
    lobes_of,
    oscillation_of,
    same_lines,
    step_shapes,
    stretches,
    trim_of,
)

# ---- How well a maneuver determines each derivative

# Axis -> what is differentiated, and derivative -> its regressor; a regressor that is not recorded
# is left out.
EQUATIONS: Mapping[str, tuple[str, Mapping[str, str]]] = {
    "pitch": ("q", {"Cm_alpha": "alpha", "Cm_q": "q", "Cm_de": "elevator"}),
    "roll": (
        "p",
        {"Cl_beta": "beta", "Cl_p": "p", "Cl_r": "r", "Cl_da": "aileron", "Cl_dr": "rudder"},
    ),
    "yaw": (
        "r",
        {"Cn_beta": "beta", "Cn_p": "p", "Cn_r": "r", "Cn_da": "aileron", "Cn_dr": "rudder"},
    ),
    "throttle": ("airspeed", {"X_V": "airspeed", "X_thrust": "thrust"}),
}
# The same by the control, of models with dimensional derivatives: low-order equivalent, multirotor.
DIMENSIONAL: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "pitch": {
        "stick": {"M_alpha": "alpha", "M_q": "q", "M_delta": "stick"},
        "pitch_command": {"M_q": "q", "M_lon": "pitch_command"},
    },
    "roll": {"roll_command": {"L_p": "p", "L_lat": "roll_command"}},
    "yaw": {"yaw_command": {"N_r": "r", "N_ped": "yaw_command"}},
}
TIME_BEFORE_INPUT = 1.0  # s before the input that belong to a maneuver
TIME_AFTER_INPUT = 4.0  # s after the input, in which the response goes on
AVERAGING_TIME = 0.1  # s, over which samples are averaged; a twentieth of a shorter maneuver
FEWEST_AVERAGES_PER_PARAMETER = 3.0
LARGEST_CORRECTED_CORRELATION = 0.95  # largest correlation of neighbours that is corrected for
LARGEST_T_VALUE = 1000.0  # records without noise have no other limit


def excitation_of(stretch: EvenSegment, start: float, end: float, axis: str) -> dict[str, float]:
    """Derivative -> absolute t value from the rows about a maneuver from ``start`` to ``end``, s,
    of an axis of ``EQUATIONS``; empty where what is needed is not recorded.
    """
    output, regressors = EQUATIONS[axis]
    rows = stretch.rows(start - TIME_BEFORE_INPUT, end + TIME_AFTER_INPUT)
    signals = {**stretch.inputs, **stretch.outputs}
    if output not in signals:
        return {}
    for control, dimensional in DIMENSIONAL.get(axis, {}).items():
        if control in signals:
            regressors = dimensional
    length = end - start + TIME_BEFORE_INPUT + TIME_AFTER_INPUT
    block = max(1, round(min(AVERAGING_TIME, length / 60.0) / stretch.step))
    averaged = {
        name: values
        for name, channel in regressors.items()
        if channel in signals
        and (values := _averaged(signals[channel][rows], block)).size
        and np.ptp(values) > 0.0
    }
    measured = _averaged(signals[output][rows], block)
    if measured.size < FEWEST_AVERAGES_PER_PARAMETER * (len(averaged) + 1) or not averaged:
        return {}
    acceleration = np.gradient(measured, block * stretch.step)
    centred = np.column_stack([values - values.mean() for values in averaged.values()])
    scaled = centred / np.sqrt(np.sum(centred**2, axis=0))
    wanted = acceleration - acceleration.mean()
    estimate, _, rank, _ = np.linalg.lstsq(scaled, wanted, rcond=1e-10)
    if rank < scaled.shape[1]:
        return {}
    residual = wanted - scaled @ estimate
    power = float(residual @ residual)
    rho = (
        float(np.clip(residual[1:] @ residual[:-1] / power, 0.0, LARGEST_CORRECTED_CORRELATION))
        if power > 0.0
        else 0.0
    )
    variance = power / (measured.size - len(averaged) - 1) * (1.0 + rho) / (1.0 - rho)
    sigma = np.sqrt(np.maximum(variance * np.diag(np.linalg.inv(scaled.T @ scaled)), 0.0))
    t = np.minimum(np.abs(estimate), LARGEST_T_VALUE * sigma) / np.where(sigma > 0.0, sigma, 1.0)
    return {
        name: float(value) if s > 0.0 else LARGEST_T_VALUE
        for name, value, s in zip(averaged, t, sigma, strict=True)
    }


def _averaged(values: np.ndarray, block: int) -> np.ndarray:
    """Return the means of successive blocks of samples."""
    count = values.size // block
    return values[: count * block].reshape(count, block).mean(axis=1)


# ---- Turns, pull-ups and trim points, from the motion of the aircraft

LEAST_TURN_BANK = math.radians(12.0)  # a smaller one is no turn
TURN_EDGE_SHARE = 0.25  # bank at which a turn begins and ends, relative to its largest
HELD_BANK_TIME = 8.0  # s, for which the bank is held to a fifth of itself
LEAST_HELD_SHARE = 0.5  # smallest share of a turn with constant bank
PULL_UP_LOAD = 0.25  # g about that of the bank, which a pull-up exceeds
PULL_UP_TIME = 1.2  # s, for which half of it lasts
MOTION_AVERAGING_TIME = 0.5  # s, over which motion is averaged
SHORTEST_TRIM = 10.0  # s, of the shortest trim point
# Largest spread of 1 s averages within SHORTEST_TRIM in a trim point; of the airspeed as a share
TRIM_SPREAD = {
    "airspeed": 0.025,
    "height": 8.0,
    "altitude": 8.0,
    "theta": math.radians(1.5),
    "phi": math.radians(4.0),
}


def turns(stretch: EvenSegment) -> list[DetectedManeuver]:
    """Parts in which the bank is held."""
    if "phi" not in stretch.outputs:
        return []
    averaged = stretch.samples(MOTION_AVERAGING_TIME)
    bank = uniform_filter1d(stretch.outputs["phi"], averaged, mode="nearest")
    out = []
    for lobe in lobes_of(bank, LEAST_TURN_BANK, join=False):
        middle = float(np.median(bank[lobe.first : lobe.last]))
        held = np.abs(bank - middle) < 0.2 * abs(middle)
        if np.count_nonzero(held[lobe.first : lobe.last]) * stretch.step < HELD_BANK_TIME:
            continue
        first, last = _to_level(
            bank * math.copysign(1.0, middle), lobe, TURN_EDGE_SHARE * abs(middle)
        )
        held_time = np.count_nonzero(held[first:last]) * stretch.step
        if held_time > LEAST_HELD_SHARE * (last - first) * stretch.step:
            out.append(_detected(stretch, Shape("turn", first, last, abs(middle)), "roll", "phi"))
    return out


def _detected(stretch: EvenSegment, shape: Shape, axis: str, channel: str = "") -> DetectedManeuver:
    """Return the maneuver with the shape of an input, of a bank angle or of a quiet part."""
    start, end = (
        float(stretch.time[min(k, stretch.time.size - 1)]) for k in (shape.first, shape.last)
    )
    return DetectedManeuver(start, end, axis, shape.kind, channel, shape.amplitude)


def _to_level(signal: np.ndarray, lobe: Lobe, level: float) -> tuple[int, int]:
    """Return the samples before and after a positive lobe at which the signal is below ``level``;
    the ends of the signal where it never is.
    """
    before = np.flatnonzero(signal[: lobe.first] < level)
    after = np.flatnonzero(signal[lobe.last :] < level)
    return int(before[-1]) if before.size else 0, lobe.last + int(
        after[0]
    ) if after.size else signal.size - 1


def pulls(stretch: EvenSegment) -> list[tuple[int, int]]:
    """Parts in which the load factor stays away from that of the bank: first sample, and the one
    after the last.
    """
    if "nz" not in stretch.outputs:
        return []
    steady = 1.0
    if "phi" in stretch.outputs:
        steady = 1.0 / np.maximum(np.cos(stretch.outputs["phi"]), 0.2)
    averaged = stretch.samples(MOTION_AVERAGING_TIME)
    excess = uniform_filter1d(stretch.outputs["nz"] - steady, averaged, mode="nearest")
    excess = excess - trim_of(stretch, excess)
    out = []
    for lobe in lobes_of(excess, PULL_UP_LOAD, join=False):
        inside = np.abs(excess[lobe.first : lobe.last])
        if np.count_nonzero(inside > 0.5 * inside.max()) * stretch.step >= PULL_UP_TIME:
            out.append((lobe.first, lobe.last))
    return out


def trim_points(
    stretch: EvenSegment, quiet: np.ndarray, controls: Mapping[str, np.ndarray]
) -> list[DetectedManeuver]:
    """Parts of at least ``SHORTEST_TRIM`` in which the inputs are quiet (``(N,)``) and speed,
    height, attitude and controls are constant.

    ``controls`` : by how much the averages over 1 s of each may change meanwhile, ``(N,)``, in its
    unit.
    """
    size = stretch.samples(SHORTEST_TRIM)
    steady = quiet.copy()
    spreads: dict[str, float | np.ndarray] = {
        name: spread for name, spread in TRIM_SPREAD.items() if name in stretch.outputs
    }
    for name, spread in (*spreads.items(), *controls.items()):
        values = (stretch.inputs if name in controls else stretch.outputs)[name]
        smooth = uniform_filter1d(values, stretch.samples(1.0), mode="nearest")
        allowed = spread * np.abs(smooth) if name == "airspeed" else spread
        around = maximum_filter1d(smooth, size, mode="nearest") - minimum_filter1d(
            smooth, size, mode="nearest"
        )
        steady &= around <= allowed
    # Each steady sample is the middle of a steady window; between two of them it stays steady.
    out: list[DetectedManeuver] = []
    for first, last in _runs(steady):
        low, high = max(0, first - size // 2), min(quiet.size, last + size // 2)
        while low < first and not quiet[low:first].all():
            low += 1 + int(np.flatnonzero(~quiet[low:first])[-1])
        not_quiet = np.flatnonzero(~quiet[last:high])
        high = last + int(not_quiet[0]) if not_quiet.size else high
        if (high - low) * stretch.step >= SHORTEST_TRIM:
            if out and stretch.time[low] <= out[-1].end:
                low = int(np.searchsorted(stretch.time, out.pop().start))
            out.append(_detected(stretch, Shape("trim", low, high - 1, 0.0), ALL_AXES))
    return out


def _runs(mask: np.ndarray) -> np.ndarray:
    """Return the first sample of each run of True, and the one after the last, ``(K, 2)``."""
    return np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)


def mean_conditions(stretch: EvenSegment, start: float, end: float) -> dict[str, float]:
    """Return the mean airspeed and height between two times, of what is recorded."""
    rows = stretch.rows(start, end)
    conditions = {"airspeed": "airspeed", "altitude": "height", "height": "height"}
    return {
        condition: float(np.mean(stretch.outputs[name][rows]))
        for name, condition in conditions.items()
        if name in stretch.outputs
    }


# ---- The search

ACTIVE_RATIO = 4.0  # multiple of the rest level at which an active part begins
ACTIVE_EDGE_RATIO = 2.0  # multiple of the rest level down to which it extends
QUIET_TIME = 1.5  # s below ACTIVE_EDGE_RATIO that part two active parts
REST_MARGIN = 2.0  # s of rest with which an active part is looked at
FEWEST_PULSES_IN_WEAK_OSCILLATION = 2  # pulses within a weak oscillation from which it is accepted
LEAST_WEAK_STRENGTH = 3.0  # smallest strength of such an oscillation
EXPLAINED_ENERGY_SHARE = 0.5  # smallest share of an oscillation's energy that levels explain
REST_AROUND_PATTERN = 1.5  # s about a pattern of levels in which there is no smaller one
RECOVERY_TIME = 8.0  # s after another maneuver in which the pilot recovers and pulls up nothing
LARGEST_PULL_UP_SHARPNESS = 0.45  # of an input that changes the load factor by a pull-up
TURN_EDGE_TIME = 8.0  # s about both ends of a turn in which roll and yaw inputs belong to it
# rate that a damper feeds back, where taking it off was measured to help
DAMPED_RATES = {"yaw": "r"}
LEAST_DAMPER_SHARE = 0.3  # share of a control's motion at rest that its damper must explain
# Ratio of the rises of two controls above their rest levels, from which on the smaller follows the
# larger. Of 40 simulated flights it changes nothing; without it three reactions of ATTAS and of a
# quadrotor are called doublets and pulses.
LEADING_RISE_RATIO = 2.0
# of a control's range, that its 1 s averages may change in a trim point; or twice ACTIVE_RATIO
TRIM_CONTROL_SHARE = 0.1
ALL_AXES = "all"  # axis of a trim point
# Least strength, flatness, edge and sharpness of each kind, chosen on the flights 0 to 19 of
# tests/long_flights.
ACCEPTANCE_LIMITS: Mapping[str, tuple[float, float, float, float]] = {
    "step": (3.5, 0.6, 5.5, 0.6),
    "pulse": (8.0, 0.75, 7.0, 0.5),
    "doublet": (6.0, 0.7, 5.5, 0.2),
    "3-2-1-1": (5.5, 0.7, 5.5, 0.2),
    "multistep": (7.5, 0.7, 6.0, 0.4),
    "sweep": (4.8, 0.65, 0.0, 0.0),
    "multisine": (5.0, 0.0, 0.0, 0.0),
    "pull-up": (9.0, 0.0, 0.0, 0.0),
}
_ALL_ROWS = slice(None)
OSCILLATIONS = ("sweep", "multisine")
ALTERNATING = ("doublet", "3-2-1-1", "multistep", *OSCILLATIONS)


@dataclass(frozen=True)
class ManeuverCandidate:
    """A shape that a control takes; ``strength``: its size over the control's rest level."""

    channel: str
    shape: Shape
    strength: float

    @property
    def axis(self) -> str:
        return AXES[self.channel]


def find_maneuvers(signals: FlightSignals) -> tuple[DetectedManeuver, ...]:
    """Return all maneuvers and trim points of a record, in the order of their times.

    Each control is searched for level changes that make a pattern and for oscillations that rise
    above its local rest level; the motion for bank angles and load factors that are held. Of
    controls that move at the same time the strongest counts, others follow it.
    """
    result = [each for stretch in stretches(signals) for each in _maneuvers_of(stretch)]
    return tuple(sorted(result, key=lambda each: (each.start, each.axis)))


def active_share(signals: FlightSignals) -> float:
    """Return the share of a record's time in which some control moves beyond its rest level; zero
    where it has none.
    """
    moving, total = 0, 0
    for stretch in stretches(signals):
        active = np.zeros(stretch.time.size, dtype=bool)
        for values in stretch.inputs.values():
            activity = activity_of(stretch, values)
            for first, last in active_parts(_ratio(activity), stretch.samples(QUIET_TIME)):
                active[first:last] = True
        moving, total = moving + int(np.count_nonzero(active)), total + active.size
    return moving / total if total else 0.0


def without_feedback(stretch: EvenSegment, name: str) -> np.ndarray:
    """Return a control without what a damper adds to it: its share of the angular rate, as the
    samples at rest show it.

    The control comes back as it is where the rate explains less than ``LEAST_DAMPER_SHARE`` of its
    motion at rest.
    """
    values, rate = stretch.inputs[name], DAMPED_RATES.get(AXES[name], "")
    if rate not in stretch.outputs:
        return values
    activity = activity_of(stretch, values)
    turning = stretch.outputs[rate] - trim_of(stretch, stretch.outputs[rate])
    rest = _ratio(activity) <= ACTIVE_EDGE_RATIO
    moved, turned = activity.deviation[rest], turning[rest]
    own, power, common = float(moved @ moved), float(turned @ turned), float(moved @ turned)
    if power <= 0.0 or common**2 < LEAST_DAMPER_SHARE * power * own:
        return values
    return values - common / power * turning


def _maneuvers_of(stretch: EvenSegment) -> list[DetectedManeuver]:
    inputs = {name: without_feedback(stretch, name) for name in stretch.inputs}
    stretch = replace(stretch, inputs=inputs)
    activities = {name: activity_of(stretch, values) for name, values in stretch.inputs.items()}
    candidates = [
        each
        for name, activity in activities.items()
        for each in candidates_of(stretch, name, activity)
    ]
    turning = turns(stretch)
    candidates = with_pulls(stretch, activities, candidates)
    candidates = [each for each in candidates if not _rolls_into(stretch, each, turning)]
    candidates = without_reactions(activities, candidates)
    maneuvers = [
        *(_detected(stretch, each.shape, each.axis, each.channel) for each in candidates),
        *turning,
    ]
    # A slow ramp of a control is no deviation from the running trim, and no trim point either.
    steady = {
        name: np.maximum(
            TRIM_CONTROL_SHARE * float(np.ptp(stretch.inputs[name])), 2.0 * ACTIVE_RATIO * each.rest
        )
        for name, each in activities.items()
    }
    trims = trim_points(stretch, _quiet(stretch, activities, maneuvers), steady)
    return [
        replace(
            each,
            conditions=mean_conditions(stretch, each.start, each.end),
            excitation={}
            if each.axis == ALL_AXES
            else excitation_of(stretch, each.start, each.end, each.axis),
        )
        for each in (*maneuvers, *trims)
    ]


def _ratio(activity: Activity, rows: slice = _ALL_ROWS) -> np.ndarray:
    """Energy over rest level of some rows, zero where both are."""
    energy, rest = activity.energy[rows], activity.rest[rows]
    return np.divide(energy, rest, out=np.zeros_like(energy), where=rest > 0.0)


def _quiet(
    stretch: EvenSegment, activities: Mapping[str, Activity], maneuvers: Sequence[DetectedManeuver]
) -> np.ndarray:
    """Samples at which no control moves beyond its rest level and no maneuver is flown."""
    quiet = np.ones(stretch.time.size, dtype=bool)
    for activity in activities.values():
        quiet &= _ratio(activity) <= ACTIVE_RATIO
    for each in maneuvers:
        quiet[stretch.rows(each.start, each.end)] = False
    return quiet


def accepted(each: ManeuverCandidate) -> bool:
    """Return whether a candidate exceeds what a pilot does between maneuvers."""
    shape = each.shape
    values = (each.strength, shape.flatness, shape.edge, shape.sharpness)
    limits = ACCEPTANCE_LIMITS[shape.kind]
    return all(value >= limit for value, limit in zip(values, limits, strict=True))


def candidates_of(stretch: EvenSegment, name: str, activity: Activity) -> list[ManeuverCandidate]:
    """Patterns of levels and oscillations of a control that are strong enough, none overlapping
    another.
    """
    if not np.any(activity.rest > 0.0):
        return []
    values = stretch.inputs[name]
    patterns = (
        _candidate(name, shape, activity)
        for shape in step_shapes(stretch, values, values - activity.deviation)
    )
    result = _from_rest(filter(accepted, patterns), stretch.samples(REST_AROUND_PATTERN))
    ratio, margin = _ratio(activity), stretch.samples(REST_MARGIN)
    for first, last in active_parts(ratio, stretch.samples(QUIET_TIME)):
        low, high = max(0, first - margin), min(ratio.size, last + margin)
        wave = oscillation_of(activity.deviation[low:high])
        if wave is None:
            continue
        wave = replace(wave, first=wave.first + low, last=wave.last + low)
        inside = [each for each in result if each.shape.first < last and first < each.shape.last]
        explained = max((_energy(activity, each.shape) for each in inside), default=0.0)
        whole = ManeuverCandidate(name, wave, float(np.median(ratio[wave.first : wave.last])))
        many = (
            len(inside) >= FEWEST_PULSES_IN_WEAK_OSCILLATION
            and whole.strength >= LEAST_WEAK_STRENGTH
        )
        if explained < EXPLAINED_ENERGY_SHARE * _energy(activity, wave) and (
            accepted(whole) or many
        ):
            result = [*(each for each in result if each not in inside), whole]
    return result


def _candidate(name: str, shape: Shape, activity: Activity) -> ManeuverCandidate:
    return ManeuverCandidate(
        name, shape, shape.amplitude / float(np.mean(activity.rest[shape.first : shape.last]))
    )


def _energy(activity: Activity, shape: Shape) -> float:
    return float(np.sum(activity.deviation[shape.first : shape.last] ** 2))


def _from_rest(candidates: Iterable[ManeuverCandidate], rest: int) -> list[ManeuverCandidate]:
    """Return the candidates, largest first, without those within ``rest`` samples of a larger one
    of their control.
    """
    chosen: list[ManeuverCandidate] = []
    for each in sorted(
        candidates,
        key=lambda each: -each.strength * float(np.sqrt(each.shape.last - each.shape.first)),
    ):
        if not any(each.shape.overlaps(other.shape, rest) for other in chosen):
            chosen.append(each)
    return chosen


def active_parts(ratio: np.ndarray, quiet: int) -> list[tuple[int, int]]:
    """Runs above ``ACTIVE_EDGE_RATIO`` that reach ``ACTIVE_RATIO``; those with fewer than ``quiet``
    samples between them are one.
    """
    out: list[tuple[int, int]] = []
    for first, last in _runs(ratio > ACTIVE_EDGE_RATIO):
        if out and first - out[-1][1] < quiet:
            out[-1] = (out[-1][0], int(last))
        else:
            out.append((int(first), int(last)))
    return [(first, last) for first, last in out if ratio[first:last].max() >= ACTIVE_RATIO]


def _rolls_into(
    stretch: EvenSegment, each: ManeuverCandidate, turning: Sequence[DetectedManeuver]
) -> bool:
    """Return whether an input of roll or yaw belongs to the beginning or the end of a turn."""
    if each.axis not in ("roll", "yaw") or each.shape.kind in (*OSCILLATIONS, "3-2-1-1"):
        return False
    start = stretch.time[each.shape.first]
    end = stretch.time[min(each.shape.last, stretch.time.size - 1)]
    return any(
        abs(edge - 0.5 * (start + end)) < TURN_EDGE_TIME or start < edge < end
        for turn in turning
        for edge in (turn.start, turn.end)
    )


def with_pulls(
    stretch: EvenSegment, activities: Mapping[str, Activity], candidates: list[ManeuverCandidate]
) -> list[ManeuverCandidate]:
    """Return the candidates with pull-ups in the place of smooth inputs of the pitch control that
    change the load factor and hold it.
    """
    control = next((name for name in activities if AXES[name] == "pitch"), None)
    if control is None or not np.any(activities[control].rest > 0.0):
        return candidates
    activity, recovery = activities[control], stretch.samples(RECOVERY_TIME)
    for first, last in pulls(stretch):
        lobe = _pulling(stretch, activity, first, last)
        near = [
            c
            for c in candidates
            if c.axis == "pitch"
            and accepted(c)
            and c.shape.first < last
            and c.shape.last > first - recovery
        ]
        if lobe is None or any(
            c.shape.sharpness > LARGEST_PULL_UP_SHARPNESS or c.shape.kind in ALTERNATING
            for c in near
        ):
            continue
        amplitude = float(np.max(np.abs(activity.deviation[slice(*lobe)])))
        candidates = [
            c
            for c in candidates
            if c.axis != "pitch" or c.shape.last <= lobe[0] or c.shape.first >= last + recovery
        ]
        pull = _candidate(control, Shape("pull-up", *lobe, amplitude), activity)
        candidates += [pull] if accepted(pull) else []
    return candidates


def _pulling(
    stretch: EvenSegment, activity: Activity, first: int, last: int
) -> tuple[int, int] | None:
    """Return the lobe of a control that leads to an excursion of the load factor: the first strong
    one that begins at most 2 s before it.
    """
    before = max(0, first - stretch.samples(2.0))
    after = min(activity.deviation.size, last + stretch.samples(10.0))
    part = activity.deviation[before:after]
    amplitude = float(np.max(np.abs(part[: last - before])))
    lobes = [
        each
        for each in lobes_of(part, HALF_WAVE_EDGE_SHARE * amplitude)
        if each.size * stretch.step > 0.8 and before + each.first < last
    ]
    return (before + lobes[0].first, before + lobes[0].last) if lobes else None


def without_reactions(
    activities: Mapping[str, Activity], candidates: Sequence[ManeuverCandidate]
) -> list[ManeuverCandidate]:
    """Return the candidates without those that overlap a stronger one of another control;
    multisines of lines of their own stay.
    """
    chosen: list[ManeuverCandidate] = []
    for each in sorted(candidates, key=lambda each: -each.strength * each.shape.flatness):
        others = (other for other in chosen if other.channel != each.channel)
        if not _follows(activities, each) and all(
            _independent(activities, each, other)
            for other in others
            if other.shape.overlaps(each.shape)
        ):
            chosen.append(each)
    return chosen


def _follows(activities: Mapping[str, Activity], each: ManeuverCandidate) -> bool:
    """Return whether another control moves more than ``LEADING_RISE_RATIO`` times as far above its
    rest level meanwhile, be it without a form.
    """
    rows = slice(each.shape.first, each.shape.last)
    peaks = {
        name: float(np.max(_ratio(activity, rows)))
        for name, activity in activities.items()
        if AXES[name] != "throttle"
    }
    return each.channel in peaks and max(peaks.values()) > LEADING_RISE_RATIO * peaks[each.channel]


def _independent(
    activities: Mapping[str, Activity], one: ManeuverCandidate, other: ManeuverCandidate
) -> bool:
    if not (one.shape.kind in OSCILLATIONS and other.shape.kind in OSCILLATIONS):
        return False
    rows = slice(max(one.shape.first, other.shape.first), min(one.shape.last, other.shape.last))
    return not same_lines(
        activities[one.channel].deviation[rows], activities[other.channel].deviation[rows]
    )
