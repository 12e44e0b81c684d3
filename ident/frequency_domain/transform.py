"""Records as Fourier transforms, responses of linear models with slopes, and noise levels in
frequency.

At these frequencies, w_k = 2 pi k / (N dt), transforms of white noise are independent of each
other, constant biases leave nothing, and the beginning and the end of a motion enter through one
vector, x(0) - x(N dt). Transforms are divided by sqrt(N): their noise has the variance of a
sample's, whatever the record.

With inputs held or linear between samples the samples of the motion obey x[k+1] = Phi x[k] + G
(u[k-1], u[k], u[k+1]), exactly. The sum of that over a record of N samples, each times exp(-j w k
dt), is

    exp(j w dt) (X - (x[0] - x[N])) = Phi X + G U

at its harmonics: a motion that neither begins nor ends in trim adds one vector, which is estimated.
No simulation, hence no trouble with a motion that grows. Klein and Morelli, Aircraft System
Identification, ch. 7, have the same with integrals in the place of sums; Pintelon, Schoukens and
Vandersteen, IEEE Trans. Automatic Control 42(12), 1997, the ends.
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

# ---- Records as Fourier transforms at the harmonics of their own length, in a band

EVEN_SAMPLING_TOLERANCE = 0.01  # largest error of a sample's time, relative to the interval
MOST_BRIDGED_SHARE = 0.05  # largest share of missing, interpolated samples of a channel
BAND_POWER_SHARE = 0.95  # share of every input's power in the default band
_REMEDY = "resample with --rate, cut with --from and --to, or use output-error"


@dataclass(frozen=True, eq=False)
class TransformedRecord:
    """A record's transforms.

    Attributes
    ----------
    omega : ``(f,)`` rad/s.
    ahead : ``(f,)`` exp(j omega dt).
    bins : ``(f,)`` harmonics that these are.
    outputs : ``(m, f)`` complex, zero where a channel was not recorded; ``known (m,)``.
    inputs : ``(r, N)`` samples, of which a delay may shift any.
    filled : samples of the outputs that were bridged.
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
    filled: int

    def shifted(self, i: int, late: int) -> np.ndarray:
        """Transform ``(f,)`` of input ``i`` as it was ``late`` samples before: exp(-j omega late
        dt) times its own, and its end terms.

        Before its first sample the input has that value; values after the last one are part of the
        end vector.
        """
        count = self.inputs.shape[1]
        at = np.clip(np.arange(count) - late, 0, count - 1)
        return np.asarray(np.fft.rfft(self.inputs[i, at])[self.bins] / np.sqrt(count))


def usual_band(
    records: Sequence[Record], inputs: Sequence[str], fewest: int
) -> tuple[float, float]:
    """Band from the first harmonic to where 95 % of every input's power lies, Hz, and up to
    ``fewest`` harmonics of all records.
    """
    high, steps, spans = 0.0, [], []
    for record in records:
        step = step_of(record)
        rows = record.input_array(tuple(inputs))
        power = np.abs(np.fft.rfft(rows - rows.mean(axis=1, keepdims=True))) ** 2
        for row in power:
            if row[1:].sum() > 0.0:
                share = np.cumsum(row[1:]) / row[1:].sum()
                high = max(
                    high, (1 + int(np.searchsorted(share, BAND_POWER_SHARE))) / (len(record) * step)
                )
        steps.append(step)
        spans.append(len(record) * step)
    low = 1.0 / max(spans)
    return low, min(max(high, (fewest + 1) / sum(spans)), 0.5 / max(steps))


def transformed(record: Record, system: System, band: tuple[float, float]) -> TransformedRecord:
    """Return the record's harmonics within a band, Hz.

    Raises
    ------
    RecordError : uneven samples, too many missing ones, or no harmonic within the band.
    """
    step, count = step_of(record), len(record)
    rows, valid = record.output_array(system.output_names)
    usable = np.asarray(valid.any(axis=1))
    filled = 0
    for i in np.flatnonzero(usable & ~valid.all(axis=1)):
        lost = int(np.count_nonzero(~valid[i]))
        if lost > MOST_BRIDGED_SHARE * count:
            what = (
                f"{lost} of {count} samples of {system.output_names[i]} are missing: a Fourier "
                "transform needs them"
            )
            raise RecordError(what, where=record.name, remedy=_REMEDY)
        rows[i] = np.interp(record.time, record.time[valid[i]], rows[i][valid[i]])
        filled += lost
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
        filled,
    )


