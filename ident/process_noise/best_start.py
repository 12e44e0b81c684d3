"""One fit with process noise from a given start, and the start that leads to an accepted maximum.

The likelihood of a filter-error fit has no bound: with a sensor's noise gone to zero a filter may
follow that sensor alone, at derivatives of any size and sigmas of next to nothing. From a start
near the truth the honest maximum is found; which of the two was found has to be asked.
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
_FEWEST_DIFFERENCES = 20  # third differences that tell a scatter
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
    guesses : trajectories to begin with. levels : measurement noise by output, and
    ``process_noise_scale`` if wanted, of a
        fit of nearly the same model: a warm start. When None they come from an output-error fit,
        which also moves the other unknowns' start.
    least : smallest measurement noise by output. Process noise can take in the noise of a sensor,
    whose level then has no optimum above zero.
    """
    layout = _never_still(layout)
    if levels is None:
        coarse = replace(
            layout.settings, tolerance=max(COARSE_TOLERANCE, layout.settings.tolerance)
        )
        first = fit_whole_records(FitProblem(replace(layout, settings=coarse)), guesses)
        if first is None:
            return None
        start, guesses = first.theta.copy(), [line.states for line in first.lines]
        noise = noise_start(first)
        factor = _size_of_motion(first, noise)
        for position, value in _amplitudes(layout).items():
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


def _amplitudes(layout: FitLayout) -> dict[int, float]:
    """Unknowns that nothing forces a state without (intensities): positions in theta and starting
    values.
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


def _never_still(layout: FitLayout) -> FitLayout:
    """Return the same layout with intensities kept off zero, where the likelihood is flat and a fit
    would stay for ever.
    """
    low = layout.low.copy()
    for position, value in _amplitudes(layout).items():
        low[position] = _LEAST_INTENSITY_SHARE * value
    return replace(layout, low=low)


def _size_of_motion(fit: Fit, noise: np.ndarray) -> float:
    """Factor on the start's forcing that makes the process noise as large as what the residuals
    hold beyond noise ``(m,)``.
    """
    layout = fit.layout
    expected, beyond = np.zeros(len(noise)), np.maximum(fit.variance - noise**2, 1e-4 * noise**2)
    for r, (problem, line) in enumerate(zip(layout.problems, fit.lines, strict=True)):
        motion = discretised_noise(
            problem, line.states, Variation(layout.split(layout.start, r)[0], 1.0)
        )
        # A filter that trusts no measurement propagates the covariance of the motion itself.
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
    """Measurement noise ``(m,)`` read off the residuals of an output-error fit, of which the slow
    part is process noise.

    Scatter of third differences of samples in a row, which pass white noise and hardly anything
    slow; not more than the residual.
    """
    std = np.sqrt(fit.variance)
    shown = third_differences(fit.residuals, [problem.valid for problem in fit.layout.problems])
    return np.clip(np.where(np.isfinite(shown), shown, std), 0.02 * std, std)


def third_differences(rows: Sequence[np.ndarray], valid: Sequence[np.ndarray]) -> np.ndarray:
    """Return the level ``(m,)`` of white noise that third differences of ``rows (m, N)`` a record
    show; infinite with too few ``valid`` samples in a row.
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


# ---- Where a fit with process noise begins, and whether it ended at an honest maximum

# times the lowest (or one over that times the highest) value of a noise level: it has run there, or
# would with one step more
AT_ITS_LIMIT = 2.0
# of the sigma that all samples together could give a parameter each of them shows fully: no record
# knows it better
IMPLAUSIBLE_SIGMA_SHARE = 1e-3
# draws about the fit, and the change of each parameter relative to its value
_CHANGES, _CHANGED = 100, 0.3
# of an output's change, below which it follows from the others: far above rounding, far below any
# parameter's part
_DEPENDENT_OUTPUT_SHARE = 1e-6
_NEGLIGIBLE_GAIN = 1e-4  # of log likelihood: a step that gains less is none
# Of a motion that grows: in gusts fits settle in ten to thirty steps with it, and creep with 1e-7;
# in still air the usual one does better.
_LEAST_DAMPING = 1e-10
Begun = tuple[FitLayout, Mapping[str, float] | None]


def fit_from_best_start(layout: FitLayout, calm: System | None = None) -> Fit | None:
    """Return the filter-error fit of a layout; None where no start has a finite cost.

    ``calm`` is the same model without the effect that forces its states (None: the layout's own),
    of which equation error and output error give further starts: where the motion grows at the
    declared values, and where the fit from them does not settle or is degenerate. The first fit
    that settles at an honest maximum is returned, else the best by that order: honest, settled,
    likely.
    """
    tried: list[Fit] = []
    plain = without_process_noise.quiet(layout)
    for begun, levels in _starts(layout, calm or layout.system, plain=plain):
        fit = fit_with_process_noise(begun, levels=levels)
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
    """Return whether the noise level of a measured output has run to its limit, or to the rounding
    of its samples, and the record does not explain that.
    """
    return bool(levels_at_limit(fit)) and not without_measurement_noise(fit)


