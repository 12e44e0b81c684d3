"""Fourier transforms of records, responses of linear models and their derivatives, and noise levels
over frequency.

The transforms are taken at the harmonics w_k = 2 pi k / (N dt) of the length of a record. There,
transforms of white noise are independent of each other, those of constant biases are zero, and the
initial and final states of a motion enter through one vector, x(0) - x(N dt). Transforms are
divided by sqrt(N), so that the variance of their noise is that of a sample for any length.

If inputs are held or linear between samples, the sampled motion obeys exactly
x[k+1] = Phi x[k] + G (u[k-1], u[k], u[k+1]). Times exp(-j w k dt) and summed over the N samples of
a record, this is

    exp(j w dt) (X - (x[0] - x[N])) = Phi X + G U

at the harmonics. The vector x[0] - x[N], here called the end vector, is estimated, since a motion
need not begin or end in trim. Nothing is simulated, so that unstable motion is no difficulty.

Klein and Morelli, Aircraft System Identification, ch. 7, derive the same with integrals instead of
sums. The end vector is that of Pintelon, Schoukens and Vandersteen, IEEE Trans. Automatic Control
42(12), 1997.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sim.declaration.model import System
from sim.errors import RecordError
from sim.maths import COMPLEX_STEP
from sim.record import Hold, Record

# ---- Fourier transforms of records at the harmonics of their length, within a band

EVEN_SAMPLING_TOLERANCE = 0.01  # largest deviation of a sampling interval, relative to the median
MOST_BRIDGED_SHARE = 0.05  # largest share of missing, interpolated samples of a channel
BAND_POWER_SHARE = 0.95  # share of every input's power in the default band
_REMEDY = "resample with --rate, cut with --from and --to, or use output-error"


@dataclass(frozen=True, eq=False)
class TransformedRecord:
    """Fourier transforms of a record of N samples at f harmonics.

    Attributes
    ----------
    record : the record.
    step : sampling interval dt, s.
    hold : behaviour of the inputs between samples.
    bins : ``(f,)`` numbers of the harmonics.
    omega : ``(f,)`` their frequencies, rad/s.
    ahead : ``(f,)`` exp(j omega dt).
    outputs : ``(m, f)`` complex transforms, zero for an output that is not recorded.
    usable : ``(m,)`` whether an output is recorded.
    inputs : ``(r, N)`` samples of the inputs.
    bridged : number of missing samples of the outputs that were interpolated.
    """

    record: Record
    step: float
    hold: Hold
    bins: np.ndarray
    omega: np.ndarray
    ahead: np.ndarray
    outputs: np.ndarray
    usable: np.ndarray
    inputs: np.ndarray
    bridged: int

    def shifted(self, i: int, delay: int) -> np.ndarray:
        """Return the transform ``(f,)`` of input ``i`` delayed by ``delay`` samples.

        Before its first sample the input has the value of this sample. Values after the last sample
        are part of the end vector.
        """
        count = self.inputs.shape[1]
        at = np.clip(np.arange(count) - delay, 0, count - 1)
        return np.asarray(np.fft.rfft(self.inputs[i, at])[self.bins] / np.sqrt(count))


def default_band(
    records: Sequence[Record], inputs: Sequence[str], fewest: int
) -> tuple[float, float]:
    """Return the default band, Hz: from the first harmonic to the frequency below which every input
    has 95 % of its power. The band has at least ``fewest`` harmonics of all records together.
    """
    high, steps, spans = 0.0, [], []
    for record in records:
        step = step_of(record)
        rows = record.input_array(tuple(inputs))
        power = np.abs(np.fft.rfft(rows - rows.mean(axis=1, keepdims=True))) ** 2
        for row in power:
            if row[1:].sum() > 0.0:
                share = np.cumsum(row[1:]) / row[1:].sum()
                last = 1 + int(np.searchsorted(share, BAND_POWER_SHARE))
                high = max(high, last / (len(record) * step))
        steps.append(step)
        spans.append(len(record) * step)
    low = 1.0 / max(spans)
    return low, min(max(high, (fewest + 1) / sum(spans)), 0.5 / max(steps))


def transformed(record: Record, system: System, band: tuple[float, float]) -> TransformedRecord:
    """Return the transforms of a record at its harmonics within a band, Hz.

    Raises
    ------
    RecordError : if samples are uneven, too many are missing, or no harmonic is within the band.
    """
    step, count = step_of(record), len(record)
    rows, valid = record.output_array(system.output_names)
    usable = np.asarray(valid.any(axis=1))
    bridged = 0
    for i in np.flatnonzero(usable & ~valid.all(axis=1)):
        lost = int(np.count_nonzero(~valid[i]))
        if lost > MOST_BRIDGED_SHARE * count:
            what = (
                f"{lost} of {count} samples of {system.output_names[i]} are missing: too many to "
                "interpolate for a Fourier transform"
            )
            raise RecordError(what, where=record.name, remedy=_REMEDY)
        rows[i] = np.interp(record.time, record.time[valid[i]], rows[i][valid[i]])
        bridged += lost
    harmonics = np.arange(1, (count + 1) // 2)
    frequency = harmonics / (count * step)
    bins = harmonics[(frequency >= band[0] * (1.0 - 1e-9)) & (frequency <= band[1] * (1.0 + 1e-9))]
    if bins.size == 0:
        what = (
            f"no harmonic of {count * step:.4g} s lies between {band[0]:.4g} and {band[1]:.4g} Hz"
        )
        raise RecordError(what, where=record.name, remedy="widen --band")
    omega = 2.0 * np.pi * bins / (count * step)
    outputs = np.where(
        usable[:, None],
        np.fft.rfft(np.where(usable[:, None], rows, 0.0))[:, bins] / np.sqrt(count),
        0.0,
    )
    inputs = record.input_array(system.input_names)
    return TransformedRecord(
        record,
        step,
        record.hold,
        bins,
        omega,
        np.exp(1j * omega * step),
        outputs,
        usable,
        inputs,
        bridged,
    )


def step_of(record: Record) -> float:
    """Return the sampling interval, s. Raises RecordError if samples are uneven."""
    steps = np.diff(record.time)
    step = float(np.median(steps))
    if not np.all(np.abs(steps - step) <= EVEN_SAMPLING_TOLERANCE * step):
        raise RecordError(
            "its samples are uneven: a Fourier transform needs even ones",
            where=record.name,
            remedy=_REMEDY,
        )
    return float((record.time[-1] - record.time[0]) / (len(record) - 1))


# ---- Matrices of a linear System and their derivatives with respect to parameters

# largest nonlinearity due to rounding, relative to the change of a rate or output
NONLINEARITY_TOLERANCE = 1e-7
_TRIAL_POINTS = 6  # points at which a System is compared with its linear model


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Matrices of x_dot = A x + B u, y = C x + D u without constant terms: ``A (n, n)``, ``B (n,
    r)``, ``C (m, n)`` and ``D (m, r)``.

    ``dA (q, n, n)``, ``dB``, ``dC`` and ``dD`` are their derivatives with respect to each of the q
    free parameters.
    """

    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    dA: np.ndarray
    dB: np.ndarray
    dC: np.ndarray
    dD: np.ndarray


