"""Numbers of the records that a search starts from: spans, input sizes, peaks of the residual's
spectrum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.tracing.fitted_model import FittedModel
from sim.declaration.effect import AIRSPEEDS
from sim.declaration.proposal import SearchContext
from sim.record import Record

_SMOOTHED_BINS = 801  # width of the smoothing window of a spectrum, frequencies
_SLOWEST_UPDATE_RATE = 2.0  # Hz: slower updates are motion
_MOST_PEAKS = 3  # peaks of a residual spectrum that start a search


def search_context(fitted: FittedModel, predicted: Sequence[Record] = ()) -> SearchContext:
    """Return the common search context of a fitted model's records: the longest span, the largest
    inputs, the ranges of the fitted outputs.

    ``predicted`` : further records that the model must predict; their outputs widen the ranges. The
    outermost hundredth of their samples is left out, as it may hold spikes.
    """
    fit, layout = fitted.fit, fitted.fit.layout
    problems, lines = layout.problems, fit.lines
    records = [problem.record for problem in problems]
    longest = max(records, key=lambda record: record.time[-1] - record.time[0])
    peak: dict[str, float] = {}
    rate: dict[str, float] = {}
    states: dict[str, float] = {}
    flown: dict[str, tuple[float, float]] = {}
    for record in records:
        for channel in record.inputs:
            peak[channel.name] = max(
                peak.get(channel.name, 0.0), float(np.max(np.abs(channel.values)))
            )
            steps = np.abs(np.diff(channel.values)) / np.diff(record.time)
            rate[channel.name] = max(rate.get(channel.name, 0.0), float(steps.max()))
            low, high = flown.get(channel.name, (np.inf, -np.inf))
            flown[channel.name] = (
                min(low, float(channel.values.min())),
                max(high, float(channel.values.max())),
            )
    for names, rows in (
        (layout.system.state_names, [line.states for line in lines]),
        (layout.system.output_names, [line.y for line in lines]),
    ):
        for i, name in enumerate(names):
            low, high = min(float(r[i].min()) for r in rows), max(float(r[i].max()) for r in rows)
            flown.setdefault(name, (low, high))
            states.setdefault(name, max(abs(low), abs(high)))
    for record in predicted:
        for channel in record.channels:
            values = channel.values[channel.valid]
            edges = (0.0, 1.0) if channel.name in record.input_names else (0.005, 0.995)
            low, high = (float(v) for v in np.quantile(values, edges))
            if channel.name in flown:
                flown[channel.name] = (
                    min(low, flown[channel.name][0]),
                    max(high, flown[channel.name][1]),
                )
    return SearchContext(
        begin=float(longest.time[0]),
        end=float(longest.time[-1]),
        interval=float(np.median(np.diff(longest.time))),
        input_peak=peak,
        input_rate=rate,
        state_peak=states,
        flown=flown,
        residual_peaks=spectral_peaks(
            records,
            fit.residuals,
            [problem.valid for problem in problems],
            fit.variance,
        ),
        update_periods={
            name: update_period(
                [record.time for record in records],
                [line.y[i] for line in lines],
                [residuals[i] for residuals in fit.residuals],
            )
            for i, name in enumerate(layout.system.output_names)
        },
        airspeed=next(
            (
                fitted.model.parameters[name].value
                for name in AIRSPEEDS
                if name in fitted.model.parameters
            ),
            0.0,
        ),
        values=dict(
            zip(layout.system.parameters.names, layout.split(fit.theta, 0)[0].tolist(), strict=True)
        ),
    )


def update_period(
    times: Sequence[np.ndarray], predicted: Sequence[np.ndarray], residuals: Sequence[np.ndarray]
) -> float:
    """Return the period, s, at which an output is most likely held between updates.

    The delay of a held output is a sawtooth between zero and the period: its residual is minus the
    delay times the output's slope. The product of residual and slope has a line at the frequency of
    the updates.

    Parameters
    ----------
    times, predicted, residuals : of each record ``(N,)``, s and the output's unit.
    """
    from scipy.ndimage import uniform_filter1d

    interval = float(np.median(np.concatenate([np.diff(time) for time in times])))
    longest = max(len(time) for time in times)
    size = 8 * longest
    power = np.zeros(size // 2 + 1)
    for values, residual in zip(predicted, residuals, strict=True):
        product = residual * np.gradient(values)
        power += (
            np.abs(np.fft.rfft((product - product.mean()) * np.hanning(len(product)), size)) ** 2
        )
    frequency = np.fft.rfftfreq(size, interval)
    # The power of the maneuver falls with frequency; a line exceeds the power around it.
    around = uniform_filter1d(power, _SMOOTHED_BINS)
    inside = (frequency > _SLOWEST_UPDATE_RATE) & (frequency < 0.5 / interval)
    height = np.where(inside, power / np.maximum(around, 1e-300), 0.0)
    at = int(np.argmax(height))
    return 1.0 / float(frequency[at]) if height[at] > 0 else np.inf


def spectral_peaks(
    records: Sequence[Record],
    residuals: Sequence[np.ndarray],
    valid: Sequence[np.ndarray],
    variance: np.ndarray,
) -> tuple[float, ...]:
    """Return the three frequencies (rad/s) at which the normalised residuals have most power,
    largest first, at least 15 % apart.

    Missing samples count as zero; samples are taken as even at their mean interval.
    """
    best: dict[float, float] = {}
    for record, residual, mask in zip(records, residuals, valid, strict=True):
        n = residual.shape[1]
        interval = float((record.time[-1] - record.time[0]) / (n - 1))
        power = np.sum(
            np.abs(np.fft.rfft(np.where(mask, residual, 0.0), axis=1)) ** 2 / variance[:, None],
            axis=0,
        )
        omega = 2.0 * np.pi * np.fft.rfftfreq(n, interval)
        smooth = np.convolve(power, [0.25, 0.5, 0.25], mode="same")
        for k in range(2, len(smooth) - 1):
            if smooth[k] >= smooth[k - 1] and smooth[k] > smooth[k + 1]:
                best[float(omega[k])] = float(smooth[k]) / n
    chosen: list[float] = []
    for frequency in sorted(best, key=lambda f: -best[f]):
        if all(abs(frequency - other) > 0.15 * other for other in chosen):
            chosen.append(frequency)
        if len(chosen) == _MOST_PEAKS:
            break
    return tuple(chosen)
