"""Numbers of the records that a search starts from: spans, input sizes, peaks of the residual's
spectrum.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.statistics.noise_levels import spectral_peaks, update_period
from ident.tracing.fitted_model import FittedModel
from sim.declaration.effect import AIRSPEEDS
from sim.declaration.proposal import SearchContext
from sim.record import Record


def search_context(fitted: FittedModel, predicted: Sequence[Record] = ()) -> SearchContext:
    """Return the common search context of a fitted model's records: the longest span, the largest
    inputs, the ranges of the fitted outputs.

    ``predicted`` : further records that the model must predict; their outputs widen the ranges. The
    outermost hundredth of their samples is left out, as it may hold spikes.
    """
    fit, layout = fitted.fit, fitted.fit.layout
    problems, lines = layout.problems, fit.linearisations
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
