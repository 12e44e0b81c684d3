"""Sentences about a study that its tables do not say: what only the prior determines, and where a residual's power lies."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scenarios.estimating import Result
from sim.model import Model
from sim.vehicles.linear import linearise

LITTLE_LEARNT = 0.5  # of the prior's standard deviation: above it the record has said less than the start did


def prior_note(result: Result) -> str:
    """Which parameters the record hardly determines, those that may wander left out; empty where there is none or the method has no priors."""
    estimation = result.estimation
    priors = {name: start for name, start in estimation.start.items() if not estimation.process_noise.get(name)}
    if result.estimate.history is None and not estimation.use_priors:
        return ""
    sigma = dict(zip(result.estimate.names, result.estimate.std.tolist(), strict=True))
    named = [f"{name} {value / priors[name].std:.2f}" for name, value in sigma.items() if name in priors and value > LITTLE_LEARNT * priors[name].std]
    if not named:
        return ""
    return f"{estimation.name}: determined by the prior more than by the record (sigma over prior sigma): {', '.join(named)}"


def residual_notes(result: Result, model: Model) -> tuple[str, ...]:
    """Where the power of the residual lies against the elastic frequencies of ``model``, one sentence for each output.

    The periodogram of normalised innovations, or of residuals, under a Hann window; the band runs from half the
    lowest to one and a half times the highest elastic frequency.
    """
    elastic = elastic_frequencies(model)
    if not elastic:
        return ()
    out = []
    low, high = 0.5 * min(elastic), 1.5 * max(elastic)
    for name, row in zip(result.estimate.output_names, residuals_of(result), strict=True):
        omega, power = periodogram(row, float(np.median(np.diff(result.record.time))))
        inside = (omega >= low) & (omega <= high)
        share, white = float(power[inside].sum() / power.sum()), float(inside.mean())
        out.append(
            f"{result.estimation.name}, residual of {name}: {100 * share:.0f} % of its power between {low:.1f} and {high:.1f} rad/s, "
            f"where the elastic modes are (white noise: {100 * white:.0f} %); strongest at {float(omega[np.argmax(power)]):.1f} rad/s"
        )
    return tuple(out)


def elastic_frequencies(model: Model) -> list[float]:
    """Frequencies of a model's oscillations above the short period, rad/s, ascending; empty for a rigid one."""
    return sorted(abs(root) for root in np.linalg.eigvals(linearise(model).A).tolist() if root.imag > 0)[1:]


def residuals_of(result: Result) -> Sequence[np.ndarray]:
    """Normalised innovations of a filter, residuals of a whole-record fit; zero where a sample is missing."""
    history = result.estimate.history
    if history is not None:
        return list(np.where(history.valid, history.innovation / history.innovation_std, 0.0))
    z, valid = result.record.output_array(result.estimate.output_names)
    return list(np.where(valid, z - result.estimate.fitted[0], 0.0))


def periodogram(row: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies (rad/s, zero left out) and power of a series under a Hann window, padded to four times its length."""
    size = 4 * len(row)
    power = np.abs(np.fft.rfft((row - row.mean()) * np.hanning(len(row)), size)) ** 2
    return 2.0 * np.pi * np.fft.rfftfreq(size, step)[1:], power[1:]
