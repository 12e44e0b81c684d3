"""Error of a free simulation, channel by channel: root mean square, share of the spread, R squared,
Theil's coefficient.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ident.tracing.diagnosis import ErrorFigures
from ident.whole_record.gauss_newton import Fit
from sim.record import Record


def prediction(
    fit: Fit | None, record_number: int, record: Record, channels: Sequence[str]
) -> np.ndarray:
    """Free simulation at every row of a record, ``(m, N)``; where the fit failed the mean of the
    measurement, zero without one."""
    if fit is not None:
        rows = dict(zip(fit.layout.system.output_names, fit.lines[record_number].y, strict=True))
        return np.array([rows[name] for name in channels])
    means = [
        float(record[name].values[record[name].valid].mean())
        if name in record.output_names
        else 0.0
        for name in channels
    ]
    return np.array([np.full(len(record), mean) for mean in means])


def error_figures(
    predictions: Sequence[np.ndarray],
    records: Sequence[Record],
    masks: Sequence[np.ndarray],
    channels: Sequence[str],
) -> ErrorFigures:
    """RMSE, NRMSE (over the measured spread), R squared and Theil's inequality coefficient, samples
    set aside left out.
    """
    rmse, nrmse, r2, theil = {}, {}, {}, {}
    for i, name in enumerate(channels):
        pairs = [
            (p[i][mask[i]], record[name].values[mask[i]])
            for p, record, mask in zip(predictions, records, masks, strict=True)
            if name in record.output_names
        ]
        p, z = np.concatenate([a for a, _ in pairs]), np.concatenate([b for _, b in pairs])
        if z.size == 0:
            continue
        error = float(np.sqrt(np.mean((z - p) ** 2)))
        spread = float(np.std(z))
        rmse[name] = error
        nrmse[name] = error / spread if spread > 0 else 0.0
        r2[name] = 1.0 - (error / spread) ** 2 if spread > 0 else 0.0
        size = float(np.sqrt(np.mean(z**2)) + np.sqrt(np.mean(p**2)))
        theil[name] = error / size if size > 0 else 0.0
    return ErrorFigures(rmse, nrmse, r2, theil)
