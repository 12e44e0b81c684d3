"""State histories for equation error, from local polynomials fitted to the channels of a record,
and residuals of the equations of motion at these states.

The smoothing is that of Savitzky and Golay, Analytical Chemistry 36(8), 1964. The weights of each
window are computed for its own sample times, so that sampling may be uneven and samples may be
missing. Near the ends of a record the window keeps its width and is not centred on the sample.

A state with a channel of its own name is smoothed from this channel. A state that is the rate of
another state, such as velocity, the rate of altitude, is the slope of that state. Nothing is
simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ident.estimate import LARGEST_NUMBER
from sim.declaration.model import System
from sim.errors import ModelError
from sim.maths import COMPLEX_STEP, complex_step_jacobian
from sim.propagation import drive_from_record, make_grid
from sim.record import Record

# ---- Smoothing and slopes by polynomials fitted to a moving window of samples

_EVEN_SAMPLING_TOLERANCE = 1e-9  # largest relative difference of even intervals
_SMOOTHING_DEGREE = 2  # degree of the local polynomials that smooth a channel
_SLOPE_STATE_DEGREE = 3  # degree of the local polynomials whose slope is a state
HALF_WIDTHS = (2, 3, 4, 6, 8, 11, 16, 23, 32, 45, 64)  # candidate half widths, rows
_LEAST_ROWS_PER_HALF_WIDTH = 6  # the largest half width is one sixth of the rows of a record
_LONGEST_WINDOW = 2.0  # longest duration of a window with gaps, relative to one without gaps


@dataclass(frozen=True, eq=False)
class Windows:
    """Weights of the samples in N moving windows of W consecutive rows, one window for each row.

    Attributes
    ----------
    first : ``(N,)`` first row of each window.
    value_weights : ``(N, W)`` weights whose sum of products with the samples is the fit at the row.
    slope_weights : ``(N, W)`` the same for the slope of the fit, 1/s.
    usable : ``(N,)`` False where more than half of the samples of the window are missing, or gaps
        make it more than twice as long as usual. All weights of the window are then zero.

    The weights of missing samples are zero.
    """

    first: np.ndarray
    value_weights: np.ndarray
    slope_weights: np.ndarray
    usable: np.ndarray

    def gather(self, rows: np.ndarray) -> np.ndarray:
        """Return the entries of ``rows (N, ...)`` in each window, ``(N, W, ...)``."""
        return rows[self.first[:, None] + np.arange(self.value_weights.shape[1])]


def windows(time: np.ndarray, valid: np.ndarray, half_width: int, degree: int) -> Windows:
    """Return the windows of ``2 half_width + 1`` rows for polynomials of a ``degree``.

    ``time (N,)`` is in s, and ``valid (N,)`` is False for missing samples.
    """
    n = len(time)
    width = min(2 * half_width + 1, n)
    first = np.clip(np.arange(n) - half_width, 0, n - width)
    gaps = np.diff(time)
    if n > 2 * width and np.all(valid) and np.ptp(gaps) < _EVEN_SAMPLING_TOLERANCE * gaps[0]:
        # The weights depend only on the place of the row in its window. They are computed for 2 W
        # rows, which contain all places, and copied.
        part = windows(time[: 2 * width], valid[: 2 * width], half_width, degree)
        place = np.arange(n) - first
        row_of_part = np.where(place <= half_width, place, place + width)
        return Windows(
            first,
            part.value_weights[row_of_part],
            part.slope_weights[row_of_part],
            part.usable[row_of_part],
        )
    rows = first[:, None] + np.arange(width)
    present = valid[rows]
    offset = time[rows] - time[:, None]
    span = np.abs(offset).max(axis=1)
    usable = present.sum(axis=1) >= max(degree + 2, (width + 1) // 2)
    longest = _LONGEST_WINDOW * (width - 1) * float(np.median(np.diff(time)))
    usable &= (time[rows[:, -1]] - time[rows[:, 0]]) <= longest
    powers = (offset / span[:, None])[:, :, None] ** np.arange(degree + 1) * present[:, :, None]
    normal = np.swapaxes(powers, 1, 2) @ powers
    normal[~usable] = np.eye(degree + 1)
    weights = np.linalg.solve(normal, np.swapaxes(powers, 1, 2)) * usable[:, None, None]
    slope = weights[:, 1] / span[:, None] if degree else np.zeros_like(weights[:, 0])
    return Windows(first, weights[:, 0], slope, usable)


def smoothed(
    time: np.ndarray, values: np.ndarray, valid: np.ndarray, half_width: int
) -> np.ndarray:
    """Return the smoothed values ``(N,)`` of a channel. Where the window is not usable, they are
    interpolated linearly between the valid samples.
    """
    fit = windows(time, valid, half_width, _SMOOTHING_DEGREE)
    return np.where(
        fit.usable,
        np.sum(fit.value_weights * fit.gather(values), axis=1),
        np.interp(time, time[valid], values[valid]),
    )


def half_width_by_cross_validation(time: np.ndarray, values: np.ndarray, valid: np.ndarray) -> int:
    """Return the half width among ``HALF_WIDTHS`` with the least mean square prediction error of
    each sample from the others.

    The prediction error is (z - fit) / (1 - w), where w is the weight of the sample itself in the
    fit (Allen 1974, Stone 1974).
    """
    best, least_mean_square = HALF_WIDTHS[0], np.inf
    for half_width in HALF_WIDTHS:
        if half_width > max(len(time) // _LEAST_ROWS_PER_HALF_WIDTH, HALF_WIDTHS[0]):
            break
        fit = windows(time, valid, half_width, _SMOOTHING_DEGREE)
        rows = np.flatnonzero(fit.usable & valid)
        if rows.size == 0:
            continue
        own_weight = fit.value_weights[rows, rows - fit.first[rows]]
        residual = values[rows] - np.sum(fit.value_weights * fit.gather(values), axis=1)[rows]
        mean_square = float(np.mean((residual / np.maximum(1.0 - own_weight, 1e-6)) ** 2))
        if mean_square < least_mean_square:
            best, least_mean_square = half_width, mean_square
    return best


# ---- State histories for equation error, from a record alone

Function = Callable[[Any, Any, Any, Any], Sequence[Any]]
SLOPE_FACTOR = 2  # the window of a slope is wider by this factor: slopes are noisier than values
# Whether an output is a state, or a state is the rate of another one, is tested at two arbitrary
# points, each shifted by one of these values.
_POINT_SHIFTS = (0.37, 0.71)
_GENERIC_INPUT = 0.1


@dataclass(frozen=True, eq=False)
class StateData:
    """Data of one state over a record.

    Attributes
    ----------
    raw : ``(N,)`` measured values, or slopes of another state.
    valid : ``(N,)`` whether a value of ``raw`` is usable.
    smooth : ``(N,)`` smoothed values for the regressors.
    slope_windows : windows whose ``slope_weights``, applied to ``raw``, give the left-hand side of
        the state equation.
    bias : position of the bias of the channel among all parameters; None without a bias.
    rate_state : name of the state that is the slope of this one; empty if there is none. The
        equation of this state is then satisfied by construction.
    """

    raw: np.ndarray
    valid: np.ndarray
    smooth: np.ndarray
    slope_windows: Windows
    bias: int | None
    rate_state: str = ""


def state_data(record: Record, system: System) -> list[StateData]:
    """Return the data of every state of the System, in its order.

    The half width of a smoothing window is that of ``half_width_by_cross_validation``; windows of
    slopes are wider by ``SLOPE_FACTOR``.

    Raises
    ------
    ModelError : if a state is neither recorded nor the rate of a recorded state.
    """
    names = system.state_names
    data: dict[str, StateData] = {}
    half_widths: dict[str, int] = {}
    for name in names:
        if name in record.output_names and name in system.output_names:
            _require_direct_reading(system, name, record.time)
            channel = record[name]
            half = half_width_by_cross_validation(record.time, channel.values, channel.valid)
            bias_name = f"bias_{name}"
            bias = system.parameters.index(bias_name) if bias_name in system.parameters else None
            smooth = smoothed(record.time, channel.values, channel.valid, half)
            slope_windows = windows(record.time, channel.valid, SLOPE_FACTOR * half, 1)
            data[name] = StateData(channel.values, channel.valid, smooth, slope_windows, bias)
            half_widths[name] = half
    relations = rate_relations(system, record.time)
    missing = [name for name in names if name not in data]
    while missing:
        derived = [
            (name, source)
            for name in missing
            for source, rate in relations.items()
            if rate == name and source in data
        ]
        if not derived:
            state = missing[0]
            raise ModelError(
                f"state {state} is neither recorded nor the rate of a recorded state",
                where=f"equation error, {record.name}",
                remedy=f"record a channel {state}, or use output-error or a filter",
            )
        for name, source in derived:
            half = SLOPE_FACTOR * half_widths[source]
            data[name], data[source] = _from_slope(record.time, data[source], half, name)
            half_widths[name] = half
        missing = [name for name in names if name not in data]
    return [data[name] for name in names]


def rate_relations(system: System, times: np.ndarray) -> dict[str, str]:
    """Return state -> its rate, for states whose rate is exactly another state, such as
    ``{"altitude": "velocity"}``.

    The Jacobian of f at two points must show this, and the values of f at all ``times``.
    """
    names, n_x, n_u = system.state_names, len(system.states), len(system.inputs)
    p = system.parameters.values()

    def rates(a: list) -> list:
        return system.f(float(times[0]), a[:n_x], a[n_x : n_x + n_u], a[n_x + n_u :])

    relations_at_points = []
    for shift in _POINT_SHIFTS:
        states = _generic_point(system.initial.values(), shift)
        point = np.concatenate([states, np.full(n_u, _GENERIC_INPUT + shift), p])
        values = _at_all_times(system.f, point, n_x, n_u, times)
        jacobian = complex_step_jacobian(rates, point.tolist())
        relations = {}
        for i, name in enumerate(names):
            for j in range(n_x):
                unit_row = np.zeros(len(point))
                unit_row[j] = 1.0
                if (
                    i != j
                    and np.array_equal(jacobian[i], unit_row)
                    and bool(np.all(values[i] == point[j]))
                ):
                    relations[name] = names[j]
        relations_at_points.append(relations)
    first, second = relations_at_points
    return {name: rate for name, rate in first.items() if second.get(name) == rate}


def _from_slope(
    time: np.ndarray, source: StateData, half: int, name: str
) -> tuple[StateData, StateData]:
    """Return the data of state ``name``, which is the rate of ``source``, and the data of
    ``source`` with ``name`` as its ``rate_state``.
    """
    fit = windows(time, source.valid, half, _SLOPE_STATE_DEGREE)
    if not np.any(fit.usable):
        raise ModelError(
            f"too few samples for the slope that gives state {name}",
            where="equation error",
            remedy="use a longer record",
        )
    slope = np.sum(fit.slope_weights * fit.gather(source.raw), axis=1)
    # The slope of this state is taken over a window of the same width: differences of neighbouring
    # slopes would be mostly noise.
    slope_windows = windows(time, fit.usable, half, 1)
    smooth = np.interp(time, time[fit.usable], slope[fit.usable])
    state = StateData(np.where(fit.usable, slope, 0.0), fit.usable, smooth, slope_windows, None)
    return state, replace(source, rate_state=name)


def _at_all_times(
    function: Function, point: np.ndarray, n_x: int, n_u: int, times: np.ndarray
) -> list[np.ndarray]:
    """Return each component of ``f`` or ``h`` over all ``times``, at one ``point`` of states,
    inputs and parameters. A component that does not depend on time may be a scalar.
    """
    a = point.tolist()
    return [np.asarray(row) for row in function(times, a[:n_x], a[n_x : n_x + n_u], a[n_x + n_u :])]


def _require_direct_reading(system: System, name: str, times: np.ndarray) -> None:
    """Raise ModelError unless output ``name`` is the state itself at all times, plus its bias."""
    n_x, n_u = len(system.states), len(system.inputs)
    states = _generic_point(system.initial.values(), _POINT_SHIFTS[0])
    point = np.concatenate([states, np.full(n_u, _GENERIC_INPUT), system.parameters.values()])
    row = system.output_names.index(name)

    def output(a: list) -> list:
        return [system.h(float(times[0]), a[:n_x], a[n_x : n_x + n_u], a[n_x + n_u :])[row]]

    direct_row = np.zeros(len(point))
    direct_row[system.state_names.index(name)] = 1.0
    if f"bias_{name}" in system.parameters:
        direct_row[n_x + n_u + system.parameters.index(f"bias_{name}")] = 1.0
    values = _at_all_times(system.h, point, n_x, n_u, times)[row]
    changes = bool(np.any(values != values.flat[0]))
    jacobian = complex_step_jacobian(output, point.tolist())[0]
    if changes or not np.array_equal(jacobian, direct_row):
        raise ModelError(
            f"output {name} is not state {name} plus a bias",
            where=f"equation error, state {name}",
            remedy="leave out the effect that changes the reading, or use output-error or a filter",
        )


def _generic_point(start: np.ndarray, shift: float) -> np.ndarray:
    """Return a point ``(n_x,)`` of the states away from special values, such as zero, one and equal
    states; ``shift`` selects one of several points.
    """
    return start * (1.0 + 0.1 * shift) + 0.01 * (shift + np.arange(1, len(start) + 1))


# ---- Residuals of the equations of motion at these states


@dataclass(frozen=True, eq=False)
class EquationResiduals:
    """Residuals of e equations at N samples of one record.

    Attributes
    ----------
    residual : ``(e, N)``, zero where it is not valid.
    valid : ``(e, N)``.
    jacobian : ``(e, N, c)`` derivatives of the right-hand sides with respect to the c unknowns.
    fitted : ``(m, N)`` outputs at the smoothed states.
    """

    residual: np.ndarray
    valid: np.ndarray
    jacobian: np.ndarray
    fitted: np.ndarray


@dataclass(frozen=True, eq=False)
class RegressionLayout:
    """Records of a fit with their states, and the order of the unknowns: shared parameters, then
    the biases of each record.

    Attributes
    ----------
    system : the model.
    shared : names of the shared parameters.
    local : names of the biases of each record.
    records : the records.
    data : measured and smoothed states of each record.
    positions : positions of ``shared`` and ``local`` among all parameters.
    """

    system: System
    shared: tuple[str, ...]
    local: tuple[str, ...]
    records: tuple[Record, ...]
    data: tuple[list[StateData], ...]
    positions: list[int] = field(default_factory=list)

    def columns(self, r: int) -> np.ndarray:
        """Return the positions in theta of the shared unknowns and of those of record ``r``."""
        shared, local = len(self.shared), len(self.local)
        return np.concatenate([np.arange(shared), shared + r * local + np.arange(local)])


def regression_layout(records: Sequence[Record], system: System) -> RegressionLayout:
    """Return the unknowns and states of a fit."""
    if system.sensor_stages:
        raise ModelError(
            f"effect {system.sensor_stages[0]} keeps a memory on the sensor path",
            where="equation error",
            remedy="use output-error",
        )
    recorded = {name for record in records for name in record.output_names}
    free = [
        name
        for name in system.parameters.free_names
        if not name.startswith("bias_") or name.removeprefix("bias_") in recorded
    ]
    shared = tuple(name for name in free if not name.startswith("bias_"))
    local = tuple(name for name in free if name.startswith("bias_"))
    if not shared:
        raise ModelError(
            "no parameter is free",
            where=f"model with {', '.join(system.parameters.names)}",
            remedy="release at least one",
        )
    positions = [system.parameters.index(name) for name in (*shared, *local)]
    return RegressionLayout(
        system,
        shared,
        local,
        tuple(records),
        tuple(state_data(record, system) for record in records),
        positions,
    )


def residuals_at(
    layout: RegressionLayout,
    theta: np.ndarray,
    histories: Sequence[Sequence[np.ndarray]] | None = None,
    *,
    with_jacobian: bool = True,
) -> list[EquationResiduals] | None:
    """Return the residuals of all records at the unknowns ``theta``; None if they are not finite.

    ``histories`` are the states of each record without sensor biases; None takes the smoothed ones.
    If ``with_jacobian`` is False, the Jacobians are zero.
    """
    with np.errstate(all="ignore"):
        parts = [
            _record_residuals(
                layout,
                r,
                theta[layout.columns(r)],
                None if histories is None else histories[r],
                with_jacobian=with_jacobian,
            )
            for r in range(len(layout.records))
        ]
    finite = all(
        np.all(np.abs(part.residual) < LARGEST_NUMBER)
        and np.all(np.abs(part.jacobian) < LARGEST_NUMBER)
        for part in parts
    )
    return parts if finite else None


def _record_residuals(
    layout: RegressionLayout,
    r: int,
    theta_r: np.ndarray,
    history: Sequence[np.ndarray] | None = None,
    *,
    with_jacobian: bool = True,
) -> EquationResiduals:
    """Return the residuals of record ``r`` at ``theta_r``, with complex-step derivatives."""
    system, record, data = layout.system, layout.records[r], layout.data[r]
    c = len(theta_r) if with_jacobian else 1
    p: list[Any] = list(system.parameters.values())
    for column, index in enumerate(layout.positions):
        p[index] = theta_r[column]
        if with_jacobian:
            p[index] = p[index] + 1j * COMPLEX_STEP * (np.arange(c) == column)
    time = record.time
    u_begin, u_end = ([_as_columns(row) for row in stage] for stage in _inputs(record, system, p))
    x: list[Any]
    if history is None:
        x = [
            _as_columns(state.smooth) - (0.0 if state.bias is None else p[state.bias])
            for state in data
        ]
    else:
        x = [
            _as_columns(row) - (0.0 if state.bias is None else 1j * np.imag(p[state.bias]))
            for row, state in zip(history, data, strict=True)
        ]
    n = len(time)
    before = system.f(time[:-1, None], [row[:-1] for row in x], [row[:-1] for row in u_begin], p)
    after = system.f(time[1:, None], [row[1:] for row in x], u_end, p)
    increments_of_states = [
        np.broadcast_to(0.5 * np.diff(time)[:, None] * (a + b), (n - 1, c))
        for a, b in zip(before, after, strict=True)
    ]
    z, measured = record.output_array(system.output_names)
    y = [np.broadcast_to(row, (n, c)) for row in system.h(time[:, None], x, u_begin, p)]

    residual, valid, jacobian = [], [], []
    for state, increments in zip(data, increments_of_states, strict=True):
        if not state.rate_state:
            fit = state.slope_windows
            slope = np.sum(fit.slope_weights * fit.gather(state.raw), axis=1)
            predicted = _slopes_from_increments(fit.slope_weights, fit.first, increments)
            residual.append(slope - predicted.real[:, 0])
            jacobian.append(predicted.imag / COMPLEX_STEP)
            valid.append(fit.usable)
    for i, name in enumerate(system.output_names):
        if name not in system.state_names:
            residual.append(z[i] - y[i].real[:, 0])
            jacobian.append(y[i].imag / COMPLEX_STEP)
            valid.append(measured[i])
    fitted = np.array([row.real[:, 0] for row in y])
    mask = np.array(valid)
    return EquationResiduals(
        np.where(mask, np.array(residual), 0.0),
        mask,
        np.where(mask[:, :, None], np.array(jacobian), 0.0),
        fitted,
    )


def _inputs(record: Record, system: System, p: Sequence[Any]) -> tuple[list[Any], list[Any]]:
    """Return the inputs just after each sample ``(N, ...)``, and just before the next one."""
    grid = make_grid(record.time, float(np.diff(record.time).max()))
    drive = drive_from_record(
        system, p, record.input_array(system.input_names), record.time, record.hold, grid
    )
    # A gap has nodes of its own between the samples.
    return [row[grid.sample] for row in drive.begin], [
        row[grid.sample[1:] - 1] for row in drive.end
    ]


def _slopes_from_increments(
    slope_weights: np.ndarray, first: np.ndarray, increments: np.ndarray
) -> np.ndarray:
    """Return the slopes ``(N, c)`` of a signal with the ``increments (N - 1, c)`` between samples.
    The window of each sample begins at ``first (N,)`` and has ``slope_weights (N, W)``.
    """
    from scipy.sparse import csr_array

    kernel = -np.cumsum(slope_weights, axis=1)[:, :-1]
    rows, width = kernel.shape
    columns = (first[:, None] + np.arange(width)).ravel()
    begin = np.arange(rows + 1) * width
    weights = csr_array((kernel.ravel(), columns, begin), shape=(rows, len(increments)))
    return np.asarray(weights @ increments)


def equation_variances(parts: list[EquationResiduals]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean square residual ``(e,)`` of each equation over all records, and the number of
    valid residuals ``(e,)``.
    """
    counts = sum(part.valid.sum(axis=1) for part in parts)
    squares = sum((part.residual**2).sum(axis=1) for part in parts)
    return np.maximum(squares / np.maximum(counts, 1), 1e-60), np.asarray(counts)


def _as_columns(row: Any) -> np.ndarray:
    """Return a row ``(N,)`` as ``(N, 1)``; a row ``(N, c)`` is unchanged."""
    row = np.asarray(row)
    return row[:, None] if row.ndim == 1 else row
