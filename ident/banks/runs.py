"""What goes into a pass of a bank of filters and what comes out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from ident.filters.problem import FilterProblem
from sim.propagation import Drive


@dataclass(frozen=True, eq=False)
class BankRuns:
    """What differs between B runs: all parameters ``p`` (entries floats or ``(B,)``), the drive, outputs ``z (m, N, B)`` or
    ``(m, N, 1)``, starting means ``start (n, B)``."""

    p: list[Any]
    drive: Drive
    z: np.ndarray
    start: np.ndarray

    def only(self, chosen: np.ndarray) -> BankRuns:
        """The chosen runs, by position."""
        runs = self.start.shape[1]

        def cut(row: Any) -> Any:
            return row[..., chosen] if np.ndim(row) and np.shape(row)[-1] == runs > 1 else row

        def cut_rows(rows: list[Any]) -> list[Any]:
            return [cut(row) if np.ndim(row) > 1 else row for row in rows]

        begin, middle, end = (cut_rows(rows) for rows in self.drive.stages)
        drive = Drive((begin, middle, end), cut_rows(self.drive.begin), cut_rows(self.drive.end))
        return BankRuns([cut(value) for value in self.p], drive, cut(self.z), self.start[:, chosen])


@dataclass(frozen=True, eq=False)
class BankHistory:
    """Sample by sample, each ``(rows, N, B)``: innovations with their standard deviations, means and standard deviations
    after each update. From the sample on where a run broke down its mean stays; an innovation that is missing is
    zero with standard deviation one."""

    innovation: np.ndarray
    innovation_std: np.ndarray
    mean: np.ndarray
    std: np.ndarray


@dataclass(frozen=True, eq=False)
class BankPass:
    """Result of one pass: mean ``(n, B)``, covariance ``(B, n, n)``, log-likelihood ``(B,)`` and nis ``(N, B)`` of the sound
    samples, ``sound (B,)``, the history when asked for."""

    mean: np.ndarray
    covariance: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    sound: np.ndarray
    history: BankHistory | None


@dataclass(frozen=True, eq=False)
class BankTrace:
    """What a smoother needs of one pass over N samples: after each update ``mean (N, n, B)`` and ``covariance (N, B, n, n)``; the
    state rows ``moved (N, B, n_x, n)`` of the transition from the sample before, less the identity; of the update ``H`` and
    ``HP (N, B, m, n)``, ``S (N, B, m, m)`` and ``y (N, B, m)``, zero, and one in S, for a missing channel."""

    mean: np.ndarray
    covariance: np.ndarray
    moved: np.ndarray
    H: np.ndarray
    HP: np.ndarray
    S: np.ndarray
    y: np.ndarray


def empty_trace(problem: FilterProblem, B: int) -> BankTrace:
    """A trace to be filled by ``run_pass``."""
    n, n_x, (m, N) = len(problem.names), len(problem.system.states), problem.valid.shape
    rows, whole = (N, B, m, n), np.zeros((N, B, n, n))
    S = np.array(np.broadcast_to(np.eye(m), (N, B, m, m)))
    return BankTrace(np.zeros((N, n, B)), whole, np.zeros((N, B, n_x, n)), np.zeros(rows), np.zeros(rows), S, np.zeros((N, B, m)))


class Stretch(NamedTuple):
    """K samples of a pass: after each update ``mean (K, B, n)`` and ``covariance (K, B, n, n)``, and of the update itself
    ``innovation (K, B, m, 1 + m)``, y and S side by side; a channel that is missing has zero in y and S, and one on the diagonal."""

    mean: np.ndarray
    covariance: np.ndarray
    innovation: np.ndarray


class March(Protocol):
    """Filters the samples ``first`` to before ``last`` from means ``x (n, B)`` and covariances ``P (B, n, n)`` after the sample before.

    ``about (n, N, B)`` is a trajectory to linearise about instead of the filter's own; ``trace`` is filled where given.
    What breaks down goes on with numbers that are not finite, or variances that are negative.
    """

    def __call__(self, first: int, last: int, x: np.ndarray, P: np.ndarray, about: np.ndarray | None, trace: BankTrace | None) -> Stretch: ...
