"""Sentences about a study that its tables do not say: what only the prior determines, and where a residual's power lies."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from scenarios.files.channel_names import CHANNEL_UNITS
from scenarios.studies.estimating import Result
from scenarios.terminal.display_units import in_hertz, shown_in, spaced
from sim.declaration.model import Model
from sim.vehicles.factory import linearise
from sim.vehicles.flexibility import LARGEST_MISFIT, Flexibility

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


def residual_note(result: Result, model: Model) -> str:
    """How much of the residual's power lies about the elastic frequencies of ``model``, by output; empty for a rigid one.

    The periodogram of normalised innovations, or of residuals, under a Hann window; the band runs from half the
    lowest to one and a half times the highest elastic frequency. Where it holds twice the share that white noise
    has there, or more, the strongest frequency is named.
    """
    elastic = elastic_frequencies(model)
    if not elastic:
        return ""
    low, high = 0.5 * min(elastic), 1.5 * max(elastic)
    shares, white = [], 0.0
    for name, row in zip(result.estimate.output_names, residuals_of(result), strict=True):
        omega, power = periodogram(row, float(np.median(np.diff(result.record.time))))
        inside = (omega >= low) & (omega <= high)
        share, white = float(power[inside].sum() / power.sum()), float(inside.mean())
        strongest = f" (strongest at {_frequency(float(omega[np.argmax(power)]))})" if share > 2.0 * white else ""
        shares.append(f"{name} {100 * share:.0f} %{strongest}")
    turn = 2.0 * math.pi
    band = f"between {low:.1f} and {high:.1f} rad/s ({low / turn:.2g} and {high / turn:.2g} Hz), about the elastic modes"
    return f"{result.estimation.name}: share of the residual's power {band}: {', '.join(shares)}; white noise has {100 * white:.0f} % there"


def flexibility_sentences(found: Flexibility, noise_std: Mapping[str, float]) -> tuple[str, ...]:
    """The degree of flexibility, the threshold it is held against, and on which side of it this aircraft is."""
    degree = (
        f"degree of flexibility {found.degree:.3g}: what a structure that follows its loads at once gets wrong at the short period "
        f"of {_frequency(found.short_period)}; deflection takes {100 * found.stiffness_loss:.0f} % of the rigid short period's stiffness"
    )
    if math.isfinite(found.separation):
        degree += f", the lowest elastic frequency is {found.separation:.2g} times its frequency"
    noise = ", ".join(_level(name, std) for name, std in noise_std.items())
    misfit = f"what no rigid model explains of this maneuver is {found.misfit:.2g} times the noise in rms (noise: {noise})"
    if not found.rigid_serves:
        return degree, f"{misfit}; threshold {LARGEST_MISFIT:g}: a rigid model no longer serves"
    seen = (
        f"yet the residual shows the structure from {found.detectable:.2g} on" if found.misfit > found.detectable else "and too small to be noticed"
    )
    return degree, f"{misfit}; threshold {LARGEST_MISFIT:g}: a rigid model still serves, {seen}"


def _level(name: str, std: float) -> str:
    factor, unit = shown_in(CHANNEL_UNITS.get(name, ""), name)
    return f"{name} {factor * std:.3g}{spaced(unit)}"


def _frequency(omega: float) -> str:
    return f"{omega:.3g} rad/s{in_hertz(omega, 'frequency', 'rad/s')}"


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
