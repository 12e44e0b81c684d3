"""The low-order equivalent system on line: equation error with a pseudo-control after a lag and a
delay.

The pseudo-control delta_dot = (stick(t - delay) - delta) / tau is not measured, and its lag and
delay are the two parameters by which the equations are not linear. Given both, it follows
from the stick alone. In the Gauss-Newton steps its derivatives with respect to them are two more
regressors, so that the covariance of all parameters counts their uncertainty. Low-order equivalents
in the frequency domain: Morelli, "Identification of Low Order Equivalent System Models from Flight
Test Data", NASA TM-2000-210117.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.frequency_domain.online import (
    OnlineEquations,
    Points,
    Sums,
    advance,
    begin,
    online_equations,
)
from ident.frequency_domain.online_regression import OnlineEstimate, estimate
from sim.declaration.model import System

LAG, DELAY, STATE = "inv_tau", "delay", "delta"
SHORTEST_LAG = 0.005  # s, smallest time constant of the lag
LONGEST_LAG = 2.0  # s, largest time constant of the lag
LONGEST_DELAY = 0.5  # s, largest delay
FACTORS = (1.0, 0.4, 2.5)  # factors on the lag where a search starts
GROWTH_BEFORE_FULL_SEARCH = 2  # growth of the number of rows that triggers a search from all starts
MOST_STEPS = 8  # most steps of a search
SHARES = (1.0, 0.3, 0.1, 0.03)  # shares of a step that are tried
MOST_ROWS = 6000  # most rows of the pseudo-control: two and a half minutes at 40 Hz


@dataclass(frozen=True, eq=False)
class LagStream:
    """A stream of the low-order equivalent system.

    Attributes
    ----------
    equations : with lag and delay held.
    sums : of the rows so far, the pseudo-control at zero.
    times, stick : of the rows, ``(N,)``.
    phasors : ``(N, F)``, exp(-j omega t).
    slopes : ``(e, q)``, derivatives of the regressors with respect to the pseudo-control.
    place : the last time constant of the lag and delay, s; ``searched``: rows at the last search
        from everywhere.
    """

    equations: OnlineEquations
    sums: Sums
    times: np.ndarray
    stick: np.ndarray
    phasors: np.ndarray
    slopes: np.ndarray
    place: tuple[float, float]
    searched: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the estimated parameters, lag and delay last."""
        return (*self.equations.names, LAG, DELAY)


def lag_stream(system: System, omega: np.ndarray, measured: Sequence[str]) -> LagStream:
    """Return a stream without rows. ``system`` : the low-order equivalent, its start where it is
    searched from.
    """
    lag = 1.0 / max(system.parameters[LAG].value, 1.0 / LONGEST_LAG)
    start = (max(lag, SHORTEST_LAG), system.parameters[DELAY].value)
    held = replace(system, parameters=system.parameters.hold([LAG, DELAY]))
    equations = online_equations(held, omega, measured, (STATE,))
    empty = np.zeros(0)
    phasors = np.zeros((0, omega.size), dtype=complex)
    slopes = _slopes(equations)
    return LagStream(equations, begin(equations), empty, empty, phasors, slopes, start)


def with_rows(
    stream: LagStream,
    time: np.ndarray,
    stick: np.ndarray,
    outputs: np.ndarray,
    values: np.ndarray | None,
) -> LagStream:
    """The stream after further rows: ``time``, ``stick`` ``(N,)``, ``outputs`` ``(m, N)``;
    ``values`` : the last estimate, for the curvature within a step. Rows beyond ``MOST_ROWS`` are
    left out."""
    free_rows = slice(0, max(MOST_ROWS - stream.times.size, 0))
    time, stick, outputs = time[free_rows], stick[free_rows], outputs[:, free_rows]
    if not time.size:
        return stream
    without_lag = None if values is None else values[: len(stream.equations.names)]
    sums = advance(stream.equations, stream.sums, time, stick[None], outputs, without_lag)
    complete = np.all(np.isfinite(outputs[[s for s in stream.equations.sources if s >= 0]]), axis=0)
    phasors = np.exp(-1j * np.outer(time, stream.equations.omega)) * complete[:, None]
    joined = [
        np.concatenate(each)
        for each in ((stream.times, time), (stream.stick, stick), (stream.phasors, phasors))
    ]
    return replace(stream, sums=sums, times=joined[0], stick=joined[1], phasors=joined[2])


