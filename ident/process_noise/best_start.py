"""Filter-error fits: one fit from a given start, and the search for a start that gives a valid
maximum.

The likelihood of a filter-error fit is unbounded: as a sensor's noise level tends to zero, the
filter follows that sensor alone, with arbitrary derivatives and tiny sigmas. A start near the truth
gives the valid local maximum. Each result is therefore tested for degeneracy.
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

_STENCIL = np.array([-1.0, 3.0, -3.0, 1.0])
_FEWEST_DIFFERENCES = 20  # fewest third differences that give a noise level
_LEAST_INTENSITY_SHARE = 1e-3  # smallest intensity, relative to its start
COARSE_TOLERANCE = 0.1  # tolerance, in sigmas, of the output-error fit that only gives a start


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
    guesses : starting trajectories.
    levels : measurement noise by output, and ``process_noise_scale`` if wanted, from a fit of
        nearly the same model. None takes them, and starting values, from an output-error fit.
    least : smallest measurement noise by output. It is needed where process noise can explain
        all noise of a sensor.
    """
    layout = _with_positive_intensities(layout)
    if levels is None:
        coarse = replace(
            layout.settings, tolerance=max(COARSE_TOLERANCE, layout.settings.tolerance)
        )
        first = fit_whole_records(FitProblem(replace(layout, settings=coarse)), guesses)
        if first is None:
            return None
        start, guesses = first.theta.copy(), [line.states for line in first.lines]
        noise = noise_start(first)
        factor = _intensity_factor(first, noise)
        for position, value in _intensities(layout).items():
            start[position] = np.clip(factor * value, layout.low[position], layout.high[position])
        layout = replace(layout, start=start)
        levels = {
            **dict(zip(layout.system.output_names, noise.tolist(), strict=True)),
            SCALE: factor,
        }
    floor = np.array([(least or {}).get(name, 0.0) for name in layout.system.output_names])
    levels = {
        **levels,
        **{
            name: max(levels.get(name, 1.0), std)
            for name, std in (least or {}).items()
            if name in layout.system.output_names
        },
    }
    present = [
        name for name, used in zip(layout.system.output_names, layout.used, strict=True) if used
    ]
    noise_model = process_noise(
        layout.system,
        {**dict.fromkeys(layout.system.output_names, 1.0), **levels},
        present,
        scale=levels.get(SCALE, 1.0),
    )
    return fit_whole_records(
        FitProblem(layout, replace(noise_model, quick=layout.settings.quick, least=floor)), guesses
    )


def _intensities(layout: FitLayout) -> dict[int, float]:
    """Return the noise intensities, each the only source of a state's noise: position in theta ->
    starting value.
    """
    found = {}
    for r in range(len(layout.problems)):
        p, _ = layout.split(layout.start, r)
        for q, index in enumerate(layout.order):
            position = int(layout.columns(r)[q])
            if layout.low[position] == 0.0 < p[index] and not np.any(
                np.array(layout.system.noise([*p[:index], 0.0, *p[index + 1 :]])[0]) > 0
            ):
                found[position] = float(p[index])
    return found


def _with_positive_intensities(layout: FitLayout) -> FitLayout:
    """Return the layout with noise intensities bounded above zero, where the likelihood is flat."""
    low = layout.low.copy()
    for position, value in _intensities(layout).items():
        low[position] = _LEAST_INTENSITY_SHARE * value
    return replace(layout, low=low)


def _intensity_factor(fit: Fit, noise: np.ndarray) -> float:
    """Return the factor on the starting intensity that makes the process noise match the residuals
    beyond the measurement noise ``(m,)``.
    """
    layout = fit.layout
    expected, beyond = np.zeros(len(noise)), np.maximum(fit.variance - noise**2, 1e-4 * noise**2)
    for r, (problem, line) in enumerate(zip(layout.problems, fit.lines, strict=True)):
        motion = discretised_noise(
            problem, line.states, Variation(layout.split(layout.start, r)[0], 1.0)
        )
        # Without measurements the filter propagates the covariance of the process noise.
        spread = whitener(
            motion, 1e12 * noise**2, np.zeros((len(problem.grid.nodes), len(noise)), dtype=bool)
        ).predicted
        expected += np.mean(
            np.einsum("tij,tjk,tik->ti", motion.H, spread, motion.H, optimize=True), axis=0
        ) / len(layout.problems)
    at = np.flatnonzero(layout.used & (expected > 0))
    ratio = float(np.sqrt(np.median(beyond[at] / expected[at]))) if at.size else 1.0
    return float(np.clip(ratio, 0.01, 100.0)) if np.isfinite(ratio) else 1.0


