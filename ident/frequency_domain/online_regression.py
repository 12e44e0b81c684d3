"""Parameters from the sums of a stream, by weighted regression, and their covariance.

The method differs from that of Morelli, Journal of Guidance, Control, and Dynamics 23(5), 2000, in
four points:

- Sensor noise in the regressors biases the estimate towards zero. The contribution of this noise to
  the normal matrix is known from the noise of the samples and is subtracted (Soderstrom,
  "Errors-in-Variables Methods in System Identification", Springer 2018, chapter 5).
- Errors at frequencies closer than one over the length of the stream are correlated. The covariance
  accounts for this, and for the correlation between equations.
- The spectrum of the residuals is that of the sensor noise, which the samples show, plus a fitted
  a + b omega^2. Without the sensor noise, the few low frequencies of a short stream may have small
  residuals by chance, and would then have most of the weight.
- At low frequencies, a sum of increments of white noise is mostly the error of its two end samples.
  These errors are common to all frequencies.

Low-order equivalent system. The pseudo-control delta with
delta_dot = (stick(t - delay) - delta) / tau is not measured. Given the time constant tau of the lag
and the delay, it follows from the stick alone. The equations are not linear in these two
parameters. In Gauss-Newton steps, the derivatives of the pseudo-control with respect to them are
two further regressors, so that the covariance of all parameters includes their uncertainty.
Low-order equivalent systems in the frequency domain are those of Morelli, "Identification of Low
Order Equivalent System Models from Flight Test Data", NASA TM-2000-210117.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.frequency_domain.online import (
    LinearParts,
    OnlineEquations,
    Sums,
    advance,
    empty_sums,
    online_equations,
)
from sim.declaration.model import System

# ---- Regression of the sums of a stream

# passes of the regression, each with the noise spectrum of the previous one
NOISE_SPECTRUM_PASSES = 4
# smallest share of the information that remains after the noise is subtracted
LEAST_INFORMATION_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class OnlineEstimate:
    """Estimate of q parameters from the sums of a stream.

    Attributes
    ----------
    values : ``(q,)`` estimates.
    covariance : ``(q, q)``, enlarged so that two standard deviations contain the true value with a
        probability of 95 % by Student's distribution. An undetermined parameter has an infinite
        variance.
    cost : minus the log likelihood without constants.
    residuals : ``(e, F)`` complex residuals of e equations at F frequencies.
    levels : ``(e, F)`` spectrum of the residuals.
    degrees : real degrees of freedom of the noise.
    """

    values: np.ndarray
    covariance: np.ndarray
    cost: float
    residuals: np.ndarray
    levels: np.ndarray
    degrees: float

    @property
    def std(self) -> np.ndarray:
        """Standard deviations ``(q,)``."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))


def estimate(
    equations: OnlineEquations, sums: Sums, further: np.ndarray | None = None
) -> OnlineEstimate | None:
    """Return the parameters by weighted regression; None if there are too few rows, or if noise
    dominates the regressors.

    ``further (e, k, F)`` are further regressors. Their coefficients follow the parameters.
    """
    if sums.rows < 3:
        return None
    e, f = sums.known_side.shape
    regressors = (
        sums.regressors if further is None else np.concatenate([sums.regressors, further], axis=1)
    )
    q = regressors.shape[1]
    all_regressors = np.zeros((e, q + e, f), dtype=complex)
    all_regressors[:, :q] = regressors
    all_regressors[range(e), range(q, q + e)] = sums.constant
    # The scale of each equation starts the spectrum of its residuals.
    sizes = np.sqrt(np.mean(np.abs(sums.known_side) ** 2, axis=1))
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    count = max(float(np.abs(sums.at_differences[0])), 1.0)
    levels = np.tile((sizes**2)[:, None], (1, f))
    near = np.abs(sums.at_differences) ** 2
    pairs = near[0] * f + 2.0 * float(near[1:] @ np.arange(f - 1, 0, -1))
    independent = f * f * near[0] / pairs  # complex values of one equation
    degrees = 2.0 * independent * e - np.count_nonzero(
        np.any(np.abs(all_regressors) > 0.0, axis=(0, 2))
    )
    if degrees < 3.0:
        return None
    for _ in range(NOISE_SPECTRUM_PASSES):
        result = _regressed(sums, all_regressors, levels, q - sums.regressors.shape[1])
        if result is None:
            return None
        theta, gain, unknown = result
        residuals = sums.known_side - np.einsum("ecf,c->ef", all_regressors, theta)
        # Degrees of freedom used by the regression in each equation: the trace of its part of the
        # hat matrix.
        spare = 2.0 * independent - np.einsum("aef,eaf->e", gain, all_regressors).real
        if np.any(spare < 2.0):
            return None
        sensors = _sensor_levels(equations, sums, theta[: len(equations.names)], count)
        known = sensors.within + sensors.ends
        levels = _levels(residuals, equations.omega, 2.0 * independent / spare, sizes, known)
    covariance = _covariance(gain, residuals, levels, sensors, sums, equations.omega, count)
    from scipy.stats import t

    # 1.959964 is the 0.975 quantile of the normal distribution.
    enlargement = float(t.ppf(0.975, degrees)) / 1.959964
    covariance = enlargement**2 * covariance
    covariance[unknown, :] = covariance[:, unknown] = 0.0
    covariance[unknown, unknown] = np.inf
    cost = independent / f * float(np.sum(np.log(levels) + np.abs(residuals) ** 2 / levels))
    return OnlineEstimate(theta[:q], covariance[:q, :q], cost, residuals, levels, degrees)