def linear_model(system: System, p: np.ndarray, free: Sequence[int]) -> LinearModel:
    """Return the matrices of a System that is linear in states and inputs, at parameters ``p``, and
    their derivatives with respect to the parameters at the positions ``free``.

    f and h are called once each, for unit values of each state and input (rows) and complex steps
    of each parameter (columns). Effects on the input and sensor paths are left out.
    """
    n, r, q = len(system.states), len(system.inputs), max(len(free), 1)
    rows: list[Any] = [complex(value) for value in p]
    for column, position in enumerate(free):
        rows[position] = p[position] + 1j * COMPLEX_STEP * (np.arange(q) == column)
    unit = np.vstack([np.zeros(n + r), np.eye(n + r)])[:, :, None]
    x, u = list(unit[:, :n].swapaxes(0, 1)), list(unit[:, n:].swapaxes(0, 1))
    rates, readings = (
        np.array(
            [np.broadcast_to(row, (1 + n + r, q)) for row in function(0.0, x, u, rows)]
        ).reshape(-1, 1 + n + r, q)
        for function in (system.f, system.h)
    )
    F, H = (each[:, 1:] - each[:, :1] for each in (rates, readings))
    dF, dH = ((each.imag / COMPLEX_STEP).transpose(2, 0, 1)[: len(free)] for each in (F, H))
    F, H = F[:, :, 0].real, H[:, :, 0].real
    values = F[:, :n], F[:, n:], H[:, :n], H[:, n:]
    return LinearModel(*values, dF[:, :, :n], dF[:, :, n:], dH[:, :, :n], dH[:, :, n:])


