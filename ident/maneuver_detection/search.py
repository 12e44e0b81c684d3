"""Search for maneuvers in a long record, and how well each of them determines derivatives.

The acceleration of an axis is regressed on a constant and the regressors of its moment (Klein and
Morelli, Aircraft System Identification, 2nd ed., chapter 5),

    q_dot = c + M_alpha alpha + M_q q + M_de elevator,

and each derivative gets the absolute value of its estimate over its standard deviation. The t value
does not depend on the units of the regressors, and equals that of the non-dimensional derivative.
Residuals that are correlated in time carry less information: with rho the correlation of
neighbours, the variance is multiplied by (1 + rho) / (1 - rho).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.maneuver_detection.shapes import (
    ALL_AXES,
    HALF_WAVE_EDGE_SHARE,
    Shape,
    load_factor_excursions,
    lobes_of,
    maneuver_of,
    mean_conditions,
    oscillation_of,
    runs_of,
    same_lines,
    step_shapes,
    trim_points,
    turns,
)
from ident.maneuver_detection.signals import (
    AXES,
    Activity,
    DetectedManeuver,
    EvenSegment,
    FlightSignals,
    activity_of,
    stretches,
    trim_of,
)

ACTIVE_RATIO = 4.0  # smallest peak energy of an active part, relative to the rest level
ACTIVE_EDGE_RATIO = 2.0  # energy at which an active part begins and ends, relative to the same
QUIET_TIME = 1.5  # s, shortest time below ACTIVE_EDGE_RATIO between two active parts
REST_MARGIN = 2.0  # s, time of rest before and after an active part that is analysed with it
FEWEST_PULSES_IN_WEAK_OSCILLATION = 2  # with as many pulses, a weak oscillation is accepted
LEAST_WEAK_STRENGTH = 3.0  # smallest strength of such an oscillation
# share of the energy of an oscillation above which a pattern of levels explains it
EXPLAINED_ENERGY_SHARE = 0.5
REST_AROUND_PATTERN = 1.5  # s, time before and after a pattern without smaller patterns
RECOVERY_TIME = 8.0  # s, time after another maneuver without pull-ups: the pilot recovers
LARGEST_PULL_UP_SHARPNESS = 0.45  # largest sharpness of the input of a pull-up
TURN_EDGE_TIME = 8.0  # s: roll and yaw inputs this near to an end of a turn belong to the turn
# axis -> rate fed back by its damper, for axes in which removal of the feedback improves results
DAMPED_RATES = {"yaw": "r"}
# smallest share of the motion of a control at rest that its damper explains
LEAST_DAMPER_SHARE = 0.3
# Of two controls that rise above their rest levels, the smaller one follows the larger one from
# this ratio on. Without it, three reactions of ATTAS and of a quadrotor are taken for maneuvers.
LEADING_RISE_RATIO = 2.0
# largest change of the 1 s averages of a control in a trim point, relative to its range; twice
# ACTIVE_RATIO times the rest level is also allowed
TRIM_CONTROL_SHARE = 0.1
# Smallest strength, flatness, edge and sharpness of each kind, chosen on the flights 0 to 19 of
# tests/long_flights.py.
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
    """A shape of a control. ``strength`` is its amplitude or energy over the rest level of the
    control.
    """

    channel: str
    shape: Shape
    strength: float

    @property
    def axis(self) -> str:
        """Axis that the control moves."""
        return AXES[self.channel]


def find_maneuvers(signals: FlightSignals) -> tuple[DetectedManeuver, ...]:
    """Return all maneuvers and trim points of a record, in the order of their times.

    Each control is searched for patterns of level changes, and for oscillations above its local
    rest level. The motion is searched for held bank angles and load factors. If several controls
    move at the same time, only the strongest is reported, since the others follow it.
    """
    result = [each for stretch in stretches(signals) for each in _maneuvers_of(stretch)]
    return tuple(sorted(result, key=lambda each: (each.start, each.axis)))


def active_share(signals: FlightSignals) -> float:
    """Return the share of the time of a record in which some control moves beyond its rest level;
    zero without controls.
    """
    moving, total = 0, 0
    for stretch in stretches(signals):
        active = np.zeros(stretch.time.size, dtype=bool)
        for values in stretch.inputs.values():
            activity = activity_of(stretch, values)
            for first, last in active_parts(_energy_ratio(activity), stretch.samples(QUIET_TIME)):
                active[first:last] = True
        moving, total = moving + int(np.count_nonzero(active)), total + active.size
    return moving / total if total else 0.0


def without_feedback(stretch: EvenSegment, name: str) -> np.ndarray:
    """Return a control without the feedback of a damper: minus the angular rate times a factor that
    is fitted to the samples at rest.

    The control is returned unchanged if the rate explains less than ``LEAST_DAMPER_SHARE`` of its
    motion at rest.
    """
    values, rate = stretch.inputs[name], DAMPED_RATES.get(AXES[name], "")
    if rate not in stretch.outputs:
        return values
    activity = activity_of(stretch, values)
    turning = stretch.outputs[rate] - trim_of(stretch, stretch.outputs[rate])
    rest = _energy_ratio(activity) <= ACTIVE_EDGE_RATIO
    moved, turned = activity.deviation[rest], turning[rest]
    own, power, common = float(moved @ moved), float(turned @ turned), float(moved @ turned)
    if power <= 0.0 or common**2 < LEAST_DAMPER_SHARE * power * own:
        return values
    return values - common / power * turning


def _maneuvers_of(stretch: EvenSegment) -> list[DetectedManeuver]:
    """Return the maneuvers and trim points of a segment."""
    inputs = {name: without_feedback(stretch, name) for name in stretch.inputs}
    stretch = replace(stretch, inputs=inputs)
    activities = {name: activity_of(stretch, values) for name, values in stretch.inputs.items()}
    candidates = [
        each
        for name, activity in activities.items()
        for each in candidates_of(stretch, name, activity)
    ]
    turning = turns(stretch)
    candidates = with_pull_ups(stretch, activities, candidates)
    candidates = [each for each in candidates if not _belongs_to_turn(stretch, each, turning)]
    candidates = without_reactions(activities, candidates)
    maneuvers = [
        *(maneuver_of(stretch, each.shape, each.axis, each.channel) for each in candidates),
        *turning,
    ]
    # A slow ramp of a control does not deviate from the running trim, but it is no trim point.
    steady = {
        name: np.maximum(
            TRIM_CONTROL_SHARE * float(np.ptp(stretch.inputs[name])), 2.0 * ACTIVE_RATIO * each.rest
        )
        for name, each in activities.items()
    }
    trims = trim_points(stretch, _quiet_samples(stretch, activities, maneuvers), steady)
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


def _energy_ratio(activity: Activity, rows: slice = _ALL_ROWS) -> np.ndarray:
    """Return energy over rest level in some rows; zero where the rest level is zero."""
    energy, rest = activity.energy[rows], activity.rest[rows]
    return np.divide(energy, rest, out=np.zeros_like(energy), where=rest > 0.0)


def _quiet_samples(
    stretch: EvenSegment, activities: Mapping[str, Activity], maneuvers: Sequence[DetectedManeuver]
) -> np.ndarray:
    """Return a mask ``(N,)`` of samples at which no control moves and no maneuver is flown."""
    quiet = np.ones(stretch.time.size, dtype=bool)
    for activity in activities.values():
        quiet &= _energy_ratio(activity) <= ACTIVE_RATIO
    for each in maneuvers:
        quiet[stretch.rows(each.start, each.end)] = False
    return quiet


def is_accepted(each: ManeuverCandidate) -> bool:
    """Return whether a candidate exceeds the limits of its kind, and so the usual activity of a
    pilot between maneuvers.
    """
    shape = each.shape
    values = (each.strength, shape.flatness, shape.edge, shape.sharpness)
    limits = ACCEPTANCE_LIMITS[shape.kind]
    return all(value >= limit for value, limit in zip(values, limits, strict=True))


def candidates_of(stretch: EvenSegment, name: str, activity: Activity) -> list[ManeuverCandidate]:
    """Return the accepted patterns of levels and oscillations of a control, without overlap."""
    if not np.any(activity.rest > 0.0):
        return []
    values = stretch.inputs[name]
    patterns = (
        _candidate(name, shape, activity)
        for shape in step_shapes(stretch, values, values - activity.deviation)
    )
    result = _largest_without_overlap(
        filter(is_accepted, patterns), stretch.samples(REST_AROUND_PATTERN)
    )
    ratio, margin = _energy_ratio(activity), stretch.samples(REST_MARGIN)
    for first, last in active_parts(ratio, stretch.samples(QUIET_TIME)):
        low, high = max(0, first - margin), min(ratio.size, last + margin)
        wave = oscillation_of(activity.deviation[low:high])
        if wave is None:
            continue
        wave = replace(wave, first=wave.first + low, last=wave.last + low)
        inside = [each for each in result if each.shape.first < last and first < each.shape.last]
        explained = max((_energy(activity, each.shape) for each in inside), default=0.0)
        oscillation = ManeuverCandidate(name, wave, float(np.median(ratio[wave.first : wave.last])))
        has_pulses = (
            len(inside) >= FEWEST_PULSES_IN_WEAK_OSCILLATION
            and oscillation.strength >= LEAST_WEAK_STRENGTH
        )
        if explained < EXPLAINED_ENERGY_SHARE * _energy(activity, wave) and (
            is_accepted(oscillation) or has_pulses
        ):
            result = [*(each for each in result if each not in inside), oscillation]
    return result


def _candidate(name: str, shape: Shape, activity: Activity) -> ManeuverCandidate:
    """Return the candidate with a shape, whose strength is the amplitude over the rest level."""
    return ManeuverCandidate(
        name, shape, shape.amplitude / float(np.mean(activity.rest[shape.first : shape.last]))
    )


def _energy(activity: Activity, shape: Shape) -> float:
    """Return the sum of squared deviations of a control within a shape."""
    return float(np.sum(activity.deviation[shape.first : shape.last] ** 2))


def _largest_without_overlap(
    candidates: Iterable[ManeuverCandidate], rest: int
) -> list[ManeuverCandidate]:
    """Return the candidates, largest first, without those within ``rest`` samples of a larger."""
    chosen: list[ManeuverCandidate] = []
    for each in sorted(
        candidates,
        key=lambda each: -each.strength * float(np.sqrt(each.shape.last - each.shape.first)),
    ):
        if not any(each.shape.overlaps(other.shape, rest) for other in chosen):
            chosen.append(each)
    return chosen


def active_parts(ratio: np.ndarray, quiet: int) -> list[tuple[int, int]]:
    """Return the active parts, as first sample and the one after the last: runs above
    ``ACTIVE_EDGE_RATIO`` that reach ``ACTIVE_RATIO``. Runs with fewer than ``quiet`` samples
    between them are joined.
    """
    out: list[tuple[int, int]] = []
    for first, last in runs_of(ratio > ACTIVE_EDGE_RATIO):
        if out and first - out[-1][1] < quiet:
            out[-1] = (out[-1][0], int(last))
        else:
            out.append((int(first), int(last)))
    return [(first, last) for first, last in out if ratio[first:last].max() >= ACTIVE_RATIO]


def _belongs_to_turn(
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


def with_pull_ups(
    stretch: EvenSegment, activities: Mapping[str, Activity], candidates: list[ManeuverCandidate]
) -> list[ManeuverCandidate]:
    """Return the candidates, in which pull-ups replace smooth inputs of the pitch control that
    change the load factor for some time.
    """
    control = next((name for name in activities if AXES[name] == "pitch"), None)
    if control is None or not np.any(activities[control].rest > 0.0):
        return candidates
    activity, recovery = activities[control], stretch.samples(RECOVERY_TIME)
    for first, last in load_factor_excursions(stretch):
        lobe = _control_lobe(stretch, activity, first, last)
        near = [
            c
            for c in candidates
            if c.axis == "pitch"
            and is_accepted(c)
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
        candidates += [pull] if is_accepted(pull) else []
    return candidates


def _control_lobe(
    stretch: EvenSegment, activity: Activity, first: int, last: int
) -> tuple[int, int] | None:
    """Return the lobe of a control that causes an excursion of the load factor from sample
    ``first`` to ``last``: the first strong one that begins at most 2 s before it; None without one.
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
    """Return the candidates without those that overlap a stronger one of another control.
    Simultaneous oscillations with different spectral lines are kept.
    """
    chosen: list[ManeuverCandidate] = []
    for each in sorted(candidates, key=lambda each: -each.strength * each.shape.flatness):
        others = (other for other in chosen if other.channel != each.channel)
        if not _follows(activities, each) and all(
            _are_independent(activities, each, other)
            for other in others
            if other.shape.overlaps(each.shape)
        ):
            chosen.append(each)
    return chosen


