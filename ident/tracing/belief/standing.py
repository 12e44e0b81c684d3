"""Whether a claim stands as it is printed: its own numbers determined and believable, the derivatives beside it not ruined."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from ident.tracing import thresholds
from ident.tracing.belief.derivatives import Wreck, wrecked
from ident.tracing.belief.static_totals import told_totals
from ident.tracing.belief.together import one_cause
from ident.tracing.candidate_model.fitted_model import FittedModel
from ident.tracing.candidate_model.quantities import implausible
from ident.tracing.diagnosis import Caution, Concern, Quantity, Requirement
from sim.declaration.effect import full_name
from sim.declaration.proposal import RESOLVED, Edged, Traceable


def undetermined(effect: Traceable, found: Mapping[str, Quantity]) -> list[str]:
    """Parameters of one sign (a time, a length, a frequency, a factor) whose sigma exceeds their value, others whose sigma exceeds their range.

    What a claim need not know is left out. Whether those of either sign stand off their absence is asked wherever an effect is accepted.
    """
    ranges = {name: effect.traits.plausible[name] for name in found if name in effect.traits.plausible and name not in effect.traits.loose}
    widest = {name: abs(found[name].value) if low >= 0.0 else high - low for name, (low, high) in ranges.items()}
    return [name for name, most in widest.items() if found[name].std >= most]


def too_fast(effect: Traceable, found: Mapping[str, Quantity], interval: float) -> list[str]:
    """Frequencies, rad/s, above four fifths of the sampling limit of records with ``interval`` seconds between samples."""
    limit = thresholds.AT_A_BOUND * RESOLVED * math.pi / interval
    return [name for name in effect.traits.oscillates if name in found and found[name].value > limit]


def in_a_gap(effect: Traceable, found: Mapping[str, Quantity], fitted: FittedModel) -> tuple[float, float] | None:
    """Begin and end (s) of missing rows in which an event begins, to three samples; None where it begins in none.

    What the inputs did there is not known, and an event can stand for it.
    """
    onset = effect.traits.onset
    if onset not in found:
        return None
    for problem in fitted.fit.layout.problems:
        time = problem.record.time
        steps = np.diff(time)
        near = thresholds.EDGE_OF_A_GAP * float(np.median(steps))
        for i in np.flatnonzero(steps > thresholds.GAP * float(np.median(steps))):
            if time[i] - near <= found[onset].value <= time[i + 1] + near:
                return float(time[i]), float(time[i + 1])
    return None


def in_lost_rows(effect: Traceable, found: Mapping[str, Quantity], fitted: FittedModel) -> float:
    """Seconds of the motion that a jump of the only output makes good, where it goes that way by several samples; zero elsewhere.

    Rows that a recorder lost do as much; other outputs would go on from elsewhere at once.
    """
    problems = fitted.fit.layout.problems
    if not effect.traits.jumps or fitted.system.output_names != (effect.traits.jumps,):
        return 0.0
    at, size = found[effect.traits.onset].value, found["size"].value
    for problem in problems:
        time, values = problem.record.time, problem.record[effect.traits.jumps].values
        before = np.flatnonzero((time < at) & np.isfinite(values))[-thresholds.ROWS_BEFORE :]
        if len(before) < thresholds.ROWS_BEFORE or at > time[-1]:
            continue
        rate = float(np.polyfit(time[before] - at, values[before], 1)[0])
        lost = size / rate if rate else 0.0
        if lost >= thresholds.GAP * float(np.median(np.diff(time))):
            return lost
    return 0.0


def with_the_control(effect: Traceable, found: Mapping[str, Quantity], fitted: FittedModel) -> str:
    """Name of a recorded input that goes most of its way just where an event with edges begins and where it ends; empty elsewhere.

    To two samples and two sigmas, in the record of the event. What acts just while a control is held is the control, which does there what the
    model does not know: it stops, counting from a trim of its own.
    """
    onset, lasts = effect.traits.onset, effect.traits.lasts
    if not isinstance(effect, Edged) or onset not in found or lasts not in found:
        return ""
    begin, length = found[onset], found[lasts]
    ends = ((begin.value, begin.std), (begin.value + length.value, math.hypot(begin.std, length.std)))
    for problem, own in zip(fitted.fit.layout.problems, fitted.values.own, strict=True):
        if own.get(full_name(effect, onset), begin.value) != begin.value:
            continue
        time = problem.record.time
        interval = float(np.median(np.diff(time)))
        near = [interval * thresholds.AT_A_STEP + thresholds.BEYOND_ITS_SCATTER * std for _, std in ends]
        for channel in problem.record.inputs:
            moving = time[_moving(channel.values, max(1, round(thresholds.STEP_TAKES / interval)))]
            if moving.size and all(np.min(np.abs(moving - at)) <= within for (at, _), within in zip(ends, near, strict=True)):
                return channel.name
    return ""


def _moving(u: np.ndarray, samples: int) -> np.ndarray:
    """Where an input, ``(N,)``, goes half of its range or more within so many samples."""
    out = np.zeros(len(u), dtype=bool)
    for first in np.flatnonzero(np.abs(u[samples:] - u[:-samples]) > thresholds.STEPS * np.ptp(u)):
        out[first : first + samples + 1] = True
    return out


def why_not(effect: Traceable, found: Mapping[str, Quantity], fitted: FittedModel) -> Caution | None:
    """Why an effect with these parameters is not claimed; None where its own numbers allow it."""
    interval, gap = sampling_interval(fitted), in_a_gap(effect, found, fitted)
    if gap is not None:
        told = f"what fits best is {effect.name} where rows are missing ({gap[0]:g} to {gap[1]:g} s): an input that was not recorded does as much"
        words, names = f"the interval between samples where {effect.name} begins", (effect.name,)
        asked = Requirement(words, gap[1] - gap[0], thresholds.GAP * interval, at_least=False, unit="s", effects=names)
        return Caution(Concern.ROWS_MISSING, told, requirement=asked)
    lost = in_lost_rows(effect, found, fitted)
    if lost > 0.0:
        told = f"what fits best is {effect.name}, but it goes as far as the motion in {lost:.2g} s: rows that the recorder lost do as much"
        asked = Requirement("the motion that it makes good", lost, thresholds.GAP * interval, at_least=False, unit="s", effects=(effect.name,))
        return Caution(Concern.ROWS_MISSING, told, requirement=asked)
    lasts = found.get(effect.traits.lasts)
    if lasts is not None and lasts.value < thresholds.SHORTEST_EVENT * interval:
        told = f"what fits best is {effect.name} of {lasts.value:.2g} s, no longer than two samples: the recorder did that, and no force"
        return Caution(Concern.BEYOND_BELIEF, told, requirement=_long_enough(effect, lasts.value, interval))
    if lasts is not None and lasts.value - thresholds.BEYOND_ITS_SCATTER * lasts.std < thresholds.SHORTEST_EVENT * interval:
        told = f"what fits best is {effect.name} of {_number(lasts)}, which may be no longer than two samples: rows that the recorder lost do as much"
        shortest = lasts.value - thresholds.BEYOND_ITS_SCATTER * lasts.std
        return Caution(Concern.UNDETERMINED, told, requirement=_long_enough(effect, shortest, interval, " less two sigmas"))
    damping = found.get(effect.traits.dies_out)
    if damping is not None and damping.value <= thresholds.BEYOND_ITS_SCATTER * damping.std:
        told = f"what fits best is {effect.name}, which need not die out (damping {_number(damping)}): a load that swings all along does as much"
        sigmas = damping.value / damping.std if damping.std > 0.0 else 0.0
        words = f"the damping of {effect.name} over its standard deviation"
        asked = Requirement(words, sigmas, thresholds.BEYOND_ITS_SCATTER, at_least=True, effects=(effect.name,))
        return Caution(Concern.UNDETERMINED, told, requirement=asked)
    control = with_the_control(effect, found, fitted)
    if control:
        told = f"what fits best is {effect.name}, but it begins and ends with a step of the {control}: that control does it, and nothing from outside"
        return Caution(Concern.ONE_CAUSE, told, requirement=_apart_from_control(effect, found, fitted, control))
    beyond, open_, fast = implausible(effect, found, slack=0.0), undetermined(effect, found), too_fast(effect, found, interval)
    if beyond or fast:
        words = f"{' and '.join([*beyond, *(name for name in fast if name not in beyond)])} beyond belief"
        told = f"what fits best is {effect.name} with {words}: the cause is another"
        return Caution(Concern.BEYOND_BELIEF, told, requirement=_believable(effect, found, beyond, interval))
    if open_:
        told = ", ".join(f"{name} {_number(found[name])}" for name in open_)
        told = f"what fits best is {effect.name}, whose numbers the records do not determine ({told})"
        return Caution(Concern.UNDETERMINED, told, requirement=_determined(effect, found, open_[0]))
    return None


def _long_enough(effect: Traceable, length: float, interval: float, note: str = "") -> Requirement:
    """An event has to last longer than two samples."""
    asked = f"the length of {effect.name}{note}"
    return Requirement(asked, length, thresholds.SHORTEST_EVENT * interval, at_least=True, unit="s", effects=(effect.name,))


def _apart_from_control(effect: Traceable, found: Mapping[str, Quantity], fitted: FittedModel, control: str) -> Requirement:
    """An event has to begin away from every step of a control."""
    begin, interval, near = found[effect.traits.onset], sampling_interval(fitted), []
    for problem in fitted.fit.layout.problems:
        time, u = problem.record.time, problem.record[control].values
        moving = time[_moving(u, max(1, round(thresholds.STEP_TAKES / interval)))]
        near += [float(np.min(np.abs(moving - begin.value)))] if moving.size else []
    bar = interval * thresholds.AT_A_STEP + thresholds.BEYOND_ITS_SCATTER * begin.std
    asked = f"the time between the begin of {effect.name} and a step of the {control}"
    return Requirement(asked, min(near, default=0.0), bar, at_least=True, unit="s", effects=(effect.name,))


def _believable(effect: Traceable, found: Mapping[str, Quantity], beyond: Sequence[str], interval: float) -> Requirement:
    """A parameter has to lie in the range that is believed of it; a frequency below what the sampling resolves."""
    names = (effect.name,)
    if not beyond:
        name = too_fast(effect, found, interval)[0]
        limit = thresholds.AT_A_BOUND * RESOLVED * math.pi / interval
        return Requirement(f"the {name} of {effect.name}", found[name].value, limit, at_least=False, unit="rad/s", effects=names)
    low, high = effect.traits.plausible[beyond[0]]
    q = found[beyond[0]]
    short = q.value < low
    return Requirement(f"the {beyond[0]} of {effect.name}", q.value, low if short else high, at_least=short, unit=q.unit, effects=names)


def _determined(effect: Traceable, found: Mapping[str, Quantity], name: str) -> Requirement:
    """A parameter's standard deviation has to be below its value, or its range where it may have either sign."""
    low, high = effect.traits.plausible[name]
    most = abs(found[name].value) if low >= 0.0 else high - low
    asked = f"the standard deviation of the {name} of {effect.name}"
    return Requirement(asked, found[name].std, most, at_least=False, unit=found[name].unit, effects=(effect.name,))


