"""Multitaper estimate of the response to one input, and a low-order model fitted to it.

They check the delay and the damping that a filter has estimated, as in NASA TM-101722, without
states and process noise: only ratios of spectra are needed. Errors of gain and phase have the
weights of MIL-F-8785C for equivalent systems.
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

# lowest and highest frequency, rad/s, of a response with short period, lag and delay
LOWEST_OMEGA, HIGHEST_OMEGA = 0.35, 14.0
_DECIBELS_PER_NEPER = 20.0 / math.log(10.0)  # dB per unit of the natural logarithm of a gain
# square root of the weight 0.01745 of an error of 1 deg, per rad
_PHASE_WEIGHT_ROOT = math.sqrt(0.01745) * 180.0 / math.pi
_PADDING_FACTOR = 4  # length of a padded transform over that of the record
_LONGEST_ALIGNED_LAG = 1.0  # longest lag by which an output is aligned with the input, s
_LARGEST_COHERENCE = 0.99  # a larger coherence has no more weight in a fit


@dataclass(frozen=True, eq=False)
class SingleInputResponse:
    """Response of outputs to one input.

    Attributes
    ----------
    omega : ``(n,)`` frequencies, rad/s.
    outputs : names of the m outputs.
    response : complex ``(m, n)`` to the input as it acts between samples: the effect of the hold is
        removed.
    coherence : ``(m, n)`` ordinary coherence, 0 to 1.
    bandwidth : half-width of the smoothing, rad/s. Frequencies closer than twice this are not
        independent.
    """

    omega: np.ndarray
    outputs: tuple[str, ...]
    response: np.ndarray
    coherence: np.ndarray
    bandwidth: float


def estimate_response(
    record: Record, low: float = LOWEST_OMEGA, high: float = HIGHEST_OMEGA, tapers: int = 5
) -> SingleInputResponse:
    """Estimate the response of all outputs to ``stick`` from cross spectra, averaged over tapers.

    The average over the bandwidth of the tapers makes a response smaller where its phase changes
    quickly with frequency, which a low-order fit takes for damping. Each output is therefore
    aligned with the input by its lag, which is restored afterwards. The remaining bias is smaller
    with fewer tapers and longer records.

    Parameters
    ----------
    record : evenly sampled record without missing samples; means are removed.
    low, high : lowest and highest frequency, rad/s.
    tapers : number of tapers. More tapers give less scatter and a more reliable coherence, and a
        larger bandwidth, (tapers + 1) pi / duration.

    Raises
    ------
    RecordError : where the sampling is uneven, a sample is missing, the input does not move, or no
        frequency is in the range.
    ModelError : where there are fewer than two tapers: the coherence of one taper is always 1.
    """
    if tapers < 2:
        raise ModelError(f"{tapers} tapers", where="estimate_response", remedy="use two or more")
    names = record.output_names
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
    u = record["stick"].values
    if not np.ptp(u) > 0:
        raise RecordError(
            "it does not move",
            where=f"{record.name}, channel stick",
            remedy="choose a window with a maneuver",
        )
    omega = 2.0 * math.pi * np.fft.rfftfreq(_PADDING_FACTOR * count, step)
    omega = omega[(omega >= low) & (omega <= high)]
    if not omega.size:
        what = f"no frequency between {low:g} and {high:g} rad/s"
        raise RecordError(what, where=record.name, remedy="give a longer record")
    u, y = u - u.mean(), y - y.mean(axis=1, keepdims=True)
    lags = [_lag(u, row, round(_LONGEST_ALIGNED_LAG / step)) for row in y]
    aligned = [
        np.concatenate([row[lag:], np.full(lag, row[-1])]) for row, lag in zip(y, lags, strict=True)
    ]
    hertz = omega / (2.0 * math.pi)
    rows = sine_segments([np.array([u, *aligned])], step, tapers, hertz, derivatives=0).transforms[
        :, 0
    ]
    shifts = np.exp(-1j * omega * step * np.array(lags)[:, None])
    U, Y = rows[0], rows[1:] * shifts[:, None, :]
    Suu, Syy = (np.abs(U) ** 2).mean(axis=0), (np.abs(Y) ** 2).mean(axis=1)
    Syu = (Y * np.conj(U)).mean(axis=1)
    coherence = np.abs(Syu) ** 2 / np.maximum(Suu * Syy, np.finfo(float).tiny)
    zero_order_hold = (1.0 - np.exp(-1j * omega * step)) / (1j * omega * step)
    hold_response = (
        zero_order_hold if record.hold is Hold.PREVIOUS else np.abs(zero_order_hold) ** 2
    )
    return SingleInputResponse(
        omega, names, Syu / Suu / hold_response, coherence, (tapers + 1) * math.pi / (count * step)
    )


def _lag(u: np.ndarray, y: np.ndarray, latest: int) -> int:
    """Return the lag of the output ``y`` behind the input ``u`` in samples, at most ``latest``, by
    the largest absolute cross-correlation.
    """
    sums = [abs(float(u[: len(u) - k] @ y[k:])) for k in range(min(latest, len(u) - 1) + 1)]
    return int(np.argmax(sums))


@dataclass(frozen=True, eq=False)
class ResponseFit:
    """A model fitted to a frequency response.

    Attributes
    ----------
    values : parameter -> estimate.
    mismatch : weighted mean of (error in dB)^2 + 0.01745 (error in deg)^2.
    converged : whether the search ended at a minimum.
    """

    values: Mapping[str, float]
    mismatch: float
    converged: bool


def model_response(
    system: System,
    values: Mapping[str, float],
    omega: np.ndarray,
    outputs: Sequence[str],
) -> np.ndarray:
    """Return the response ``(m, n)`` of a System, linearised at rest, to its first input.

    The parameter ``delay`` (s), if the System has one, delays this input.
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
    held_delay = system.parameters["delay"].value if "delay" in system.parameters else 0.0
    delay_factor = np.exp(-s * values.get("delay", held_delay))
    return ((C[rows] @ inside + D[rows])[:, :, 0] * delay_factor[:, None]).T


