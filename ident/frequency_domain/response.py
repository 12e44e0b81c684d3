"""Response of a linear model to recorded inputs at the harmonics of a record, with slopes by parameters and by the ends of the motion.

With inputs held or linear between samples the samples of the motion obey x[k+1] = Phi x[k] + G (u[k-1], u[k], u[k+1]), exactly. The sum
of that over a record of N samples, each times exp(-j w k dt), is

    exp(j w dt) (X - (x[0] - x[N])) = Phi X + G U

at its harmonics: a motion that neither begins nor ends in trim adds one vector, which is estimated. No simulation, hence no trouble with a
motion that grows. Klein and Morelli, Aircraft System Identification, ch. 7, have the same with integrals in the place of sums;
Pintelon, Schoukens and Vandersteen, IEEE Trans. Automatic Control 42(12), 1997, the ends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ident.frequency_domain.linear_model import LinearModel
from ident.frequency_domain.transform import TransformedRecord
from sim.maths import COMPLEX_STEP
from sim.record import Hold

NEIGHBOURS = (-1, 0, 1)  # samples, beside the last one before a delayed interval begins, that move the state


@dataclass(frozen=True)
class Delay:
    """``seconds`` late, and the position of that parameter among the wanted ones, None where it is held."""

    seconds: float = 0.0
    position: int | None = None


@dataclass(frozen=True, eq=False)
class Response:
    """``y (m, f)`` of motion from rest to rest; ``by_parameter (m, f, q)`` and ``by_ends (m, f, n)``, the last of any x[0] - x[N]."""

    y: np.ndarray
    by_parameter: np.ndarray
    by_ends: np.ndarray


def response(model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay], ends: np.ndarray) -> Response:
    """Response to a record's inputs, those at the positions in ``delays`` late; ``ends (n,)`` is x[0] - x[N]."""
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
    direct = np.einsum("qmn,fn->mfq", model.dC, X) + np.einsum("qmr,fr->mfq", model.dD, U) + np.einsum("mr,frq->mfq", model.D, dU)
    by_parameter = direct + np.einsum("mn,fnq->mfq", model.C, dX)
    return Response(y, by_parameter, np.einsum("mn,fnk->mfk", model.C, solved[:, :, 1:]))


def _stepped(model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Phi ``(n, n)``, its slopes ``(q, n, n)``, what the inputs do to the state ``(f, n)`` and its slopes ``(f, n, q)``."""
    n, q = len(model.A), len(model.dA)
    width = max(q, 1)
    step = 1j * COMPLEX_STEP
    A = model.A + step * (model.dA if q else np.zeros((1, n, n)))
    B = model.B + step * (model.dB if q else np.zeros((1, *model.B.shape)))
    Phi = _transition(A, np.zeros((width, n)), np.full(width, record.step, dtype=complex))[0]
    forced, d_forced = np.zeros((len(record.omega), n), dtype=complex), np.zeros((len(record.omega), n, q), dtype=complex)
    for i in range(model.B.shape[1]):
        late, part = _parted(delays.get(i, Delay()), record.step, width)
        for offset, G in zip(NEIGHBOURS, _gains(A, B[:, :, i], part, record), strict=True):
            if not np.any(G):
                continue
            U = record.shifted(i, late - offset)
            forced += U[:, None] * G[0].real
            d_forced += U[:, None, None] * (G.imag / COMPLEX_STEP).T[None, :, :q]
    return Phi[0].real, Phi[:q].imag / COMPLEX_STEP, forced, d_forced


def _parted(delay: Delay, step: float, width: int) -> tuple[int, np.ndarray]:
    """Whole samples of a delay, and the rest of it as a share of one, ``(width,)``, with a complex step where the delay is wanted."""
    whole = int(np.floor(delay.seconds / step + 1e-12))
    rest = np.full(width, max(delay.seconds / step - whole, 0.0), dtype=complex)
    if delay.position is not None:
        rest[delay.position] += 1j * COMPLEX_STEP / step
    return whole, rest


def _gains(A: np.ndarray, b: np.ndarray, part: np.ndarray, record: TransformedRecord) -> Sequence[np.ndarray]:
    """What the samples u[k-1], u[k], u[k+1] of an input add to x[k+1], ``(q, n)`` each, where it is late by ``part`` of a sample.

    Over the first ``part`` of the interval the input still is what it was between the two samples before.
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


def _transition(A: np.ndarray, b: np.ndarray, time: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Over ``time (q,)``: the transition ``(q, n, n)``, and what an input of one and one that grows as the time do, ``(q, n)``."""
    from scipy.linalg import expm

    q, n = len(A), A.shape[1]
    block = np.zeros((q, n + 2, n + 2), dtype=complex)
    block[:, :n, :n], block[:, :n, n], block[:, n, n + 1] = A, b, 1.0
    found = expm(block * time[:, None, None])
    return found[:, :n, :n], found[:, :n, n], found[:, :n, n + 1]


def _read(model: LinearModel, record: TransformedRecord, delays: Mapping[int, Delay]) -> tuple[np.ndarray, np.ndarray]:
    """Inputs as the outputs feel them at the samples ``(f, r)``, and their slopes by the wanted parameters ``(f, r, q)``."""
    q, count = len(model.dA), model.B.shape[1]
    U, dU = np.zeros((len(record.omega), count), dtype=complex), np.zeros((len(record.omega), count, q), dtype=complex)
    for i in range(count):
        delay = delays.get(i, Delay())
        late, rest = _parted(Delay(delay.seconds), record.step, 1)
        share = float(rest[0].real)
        now, before = record.shifted(i, late), record.shifted(i, late + 1)
        if record.hold is Hold.PREVIOUS:
            U[:, i] = before if share > 0.0 else now
            continue
        U[:, i] = (1.0 - share) * now + share * before
        if delay.position is not None:
            dU[:, i, delay.position] = (before - now) / record.step
    return U, dU
