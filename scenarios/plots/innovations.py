"""Innovations of a filter with their bounds, and their autocorrelation."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ident.estimate import FilterHistory
from ident.statistics.residual_spectrum import autocovariance
from scenarios.plots.display import axis_label, display_unit, scaled_unit, symbol
from scenarios.plots.histories import sound_samples
from scenarios.plots.style import BLACK, BLUE, LABEL_SIZE, SKY, VERMILION, ZERO, caption, finish, make_sheet, time_axis, y_label

EXPECTED_OUTSIDE = math.erfc(math.sqrt(2.0))  # of a Gaussian, outside two standard deviations
OF_PRIOR = 5.0  # bounds so many times as wide as nine in ten others are the prior's
_FEWEST = 8  # samples from which an autocorrelation says anything


def figure_innovations(history: FilterHistory, output_names: Sequence[str], units: Sequence[str], title: str = "", lags: int = 50) -> Figure:
    """Innovations with bounds of two standard deviations, 2 sqrt((H P H' + R)_ii) (eq. 23 of NASA TM-101722), beside
    each the autocorrelation of the normalised innovations with the band that holds 95 % of those of white noise.

    ``output_names`` and ``units`` are those of the ``m`` outputs in order. Missing samples and those after a breakdown are
    left out; an output without any is not drawn. The share of samples outside the bounds is stated. Angles in degrees.
    """
    sound = sound_samples(history)
    rows = [row for row in range(len(output_names)) if np.any(history.valid[row])]
    sheet = make_sheet([1.5] * max(len(rows), 1), (1.7, 1.0), row_gap=0.36, column_gap=0.78)
    if not rows:
        for panel in sheet.panels:
            caption(panel, "no sample was used")
    for row, (left, right) in zip(rows, sheet.axes, strict=False):
        valid, base = history.valid[row], display_unit(units[row])
        # A power of ten stands in the unit: above the axis it would run into the caption.
        unit = scaled_unit(base, base.factor * _limit(history.innovation[row, valid], history.innovation_std[row, valid]))
        _innovations(left, history.time[valid], unit.factor * history.innovation[row, valid], unit.factor * history.innovation_std[row, valid])
        left.set_xlim(history.time[0], history.time[-1])
        y_label(left, axis_label(output_names[row], unit))
        normalised = np.where(valid, history.innovation[row] / history.innovation_std[row], 0.0)
        _autocorrelation(right, normalised, valid, lags)
        late = f"; ends at {history.time[sound - 1]:.3g} s" if sound < len(valid) else ""
        outside = float(np.mean(np.abs(normalised[valid]) > 2.0))
        caption(left, f"{symbol(output_names[row])}: {100 * outside:.1f} % outside ±2σ ({100 * EXPECTED_OUTSIDE:.1f} % expected){late}")
    if len(sheet.axes[-1]) == 2:
        time_axis(sheet.axes[-1][0])
        sheet.axes[-1][1].set_xlabel("lag (samples)", fontsize=LABEL_SIZE)
    return finish(sheet, title, head=0.24)


def _innovations(panel: Axes, time: np.ndarray, innovation: np.ndarray, std: np.ndarray) -> None:
    panel.axhline(0.0, **ZERO)
    panel.plot(time, innovation, color=BLUE, linestyle="none", marker=".", markersize=3.0, markeredgewidth=0.0, label="innovation")
    panel.plot(time, 2.0 * std, color=VERMILION, linewidth=1.1, label="±2σ bounds")
    panel.plot(time, -2.0 * std, color=VERMILION, linewidth=1.1)
    limit = _limit(innovation, std)
    beyond = np.abs(innovation) > limit
    if beyond.any():
        edge = 0.97 * limit * np.sign(innovation[beyond])
        label = "innovation beyond the axis"
        panel.plot(time[beyond], edge, color=BLACK, linestyle="none", marker="d", markersize=5.0, markeredgewidth=0.0, label=label)
    panel.set_ylim(-limit, limit)


def _limit(innovation: np.ndarray, std: np.ndarray) -> float:
    """Where the axis ends: the first bounds come from the prior and may dwarf all others, and so may innovations within them."""
    usual = float(np.quantile(std, 0.9))
    of_prior = std > OF_PRIOR * usual
    return 1.15 * max(float(np.abs(innovation[~of_prior]).max()), 2.0 * usual)


def _autocorrelation(panel: Axes, normalised: np.ndarray, valid: np.ndarray, lags: int) -> None:
    """Missing samples are zero in ``normalised``, so they add to no sum; the band follows the number of pairs at each lag."""
    n, used = len(normalised), int(np.count_nonzero(valid))
    last = min(lags, used // 4)
    power = float(np.sum(normalised**2))
    if used < _FEWEST or power == 0.0:
        caption(panel, "too few samples")
        return
    lag = np.arange(1, last + 1)
    r = autocovariance(normalised, last)[1:] * n / power
    pairs = np.maximum(autocovariance(valid.astype(float), last)[1:] * n, 0.0)
    band = 1.96 * np.sqrt(pairs) / used
    panel.fill_between(lag, -band, band, color=SKY, alpha=0.35, linewidth=0, label="95 % band of white noise")
    panel.axhline(0.0, **ZERO)
    panel.vlines(lag, 0.0, r, color=BLACK, linewidth=1.0)
    limit = min(1.05, 1.25 * max(float(np.abs(r).max()), 2.0 * float(band.max())))
    panel.set_ylim(-limit, limit)
    panel.set_xlim(0, last + 1)
    y_label(panel, "autocorrelation")
    caption(panel, f"{int(np.count_nonzero(np.abs(r) > band))} of {last} lags outside")
