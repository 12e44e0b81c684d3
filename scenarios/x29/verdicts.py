"""Verdicts on a study: a sentence each with the measured value, its bound and the conclusion."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from scenarios.x29.estimating import SETTLED, Misfit, sensor_noise
from scenarios.x29.study import LoopStudy

# s: the loop's own response is taken from frame to frame, the recorded stick is held between 40 Hz
# samples
HALF_FRAME = 0.00625
FREQUENCY = 0.05  # tolerance, share of the frequency
DAMPING = 0.05  # tolerance of the damping ratio
DELAY = 0.015  # tolerance, s
DERIVATIVES = ("L_alpha", "M_alpha", "M_delta", "M_q")
SHARE = {False: 0.10, True: 0.20}  # of a derivative, without and with measurement noise
MOVED = 3.0  # sigmas that an accident of the record may move frequency and damping
STANDS_OUT = 1.5  # misfit inside a stretch over that elsewhere
PEAK_SAMPLES = 5  # samples that a peak is averaged over
LEAST_PEAK = 1.0  # percent: smaller peaks count as zero, also without noise


def verdicts(study: LoopStudy) -> tuple[str, ...]:
    """All verdicts on a study, in the order of its tables."""
    return tuple(
        sentence
        for part in (_equivalent, _against, _restarts, _peak, _stretch, _whiteness)
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
    verdict = f"beyond the bound: {_list(beyond)}" if beyond else "all within"
    yield (
        f"against the loop's own low-order equivalent: frequency {_percent(off['frequency'][0])} "
        f"(bound {_bound(FREQUENCY)}), "
        f"damping ratio {off['damping'][0]:+.3f} (bound {DAMPING:g}), delay "
        f"{1e3 * off['delay'][0]:+.1f} ms (bound {1e3 * DELAY:g} ms, "
        f"{1e3 * HALF_FRAME:.0f} ms of it the hold of the recorded stick), of "
        f"{', '.join(DERIVATIVES)} {largest} differs most, "
        f"{_percent(off[largest][0])} (bound {_bound(share)}): {verdict}"
    )


def _against(study: LoopStudy) -> Iterator[str]:
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
        verdict = f"{_list(beyond)} by more than {MOVED:g} sigmas"
        spectra = (
            ""
            if record is None
            else (
                f"; the record's spectra give a damping ratio of {record['damping_ratio']:.3f} "
                "without a filter"
            )
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
    if moved[at] < SETTLED:
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
    """Words on the variants with and without a property, joined by semicolons."""
    groups = (
        (yes, [shown[label] for label, is_so in off.items() if is_so]),
        (no, [shown[label] for label, is_so in off.items() if not is_so]),
    )
    return "; ".join(f"{word} with {_list(result)}" for word, result in groups if result)


def _signed(value: float) -> str:
    """Two decimals with a sign; a value that rounds to zero is positive."""
    return f"{round(value, 2) + 0.0:+.2f}"


def _percent(share: float) -> str:
    return f"{100.0 * share:+.1f} %"


def _bound(share: float) -> str:
    return f"{100.0 * share:g} %"


def _list(names: Sequence[str]) -> str:
    return ", ".join(names)