def _regressed(
    sums: Sums, all_regressors: np.ndarray, levels: np.ndarray, further: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Return the coefficients ``(c,)``, the gains ``(c, e, F)`` by which they follow from the known
    sides, and the positions of undetermined coefficients; None if noise dominates the regressors.

    Parameters
    ----------
    all_regressors : ``(e, c, F)``.
    levels : ``(e, F)`` spectrum of the residuals.
    """
    weights = 1.0 / levels
    normal = np.einsum("eaf,ef,ebf->ab", all_regressors.conj(), weights, all_regressors).real
    scale = np.sqrt(np.maximum(np.diag(normal), 0.0))
    unknown = scale <= 1e-12 * max(float(scale.max()), 1e-300)
    scale = np.where(unknown, 1.0, scale)
    scaled = normal / np.outer(scale, scale)
    scaled[unknown, :] = scaled[:, unknown] = 0.0
    noise_share = np.zeros_like(normal)
    p = sums.regressors.shape[1]
    noise, n = sums.noise_variance, sums.squared_slopes.shape[1]
    share = sums.squared_slopes[:, :, :p, :p]
    noise_share[:p, :p] = np.einsum("esab,s,e->ab", share, noise[:n], weights.sum(axis=1))
    without_noise = scaled - noise_share / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    undetermined = values < 1e-10 * max(float(values[-1]), 1e-300)
    kept_vectors = vectors[:, ~undetermined]
    inverse = np.asarray((kept_vectors / values[~undetermined]) @ kept_vectors.T)
    # share of the information that remains, in the direction with the largest share of noise
    root = kept_vectors / np.sqrt(values[~undetermined])
    kept = np.linalg.eigvalsh(root.T @ without_noise @ root)
    if kept.size and kept[0] >= LEAST_INFORMATION_SHARE:
        inverse = np.linalg.pinv(without_noise, rcond=1e-10, hermitian=True)
    elif kept.size:
        return None
    weak = np.any(np.abs(vectors[:, undetermined]) > 1e-3, axis=1)
    inverse = inverse / np.outer(scale, scale)
    gain = np.einsum("ab,ebf,ef->aef", inverse, all_regressors.conj(), weights)
    theta = np.einsum("aef,ef->a", gain, sums.known_side).real
    return theta, gain, np.flatnonzero(unknown | weak)


@dataclass(frozen=True, eq=False)
class SensorLevels:
    """Spectrum of the residuals that the noise of the samples causes.

    Attributes
    ----------
    within : ``(e, F)`` by all samples except the two ends of a sum of increments.
    ends : ``(e, F)`` by these two samples, whose errors are common to all frequencies.
    """

    within: np.ndarray
    ends: np.ndarray


def _sensor_levels(
    equations: OnlineEquations, sums: Sums, theta: np.ndarray, count: float
) -> SensorLevels:
    """Return the spectrum of the residuals due to white noise of the samples.

    The noise of a state acts on its increments, and on the rates that depend on it. The noise of an
    output acts on its own equation. ``theta (q,)`` are the parameters, and ``count`` is the number
    of steps.
    """
    noise, e, n = sums.noise_variance, len(equations.states), sums.squared_slopes.shape[1]
    step = (sums.time - sums.first) / count
    turned = np.abs(1.0 - np.exp(-1j * equations.omega * step)) ** 2
    one = np.append(theta, 1.0)
    shared = np.einsum("a,esab,b,s->e", one, sums.squared_slopes, one, noise[:n])
    within = np.tile(shared[:, None], (1, turned.size))
    ends = np.zeros_like(within)
    of_states = noise[list(equations.states)][:, None]
    within[:e] += count * of_states * turned
    within[e:] += count * noise[n:][:, None]
    ends[:e] = 2.0 * of_states
    return SensorLevels(within, ends)


def _levels(
    residuals: np.ndarray,
    omega: np.ndarray,
    larger: np.ndarray,
    sizes: np.ndarray,
    known: np.ndarray,
) -> np.ndarray:
    """Return the spectrum ``(e, F)`` of the residuals of each equation: the ``known (e, F)``
    spectrum by white noise of the samples, plus a fitted a + b omega^2 for process noise and
    coloured sensor noise.

    Parameters
    ----------
    larger : ``(e,)`` factors on the squared residuals that correct for the degrees of freedom used
        by the regression.
    sizes : ``(e,)`` rms of the known sides, which set the smallest level.
    """
    from scipy.optimize import nnls

    shapes = np.column_stack([np.ones(omega.size), (omega / omega[-1]) ** 2])
    out = np.empty(residuals.shape)
    for k, row in enumerate(residuals):
        power = larger[k] * np.abs(row) ** 2
        floor = 1e-24 * sizes[k] ** 2
        level = np.maximum(max(float(power.mean()), floor), known[k])
        for _ in range(3):
            solution = nnls(shapes / level[:, None], (power - known[k]) / level)[0]
            level = known[k] + shapes @ solution
            level = np.maximum(level, 1e-3 * max(float(level.max()), floor))
        out[k] = np.maximum(level, floor)
    return out


def _covariance(
    gain: np.ndarray,
    residuals: np.ndarray,
    levels: np.ndarray,
    sensors: SensorLevels,
    sums: Sums,
    omega: np.ndarray,
    count: float,
) -> np.ndarray:
    """Return the covariance of the coefficients ``gain @ residuals`` for noise that is correlated
    between frequencies and between equations. The errors of the two end samples of a sum of
    increments are added separately.
    """
    e, f = residuals.shape
    spread = np.sqrt(np.maximum(levels - sensors.ends, 0.0))
    scaled = residuals / np.sqrt(levels)
    correlation = np.real(scaled @ np.conj(scaled).T)
    size = np.sqrt(np.maximum(np.diag(correlation), 1e-300))
    correlation = correlation / np.outer(size, size)
    lag = np.subtract.outer(np.arange(f), np.arange(f))
    differences = sums.at_differences[np.abs(lag)] / count
    near = np.where(lag >= 0, differences, differences.conj())
    far = sums.at_sums[np.add.outer(np.arange(f), np.arange(f))] / count
    # The variance of Re(g e) for real noise is half of the real part of g N g* + g P g^T.
    g = gain * spread
    total = np.zeros((gain.shape[0],) * 2)
    for k in range(e):
        near_sum, turned = g[:, k] @ near, g[:, k] @ far
        for m in range(e):
            both = near_sum @ g[:, m].conj().T + turned @ g[:, m].T
            total += 0.5 * correlation[k, m] * both.real
    for at in (sums.first, sums.time):
        reached = np.einsum("aef,f->ae", gain, np.exp(-1j * omega * at)).real
        total += (reached * 0.5 * sensors.ends[:, 0]) @ reached.T
    return 0.5 * (total + total.T)


# ---- Low-order equivalent system on line, with a pseudo-control after a lag and a delay

LAG, DELAY, STATE = "inv_tau", "delay", "delta"
SHORTEST_LAG = 0.005  # s, smallest time constant of the lag
LONGEST_LAG = 2.0  # s, largest time constant of the lag
LONGEST_DELAY = 0.5  # s, largest delay
FACTORS = (1.0, 0.4, 2.5)  # factors on the lag where a search starts
GROWTH_BEFORE_FULL_SEARCH = 2  # factor of the number of rows after which all starts are tried again
MOST_STEPS = 8  # most steps of a search
SHARES = (1.0, 0.3, 0.1, 0.03)  # shares of a step that are tried
MOST_ROWS = 6000  # most rows of the pseudo-control: two and a half minutes at 40 Hz


@dataclass(frozen=True, eq=False)
class LagStream:
    """A stream of the low-order equivalent system.

    Attributes
    ----------
    equations : the equations with fixed lag and delay.
    sums : sums over the rows so far, with a pseudo-control of zero.
    times, stick : ``(N,)`` times, s, and stick of the rows.
    phasors : ``(N, F)`` exp(-j omega t), zero for rows without a complete state.
    slopes : ``(e, q)`` derivatives of the regressors with respect to the pseudo-control.
    lag_and_delay : last estimates of the time constant of the lag and of the delay, s.
    rows_at_last_search : number of rows at the last search from all starts.
    """

    equations: OnlineEquations
    sums: Sums
    times: np.ndarray
    stick: np.ndarray
    phasors: np.ndarray
    slopes: np.ndarray
    lag_and_delay: tuple[float, float]
    rows_at_last_search: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters, lag and delay last."""
        return (*self.equations.names, LAG, DELAY)


def lag_stream(system: System, omega: np.ndarray, measured: Sequence[str]) -> LagStream:
    """Return a stream without rows.

    Parameters
    ----------
    system : low-order equivalent system; its lag and delay start the search.
    omega : ``(F,)`` evenly spaced frequencies, rad/s.
    measured : names of the outputs in the stream.
    """
    lag = 1.0 / max(system.parameters[LAG].value, 1.0 / LONGEST_LAG)
    start = (max(lag, SHORTEST_LAG), system.parameters[DELAY].value)
    held = replace(system, parameters=system.parameters.hold([LAG, DELAY]))
    equations = online_equations(held, omega, measured, (STATE,))
    empty = np.zeros(0)
    phasors = np.zeros((0, omega.size), dtype=complex)
    slopes = _slopes(equations)
    return LagStream(equations, empty_sums(equations), empty, empty, phasors, slopes, start)


def with_rows(
    stream: LagStream,
    time: np.ndarray,
    stick: np.ndarray,
    outputs: np.ndarray,
    values: np.ndarray | None,
) -> LagStream:
    """Return the stream after further rows. Rows beyond ``MOST_ROWS`` are left out.

    Parameters
    ----------
    time, stick : ``(N,)`` times, s, and stick.
    outputs : ``(m, N)`` in the order of the System, NaN where a sample is missing.
    values : last estimate of all parameters, for the states at the middle of a step; or None.
    """
    free_rows = slice(0, max(MOST_ROWS - stream.times.size, 0))
    time, stick, outputs = time[free_rows], stick[free_rows], outputs[:, free_rows]
    if not time.size:
        return stream
    without_lag = None if values is None else values[: len(stream.equations.names)]
    sums = advance(stream.equations, stream.sums, time, stick[None], outputs, without_lag)
    complete = np.all(np.isfinite(outputs[[s for s in stream.equations.sources if s >= 0]]), axis=0)
    phasors = np.exp(-1j * np.outer(time, stream.equations.omega)) * complete[:, None]
    return replace(
        stream,
        sums=sums,
        times=np.append(stream.times, time),
        stick=np.append(stream.stick, stick),
        phasors=np.concatenate([stream.phasors, phasors]),
    )


def estimated(stream: LagStream) -> tuple[OnlineEstimate | None, LagStream]:
    """Return the estimate and the stream with its lag and delay. In the estimate, the inverse time
    constant of the lag and the delay follow the other parameters. It is None if the rows do not
    determine it.
    """
    if stream.times.size < 4:
        return None, stream
    starts = [stream.lag_and_delay]
    if stream.times.size >= GROWTH_BEFORE_FULL_SEARCH * stream.rows_at_last_search:
        step = float(np.median(np.diff(stream.times)))
        delays = np.arange(0.0, 0.3, max(0.03, step))
        starts += [
            (factor * stream.lag_and_delay[0], float(delay))
            for factor in FACTORS
            for delay in delays
        ]
        stream = replace(stream, rows_at_last_search=stream.times.size)
    fits = [(fit, start) for start in starts if (fit := _regression(stream, *start)) is not None]
    if not fits:
        return None, stream
    best, point = min(fits, key=lambda pair: pair[0].cost)
    q = len(stream.equations.names)
    for _ in range(MOST_STEPS):
        with_slopes = _regression(stream, *point, best.values[:q])
        if with_slopes is None:
            return None, stream
        moved = False
        for share in SHARES:
            change = share * with_slopes.values[q:]
            lag, delay = point[0] + change[0], point[1] + change[1]
            trial_point = (
                float(np.clip(lag, SHORTEST_LAG, LONGEST_LAG)),
                float(np.clip(delay, 0.0, LONGEST_DELAY)),
            )
            trial = _regression(stream, *trial_point)
            if trial is not None and trial.cost < best.cost:
                gained, best, point, moved = best.cost - trial.cost, trial, trial_point, True
                break
        if not moved or gained < 1e-3:
            break
    with_slopes = _regression(stream, *point, best.values[:q])
    if with_slopes is None:
        return None, stream
    # The parameter is the inverse of the time constant.
    to_inverse = np.ones(q + 2)
    to_inverse[q] = -1.0 / point[0] ** 2
    values = np.concatenate([best.values[:q], [1.0 / point[0], point[1]]])
    result = replace(
        with_slopes,
        values=values,
        covariance=with_slopes.covariance * np.outer(to_inverse, to_inverse),
        cost=best.cost,
    )
    return result, replace(stream, lag_and_delay=point)


def _regression(
    stream: LagStream, time_constant: float, delay: float, values: np.ndarray | None = None
) -> OnlineEstimate | None:
    """Return the regression for a given time constant of the lag and a given ``delay``, s.

    With ``values (q,)`` of the other parameters, the regression also has the derivatives with
    respect to time constant and delay as regressors. Their coefficients follow the others.
    """
    sums = stream.sums
    pseudo_control_part = _transforms(stream, time_constant, delay)[:, None, :]
    regressors = sums.regressors + stream.slopes[:, :, None] * pseudo_control_part
    with_lag = replace(sums, regressors=regressors)
    if values is None:
        return estimate(stream.equations, with_lag)
    size = stream.slopes @ values
    columns = []
    for k, reach in enumerate((1e-3 * time_constant, 1e-4)):
        ends = []
        for sign in (1.0, -1.0):
            varied = [time_constant, delay]
            varied[k] += sign * reach
            ends.append(_transforms(stream, *varied))
        columns.append(size[:, None] * (ends[0] - ends[1]) / (2.0 * reach))
    further = np.stack(columns, axis=1)
    return estimate(stream.equations, with_lag, further)


def _slopes(equations: OnlineEquations) -> np.ndarray:
    """Return the derivatives ``(e, q)`` of all regressors with respect to the pseudo-control."""
    system, points = equations.system, LinearParts(equations, None)
    n, time = len(system.states), np.zeros(1)
    unit = np.zeros((n, 1))
    unit[system.state_names.index(STATE)] = 1.0
    still = np.zeros((len(system.inputs), 1))
    rows = []
    for function, which in ((system.f, equations.states), (system.h, equations.readings)):
        at_one, at_zero = (
            points.split(function, time, state, still)[1] for state in (unit, 0.0 * unit)
        )
        slope = at_one - at_zero
        rows += [slope[k, :, 0] for k in which]
    return np.array(rows)


def _transforms(stream: LagStream, time_constant: float, delay: float) -> np.ndarray:
    """Return the transforms ``(e, F)`` of the pseudo-control: of its integrals over the steps for
    equations of states, and of its samples for equations of outputs. ``time_constant`` of the lag
    and ``delay`` are in s.
    """
    delta, integral = pseudo_control(stream.times, stream.stick, 1.0 / time_constant, delay)
    recorded = np.abs(stream.phasors[:, 0]) > 0.0
    phasors, e = stream.phasors[recorded], len(stream.equations.states)
    out = np.empty((len(stream.slopes), phasors.shape[1]), dtype=complex)
    out[:e] = np.diff(integral[recorded]) @ phasors[:-1]
    out[e:] = delta[recorded] @ phasors
    return out


def pseudo_control(
    times: np.ndarray, stick: np.ndarray, lag: float, delay: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the pseudo-control and its integral at the rows, ``(N,)`` each, for a stick that is
    constant between rows.

    Parameters
    ----------
    times, stick : ``(N,)`` times, s, and stick.
    lag : inverse time constant of the lag, 1/s.
    delay : s.

    Before the first row the pseudo-control equals the first stick. The result is exact for even
    steps; otherwise it is interpolated linearly between even steps.
    """
    from scipy.signal import lfilter

    step = float(np.median(np.diff(times)))
    count = int(np.ceil((times[-1] - times[0]) / step - 1e-6)) + 1
    grid = times[0] + step * np.arange(count)
    last_row = np.clip(
        np.searchsorted(times, grid + 1e-6 * step, side="right") - 1, 0, times.size - 1
    )
    u = stick[last_row] - stick[0]
    whole_samples, rest = divmod(max(delay, 0.0), step)
    before = np.concatenate([np.zeros(int(whole_samples) + 1), u])[:count]
    now = np.concatenate([np.zeros(int(whole_samples)), u])[:count]
    first_decay, second_decay = np.exp(-lag * rest), np.exp(-lag * (step - rest))
    change = second_decay * (1.0 - first_decay) * before + (1.0 - second_decay) * now
    delta = np.concatenate([[0.0], lfilter([1.0], [1.0, -first_decay * second_decay], change)[:-1]])
    area = np.concatenate([[0.0], np.cumsum(rest * before + (step - rest) * now)[:-1]])
    integral = area - delta / lag
    rows = [np.interp(times, grid, each) for each in (delta, integral)]
    return rows[0] + stick[0], rows[1] + stick[0] * (times - times[0])
