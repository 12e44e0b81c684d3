"""What a study of the low-order filter measures of its own misfit: peaks, stretches, structure of innovations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.estimate import Estimate
from ident.statistics.residuals import ljung_box
from scenarios.x29.flying import Flown
from sim.record import Record

LARGE = 0.9  # size of a correlation that is worth a mark


@dataclass(frozen=True)
class Misfit:
    """Of a free simulation and of the filter that it came from.

    Attributes
    ----------
    rms : measured minus simulated over the noise's sigma, by output.
    stretch, elsewhere : rms of q (over sigma) inside the scenario's stretch and outside; zero where it has none.
    peak_measured, peak_simulated : q at the largest |q| of the scenario's peak interval, rad/s; zero where it has none.
    lag_one : lag-one correlation of the normalised q innovations. q_box : Ljung-Box statistic over 25 lags.
    low_share : share of the q innovations' power below a fifth of the Nyquist frequency; white noise has a fifth.
    ratio : root mean square of all normalised innovations.
    """

    rms: dict[str, float]
    stretch: float
    elsewhere: float
    peak_measured: float
    peak_simulated: float
    lag_one: float
    q_box: float
    low_share: float
    ratio: float

    @property
    def peak_percent(self) -> float:
        """How much of the final peak the free simulation lacks (negative) or exaggerates, percent of the measured one."""
        return 100.0 * (abs(self.peak_simulated) / abs(self.peak_measured) - 1.0) if self.peak_measured else 0.0


def sensor_noise(flown: Flown) -> np.ndarray:
    """The telemetry's sigma of alpha, q and nz."""
    t = flown.x29.telemetry
    return np.array([t.alpha_noise, t.q_noise, t.nz_noise])


def misfit(
    record: Record,
    simulated: np.ndarray,
    estimate: Estimate,
    noise_std: np.ndarray,
    stretch: tuple[float, float] | None,
    peak: tuple[float, float] | None,
) -> Misfit:
    """Measure a free simulation ``(3, N)`` and the innovations of its estimate; ``noise_std`` ``(3,)`` is what the misfit is held against."""
    names = estimate.output_names
    z, valid = record.output_array(names)
    error = np.where(valid, z - simulated, 0.0) / noise_std[:, None]
    row = names.index("q")
    inside = np.zeros(len(record), dtype=bool) if stretch is None else (record.time >= stretch[0]) & (record.time <= stretch[1])
    measured = simulated_peak = 0.0
    if peak is not None:
        within = np.flatnonzero((record.time >= peak[0]) & (record.time <= peak[1]))
        if within.size:
            at = within[int(np.argmax(np.abs(z[row, within])))]
            # Over five samples, so that the noise of one does not decide.
            near = slice(max(at - 2, 0), at + 3)
            measured, simulated_peak = float(z[row, near].mean()), float(simulated[row, near].mean())
    history = estimate.history
    assert history is not None
    series = (history.innovation[row] / history.innovation_std[row])[history.valid[row]]
    centred = series - series.mean()
    power = np.abs(np.fft.rfft(centred)) ** 2
    nis = float(history.nis.sum()) / max(int(history.degrees.sum()), 1)
    return Misfit(
        {name: float(np.sqrt(np.mean(line**2))) for name, line in zip(names, error, strict=True)},
        float(np.sqrt(np.mean(error[row, inside] ** 2))) if inside.any() else 0.0,
        float(np.sqrt(np.mean(error[row, ~inside] ** 2))) if inside.any() else 0.0,
        measured,
        simulated_peak,
        float(centred[1:] @ centred[:-1] / (centred @ centred)),
        ljung_box(series, np.ones(len(series), dtype=bool), "q").statistic,
        float(power[1 : max(2, len(power) // 5)].sum() / power[1:].sum()),
        float(np.sqrt(nis)),
    )
