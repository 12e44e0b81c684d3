"""One fit with process noise from a given start, and where its noise levels begin when nothing is known of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.process_noise.discretised import Variation, discretised_noise
from ident.process_noise.innovations_model import SCALE, process_noise
from ident.process_noise.whitener import whitener
from ident.whole_record.fit_problem import FitProblem
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitLayout

_STENCIL = np.array([-1.0, 3.0, -3.0, 1.0])
_FEWEST = 20  # third differences that tell a scatter
_LEAST = 1e-3  # smallest intensity, relative to its start
COARSE = 0.1  # tolerance, in sigmas, of the output-error fit that only gives a start


def fit_with_process_noise(
    layout: FitLayout,
    guesses: list[np.ndarray] | None = None,
    levels: Mapping[str, float] | None = None,
    least: Mapping[str, float] | None = None,
) -> Fit | None:
    """Fit a layout's unknowns and the noise levels together; None where no finite cost was found.

    Parameters
    ----------
    layout : of a System with process noise.
    guesses : trajectories to begin with. levels : measurement noise by output, and ``process_noise_scale`` if wanted, of a
        fit of nearly the same model: a warm start. When None they come from an output-error fit, which also
        moves the other unknowns' start.
    least : smallest measurement noise by output. Process noise can take in the noise of a sensor, whose level then has no optimum above zero.
    """
    layout = _never_still(layout)
    if levels is None:
        coarse = replace(layout.settings, tolerance=max(COARSE, layout.settings.tolerance))
        first = fit_whole_records(FitProblem(replace(layout, settings=coarse)), guesses)
        if first is None:
            return None
        start, guesses, noise = first.theta.copy(), [line.states for line in first.lines], noise_start(first)
        factor = _size_of_motion(first, noise)
        for position, value in _amplitudes(layout).items():
            start[position] = np.clip(factor * value, layout.low[position], layout.high[position])
        layout = replace(layout, start=start)
        levels = {**dict(zip(layout.system.output_names, noise.tolist(), strict=True)), SCALE: factor}
    floor = np.array([(least or {}).get(name, 0.0) for name in layout.system.output_names])
    levels = {**levels, **{name: max(levels.get(name, 1.0), std) for name, std in (least or {}).items() if name in layout.system.output_names}}
    present = [name for name, used in zip(layout.system.output_names, layout.used, strict=True) if used]
    noise_model = process_noise(layout.system, {**dict.fromkeys(layout.system.output_names, 1.0), **levels}, present, scale=levels.get(SCALE, 1.0))
    return fit_whole_records(FitProblem(layout, replace(noise_model, quick=layout.settings.quick, least=floor)), guesses)


def _amplitudes(layout: FitLayout) -> dict[int, float]:
    """Unknowns that nothing forces a state without (intensities): positions in theta and starting values."""
    found = {}
    for r in range(len(layout.problems)):
        p, _ = layout.split(layout.start, r)
        for q, index in enumerate(layout.order):
            position = int(layout.columns(r)[q])
            if layout.low[position] == 0.0 < p[index] and not np.any(np.array(layout.system.noise([*p[:index], 0.0, *p[index + 1 :]])[0]) > 0):
                found[position] = float(p[index])
    return found


def _never_still(layout: FitLayout) -> FitLayout:
    """The same layout with intensities kept off zero, where the likelihood is flat and a fit would stay for ever."""
    low = layout.low.copy()
    for position, value in _amplitudes(layout).items():
        low[position] = _LEAST * value
    return replace(layout, low=low)


def _size_of_motion(fit: Fit, noise: np.ndarray) -> float:
    """Factor on the start's forcing that makes the process noise as large as what the residuals hold beyond noise ``(m,)``."""
    layout = fit.layout
    expected, beyond = np.zeros(len(noise)), np.maximum(fit.variance - noise**2, 1e-4 * noise**2)
    for r, (problem, line) in enumerate(zip(layout.problems, fit.lines, strict=True)):
        motion = discretised_noise(problem, line.states, Variation(layout.split(layout.start, r)[0], 1.0))
        # A filter that trusts no measurement propagates the covariance of the motion itself.
        spread = whitener(motion, 1e12 * noise**2, np.zeros((len(problem.grid.nodes), len(noise)), dtype=bool)).predicted
        expected += np.mean(np.einsum("tij,tjk,tik->ti", motion.H, spread, motion.H, optimize=True), axis=0) / len(layout.problems)
    at = np.flatnonzero(layout.used & (expected > 0))
    ratio = float(np.sqrt(np.median(beyond[at] / expected[at]))) if at.size else 1.0
    return float(np.clip(ratio, 0.01, 100.0)) if np.isfinite(ratio) else 1.0


def noise_start(fit: Fit) -> np.ndarray:
    """Measurement noise ``(m,)`` read off the residuals of an output-error fit, of which the slow part is process noise.

    Scatter of third differences of samples in a row, which pass white noise and hardly anything slow; not more than the residual.
    """
    std = np.sqrt(fit.variance)
    shown = third_differences(fit.residuals, [problem.valid for problem in fit.layout.problems])
    return np.clip(np.where(np.isfinite(shown), shown, std), 0.02 * std, std)


def third_differences(rows: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> np.ndarray:
    """Level ``(m,)`` of white noise that third differences of ``rows (m, N)`` a record show; infinite with too few ``valid`` samples in a row."""
    out = np.full(len(rows[0]), np.inf)
    for i in range(len(out)):
        found = []
        for row, known in zip(rows, valid, strict=True):
            whole = np.convolve(~known[i], np.ones(len(_STENCIL)), mode="valid") < 0.5
            found.append(np.convolve(row[i], _STENCIL[::-1], mode="valid")[whole])
        scatter = np.concatenate(found)
        if scatter.size >= _FEWEST:
            out[i] = np.sqrt(np.mean(scatter**2) / np.sum(_STENCIL**2))
    return out