def first_nonlinear(system: System, records: Sequence[Record]) -> str:
    """Return the name of the first rate or output that is not a linear function of states and
    inputs, or depends on time, within the range of the records; empty if there is none.
    """
    p = system.parameters.values()
    with np.errstate(all="ignore"):  # non-finite values at rest are not linear
        model = linear_model(system, p, ())
    names = [f"the rate of {name}" for name in system.state_names] + list(system.output_names)
    matrix = np.block([[model.A, model.B], [model.C, model.D]])
    sizes = np.array(
        [_largest_value(name, records) for name in (*system.state_names, *system.input_names)]
    )
    times = np.concatenate([np.zeros(1), *(record.time for record in records)])
    # Points on sines without a common period, so that they cover all dimensions; and at rest.
    at = np.arange(len(sizes))
    points = [sizes * np.sin(1.0 + at * (k + 1.0) + 0.7 * k) for k in range(_TRIAL_POINTS)]
    points.append(0.0 * sizes)
    with np.errstate(all="ignore"):
        start = _values(system, points[-1], p, np.zeros(1))
        largest = np.maximum(np.max(np.abs(matrix * sizes), axis=1), 1e-300)
        tolerance = NONLINEARITY_TOLERANCE * largest + 1e-12 * np.abs(start[:, 0])
        for point in points:
            result, expected = _values(system, point, p, times) - start, matrix @ point
            off = ~np.all(np.abs(result - expected[:, None]) <= tolerance[:, None], axis=1)
            if np.any(off):
                return names[int(np.argmax(off))]
    return ""


