"""Measurement noise read off a record: the band that encloses a channel's scatter is taken as plus and minus two sigma.

As NASA TM-101722 did by eye on time histories; here the smooth part is taken out by a third difference first.
"""

from __future__ import annotations

import numpy as np

from sim.errors import RecordError
from sim.record import Record

WITHIN_TWO_SIGMA = 0.9545  # share of a Gaussian inside the band
_FEWEST = 20
_STENCIL = np.array([-1.0, 3.0, -3.0, 1.0])


def noise_envelope(record: Record, start: float | None = None, stop: float | None = None) -> dict[str, float]:
    """Standard deviation of the noise on each output: a quarter of the width of the band that holds 95.45 % of it.

    Parameters
    ----------
    record : measured data, samples taken as evenly spaced.
    start, stop : a quiet stretch, s; the whole record when None, which is as good as long as the motion is slow against
        the sampling: a third difference lets a motion at w rad/s pass by (w dt)^3/4.5 of its amplitude.

    Four samples in a row enter as d = (-y[k] + 3 y[k+1] - 3 y[k+2] + y[k+3]) / sqrt(20), which has the variance of white
    noise. The band is central (quantiles), so that isolated spikes and switches do not widen it.

    Raises
    ------
    RecordError : fewer than twenty such runs of valid samples in a channel, or a channel without any noise.
    """
    stretch = record if start is None and stop is None else record.window(start, stop)
    out = {}
    for channel in stretch.outputs:
        whole = np.convolve(~channel.valid, np.ones(len(_STENCIL)), mode="valid") < 0.5
        d = np.convolve(channel.values, _STENCIL[::-1], mode="valid")[whole] / np.sqrt(np.sum(_STENCIL**2))
        where = f"{record.name}, channel {channel.name}"
        if d.size < _FEWEST:
            raise RecordError(f"{d.size} runs of four samples are too few for a noise envelope", where=where, remedy="give a longer stretch")
        half_width = float(np.quantile(np.abs(d - np.median(d)), WITHIN_TWO_SIGMA))
        if half_width == 0.0:
            raise RecordError("shows no noise at all", where=where, remedy="declare the noise level")
        out[channel.name] = half_width / 2.0
    return out