def without_measurement_noise(fit: Fit) -> bool:
    """Return whether the record itself has hardly any measurement noise: all outputs are met so,
    and more of them than process noise has sources.

    A filter may follow as many outputs exactly as process noise has sources, whatever the
    derivatives are; each further output is met exactly by the right ones only, unless it repeats
    others (see ``_distinct_outputs``). Noise levels and sigmas are then upper bounds.
    """
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    own, low, _ = _levels_and_limits(fit)
    quiet = QUIET_NOISE_SHARE * np.array([_motion(fit.layout, i) for i in noise_model.estimated])
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
    """Return the number of estimated outputs of which none is the same function of others at every
    value of the parameters, a constant apart.

    A channel recorded twice, or an angle computed from a measured velocity, repeats another one: a
    filter that follows the one meets both, at any derivatives. The number is the rank of the
    outputs at states, inputs and parameters all changed about the fit.
    """
    noise_model, layout, rng = fit.noise_model, fit.layout, np.random.default_rng(0)
    assert isinstance(noise_model, ProcessNoise)
    system, rows = layout.system, []
    p, _ = layout.split(fit.theta, 0)
    at = [system.parameters.index(name) for name in layout.shared if not name.startswith("bias_")]
    x, record = fit.lines[0].states, layout.problems[0].record
    u = np.array([record[name].values for name in system.input_names])
    x_size, u_size = np.std(x, axis=1), np.std(u, axis=1)
    with np.errstate(all="ignore"):
        for _ in range(_CHANGES):
            k = rng.integers(len(record))
            states = x[:, min(k, x.shape[1] - 1)] + x_size * rng.standard_normal(len(x_size))
            inputs = u[:, k] + u_size * rng.standard_normal(len(u_size))
            changed = p.copy()
            changed[at] *= 1.0 + _CHANGED * rng.standard_normal(len(at))
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


def _motion(layout: FitLayout, output: int) -> float:
    """Return the root mean square of an output's samples about the mean of each record."""
    rows = [problem.z[output, problem.valid[output]] for problem in layout.problems]
    away = np.concatenate([row - np.mean(row) for row in rows if row.size])
    return float(np.sqrt(np.mean(away**2))) if away.size else 0.0


def levels_at_limit(fit: Fit) -> tuple[str, ...]:
    """Return the outputs of which a fit knows no noise level: it has run to its limit, or to the
    rounding of their samples.
    """
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    own, low, high = _levels_and_limits(fit)
    lost = (own <= AT_ITS_LIMIT * low) | (own * AT_ITS_LIMIT >= high)
    return tuple(
        noise_model.outputs[i] for i, gone in zip(noise_model.estimated, lost, strict=True) if gone
    )


def _levels_and_limits(fit: Fit) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimated noise levels with the lowest and highest value of each, ``(k,)``."""
    noise_model = fit.noise_model
    assert isinstance(noise_model, ProcessNoise)
    count = len(noise_model.estimated)
    own = fit.theta[len(fit.theta) - len(noise_model.names) :][:count]
    low = np.maximum(
        noise_model.low[:count], np.sqrt(fit.layout.smallest[list(noise_model.estimated)])
    )
    return own, low, noise_model.high[:count]


def absurd_sigmas(fit: Fit, std: np.ndarray) -> list[str]:
    """Shared parameters whose sigma ``(s,)`` is smaller than any record of this length and noise
    can give.

    A sample whose motion is r sigmas of its noise knows a factor on that motion to 1/r; all
    together to 1/sqrt(sum r^2). The noise is that which the third differences of the measurements
    show, whatever the fit made of it.
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


def _starts(layout: FitLayout, calm: System, *, plain: bool) -> Iterator[Begun]:
    """Layouts and noise levels to begin with; of a motion that grows, derivatives are exact, and
    the declared values come last.
    """
    if plain:
        yield layout, None
    if layout.prior is None:
        records = [problem.record for problem in layout.problems]
        for exact in (
            (layout,)
            if plain
            else (_exactly(layout, _LEAST_DAMPING), _exactly(layout, layout.settings.least_damping))
        ):
            if not plain:
                # In gusts fits from here settle in ten steps, where those from equation error
                # creep.
                yield from _from_output_error(exact, records, calm)
            yield from _from_regression(exact, records, calm)
    if not plain:
        yield layout, None


def _exactly(layout: FitLayout, least_damping: float) -> FitLayout:
    """Return the layout with exact derivatives, settled where its cost is: an initial state that
    grows by e^15 never stands still in its own sigmas.
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


def _from_regression(layout: FitLayout, records: Sequence, calm: System) -> Iterator[Begun]:
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
        yield _begun(layout, found.as_dict()), {**levels, SCALE: 1.0}


def _from_output_error(layout: FitLayout, records: Sequence, calm: System) -> Iterator[Begun]:
    masks = [problem.valid for problem in layout.problems]
    fit = without_process_noise.fit_from_best_start(
        lay_out(records, calm, layout.settings, local=layout.local, masks=masks)
    )
    if fit is not None:
        levels = dict(zip(calm.output_names, noise_start(fit).tolist(), strict=True))
        yield (
            _begun(layout, dict(zip(fit.layout.names, fit.theta.tolist(), strict=True))),
            {**levels, SCALE: 1.0},
        )


def _begun(layout: FitLayout, values: Mapping[str, float]) -> FitLayout:
    start = np.array(
        [
            values.get(name, old)
            for name, old in zip(layout.names, layout.start.tolist(), strict=True)
        ]
    )
    return replace(layout, start=np.clip(start, layout.low, layout.high))