def estimated(stream: LagStream) -> tuple[OnlineEstimate | None, LagStream]:
    """Return the estimate, lag and delay after the other parameters, and the stream with their
    last values.
    """
    if stream.times.size < 4:
        return None, stream
    starts = [stream.place]
    if stream.times.size >= GROWTH_BEFORE_FULL_SEARCH * stream.searched:
        step = float(np.median(np.diff(stream.times)))
        delays = np.arange(0.0, 0.3, max(0.03, step))
        starts += [
            (factor * stream.place[0], float(delay)) for factor in FACTORS for delay in delays
        ]
        stream = replace(stream, searched=stream.times.size)
    outcome = [(each, one) for one in starts if (each := _regression_at(stream, *one)) is not None]
    if not outcome:
        return None, stream
    best, place = min(outcome, key=lambda pair: pair[0].cost)
    q = len(stream.equations.names)
    for _ in range(MOST_STEPS):
        with_slopes = _regression_at(stream, *place, best.values[:q])
        if with_slopes is None:
            return None, stream
        moved = False
        for share in SHARES:
            change = share * with_slopes.values[q:]
            lag, delay = place[0] + change[0], place[1] + change[1]
            place_tried = (
                float(np.clip(lag, SHORTEST_LAG, LONGEST_LAG)),
                float(np.clip(delay, 0.0, LONGEST_DELAY)),
            )
            trial = _regression_at(stream, *place_tried)
            if trial is not None and trial.cost < best.cost:
                gained, best, place, moved = best.cost - trial.cost, trial, place_tried, True
                break
        if not moved or gained < 1e-3:
            break
    with_slopes = _regression_at(stream, *place, best.values[:q])
    if with_slopes is None:
        return None, stream
    # From the time constant to its inverse, which the parameter is.
    to_inverse = np.ones(q + 2)
    to_inverse[q] = -1.0 / place[0] ** 2
    values = np.concatenate([best.values[:q], [1.0 / place[0], place[1]]])
    result = replace(
        with_slopes,
        values=values,
        covariance=with_slopes.covariance * np.outer(to_inverse, to_inverse),
        cost=best.cost,
    )
    return result, replace(stream, place=place)


def _regression_at(
    stream: LagStream, time: float, delay: float, values: np.ndarray | None = None
) -> OnlineEstimate | None:
    """The regression with time constant of the lag and delay given, s; with ``values`` of the other
    parameters also over small changes of the two, whose coefficients follow."""
    sums = stream.sums
    filled = (
        sums.regressors + stream.slopes[:, :, None] * _transforms(stream, time, delay)[:, None, :]
    )
    whole = replace(sums, regressors=filled)
    if values is None:
        return estimate(stream.equations, whole)
    size = stream.slopes @ values
    columns = []
    for k, reach in enumerate((1e-3 * time, 1e-4)):
        ends = []
        for sign in (1.0, -1.0):
            moved = [time, delay]
            moved[k] += sign * reach
            ends.append(_transforms(stream, *moved))
        columns.append(size[:, None] * (ends[0] - ends[1]) / (2.0 * reach))
    more = np.stack(columns, axis=1)
    return estimate(stream.equations, whole, more)


def _slopes(equations: OnlineEquations) -> np.ndarray:
    """Return the derivatives ``(e, q)`` of the regressors of all equations with respect to the
    pseudo-control.
    """
    system, points = equations.system, Points(equations, None)
    n, at = len(system.states), np.zeros(1)
    unit = np.zeros((n, 1))
    unit[system.state_names.index(STATE)] = 1.0
    still = np.zeros((len(system.inputs), 1))
    rows = []
    for function, which in ((system.f, equations.states), (system.h, equations.readings)):
        slope = (
            points.of(function, at, unit, still)[1] - points.of(function, at, 0.0 * unit, still)[1]
        )
        rows += [slope[k, :, 0] for k in which]
    return np.array(rows)


def _transforms(stream: LagStream, time: float, delay: float) -> np.ndarray:
    """Return the transforms of the pseudo-control ``(e, F)``: its integrals over the rows for
    rates, itself for outputs.
    """
    delta, whole = pseudo_control(stream.times, stream.stick, 1.0 / time, delay)
    recorded = np.abs(stream.phasors[:, 0]) > 0.0
    phasors, e = stream.phasors[recorded], len(stream.equations.states)
    out = np.empty((len(stream.slopes), phasors.shape[1]), dtype=complex)
    out[:e] = np.diff(whole[recorded]) @ phasors[:-1]
    out[e:] = delta[recorded] @ phasors
    return out


def pseudo_control(
    times: np.ndarray, stick: np.ndarray, lag: float, delay: float
) -> tuple[np.ndarray, np.ndarray]:
    """The pseudo-control and its integral at the rows, ``(N,)`` each, of a stick that is held.

    Before the first row it is at rest at the first stick. Exact where the rows are evenly spaced;
    else by lines on even steps.
    """
    from scipy.signal import lfilter

    step = float(np.median(np.diff(times)))
    count = int(np.ceil((times[-1] - times[0]) / step - 1e-6)) + 1
    grid = times[0] + step * np.arange(count)
    at = np.clip(np.searchsorted(times, grid + 1e-6 * step, side="right") - 1, 0, times.size - 1)
    u = stick[at] - stick[0]
    whole, rest = divmod(max(delay, 0.0), step)
    before = np.concatenate([np.zeros(int(whole) + 1), u])[:count]
    now = np.concatenate([np.zeros(int(whole)), u])[:count]
    first, second = np.exp(-lag * rest), np.exp(-lag * (step - rest))
    gained = second * (1.0 - first) * before + (1.0 - second) * now
    delta = np.concatenate([[0.0], lfilter([1.0], [1.0, -first * second], gained)[:-1]])
    area = np.concatenate([[0.0], np.cumsum(rest * before + (step - rest) * now)[:-1]])
    integral = area - delta / lag
    rows = [np.interp(times, grid, each) for each in (delta, integral)]
    return rows[0] + stick[0], rows[1] + stick[0] * (times - times[0])
