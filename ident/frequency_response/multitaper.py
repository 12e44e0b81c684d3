"""Frequency response of a record by a multitaper spectral estimate, and a low-order model fitted to
it.

The check of a filter's delay and damping that NASA TM-101722 took from a frequency-response
analysis: no filter, no state, no process noise, only ratios of spectra. Sine tapers: Riedel and
Sidorenko, "Minimum Bias Multiple Taper Spectral Estimation", IEEE Transactions on Signal Processing
43(1), 1995. Weights of gain and phase: MIL-F-8785C's equivalent-system matching.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.frequency_response.segments import sine_segments
from sim.declaration.model import System
from sim.errors import ModelError, RecordError
from sim.maths import complex_step_jacobian
from sim.record import Hold, Record

LOW, HIGH = 0.35, 14.0  # rad/s, where short period, lag and delay show
_DECIBEL, _PHASE = 20.0 / math.log(10.0), math.sqrt(0.01745) * 180.0 / math.pi
_PADDING = 4
_LATEST = 1.0  # s, the longest lag by which an output is aligned with the input


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Response of outputs to one input.

    Attributes
    ----------
    omega : ``(n,)`` rad/s.
    outputs : names of the m rows.
    response : complex ``(m, n)``, output per input as it acts between samples (the hold is taken
    out). coherence : ``(m, n)``, 0 to 1: share of the output that follows the input linearly.
    bandwidth : half width of the smoothing, rad/s; neighbours closer than twice this are not
    independent.
    """

    omega: np.ndarray
    outputs: tuple[str, ...]
    response: np.ndarray
    coherence: np.ndarray
    bandwidth: float


def estimate_response(
    record: Record,
    input_name: str = "stick",
    outputs: Sequence[str] | None = None,
    low: float = LOW,
    high: float = HIGH,
    tapers: int = 5,
) -> FrequencyResponse:
    """Estimate the response by averaging cross spectra over sine tapers.

    Averaging over the tapers' bandwidth flattens a response that turns quickly with frequency, and
    a low-order fit reads that as damping. Each output is therefore aligned with the input by its
    lag beforehand (the lag is put back); what bias remains falls with fewer tapers and longer
    records.

    Parameters
    ----------
    record : evenly sampled, without missing samples; means are removed.
    outputs : all of the record's when None.
    low, high : range of frequencies kept, rad/s.
    tapers : more give less scatter and a coherence that means more, and smear over (tapers + 1) pi
    / duration.

    Raises
    ------
    RecordError : uneven sampling, missing samples, an input without motion, no frequency in the
    range. ModelError : fewer than two tapers (the coherence of one is always 1).
    """
    if tapers < 2:
        raise ModelError(f"{tapers} tapers", where="estimate_response", remedy="use two or more")
    names = record.output_names if outputs is None else tuple(outputs)
    steps, count = np.diff(record.time), len(record)
    step = float(steps.mean())
    if np.max(np.abs(steps - step)) > 1e-3 * step:
        raise RecordError(
            "sampling is uneven", where=record.name, remedy="resample it evenly first"
        )
    y, valid = record.output_array(names)
    if not valid.all():
        raise RecordError(
            "a sample is missing", where=record.name, remedy="choose a window without gaps"
        )
    u = record[input_name].values
    if not np.ptp(u) > 0:
        raise RecordError(
            "it does not move",
            where=f"{record.name}, channel {input_name}",
            remedy="choose a window with a maneuver",
        )
    omega = 2.0 * math.pi * np.fft.rfftfreq(_PADDING * count, step)
    omega = omega[(omega >= low) & (omega <= high)]
    if not omega.size:
        what = f"no frequency between {low:g} and {high:g} rad/s"
        raise RecordError(what, where=record.name, remedy="give a longer record")
    u, y = u - u.mean(), y - y.mean(axis=1, keepdims=True)
    lags = [_lag(u, row, round(_LATEST / step)) for row in y]
    aligned = [
        np.concatenate([row[lag:], np.full(lag, row[-1])]) for row, lag in zip(y, lags, strict=True)
    ]
    hertz = omega / (2.0 * math.pi)
    rows = sine_segments([np.array([u, *aligned])], step, tapers, hertz, derivatives=0).transforms[
        :, 0
    ]
    late = np.exp(-1j * omega * step * np.array(lags)[:, None])
    U, Y = rows[0], rows[1:] * late[:, None, :]
    Suu, Syy = (np.abs(U) ** 2).mean(axis=0), (np.abs(Y) ** 2).mean(axis=1)
    Syu = (Y * np.conj(U)).mean(axis=1)
    coherence = np.abs(Syu) ** 2 / np.maximum(Suu * Syy, np.finfo(float).tiny)
    between = (1.0 - np.exp(-1j * omega * step)) / (1j * omega * step)
    held = between if record.hold is Hold.PREVIOUS else np.abs(between) ** 2
    return FrequencyResponse(
        omega, names, Syu / Suu / held, coherence, (tapers + 1) * math.pi / (count * step)
    )