def _follows(activities: Mapping[str, Activity], each: ManeuverCandidate) -> bool:
    """Return whether another control rises more than ``LEADING_RISE_RATIO`` times as far above its
    rest level at the same time, even if it has no accepted shape.
    """
    rows = slice(each.shape.first, each.shape.last)
    peaks = {
        name: float(np.max(_energy_ratio(activity, rows)))
        for name, activity in activities.items()
        if AXES[name] != "throttle"
    }
    return each.channel in peaks and max(peaks.values()) > LEADING_RISE_RATIO * peaks[each.channel]


def _are_independent(
    activities: Mapping[str, Activity], one: ManeuverCandidate, other: ManeuverCandidate
) -> bool:
    """Return whether two candidates are oscillations with different spectral lines."""
    if not (one.shape.kind in OSCILLATIONS and other.shape.kind in OSCILLATIONS):
        return False
    rows = slice(max(one.shape.first, other.shape.first), min(one.shape.last, other.shape.last))
    return not same_lines(*(activities[each.channel].deviation[rows] for each in (one, other)))


# ---- How well a maneuver determines each derivative

# axis -> signal whose rate is the left-hand side, and derivative -> its regressor
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
# axis -> control -> derivative -> regressor, for models with dimensional derivatives: low-order
# equivalent system and multirotor
DIMENSIONAL: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "pitch": {
        "stick": {"M_alpha": "alpha", "M_q": "q", "M_delta": "stick"},
        "pitch_command": {"M_q": "q", "M_lon": "pitch_command"},
    },
    "roll": {"roll_command": {"L_p": "p", "L_lat": "roll_command"}},
    "yaw": {"yaw_command": {"N_r": "r", "N_ped": "yaw_command"}},
}
TIME_BEFORE_INPUT = 1.0  # s, time before the input that is used
TIME_AFTER_INPUT = 4.0  # s, time after the input that is used, since the response continues
AVERAGING_TIME = 0.1  # s, longest block over which samples are averaged
FEWEST_AVERAGES_PER_PARAMETER = 3.0  # fewest averages for each unknown, constant included
LARGEST_CORRECTED_CORRELATION = 0.95  # largest correlation of neighbours in the correction
LARGEST_T_VALUE = 1000.0  # limit for records without noise


def excitation_of(stretch: EvenSegment, start: float, end: float, axis: str) -> dict[str, float]:
    """Return derivative -> absolute t value from a maneuver of an axis of ``EQUATIONS`` between the
    times ``start`` and ``end``, s; empty if the necessary signals are not recorded.
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
    correlation = residual[1:] @ residual[:-1] / power if power > 0.0 else 0.0
    rho = float(np.clip(correlation, 0.0, LARGEST_CORRECTED_CORRELATION))
    variance = power / (measured.size - len(averaged) - 1) * (1.0 + rho) / (1.0 - rho)
    sigma = np.sqrt(np.maximum(variance * np.diag(np.linalg.inv(scaled.T @ scaled)), 0.0))
    t = np.minimum(np.abs(estimate), LARGEST_T_VALUE * sigma) / np.where(sigma > 0.0, sigma, 1.0)
    return {
        name: float(value) if s > 0.0 else LARGEST_T_VALUE
        for name, value, s in zip(averaged, t, sigma, strict=True)
    }


def _averaged(values: np.ndarray, block: int) -> np.ndarray:
    """Return the means of successive blocks of ``block`` samples."""
    count = values.size // block
    return values[: count * block].reshape(count, block).mean(axis=1)