def fit_response(response: SingleInputResponse, system: System, free: Sequence[str]) -> ResponseFit:
    """Return the fit of the parameters ``free`` to an estimated response, from the values of the
    System.

    The weight of a frequency w with coherence c is c / (1 - c) / w, with c at most 0.99. The first
    factor is the inverse variance of gain and phase. The second one gives each octave the same
    weight, as in the usual match at logarithmically spaced frequencies. The fit uses all outputs
    that the response and the System have in common.
    """
    from scipy.optimize import least_squares

    names = tuple(name for name in response.outputs if name in system.output_names)
    rows = [response.outputs.index(name) for name in names]
    c = np.minimum(response.coherence[rows], _LARGEST_COHERENCE)
    power = c / (1.0 - c) / response.omega
    weight = np.sqrt(power / power.mean())
    start = system.parameters.values(free)
    bounds = np.array([system.parameters[name].bounds for name in free]).T

    def errors(p: np.ndarray) -> np.ndarray:
        result = model_response(
            system, dict(zip(free, p.tolist(), strict=True)), response.omega, names
        )
        ratio = np.log(result / response.response[rows])
        return np.concatenate(
            [
                (_DECIBELS_PER_NEPER * weight * ratio.real).ravel(),
                (_PHASE_WEIGHT_ROOT * weight * ratio.imag).ravel(),
            ]
        )

    solution = least_squares(
        errors,
        start,
        bounds=(bounds[0], bounds[1]),
        x_scale=np.maximum(np.abs(start), 1e-3),
        max_nfev=500,
    )
    return ResponseFit(
        dict(zip(free, solution.x.tolist(), strict=True)),
        float(2.0 * solution.cost / weight.size),
        solution.status > 0,
    )