def noise_start(fit: Fit) -> np.ndarray:
    """Return the measurement noise ``(m,)`` from the residuals of an output-error fit, whose slow
    part is process noise.

    It is the scatter of third differences of consecutive samples, which suppress slow motion, and
    at most the residual's.
    """
    std = np.sqrt(fit.variance)
    shown = third_differences(fit.residuals, [problem.valid for problem in fit.layout.problems])
    return np.clip(np.where(np.isfinite(shown), shown, std), 0.02 * std, std)


def third_differences(rows: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> np.ndarray:
    """Return the level ``(m,)`` of white noise from third differences of ``rows (m, N)`` of each
    record; infinite with too few ``valid`` samples in a row.
    """
    out = np.full(len(rows[0]), np.inf)
    for i in range(len(out)):
        found = []
        for row, known in zip(rows, valid, strict=True):
            whole = np.convolve(~known[i], np.ones(len(_STENCIL)), mode="valid") < 0.5
            found.append(np.convolve(row[i], _STENCIL[::-1], mode="valid")[whole])
        scatter = np.concatenate(found)
        if scatter.size >= _FEWEST_DIFFERENCES:
            out[i] = np.sqrt(np.mean(scatter**2) / np.sum(_STENCIL**2))
    return out


# ---- Starts of a fit with process noise, and tests for degenerate fits

AT_ITS_LIMIT = 2.0  # a noise level within this factor of its lowest or highest value has run to it
# smallest plausible sigma, as a share of the one that all samples give a fully visible parameter
IMPLAUSIBLE_SIGMA_SHARE = 1e-3
# random changes about the fit: their number, and the relative size for parameters
_CHANGES, _RELATIVE_CHANGE = 100, 0.3
# share of an output's change below which it depends on the others: far above rounding
_DEPENDENT_OUTPUT_SHARE = 1e-6
_NEGLIGIBLE_GAIN = 1e-4  # smallest gain of log likelihood by a step
# Least damping for unstable motion: in gusts fits converge in ten to thirty steps with it, hardly
# with 1e-7; in still air the default is better.
_UNSTABLE_LEAST_DAMPING = 1e-10
StartOfFit = tuple[FitLayout, Mapping[str, float] | None]


def fit_from_best_start(layout: FitLayout, calm: System | None = None) -> Fit | None:
    """Return the filter-error fit of a layout; None where no start has a finite cost.

    ``calm`` is the same model without the noise effect (None: the layout's own). Equation error and
    output error of it give further starts, used if the motion is unstable at the declared values or
    the fit from them does not converge or is degenerate. The first converged, valid fit is
    returned; else the best, compared by valid, converged, likelihood.
    """
    tried: list[Fit] = []
    plain = without_process_noise.quiet(layout)
    for start_layout, levels in _starts(layout, calm or layout.system, plain=plain):
        fit = fit_with_process_noise(start_layout, levels=levels)
        if fit is None:
            continue
        tried.append(fit)
        if fit.outcome is Outcome.CONVERGED and not degenerate(fit):
            break
    return min(
        tried,
        key=lambda fit: (degenerate(fit), fit.outcome is not Outcome.CONVERGED, fit.cost),
        default=None,
    )


def degenerate(fit: Fit) -> bool:
    """Return whether the noise level of a measured output ran to its limit, or to the rounding of
    its samples, although the record has measurement noise.
    """
    return bool(levels_at_limit(fit)) and not without_measurement_noise(fit)


def without_measurement_noise(fit: Fit) -> bool:
    """Return whether the record has hardly any measurement noise: all outputs are fitted almost
    exactly, and there are more of them than sources of process noise.

    With any derivatives a filter can follow as many outputs exactly as there are sources of process
    noise. A further output is fitted exactly by the right derivatives only, unless it repeats
    others (``_distinct_outputs``). Noise levels and sigmas are then upper bounds.
    """
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    own, low, _ = _levels_and_limits(fit)
    quiet = QUIET_NOISE_SHARE * np.array(
        [_rms_about_mean(fit.layout, i) for i in noise_model.estimated]
    )
    sources = max(
        int(
            np.count_nonzero(
                np.array(fit.layout.system.noise(fit.layout.split(fit.theta, r)[0].tolist())[0]) > 0
            )
        )
        for r in range(len(fit.layout.problems))
    )
    return (
        bool(np.all(own <= np.maximum(AT_ITS_LIMIT * low, quiet)))
        and _distinct_outputs(fit) > sources
    )


def _distinct_outputs(fit: Fit) -> int:
    """Return the number of functionally independent outputs among the estimated ones.

    A channel that is recorded twice, or computed from another one, adds no information. The number
    is the rank of the outputs under random changes of states, inputs and parameters about the fit.
    """
    noise_model, layout, rng = fit.noise_model, fit.layout, np.random.default_rng(0)
    assert isinstance(noise_model, ProcessNoise)
    system, rows = layout.system, []
    p, _ = layout.split(fit.theta, 0)
    at = [system.parameters.index(name) for name in layout.shared if not name.startswith("bias_")]
    x, record = fit.lines[0].states, layout.problems[0].record
    u = np.array([record[name].values for name in system.input_names])
    u = u.reshape(len(system.input_names), len(record))  # also where there is none
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
    away = values - np.mean(values, axis=0)
    size = np.linalg.norm(away, axis=0)
    return int(
        np.linalg.matrix_rank(away / np.where(size > 0.0, size, 1.0), tol=_DEPENDENT_OUTPUT_SHARE)
    )


def _rms_about_mean(layout: FitLayout, output: int) -> float:
    """Return the root mean square of an output's samples about the mean of each record."""
    rows = [problem.z[output, problem.valid[output]] for problem in layout.problems]
    away = np.concatenate([row - np.mean(row) for row in rows if row.size])
    return float(np.sqrt(np.mean(away**2))) if away.size else 0.0


def levels_at_limit(fit: Fit) -> tuple[str, ...]:
    """Return the outputs whose noise level ran to its limit or to the rounding of their samples."""
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    own, low, high = _levels_and_limits(fit)
    lost = (own <= AT_ITS_LIMIT * low) | (own * AT_ITS_LIMIT >= high)
    return tuple(
        noise_model.outputs[i] for i, gone in zip(noise_model.estimated, lost, strict=True) if gone
    )


def _levels_and_limits(fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the estimated noise levels with the lowest and highest value of each, ``(k,)``."""
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    count = len(noise_model.estimated)
    own = fit.theta[len(fit.theta) - len(noise_model.names) :][:count]
    low = np.maximum(
        noise_model.low[:count], np.sqrt(fit.layout.smallest[list(noise_model.estimated)])
    )
    return own, low, noise_model.high[:count]


def absurd_sigmas(fit: Fit, std: np.ndarray) -> list[str]:
    """Return the shared parameters whose sigma ``(s,)`` is impossibly small for the length and
    noise of the records.

    One sample with a motion of r sigmas of its noise determines a factor on the motion to 1/r; all
    samples together to 1/sqrt(sum r^2). The noise is that of the third differences of the
    measurements.
    """
    layout = fit.layout
    shown = third_differences(
        [problem.z for problem in layout.problems], [problem.valid for problem in layout.problems]
    )
    told = 0.0
    for i in np.flatnonzero(layout.used):
        rows = np.concatenate([problem.z[i, problem.valid[i]] for problem in layout.problems])
        told += float(np.sum((rows - np.mean(rows)) ** 2)) / max(float(shown[i]) ** 2, 1e-300)
    least = IMPLAUSIBLE_SIGMA_SHARE / np.sqrt(max(told, 1.0))
    return [
        name
        for name, value, sigma in zip(
            layout.shared, fit.theta[: len(layout.shared)], std, strict=True
        )
        if sigma < least * abs(value)
    ]


def _starts(layout: FitLayout, calm: System, *, plain: bool) -> Iterator[StartOfFit]:
    """Yield starting layouts and noise levels. For unstable motion, derivatives are exact and the
    declared values come last.
    """
    if plain:
        yield layout, None
    if layout.prior is None:
        records = [problem.record for problem in layout.problems]
        for exact in (
            (layout,)
            if plain
            else (
                _for_unstable_motion(layout, _UNSTABLE_LEAST_DAMPING),
                _for_unstable_motion(layout, layout.settings.least_damping),
            )
        ):
            if not plain:
                # In gusts these starts converge in ten steps, those of equation error hardly.
                yield from _from_output_error(exact, records, calm)
            yield from _from_regression(exact, records, calm)
    if not plain:
        yield layout, None


def _for_unstable_motion(layout: FitLayout, least_damping: float) -> FitLayout:
    """Return the layout with exact derivatives that ends once the cost settles: the initial state
    of an unstable motion (growth e^15) never settles within its sigmas.
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
    try:
        found = run_equation_error(records, calm)
    except FlightidError:
        return
    if (
        found.outcome is Outcome.CONVERGED
        and np.all(np.isfinite(found.values))
        and np.all(found.noise_std > 0.0)
    ):
        levels = dict(zip(found.output_names, found.noise_std.tolist(), strict=True))
        yield _started_at(layout, found.as_dict()), {**levels, SCALE: 1.0}


def _from_output_error(layout: FitLayout, records: Sequence, calm: System) -> Iterator[StartOfFit]:
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
    start = np.array(
        [
            values.get(name, old)
            for name, old in zip(layout.names, layout.start.tolist(), strict=True)
        ]
    )
    return replace(layout, start=np.clip(start, layout.low, layout.high))