def step_of(record: Record) -> float:
    """Return the sampling interval, s. Raises RecordError where samples are uneven."""
    steps = np.diff(record.time)
    step = float(np.median(steps))
    if not np.all(np.abs(steps - step) <= EVEN_SAMPLING_TOLERANCE * step):
        raise RecordError(
            "its samples are uneven: a Fourier transform needs even ones",
            where=record.name,
            remedy=_REMEDY,
        )
    return float((record.time[-1] - record.time[0]) / (len(record) - 1))


# ---- The matrices of a linear System and their slopes by its parameters

# largest nonlinearity by rounding, relative to the change of a rate or reading
NONLINEARITY_TOLERANCE = 1e-7
_TRIAL_POINTS = 6  # points at which a System is compared with its matrices


@dataclass(frozen=True, eq=False)
class LinearModel:
    """x_dot = A x + B u, y = C x + D u less constants: ``A (n, n)``, ``B (n, r)``, ``C (m, n)``,
    ``D (m, r)``.

    ``dA (q, n, n)`` and so on are the slopes by each of the wanted parameters.
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
    """Return the matrices of a System that is linear in states and inputs, at parameters ``p``,
    with slopes by those at the positions ``free``.

    One call each of ``f`` and ``h``: a row a unit step of a state or input, a column a complex step
    of a parameter. Effects on the input and sensor paths are left out.
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
    return LinearModel(
        F[:, :n],
        F[:, n:],
        H[:, :n],
        H[:, n:],
        dF[:, :, :n],
        dF[:, :, n:],
        dH[:, :, :n],
        dH[:, :, n:],
    )


def bent(system: System, records: Sequence[Record]) -> str:
    """Return the first rate or output that is no time-invariant linear function of states and
    inputs within the records' range; else empty.
    """
    p = system.parameters.values()
    with np.errstate(all="ignore"):  # non-finite values at rest are not linear
        model = linear_model(system, p, ())
    names = [f"the rate of {name}" for name in system.state_names] + list(system.output_names)
    matrix = np.block([[model.A, model.B], [model.C, model.D]])
    sizes = np.array([_size(name, records) for name in (*system.state_names, *system.input_names)])
    times = np.concatenate([np.zeros(1), *(record.time for record in records)])
    # Points on sines without a common period, which cover a few dimensions, and at rest.
    points = [
        *(
            sizes * np.sin(1.0 + np.arange(len(sizes)) * (k + 1.0) + 0.7 * k)
            for k in range(_TRIAL_POINTS)
        ),
        0.0 * sizes,
    ]
    with np.errstate(all="ignore"):
        start = _values(system, points[-1], p, np.zeros(1))
        tolerance = NONLINEARITY_TOLERANCE * np.maximum(
            np.max(np.abs(matrix * sizes), axis=1), 1e-300
        ) + 1e-12 * np.abs(start[:, 0])
        for point in points:
            result, expected = _values(system, point, p, times) - start, matrix @ point
            off = ~np.all(np.abs(result - expected[:, None]) <= tolerance[:, None], axis=1)
            if np.any(off):
                return names[int(np.argmax(off))]
    return ""


