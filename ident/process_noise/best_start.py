"""Filter-error fits: one fit from a given start, and the search for a start that gives a valid
maximum.

The likelihood of a filter-error fit is unbounded: as the noise level of a sensor tends to zero, the
filter follows that sensor alone, with arbitrary derivatives and tiny sigmas. Such a fit is
degenerate. The valid maximum is a local one, which a start near the truth leads to. Each fit is
therefore tested for degeneracy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ident.estimate import Outcome
from ident.process_noise.innovations_model import SCALE, ProcessNoise, process_noise
from ident.process_noise.linear_noise import Variation, discretised_noise
from ident.process_noise.whitener import whitener
from ident.regression.equation_error import run_equation_error
from ident.whole_record import output_error as without_process_noise
from ident.whole_record.gauss_newton import Fit, fit_whole_records
from ident.whole_record.layout import FitLayout, FitProblem, lay_out
from ident.whole_record.numerical_errors import QUIET_NOISE_SHARE
from sim.declaration.model import System
from sim.errors import FlightidError

# ---- One fit with process noise from a given start

_THIRD_DIFFERENCE = np.array([-1.0, 3.0, -3.0, 1.0])  # weights of consecutive samples
_FEWEST_DIFFERENCES = 20  # fewest third differences that give a noise level
_LEAST_WHITE_SHARE = 0.02  # smallest starting noise level, relative to the rms residual
_LEAST_INTENSITY_SHARE = 1e-3  # lower bound of a noise intensity, relative to its start
COARSE_TOLERANCE = 0.1  # tolerance, in sigmas, of an output-error fit that only gives a start


def fit_with_process_noise(
    layout: FitLayout,
    guesses: list[np.ndarray] | None = None,
    levels: Mapping[str, float] | None = None,
    least: Mapping[str, float] | None = None,
) -> Fit | None:
    """Return the fit of the unknowns of a layout and the noise levels together; None where no cost
    is finite.

    Parameters
    ----------
    layout : layout of a System with process noise.
    guesses : starting trajectory of each record; None takes the measured channels.
    levels : output -> starting value of its noise level (standard deviation of the measurement
        noise), and ``process_noise_scale`` -> starting value of the scale of declared process
        noise. None takes these, and the starting values of all unknowns, from an output-error fit.
    least : output -> smallest noise level. It is needed where the process noise can explain all
        noise of a sensor.
    """
    layout = _with_positive_intensities(layout)
    if levels is None:
        coarse = replace(
            layout.settings, tolerance=max(COARSE_TOLERANCE, layout.settings.tolerance)
        )
        coarse_fit = fit_whole_records(FitProblem(replace(layout, settings=coarse)), guesses)
        if coarse_fit is None:
            return None
        start, guesses = (
            coarse_fit.theta.copy(),
            coarse_fit.trajectories,
        )
        noise = noise_start(coarse_fit)
        factor = _intensity_factor(coarse_fit, noise)
        for position, value in _intensities(layout).items():
            start[position] = np.clip(factor * value, layout.low[position], layout.high[position])
        layout = replace(layout, start=start)
        levels = {
            **dict(zip(layout.system.output_names, noise.tolist(), strict=True)),
            SCALE: factor,
        }
    names = layout.system.output_names
    floor = {name: (least or {}).get(name, 0.0) for name in names}
    std = {name: max(levels.get(name, 1.0), floor[name]) for name in names}
    present = [name for name, used in zip(names, layout.used, strict=True) if used]
    noise_model = process_noise(layout.system, std, present, scale=levels.get(SCALE, 1.0))
    noise_model = replace(
        noise_model, quick=layout.settings.quick, least=np.array(list(floor.values()))
    )
    return fit_whole_records(FitProblem(layout, noise_model), guesses)


def _intensities(layout: FitLayout) -> dict[int, float]:
    """Return position in theta -> starting value, for the parameters that are noise intensities.

    A parameter is a noise intensity if its lower bound is zero and the process noise vanishes at
    this bound.
    """
    intensities = {}
    for r in range(len(layout.problems)):
        p, _ = layout.split(layout.start, r)
        columns = layout.columns(r)
        for position, index in zip(
            columns[: len(layout.order)].tolist(), layout.order, strict=True
        ):
            if layout.low[position] == 0.0 < p[index] and not np.any(
                np.array(layout.system.noise([*p[:index], 0.0, *p[index + 1 :]])[0]) > 0
            ):
                intensities[position] = float(p[index])
    return intensities


def _with_positive_intensities(layout: FitLayout) -> FitLayout:
    """Return the layout with lower bounds of the noise intensities above zero, since the likelihood
    is flat at zero.
    """
    low = layout.low.copy()
    for position, value in _intensities(layout).items():
        low[position] = _LEAST_INTENSITY_SHARE * value
    return replace(layout, low=low)


def _intensity_factor(fit: Fit, noise: np.ndarray) -> float:
    """Return the factor on the starting noise intensities with which the process noise explains the
    residuals of an output-error fit.

    ``noise (m,)`` are the standard deviations of the measurement noise. The process noise has to
    explain the variance of the residuals in excess of it.
    """
    layout = fit.layout
    expected, excess = np.zeros(len(noise)), np.maximum(fit.variance - noise**2, 1e-4 * noise**2)
    for r, (problem, linearisation) in enumerate(
        zip(layout.problems, fit.linearisations, strict=True)
    ):
        motion = discretised_noise(
            problem, linearisation.states, Variation(layout.split(layout.start, r)[0], 1.0)
        )
        # Without valid samples the filter predicts the covariance of the process noise.
        covariance = whitener(
            motion, 1e12 * noise**2, np.zeros((len(problem.grid.nodes), len(noise)), dtype=bool)
        ).predicted
        expected += np.mean(
            np.einsum("tij,tjk,tik->ti", motion.H, covariance, motion.H, optimize=True), axis=0
        ) / len(layout.problems)
    at = np.flatnonzero(layout.used & (expected > 0))  # outputs that the process noise reaches
    ratio = float(np.sqrt(np.median(excess[at] / expected[at]))) if at.size else 1.0
    # a start farther away than a factor of 100 is no better than the declared intensities
    return float(np.clip(ratio, 0.01, 100.0)) if np.isfinite(ratio) else 1.0


def noise_start(fit: Fit) -> np.ndarray:
    """Return starting values ``(m,)`` of the noise levels from the residuals of an output-error
    fit.

    The slow part of the residuals is process noise. Third differences of consecutive samples
    suppress it, and their scatter gives the measurement noise. A level is at most the standard
    deviation of the residuals.
    """
    std = np.sqrt(fit.variance)
    white = white_noise_level(fit.residuals, [problem.valid for problem in fit.layout.problems])
    return np.clip(np.where(np.isfinite(white), white, std), _LEAST_WHITE_SHARE * std, std)


def white_noise_level(rows: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> np.ndarray:
    """Return the standard deviation ``(m,)`` of the white noise in each row, from third differences
    of consecutive samples; infinite where too few of them are valid.

    Parameters
    ----------
    rows : ``(m, N)`` of each record.
    valid : ``(m, N)`` of each record, False where a sample does not count.
    """
    noise = np.full(len(rows[0]), np.inf)
    for i in range(len(noise)):
        differences_by_record = []
        for row, mask in zip(rows, valid, strict=True):
            missing = np.convolve(~mask[i], np.ones(len(_THIRD_DIFFERENCE)), mode="valid")
            differences = np.convolve(row[i], _THIRD_DIFFERENCE[::-1], mode="valid")
            differences_by_record.append(differences[missing < 0.5])
        differences = np.concatenate(differences_by_record)
        if differences.size >= _FEWEST_DIFFERENCES:
            noise[i] = np.sqrt(np.mean(differences**2) / np.sum(_THIRD_DIFFERENCE**2))
    return noise


# ---- Starts of a fit with process noise, and tests for degenerate fits

AT_ITS_LIMIT = 2.0  # a noise level within this factor of one of its bounds is at its limit
# smallest plausible sigma of a parameter over its value, relative to the sigma of a factor on the
# motion of all outputs
IMPLAUSIBLE_SIGMA_SHARE = 1e-3
_CHANGES = 100  # random changes of states, inputs and parameters that show dependent outputs
_RELATIVE_CHANGE = 0.3  # standard deviation of a changed parameter, relative to its value
# an output depends on the others where they explain all but this share of its change; the share is
# far above rounding
_DEPENDENT_OUTPUT_SHARE = 1e-6
# a fit of unstable motion ends where a step gains less log likelihood
_NEGLIGIBLE_GAIN = 1e-4
# least damping for unstable motion: with it, fits in gusts converge in ten to thirty steps, with
# 1e-7 hardly any; in still air the default of `FitSettings` is better
_UNSTABLE_LEAST_DAMPING = 1e-10
StartOfFit = tuple[FitLayout, Mapping[str, float] | None]  # layout with its start, noise levels


def fit_from_best_start(layout: FitLayout, calm: System | None = None) -> Fit | None:
    """Return the filter-error fit of a layout; None where no start has a finite cost.

    ``calm`` is the same model without the noise effect; None takes the model of the layout. Its
    equation error and output error give further starts. They are used where the motion is unstable
    at the declared values, or the fit from the declared values does not converge or is degenerate.
    The first converged and valid fit is returned. If there is none, valid fits come before
    degenerate ones, then converged ones before others, and then the likelihood decides.
    """
    fits: list[Fit] = []
    stable = without_process_noise.grows_little(layout)
    for start_layout, levels in _starts(layout, calm or layout.system, stable=stable):
        fit = fit_with_process_noise(start_layout, levels=levels)
        if fit is None:
            continue
        fits.append(fit)
        if fit.outcome is Outcome.CONVERGED and not degenerate(fit):
            break
    return min(
        fits,
        key=lambda fit: (degenerate(fit), fit.outcome is not Outcome.CONVERGED, fit.cost),
        default=None,
    )


def degenerate(fit: Fit) -> bool:
    """Return whether a fit is degenerate: the noise level of an output is at its limit, or at the
    rounding of its samples, although the record has measurement noise.
    """
    return bool(levels_at_limit(fit)) and not without_measurement_noise(fit)


def without_measurement_noise(fit: Fit) -> bool:
    """Return whether the record has hardly any measurement noise: all outputs are fitted almost
    exactly, and more outputs are independent than there are sources of process noise.

    With wrong derivatives, a filter can follow as many outputs exactly as there are sources of
    process noise. A further output is fitted exactly by the right derivatives only, unless it
    depends on others (`_independent_outputs`). In a record without measurement noise, noise levels
    and sigmas are upper bounds.
    """
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    levels, low, _ = _levels_and_limits(fit)
    negligible = QUIET_NOISE_SHARE * np.array(
        [_rms_about_mean(fit.layout, i) for i in noise_model.estimated]
    )
    sources = 0
    for r in range(len(fit.layout.problems)):
        p, _ = fit.layout.split(fit.theta, r)
        density = np.array(fit.layout.system.noise(p.tolist())[0])
        sources = max(sources, int(np.count_nonzero(density > 0)))
    exact = bool(np.all(levels <= np.maximum(AT_ITS_LIMIT * low, negligible)))
    return exact and _independent_outputs(fit) > sources


def _independent_outputs(fit: Fit) -> int:
    """Return the number of functionally independent outputs, of those with an estimated noise
    level.

    A channel that is recorded twice, or computed from another one, adds no information. The number
    is the rank of the outputs under random changes of states, inputs and parameters about the fit.
    """
    noise_model, layout, rng = fit.noise_model, fit.layout, np.random.default_rng(0)
    assert isinstance(noise_model, ProcessNoise)
    system, rows = layout.system, []
    p, _ = layout.split(fit.theta, 0)
    at = [system.parameters.index(name) for name in layout.shared if not name.startswith("bias_")]
    x, record = fit.linearisations[0].states, layout.problems[0].record
    u = np.array([record[name].values for name in system.input_names])
    u = u.reshape(len(system.input_names), len(record))  # also for a system without inputs
    x_size, u_size = np.std(x, axis=1), np.std(u, axis=1)
    with np.errstate(all="ignore"):
        for _ in range(_CHANGES):
            k = rng.integers(len(record))
            states = x[:, min(k, x.shape[1] - 1)] + x_size * rng.standard_normal(len(x_size))
            inputs = u[:, k] + u_size * rng.standard_normal(len(u_size))
            changed = p.copy()
            changed[at] *= 1.0 + _RELATIVE_CHANGE * rng.standard_normal(len(at))
            rows.append(
                system.h(float(record.time[k]), states.tolist(), inputs.tolist(), changed.tolist())
            )
    values = np.array(rows, dtype=float)[:, list(noise_model.estimated)]
    values = values[np.all(np.isfinite(values), axis=1)]
    if len(values) < 2:
        return 0
    changes = values - np.mean(values, axis=0)
    size = np.linalg.norm(changes, axis=0)
    scaled = changes / np.where(size > 0.0, size, 1.0)
    return int(np.linalg.matrix_rank(scaled, tol=_DEPENDENT_OUTPUT_SHARE))


def _rms_about_mean(layout: FitLayout, output: int) -> float:
    """Return the rms of the samples of an output about the mean of each record."""
    rows = [problem.z[output, problem.valid[output]] for problem in layout.problems]
    deviations = np.concatenate([row - np.mean(row) for row in rows if row.size])
    return float(np.sqrt(np.mean(deviations**2))) if deviations.size else 0.0


def levels_at_limit(fit: Fit) -> tuple[str, ...]:
    """Return the outputs whose noise level is at its limit, or at the rounding of their samples."""
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    levels, low, high = _levels_and_limits(fit)
    at_limit = (levels <= AT_ITS_LIMIT * low) | (levels * AT_ITS_LIMIT >= high)
    outputs = [noise_model.outputs[i] for i in noise_model.estimated]
    return tuple(name for name, limited in zip(outputs, at_limit, strict=True) if limited)


def _levels_and_limits(fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the k estimated noise levels, their lowest and their highest values: three arrays
    ``(k,)``.
    """
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    count = len(noise_model.estimated)
    levels = fit.theta[len(fit.theta) - len(noise_model.names) :][:count]
    low = np.maximum(
        noise_model.low[:count], np.sqrt(fit.layout.smallest[list(noise_model.estimated)])
    )
    return levels, low, noise_model.high[:count]