def why_no_set(root: FittedModel, best: FittedModel) -> list[Caution]:
    """Cautions where a set of effects ruins derivatives that the declared model alone had."""
    wrecks = wrecked(root, best)
    kept = told_totals(best, [wreck.name for wreck in wrecks])
    told = f"with {' and '.join(best.names)}"
    out = [Caution(Concern.DERIVATIVES, f"{told} {_told(wreck)}", requirement=wreck.requirement) for wreck in wrecks]
    return [*out, *([Caution(Concern.DERIVATIVES, f"what does not change with it: {kept}")] if kept else [])]


def sampling_interval(fitted: FittedModel) -> float:
    """The longest of the records' mean sampling intervals, s."""
    times = [problem.record.time for problem in fitted.fit.layout.problems]
    return max(float(time[-1] - time[0]) / (len(time) - 1) for time in times)


def cautions_of(root: FittedModel, best: FittedModel, found: Sequence[tuple[Traceable, Mapping[str, Quantity]]]) -> list[Caution]:
    """All that speaks against printing effects of a set with these parameters; empty where they stand."""
    own = [why_not(effect, values, best) for effect, values in found]
    return [*(caution for caution in own if caution is not None), *why_no_set(root, best), *one_cause(best, found)]


def _number(q: Quantity) -> str:
    return f"{q.value:.3g} +- {q.std:.2g}{'' if q.unit in ('', '1') else f' {q.unit}'}"


def _told(wreck: Wreck) -> str:
    before, after = (f"{q.value:.3g} +- {q.std:.2g}" for q in (wreck.before, wreck.after))
    return f"{wreck.name} {wreck.why}: {before} without, {after} with"