def _lag(u: np.ndarray, y: np.ndarray, latest: int) -> int:
    """By how many samples the output follows the input: where the size of their correlation is
    largest, up to ``latest``.
    """
    sums = [abs(float(u[: len(u) - k] @ y[k:])) for k in range(min(latest, len(u) - 1) + 1)]
    return int(np.argmax(sums))


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A model fitted to a frequency response: parameter values by name, mismatch as the weighted
    mean of (error in dB)^2 + 0.01745 (error in deg)^2, whether the search ended at a minimum."""

    values: Mapping[str, float]
    mismatch: float
    converged: bool


def model_response(
    system: System,
    values: Mapping[str, float],
    omega: np.ndarray,
    outputs: Sequence[str],
    delay: str = "delay",
) -> np.ndarray:
    """Response ``(m, n)`` of a System linearised at rest to its first input, a pure delay of that
    input included.
    """
    p = system.parameters.with_values(values).values().tolist()
    x0, u0 = [0.0] * len(system.states), [0.0] * len(system.inputs)
    A = complex_step_jacobian(lambda x: system.f(0.0, x, u0, p), x0)
    B = complex_step_jacobian(lambda u: system.f(0.0, x0, u, p), u0)[:, :1]
    C = complex_step_jacobian(lambda x: system.h(0.0, x, u0, p), x0)
    D = complex_step_jacobian(lambda u: system.h(0.0, x0, u, p), u0)[:, :1]
    rows = [system.output_names.index(name) for name in outputs]
    s = 1j * np.asarray(omega)
    inside = np.linalg.solve(s[:, None, None] * np.eye(len(A)) - A, B.astype(complex)[None])
    late = (
        np.exp(-s * values.get(delay, 0.0))
        if delay in values
        else np.exp(-s * _held_delay(system, delay))
    )
    return ((C[rows] @ inside + D[rows])[:, :, 0] * late[:, None]).T


def fit_response(
    response: FrequencyResponse,
    system: System,
    free: Sequence[str],
    outputs: Sequence[str] | None = None,
    delay: str = "delay",
) -> ResponseFit:
    """Fit a model's named parameters to an estimated response, starting from the System's values.

    Each frequency w counts by its coherence c as c / (1 - c), limited at c = 0.99, the inverse
    variance of gain and phase, and as 1/w, which gives each octave the same say, as the usual
    matching at logarithmically spaced frequencies does. Raises ModelError for an output that the
    response lacks.
    """
    from scipy.optimize import least_squares

    names = (
        tuple(outputs)
        if outputs is not None
        else tuple(name for name in response.outputs if name in system.output_names)
    )
    for name in names:
        if name not in response.outputs:
            raise ModelError(
                "it is not among the estimated responses",
                where=f"fit_response, {name}",
                remedy=f"use {', '.join(response.outputs)}",
            )
    rows = [response.outputs.index(name) for name in names]
    c = np.minimum(response.coherence[rows], 0.99)
    power = c / (1.0 - c) / response.omega
    weight = np.sqrt(power / power.mean())
    start = system.parameters.values(free)
    bounds = np.array([system.parameters[name].bounds for name in free]).T

    def errors(p: np.ndarray) -> np.ndarray:
        found = model_response(
            system, dict(zip(free, p.tolist(), strict=True)), response.omega, names, delay
        )
        ratio = np.log(found / response.response[rows])
        return np.concatenate(
            [(_DECIBEL * weight * ratio.real).ravel(), (_PHASE * weight * ratio.imag).ravel()]
        )

    found = least_squares(
        errors,
        start,
        bounds=(bounds[0], bounds[1]),
        x_scale=np.maximum(np.abs(start), 1e-3),
        max_nfev=500,
    )
    return ResponseFit(
        dict(zip(free, found.x.tolist(), strict=True)),
        float(2.0 * found.cost / weight.size),
        found.status > 0,
    )


def _held_delay(system: System, delay: str) -> float:
    return system.parameters[delay].value if delay in system.parameters else 0.0