def implausibly_small_sigmas(fit: Fit, std: np.ndarray) -> list[str]:
    """Return the names of the shared parameters whose sigma is impossibly small for the length and
    noise of the records. ``std`` are the sigmas ``(s,)``.

    A sample whose motion is r times its noise determines a factor on the motion to 1/r, and all
    samples determine it to 1/sqrt(sum r^2). The noise is taken from third differences of the
    measured outputs.
    """
    layout = fit.layout
    noise = white_noise_level(
        [problem.z for problem in layout.problems], [problem.valid for problem in layout.problems]
    )
    information = 0.0
    for i in np.flatnonzero(layout.used):
        samples = np.concatenate([problem.z[i, problem.valid[i]] for problem in layout.problems])
        motion = float(np.sum((samples - np.mean(samples)) ** 2))
        information += motion / max(float(noise[i]) ** 2, 1e-300)
    least = IMPLAUSIBLE_SIGMA_SHARE / np.sqrt(max(information, 1.0))
    values = fit.theta[: len(layout.shared)]
    return [
        name
        for name, value, sigma in zip(layout.shared, values, std, strict=True)
        if sigma < least * abs(value)
    ]


def _starts(layout: FitLayout, calm: System, *, stable: bool) -> Iterator[StartOfFit]:
    """Yield starting layouts and noise levels. The declared values come first for a stable motion
    and last for an unstable one.
    """
    records = [problem.record for problem in layout.problems]
    if stable:
        yield layout, None
        if layout.prior is None:
            yield from _from_regression(layout, records, calm)
        return
    if layout.prior is None:
        for least_damping in (_UNSTABLE_LEAST_DAMPING, layout.settings.least_damping):
            exact = _for_unstable_motion(layout, least_damping)
            # In gusts these starts converge in ten steps; those of equation error hardly converge.
            yield from _from_output_error(exact, records, calm)
            yield from _from_regression(exact, records, calm)
    yield layout, None


