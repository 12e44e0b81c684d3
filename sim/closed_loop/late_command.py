"""The linear loop whose computing delay is no whole number of frames: python-control systems for studies of its margins.

The computer reads its sensors at a frame and moves the command ``late`` seconds after it, whatever ``delay_frames`` of its law says. The command
holds until the next one comes, so sampling is exact: over a frame the old command acts for the rest of ``late``, then the new one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sim.closed_loop.airframe import X29
from sim.closed_loop.equations import OUTPUT_NAMES, law_matrices, mixing, plant, shaping_matrices
from sim.errors import ModelError

if TYPE_CHECKING:
    from control import StateSpace


@dataclass(frozen=True, eq=False)
class LateLoop:
    """A loop in its three sampled parts: plant from ``u_p`` to ``OUTPUT_NAMES``, law from r, gyro and accelerometer to ``u_p`` without any
    delay, stick shaping from stick to r; and the sample time, s."""

    plant: StateSpace
    law: StateSpace
    shaping: StateSpace
    frame: float

    @property
    def open_loop(self) -> StateSpace:
        """The loop broken at u_p: the negated command that comes back; 1 + L = 0 closes it."""
        import control

        law, plant = self.law, self.plant
        back = control.ss(law.A, law.B[:, 1:], -law.C, -law.D[:, 1:], self.frame)
        return back * control.ss(plant.A, plant.B, plant.C[6:8], plant.D[6:8], self.frame)

    def response(self, omega: np.ndarray) -> np.ndarray:
        """Response of alpha, q and incremental nz to the stick from frame to frame, complex ``(3, n)``, per inch; ``omega`` in rad/s."""
        z = np.exp(1j * np.asarray(omega) * self.frame)
        moved, law, shaped = (_at(block, z) for block in (self.plant, self.law, self.shaping))
        returned = -(law[:, 0, 1] * moved[:, 6, 0] + law[:, 0, 2] * moved[:, 7, 0])
        return np.asarray(moved[:, :3, 0].T * law[:, 0, 0] * shaped[:, 0, 0] / (1.0 + returned))


def late_loop(x29: X29, late: float) -> LateLoop:
    """The loop of ``x29`` with commands ``late`` s after the frame whose sensors they were computed from. Raises ModelError for a negative one."""
    import control

    if not late >= 0.0:
        raise ModelError(f"a computing delay of {late:g} s", where="late_loop", remedy="give 0 or more")
    law = law_matrices(replace(x29.law, delay_frames=1))
    shaping, gain = shaping_matrices(x29.stick, x29.frame), x29.stick.gain
    # Of a law with one frame of delay the third state is the command on its way: its row is the law without delay.
    return LateLoop(
        _late_plant(x29, late),
        control.ss(law.A[:2, :2], law.B[:2], law.A[2:3, :2], law.B[2:3], x29.frame),
        control.ss(shaping.A, gain * shaping.B, shaping.C, gain * shaping.D, x29.frame),
        x29.frame,
    )


def _at(block: StateSpace, z: np.ndarray) -> np.ndarray:
    """Transfer matrices ``(n, outputs, inputs)`` at ``z (n,)``, all in one solution; python-control's own call takes one point after the other."""
    resolvent = z[:, None, None] * np.eye(block.nstates) - block.A
    return np.asarray(block.C @ np.linalg.solve(resolvent, np.broadcast_to(block.B, (z.size, *block.B.shape))) + block.D)


def _late_plant(x29: X29, late: float) -> StateSpace:
    """From u_p to ``OUTPUT_NAMES``; states: the plant's, then the commands of the frames before, the latest first."""
    import control

    system, T = plant(x29), x29.frame
    whole = int(np.floor(late / T + 1e-9))
    rest = max(late - whole * T, 0.0)
    continuous = control.ss(system.A, system.B @ mixing(x29)[:, None], system.C, np.zeros((len(OUTPUT_NAMES), 1)))
    after = control.sample_system(continuous, T - rest, "zoh")
    n, m = system.A.shape[0], whole + 1
    A, B = np.zeros((n + m, n + m)), np.zeros((n + m, 1))
    A[:n, :n], new = after.A, after.B
    if rest > 0.0:
        before = control.sample_system(continuous, rest, "zoh")
        A[:n, :n], A[:n, n + whole : n + whole + 1] = after.A @ before.A, after.A @ before.B
    if whole:
        A[:n, n + whole - 1 : n + whole] += new
    else:
        B[:n] = new
    B[n] = 1.0
    A[n + 1 :, n : n + m - 1] = np.eye(m - 1)
    C = np.hstack([system.C, np.zeros((len(OUTPUT_NAMES), m))])
    return control.ss(A, B, C, np.zeros((len(OUTPUT_NAMES), 1)), T)