def _values(system: System, point: np.ndarray, p: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Rates and outputs ``(n + m, T)`` at a point at all times."""
    n = len(system.states)
    # numbers of NumPy, whose division by zero is no exception
    x, u = list(point[:n]), list(point[n:])
    rows = (*system.f(times, x, u, p.tolist()), *system.h(times, x, u, p.tolist()))
    return np.array([np.broadcast_to(row, times.shape) for row in rows], dtype=float)


def _size(name: str, records: Sequence[Record]) -> float:
    """Return the largest recorded value of a signal, one where it is not recorded."""
    result = [
        np.max(np.abs(channel.values[channel.valid]), initial=0.0)
        for record in records
        for channel in record.channels
        if channel.name == name
    ]
    return float(max(result, default=0.0)) or 1.0


# ---- Response of a linear model to recorded inputs at the harmonics of a record

# neighbours of the last sample before a delayed interval that act on the state
NEIGHBOURS = (-1, 0, 1)


@dataclass(frozen=True)
class Delay:
    """Delay of an input: ``seconds``, and the position of its parameter among the wanted ones, None
    if fixed.
    """

    seconds: float = 0.0
    position: int | None = None


@dataclass(frozen=True, eq=False)
class TransformedResponse:
    """``y (m, f)`` of motion from rest to rest; ``by_parameter (m, f, q)`` and ``by_ends (m, f,
    n)``, the last of any x[0] - x[N].
    """

    y: np.ndarray
    by_parameter: np.ndarray
    by_ends: np.ndarray


def response(
    model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay], ends: np.ndarray
) -> TransformedResponse:
    """Return the response to a record's inputs, with ``delays`` by position of the input; ``ends
    (n,)`` is x[0] - x[N].
    """
    n, q = len(model.A), len(model.dA)
    Phi, dPhi, forced, d_forced = _stepped(model, record, delays)
    M = record.ahead[:, None, None] * np.eye(n) - Phi
    unit = np.broadcast_to(record.ahead[:, None, None] * np.eye(n), M.shape)
    solved = np.linalg.solve(M, np.concatenate([forced[:, :, None], unit], axis=2))
    X = solved[:, :, 0] + solved[:, :, 1:] @ ends
    pushed = np.einsum("qij,fj->fiq", dPhi, X) + d_forced
    dX = np.linalg.solve(M, pushed) if q else np.zeros((len(X), n, 0))
    U, dU = _read(model, record, delays)
    y = (X @ model.C.T + U @ model.D.T).T
    direct = (
        np.einsum("qmn,fn->mfq", model.dC, X)
        + np.einsum("qmr,fr->mfq", model.dD, U)
        + np.einsum("mr,frq->mfq", model.D, dU)
    )
    by_parameter = direct + np.einsum("mn,fnq->mfq", model.C, dX)
    return TransformedResponse(y, by_parameter, np.einsum("mn,fnk->mfk", model.C, solved[:, :, 1:]))


def _stepped(
    model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Phi ``(n, n)``, its slopes ``(q, n, n)``, the effect of the inputs on the state ``(f, n)``
    and its slopes ``(f, n, q)``.
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
        delay, part = _parted(delays.get(i, Delay()), record.step, width)
        for offset, G in zip(NEIGHBOURS, _gains(A, B[:, :, i], part, record), strict=True):
            if not np.any(G):
                continue
            U = record.shifted(i, delay - offset)
            forced += U[:, None] * G[0].real
            d_forced += U[:, None, None] * (G.imag / COMPLEX_STEP).T[None, :, :q]
    return Phi[0].real, Phi[:q].imag / COMPLEX_STEP, forced, d_forced


def _parted(delay: Delay, step: float, width: int) -> tuple[int, np.ndarray]:
    """Whole samples of a delay, and the rest of it as a share of one, ``(width,)``, with a complex
    step where the delay is wanted.
    """
    whole = int(np.floor(delay.seconds / step + 1e-12))
    rest = np.full(width, max(delay.seconds / step - whole, 0.0), dtype=complex)
    if delay.position is not None:
        rest[delay.position] += 1j * COMPLEX_STEP / step
    return whole, rest


def _gains(
    A: np.ndarray, b: np.ndarray, part: np.ndarray, record: TransformedRecord
) -> Sequence[np.ndarray]:
    """Return the contributions ``(q, n)`` of the samples u[k-1], u[k], u[k+1] of an input to
    x[k+1], if the input is late by ``part`` of a sample.

    During the first ``part`` of the interval the input is still that between the two previous
    samples.
    """
    dt = record.step
    _, step1, ramp1 = _transition(A, b, part * dt)
    Phi2, step2, ramp2 = _transition(A, b, (1.0 - part) * dt)
    first, nothing = part[:, None], np.zeros_like(step1)
    carried = np.array([_times(Phi2, row) for row in (step1, ramp1)])
    if record.hold is Hold.PREVIOUS:
        return carried[0], step2, nothing
    return (
        first * carried[0] - carried[1] / dt,
        (1.0 - first) * carried[0] + carried[1] / dt + step2 - ramp2 / dt,
        ramp2 / dt,
    )


def _times(Phi: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("qij,qj->qi", Phi, rows))


def _transition(
    A: np.ndarray, b: np.ndarray, time: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the transition ``(q, n, n)`` over ``time (q,)``, and the effects of a constant input
    and of a ramp, ``(q, n)``.
    """
    from scipy.linalg import expm

    q, n = len(A), A.shape[1]
    block = np.zeros((q, n + 2, n + 2), dtype=complex)
    block[:, :n, :n], block[:, :n, n], block[:, n, n + 1] = A, b, 1.0
    result = expm(block * time[:, None, None])
    return result[:, :n, :n], result[:, :n, n], result[:, :n, n + 1]


def _read(
    model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the inputs of the output equations at the samples ``(f, r)``, and their derivatives by
    the wanted parameters ``(f, r, q)``.
    """
    q, count = len(model.dA), model.B.shape[1]
    U = np.zeros((len(record.omega), count), dtype=complex)
    dU = np.zeros((len(record.omega), count, q), dtype=complex)
    for i in range(count):
        delay = delays.get(i, Delay())
        delay_value, rest = _parted(Delay(delay.seconds), record.step, 1)
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
# harmonics on either side for a local level: seven give it to 40 %, which the sum over all averages
# out
NEIGHBOURING_HARMONICS = 3


def one_band(count: int) -> np.ndarray:
    """Band of each of ``count`` frequencies: the same."""
    return np.zeros(count, dtype=int)


def equal_bands(omegas: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return the band of each frequency of each record; bands hold equal numbers, as many as
    ``FEWEST_HARMONICS`` and ``MOST_NOISE_BANDS`` allow.
    """
    every = np.sort(np.concatenate(omegas))
    count = int(np.clip(len(every) // FEWEST_HARMONICS, 1, MOST_NOISE_BANDS))
    edges = every[[round(k * len(every) / count) for k in range(1, count)]]
    return [np.searchsorted(edges, omega, side="right") for omega in omegas]


def levels(
    residuals: Sequence[np.ndarray],
    usable: Sequence[np.ndarray],
    bands: Sequence[np.ndarray],
    floor: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mean square of the residuals ``(m, f)`` by output and band, ``(m, b)``, not below
    ``floor (m,)``, and how many there are.
    """
    width = 1 + max(int(np.max(band)) for band in bands)
    total, count = np.zeros((len(floor), width)), np.zeros((len(floor), width))
    for residual, measured, band in zip(residuals, usable, bands, strict=True):
        for b in range(width):
            total[:, b] += np.where(
                measured, np.sum(np.abs(residual[:, band == b]) ** 2, axis=1), 0.0
            )
            count[:, b] += np.where(measured, np.count_nonzero(band == b), 0.0)
    return np.where(
        count > 0, np.maximum(total / np.maximum(count, 1.0), floor[:, None]), 1.0
    ), count


def coloured(
    residuals: Sequence[np.ndarray],
    usable: Sequence[np.ndarray],
    bands: Sequence[np.ndarray],
    floor: np.ndarray,
) -> bool:
    """Return whether the bands' levels differ by more than chance, in any output.

    Squares of transforms of noise are exponential, so twice the log likelihood ratio of one level
    to several is chi-squared with as many degrees as there are further levels.
    """
    from scipy.special import gammaincc  # scipy.stats takes half a second to load

    split_levels, count = levels(residuals, usable, bands, floor)
    together, _ = levels(residuals, usable, [np.zeros_like(band) for band in bands], floor)
    degrees = split_levels.shape[1] - 1
    if degrees == 0:
        return False
    determined = np.flatnonzero(count.sum(axis=1) > 0)
    ratio = 2.0 * np.sum(
        count[determined] * np.log(together[determined] / split_levels[determined]), axis=1
    )
    return bool(
        np.min(gammaincc(0.5 * degrees, 0.5 * np.maximum(ratio, 0.0)), initial=1.0)
        * max(len(determined), 1)
        < LEAST_UNIFORM_NOISE_PROBABILITY
    )


def about_each(power: np.ndarray) -> np.ndarray:
    """Return means of powers, or cross powers, ``(k, f)`` over the neighbours of each frequency."""
    width = min(2 * NEIGHBOURING_HARMONICS + 1, power.shape[1])
    kernel = np.ones(width)
    count = np.convolve(np.ones(power.shape[1]), kernel, mode="same")
    return np.array([np.convolve(row, kernel, mode="same") for row in power]) / count
