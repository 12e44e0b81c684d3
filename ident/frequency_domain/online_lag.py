"""The low-order equivalent system on line: equation error with a pseudo-control after a lag and a
delay.

The pseudo-control delta with delta_dot = (stick(t - delay) - delta) / tau is not measured. Given
the time constant tau of the lag and the delay, it follows from the stick alone. These are the two
parameters in which the equations are not linear. In Gauss-Newton steps, the derivatives of the
pseudo-control with respect to them are two further regressors, so that the covariance of all
parameters includes their uncertainty. Low-order equivalent systems in the frequency domain are
those of Morelli, "Identification of Low Order Equivalent System Models from Flight Test Data", NASA
TM-2000-210117.
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
from ident.frequency_domain.online_regression import OnlineEstimate, estimate
from sim.declaration.model import System

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
    extended = [
        np.concatenate(each)
        for each in ((stream.times, time), (stream.stick, stick), (stream.phasors, phasors))
    ]
    return replace(stream, sums=sums, times=extended[0], stick=extended[1], phasors=extended[2])


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
    """Return the derivatives ``(e, q)`` of the regressors of all equations with respect to the
    pseudo-control.
    """
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