def _for_unstable_motion(layout: FitLayout, least_damping: float) -> FitLayout:
    """Return the layout with exact derivatives and settings by which a fit ends when a step gains
    nothing.

    A small step is no criterion here: rounding keeps the initial state of a motion that grows by
    e^15 from settling within a share of its sigma.
    """
    problems = tuple(replace(problem, exact=True) for problem in layout.problems)
    settings = layout.settings
    return replace(
        layout,
        problems=problems,
        settings=replace(
            settings, enough=max(settings.enough, _NEGLIGIBLE_GAIN), least_damping=least_damping
        ),
    )


def _from_regression(layout: FitLayout, records: Sequence, calm: System) -> Iterator[StartOfFit]:
    """Yield the start from equation error; nothing where it fails."""
    try:
        estimate = run_equation_error(records, calm)
    except FlightidError:
        return
    if (
        estimate.outcome is Outcome.CONVERGED
        and np.all(np.isfinite(estimate.values))
        and np.all(estimate.noise_std > 0.0)
    ):
        levels = dict(zip(estimate.output_names, estimate.noise_std.tolist(), strict=True))
        yield _started_at(layout, estimate.as_dict()), {**levels, SCALE: 1.0}


def _from_output_error(layout: FitLayout, records: Sequence, calm: System) -> Iterator[StartOfFit]:
    """Yield the start from the output-error fit; nothing where it has no finite cost."""
    masks = [problem.valid for problem in layout.problems]
    fit = without_process_noise.fit_from_best_start(
        lay_out(records, calm, layout.settings, local=layout.local, masks=masks)
    )
    if fit is not None:
        levels = dict(zip(calm.output_names, noise_start(fit).tolist(), strict=True))
        yield (
            _started_at(layout, dict(zip(fit.layout.names, fit.theta.tolist(), strict=True))),
            {**levels, SCALE: 1.0},
        )


def _started_at(layout: FitLayout, values: Mapping[str, float]) -> FitLayout:
    """Return the layout with the starting values of some unknowns replaced, within the bounds."""
    declared = zip(layout.names, layout.start.tolist(), strict=True)
    start = np.array([values.get(name, value) for name, value in declared])
    return replace(layout, start=np.clip(start, layout.low, layout.high))
