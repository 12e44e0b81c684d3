"""Frames of the computer in which nothing is limited, many at a time: the loop is linear then, and a stretch of it one matrix product.

What comes near a limit is left to be stepped by ``sim.closed_loop.limits``, frame by frame, which is exact there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sim.closed_loop.airframe import X29
from sim.closed_loop.equations import Matrices, law_matrices, mixing, plant
from sim.closed_loop.limits import Stepper

FRAMES = 32  # at a time: more cost more for each, fewer do not repay the call
INSIDE = 1.0 - 1e-9  # of a limit, within which rounding does not decide


@dataclass(frozen=True, eq=False)
class Stretch:
    """``FRAMES`` steps of ``w' = A w + b r`` at once.

    Attributes
    ----------
    from_start : ``((FRAMES + 1) d, d)``, w at every frame from w at the first. from_input : ``((FRAMES + 1) d, FRAMES)``, from r.
    """

    from_start: np.ndarray
    from_input: np.ndarray

    def states(self, start: np.ndarray, driven: np.ndarray) -> np.ndarray:
        """w at the frames of ``driven (k,)``, at most ``FRAMES`` of them, and at the one after the last: ``(k + 1, d)``."""
        d, k = start.size, driven.size
        rows = (k + 1) * d
        return np.asarray(self.from_start[:rows] @ start + self.from_input[:rows, :k] @ driven).reshape(k + 1, d)


def stretch(A: np.ndarray, b: np.ndarray) -> Stretch:
    """Prepare ``A (d, d)``, ``b (d,)``."""
    d = b.size
    powers, pulses = np.empty((FRAMES + 1, d, d)), np.zeros((FRAMES + 1, d, FRAMES))
    powers[0] = np.eye(d)
    for j in range(FRAMES):
        powers[j + 1] = A @ powers[j]
    answer = powers[:-1] @ b
    for j in range(1, FRAMES + 1):
        pulses[j, :, :j] = answer[:j][::-1].T
    return Stretch(powers.reshape(-1, d), pulses.reshape(-1, FRAMES))


def filtered(block: Matrices, driven: np.ndarray) -> np.ndarray:
    """Output ``(N,)`` of a sampled block with one input and one output, from rest."""
    prepared, out, state = stretch(block.A, block.B[:, 0]), np.empty(driven.size), np.zeros(block.A.shape[0])
    for k in range(0, driven.size, FRAMES):
        part = driven[k : k + FRAMES]
        states = prepared.states(state, part)
        out[k : k + FRAMES] = states[:-1] @ block.C[0] + block.D[0, 0] * part
        state = states[-1]
    return out


@dataclass(frozen=True, eq=False)
class FreeFrames:
    """The loop with every ram free: plant states, then the computer's.

    Attributes
    ----------
    prepared : the loop over a stretch. watch, offset : ``(v, d)`` and ``(v,)``: a frame is free where ``|watch w + offset|`` stays below one.
    command : ``(d,)``, u_p. inner : ``(n, d)``, plant states at the last look of a record within the frame.
    """

    prepared: Stretch
    watch: np.ndarray
    offset: np.ndarray
    command: np.ndarray
    inner: np.ndarray

    def ahead(self, start: np.ndarray, reference: np.ndarray) -> np.ndarray:
        """w at the frames from ``start`` on that are free, and at the one after them, ``(f + 1, d)``; ``reference (k,)`` g at the frames."""
        states = self.prepared.states(start, reference[:FRAMES])
        seen = np.abs(states[:-1] @ self.watch.T + self.offset).max(axis=1)
        limited = np.flatnonzero(~(seen < INSIDE))
        return states if limited.size == 0 else states[: limited[0] + 1]


def free_frames(x29: X29, steppers: Sequence[Stepper], departure: float) -> FreeFrames:
    """Prepare the loop of an aircraft; ``departure`` rad of alpha ends a flight."""
    law, mix, n = law_matrices(x29.law), mixing(x29), plant(x29).A.shape[0]
    d = n + law.A.shape[0]
    command = np.concatenate([np.zeros(n), law.C[0]])
    # The extended state of the steppers, plant states, commands and one, from w; the last by ``offset``.
    state, watch, offset = np.eye(n, d), [], []
    inner = state
    for stepper in steppers:
        inner = state
        extended = np.concatenate([state, np.outer(mix, command)])
        watch.append(stepper.watch[:, :-1] @ extended)
        offset.append(stepper.watch[:, -1])
        state = stepper.free[:n, :-1] @ extended
    for i, surface in enumerate(x29.surfaces):
        half, middle = (surface.upper - surface.lower) / 2.0, (surface.upper + surface.lower) / 2.0 - surface.trim
        watch.append(mix[i] / half * command[None])
        offset.append(np.array([-middle / half]))
    watch.append(np.eye(1, d) / departure)
    offset.append(np.zeros(1))
    sensed = law.B[:, 1:] @ plant(x29).C[6:8]
    A = np.concatenate([state, np.concatenate([sensed, law.A], axis=1)])
    b = np.concatenate([np.zeros(n), law.B[:, 0]])
    return FreeFrames(stretch(A, b), np.concatenate(watch), np.concatenate(offset), command, inner)