def _values(system: System, point: np.ndarray, p: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Return rates and outputs ``(n + m, T)`` at one ``point (n + r,)`` and all ``times (T,)``."""
    n = len(system.states)
    # NumPy numbers: their division by zero raises no exception.
    x, u = list(point[:n]), list(point[n:])
    rows = (*system.f(times, x, u, p.tolist()), *system.h(times, x, u, p.tolist()))
    return np.array([np.broadcast_to(row, times.shape) for row in rows], dtype=float)


def _largest_value(name: str, records: Sequence[Record]) -> float:
    """Return the largest absolute value of a signal; one if it is not recorded or always zero."""
    result = [
        np.max(np.abs(channel.values[channel.valid]), initial=0.0)
        for record in records
        for channel in record.channels
        if channel.name == name
    ]
    return float(max(result, default=0.0)) or 1.0


# ---- Response of a linear model to recorded inputs at the harmonics of a record

# Samples of a delayed input that act on the state over an interval, relative to its first sample.
NEIGHBOURS = (-1, 0, 1)


@dataclass(frozen=True)
class Delay:
    """Delay of an input in ``seconds``, and the ``position`` of its parameter among the free ones;
    None if it is fixed.
    """

    seconds: float = 0.0
    position: int | None = None


@dataclass(frozen=True, eq=False)
class TransformedResponse:
    """Transforms of the outputs of a linear model.

    Attributes
    ----------
    y : ``(m, f)`` transforms of the outputs.
    by_parameter : ``(m, f, q)`` derivatives with respect to the free parameters.
    by_ends : ``(m, f, n)`` derivatives with respect to the end vector x[0] - x[N].
    """

    y: np.ndarray
    by_parameter: np.ndarray
    by_ends: np.ndarray


def response(
    model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay], ends: np.ndarray
) -> TransformedResponse:
    """Return the response of a model to the inputs of a record.

    Parameters
    ----------
    delays : position of an input -> its delay.
    ends : ``(n,)`` end vector x[0] - x[N].
    """
    n, q = len(model.A), len(model.dA)
    Phi, dPhi, forced, d_forced = _discretised(model, record, delays)
    M = record.ahead[:, None, None] * np.eye(n) - Phi
    unit = np.broadcast_to(record.ahead[:, None, None] * np.eye(n), M.shape)
    solved = np.linalg.solve(M, np.concatenate([forced[:, :, None], unit], axis=2))
    X = solved[:, :, 0] + solved[:, :, 1:] @ ends
    right_sides = np.einsum("qij,fj->fiq", dPhi, X) + d_forced
    dX = np.linalg.solve(M, right_sides) if q else np.zeros((len(X), n, 0))
    U, dU = _output_inputs(model, record, delays)
    y = (X @ model.C.T + U @ model.D.T).T
    direct = (
        np.einsum("qmn,fn->mfq", model.dC, X)
        + np.einsum("qmr,fr->mfq", model.dD, U)
        + np.einsum("mr,frq->mfq", model.D, dU)
    )
    by_parameter = direct + np.einsum("mn,fnq->mfq", model.C, dX)
    return TransformedResponse(y, by_parameter, np.einsum("mn,fnk->mfk", model.C, solved[:, :, 1:]))


def _discretised(
    model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the matrix Phi ``(n, n)``, its derivatives ``(q, n, n)``, the transforms ``(f, n)`` of
    G U, and their derivatives ``(f, n, q)``.
    """
    n, q = len(model.A), len(model.dA)
    width = max(q, 1)
    step = 1j * COMPLEX_STEP
    A = model.A + step * (model.dA if q else np.zeros((1, n, n)))
    B = model.B + step * (model.dB if q else np.zeros((1, *model.B.shape)))
    Phi = _transition(A, np.zeros((width, n)), np.full(width, record.step, dtype=complex))[0]
    forced = np.zeros((len(record.omega), n), dtype=complex)
    d_forced = np.zeros((len(record.omega), n, q), dtype=complex)
    for i in range(model.B.shape[1]):
        delay, part = _whole_and_rest(delays.get(i, Delay()), record.step, width)
        for offset, G in zip(NEIGHBOURS, _gains(A, B[:, :, i], part, record), strict=True):
            if not np.any(G):
                continue
            U = record.shifted(i, delay - offset)
            forced += U[:, None] * G[0].real
            d_forced += U[:, None, None] * (G.imag / COMPLEX_STEP).T[None, :, :q]
    return Phi[0].real, Phi[:q].imag / COMPLEX_STEP, forced, d_forced


def _whole_and_rest(delay: Delay, step: float, width: int) -> tuple[int, np.ndarray]:
    """Return the number of whole samples of a delay, and the remaining share of a sample,
    ``(width,)``, with a complex step if the delay is a free parameter.
    """
    whole = int(np.floor(delay.seconds / step + 1e-12))
    rest = np.full(width, max(delay.seconds / step - whole, 0.0), dtype=complex)
    if delay.position is not None:
        rest[delay.position] += 1j * COMPLEX_STEP / step
    return whole, rest


def _gains(
    A: np.ndarray, b: np.ndarray, part: np.ndarray, record: TransformedRecord
) -> Sequence[np.ndarray]:
    """Return the factors ``(q, n)`` of the samples u[k-1], u[k], u[k+1] of an input in x[k+1], if
    the input is delayed by ``part (q,)`` of a sample.

    During this part of the interval the input is still that of the previous interval.
    """
    dt = record.step
    _, step1, ramp1 = _transition(A, b, part * dt)
    Phi2, step2, ramp2 = _transition(A, b, (1.0 - part) * dt)
    first, nothing = part[:, None], np.zeros_like(step1)
    carried = np.array([np.einsum("qij,qj->qi", Phi2, row) for row in (step1, ramp1)])
    if record.hold is Hold.PREVIOUS:
        return carried[0], step2, nothing
    return (
        first * carried[0] - carried[1] / dt,
        (1.0 - first) * carried[0] + carried[1] / dt + step2 - ramp2 / dt,
        ramp2 / dt,
    )


def _transition(
    A: np.ndarray, b: np.ndarray, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the transition matrix ``(q, n, n)`` over ``time (q,)``, s, and the effects on the
    state, ``(q, n)`` each, of a unit step and of a ramp with unit slope in this time.
    """
    from scipy.linalg import expm

    q, n = len(A), A.shape[1]
    block = np.zeros((q, n + 2, n + 2), dtype=complex)
    block[:, :n, :n], block[:, :n, n], block[:, n, n + 1] = A, b, 1.0
    result = expm(block * time[:, None, None])
    return result[:, :n, :n], result[:, :n, n], result[:, :n, n + 1]


def _output_inputs(
    model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the transforms ``(f, r)`` of the delayed inputs at the samples, which act directly on
    the outputs, and their derivatives ``(f, r, q)`` with respect to the free parameters.
    """
    q, count = len(model.dA), model.B.shape[1]
    U = np.zeros((len(record.omega), count), dtype=complex)
    dU = np.zeros((len(record.omega), count, q), dtype=complex)
    for i in range(count):
        delay = delays.get(i, Delay())
        delay_value, rest = _whole_and_rest(Delay(delay.seconds), record.step, 1)
        share = float(rest[0].real)
        now, before = record.shifted(i, delay_value), record.shifted(i, delay_value + 1)
        if record.hold is Hold.PREVIOUS:
            U[:, i] = before if share > 0.0 else now
            continue
        U[:, i] = (1.0 - share) * now + share * before
        if delay.position is not None:
            dU[:, i, delay.position] = (before - now) / record.step
    return U, dU


# ---- Noise level of each output over frequency

# smallest probability, over all outputs, of equal noise levels
LEAST_UNIFORM_NOISE_PROBABILITY = 1e-3
FEWEST_HARMONICS = 12  # fewest harmonics of a band: its level is then known to 20 %
# most bands: noise of sensors and slow turbulence changes by decades, not from line to line
MOST_NOISE_BANDS = 6
# Harmonics on either side that give a local level. Seven harmonics determine it to 40 %; these
# errors average out in sums over all harmonics.
NEIGHBOURING_HARMONICS = 3


def equal_bands(omegas: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the number of the band of each frequency, by record. Bands contain equal numbers of
    frequencies, and there are as many as ``FEWEST_HARMONICS`` and ``MOST_NOISE_BANDS`` allow.
    """
    every = np.sort(np.concatenate(omegas))
    count = int(np.clip(len(every) // FEWEST_HARMONICS, 1, MOST_NOISE_BANDS))
    edges = every[[round(k * len(every) / count) for k in range(1, count)]]
    return [np.searchsorted(edges, omega, side="right") for omega in omegas]


def noise_levels(
    residuals: Sequence[np.ndarray],
    usable: Sequence[np.ndarray],
    bands: Sequence[np.ndarray],
    floor: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean square ``(m, b)`` of the residuals by output and band, and their numbers
    ``(m, b)``.

    Parameters
    ----------
    residuals : complex ``(m, f)`` of each record.
    usable : ``(m,)`` of each record, whether an output is recorded.
    bands : ``(f,)`` of each record, band of each frequency.
    floor : ``(m,)`` smallest mean square.
    """
    width = 1 + max(int(np.max(band)) for band in bands)
    total, count = np.zeros((len(floor), width)), np.zeros((len(floor), width))
    for residual, measured, band in zip(residuals, usable, bands, strict=True):
        for b in range(width):
            squares = np.sum(np.abs(residual[:, band == b]) ** 2, axis=1)
            total[:, b] += np.where(measured, squares, 0.0)
            count[:, b] += np.where(measured, np.count_nonzero(band == b), 0.0)
    mean = np.maximum(total / np.maximum(count, 1.0), floor[:, None])
    return np.where(count > 0, mean, 1.0), count


def levels_differ(
    residuals: Sequence[np.ndarray],
    usable: Sequence[np.ndarray],
    bands: Sequence[np.ndarray],
    floor: np.ndarray,
) -> bool:
    """Return whether the noise levels of the bands differ significantly in any output. The
    arguments are those of `noise_levels`.

    Squared transforms of noise have exponential distributions. Twice the log likelihood ratio of
    several levels to one level is therefore chi-squared distributed; its degrees of freedom are the
    number of levels minus one.
    """
    from scipy.special import gammaincc  # scipy.stats takes half a second to load

    split_levels, count = noise_levels(residuals, usable, bands, floor)
    together, _ = noise_levels(residuals, usable, [np.zeros_like(band) for band in bands], floor)
    degrees = split_levels.shape[1] - 1
    if degrees == 0:
        return False
    determined = np.flatnonzero(count.sum(axis=1) > 0)
    log_ratio = np.log(together[determined] / split_levels[determined])
    ratio = 2.0 * np.sum(count[determined] * log_ratio, axis=1)
    least = np.min(gammaincc(0.5 * degrees, 0.5 * np.maximum(ratio, 0.0)), initial=1.0)
    return bool(least * max(len(determined), 1) < LEAST_UNIFORM_NOISE_PROBABILITY)


def means_over_neighbours(power: np.ndarray) -> np.ndarray:
    """Return the means ``(k, f)`` of powers or cross powers ``(k, f)`` over each frequency and its
    neighbours.
    """
    width = min(2 * NEIGHBOURING_HARMONICS + 1, power.shape[1])
    kernel = np.ones(width)
    count = np.convolve(np.ones(power.shape[1]), kernel, mode="same")
    return np.array([np.convolve(row, kernel, mode="same") for row in power]) / count
