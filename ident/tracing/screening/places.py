"""A signature put to many places of the records: what share of the residual it explains there, and
with which amplitudes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ident.estimate import LARGEST, counted_numerics
from ident.tracing import thresholds
from ident.tracing.candidate_model.fitted_model import FittedModel
from sim.declaration.proposal import Probe

# numbers of moved signatures that are whitened together: more do not stay in a processor's cache
_AT_ONCE = 200_000


@dataclass(frozen=True, eq=False)
class Whitened:
    """The fitted model's residual ``e (D,)``, orthonormal basis of its Jacobian ``Q (D, n)``, and
    the rows of each record.
    """

    e: np.ndarray
    Q: np.ndarray
    rows: tuple[slice, ...]


@dataclass(frozen=True, eq=False)
class WeighedPlaces:
    """A signature of ``k`` columns at some places, in samples: whitened ``flat (places k, D)``,
    ``gains (places,)``, ``amplitudes (places, k)``.

    ``each`` : rows of the outputs, and the amplitudes there.
    """

    places: tuple[int, ...]
    flat: np.ndarray
    gains: np.ndarray
    amplitudes: np.ndarray
    each: tuple[tuple[slice, np.ndarray], ...]

    def at(self, place: int) -> WeighedPlaces:
        """The same of one place alone, which no longer holds what the others need."""
        k, here = self.amplitudes.shape[1], slice(place, place + 1)
        flat = self.flat if len(self.places) == 1 else self.flat[place * k : (place + 1) * k].copy()
        return WeighedPlaces(
            self.places[here],
            flat,
            self.gains[here],
            self.amplitudes[here],
            tuple((rows, a[here]) for rows, a in self.each),
        )


def whitened(fitted: FittedModel) -> Whitened:
    fit, layout = fitted.fit, fitted.fit.layout
    sizes = [problem.valid.size for problem in layout.problems]
    ends = np.cumsum(sizes)
    rows = tuple(slice(int(end - size), int(end)) for size, end in zip(sizes, ends, strict=True))
    J = np.zeros((int(ends[-1]), len(fit.theta)))
    e = np.zeros(int(ends[-1]))
    for r, (problem, at) in enumerate(zip(layout.problems, rows, strict=True)):
        w = np.where(problem.valid, 1.0 / np.sqrt(fit.variance)[:, None], 0.0)
        J[at, layout.columns(r)] = (fit.jacobians[r] * w[:, :, None]).reshape(sizes[r], -1)
        e[at] = (fit.residuals[r] * w).ravel()
    scale = np.linalg.norm(J, axis=0)
    acting = scale > 0
    Q, _ = np.linalg.qr(J[:, acting] / scale[acting])
    return Whitened(e - Q @ (Q.T @ e), Q, rows)


def places_of(fitted: FittedModel, probe: Probe, onset: str) -> list[int]:
    """By how many samples a probe's signature is moved: over the whole record where it merely
    shifts with the onset.
    """
    if not (probe.shifts and onset):
        return [0]
    longest = max(len(problem.record) for problem in fitted.fit.layout.problems)
    return list(range(0, longest - 2, max(1, longest // thresholds.PLACES)))


def closer_places(weighed: WeighedPlaces) -> list[int]:
    """Every sample between the neighbours of the best place."""
    places = weighed.places
    at = int(np.argmax(weighed.gains))
    return list(range(places[max(at - 1, 0)], places[min(at + 1, len(places) - 1)] + 1))


def weigh(
    fitted: FittedModel,
    parts: Sequence[np.ndarray],
    white: Whitened,
    spans: Sequence[slice],
    places: Sequence[int],
) -> WeighedPlaces:
    """A signature at each of some places, acting on each of ``spans`` by itself; one whose square
    leaves the range of numbers counts as none.
    """
    with counted_numerics():
        return _weighed(fitted, parts, white, spans, places)


def _weighed(
    fitted: FittedModel,
    parts: Sequence[np.ndarray],
    white: Whitened,
    spans: Sequence[slice],
    places: Sequence[int],
) -> WeighedPlaces:
    total, N = float(white.e @ white.e), float(fitted.fit.counts.sum())
    flat = _placed(fitted, parts, white, places)
    beyond = ~(np.einsum("ij,ij->i", flat, flat) < LARGEST**2)
    if np.any(beyond):
        flat[beyond] = 0.0
    k = len(flat) // len(places)
    gains, amplitudes, each = np.zeros(len(places)), np.zeros((len(places), k)), []
    for rows in spans:
        share, a = _explained(white, rows, flat, k, total)
        gain = -0.5 * N * np.log1p(-np.minimum(share, 0.999999))
        amplitudes = np.where((gain > gains)[:, None], a, amplitudes)
        gains = gains + gain
        each.append((rows, a))
    return WeighedPlaces(tuple(places), flat, gains, amplitudes, tuple(each))


def _placed(
    fitted: FittedModel, parts: Sequence[np.ndarray], white: Whitened, places: Sequence[int]
) -> np.ndarray:
    """Whitened signature at each place, ``(places k, D)``, the columns of a place one behind the
    other.

    A later onset only shifts a signature, by whole samples here: the fit that follows moves it by
    fractions.
    """
    k = parts[0].shape[2]
    out = np.empty((len(places) * k, len(white.e)))
    for r, (part, rows) in enumerate(zip(parts, white.rows, strict=True)):
        m, N = part.shape[:2]
        turned, few = part.transpose(2, 0, 1), max(1, _AT_ONCE // part.size)
        for first in range(0, len(places), few):
            some = places[first : first + few]
            moved = np.zeros((len(some), k, m, N))
            for number, shift in enumerate(some):
                moved[number, :, :, shift:] = turned[:, :, : max(N - shift, 0)]
            whitened = fitted.fit.whiten(r, moved.reshape(-1, m, N).transpose(1, 2, 0))
            out[first * k : (first + len(some)) * k, rows] = whitened.transpose(2, 0, 1).reshape(
                -1, m * N
            )
    return out


def _explained(
    white: Whitened, rows: slice, flat: np.ndarray, k: int, total: float
) -> tuple[np.ndarray, np.ndarray]:
    """For each place, acting on ``rows`` alone: share of the residual that its columns explain, and
    their amplitudes ``(places, k)``.

    The residual is orthogonal to the fitted model's Jacobian, so that only sizes of the projected
    columns are needed.
    """
    block, Q, e = flat[:, rows], white.Q[rows], white.e[rows]
    places = len(block) // k
    columns, inside = block.reshape(places, k, -1), (block @ Q).reshape(places, k, -1)
    whole = columns @ columns.swapaxes(1, 2)
    raw, gram = np.einsum("pii->pi", whole), whole - inside @ inside.swapaxes(1, 2)
    size = np.sqrt(np.maximum(np.einsum("pii->pi", gram), 0.0))
    # What the fitted model's own parameters explain but for rounding is no signature.
    sound = np.isfinite(size) & (size > 1e-5 * np.sqrt(raw)) & (size > 0)
    scale = np.where(sound, 1.0 / np.where(sound, size, 1.0), 0.0)
    b = (block @ e).reshape(places, k) * scale
    unit = gram * scale[:, :, None] * scale[:, None, :] + np.eye(k) * (1e-9 + ~sound[:, None, :])
    coefficients = np.linalg.solve(
        np.where(np.isfinite(unit), unit, 0.0) + np.eye(k) * ~np.isfinite(unit),
        np.nan_to_num(b)[:, :, None],
    )[:, :, 0]
    share = np.clip(np.einsum("pk,pk->p", coefficients, np.nan_to_num(b)) / total, 0.0, 1.0)
    return share, coefficients * scale


def added_by(white: Whitened, weighed: WeighedPlaces) -> np.ndarray:
    """What a signature that is weighed at one place adds to the projected outputs, ``(D,)``."""
    out = np.zeros(len(white.e))
    for rows, amplitudes in weighed.each:
        out[rows] += amplitudes[0] @ weighed.flat[:, rows]
    return out - white.Q @ (white.Q.T @ out)
