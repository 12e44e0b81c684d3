"""Many extended Kalman filters in one batched pass: banks of delays, Monte-Carlo campaigns.

The same filter as `ident.ekf`, with runs on a batch axis and measurements taken one scalar at a time
(equal to the joint update for a diagonal R). Agrees with filterpy's filter to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ident.ekf import FilterSettings
from ident.setup import filter_problem, with_free
from sim.grid import drive_from_record
from sim.maths import COMPLEX_STEP
from sim.record import Record
from sim.system import System

LOG_TWO_PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, eq=False)
class BankEstimate:
    """Final estimates of B filters.

    Attributes
    ----------
    names : states, then free parameters (n).
    mean : ``(n, B)``, covariance : ``(B, n, n)`` after the last sample.
    log_likelihood : ``(B,)``; minus infinity for a run that broke down.
    nis : ``(N, B)`` normalised innovation squared at each sample.
    sound : ``(B,)`` False where a run broke down; its mean and covariance are the start's.
    innovation, innovation_std : ``(m, N, B)``, kept when asked for.
    history : ``(n, N, B)`` means after each update, kept when asked for.
    """

    names: tuple[str, ...]
    mean: np.ndarray
    covariance: np.ndarray
    log_likelihood: np.ndarray
    nis: np.ndarray
    sound: np.ndarray
    innovation: np.ndarray | None = None
    innovation_std: np.ndarray | None = None
    history: np.ndarray | None = None
    history_std: np.ndarray | None = None

    @property
    def std(self) -> np.ndarray:
        """Standard deviations after the last sample, ``(n, B)``."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2).T, 0.0))


def run_bank(
    record: Record,
    system: System,
    settings: FilterSettings | None = None,
    *,
    z: np.ndarray | None = None,
    held: dict[str, np.ndarray] | None = None,
    start: np.ndarray | None = None,
    keep: bool = False,
) -> BankEstimate:
    """Run B filters over one time base.

    Parameters
    ----------
    record : time, inputs, and the validity of the outputs, shared by all runs.
    system : compiled with ``online=True``.
    settings : as for ``run_ekf``; ``passes`` repeats the whole bank from its own result.
    z : outputs of each run, ``(m, N, B)``; the record's own for all when None.
    held : values of held parameters by name, ``(B,)`` each, e.g. ``{"input-delay.delay": delays}``.
    start : starting mean of states and free parameters, ``(n,)`` or ``(n, B)``; the System's when None.
    keep : also return histories of means and innovations.

    Raises
    ------
    ModelError : as for ``run_ekf``.
    """
    settings = settings or FilterSettings()
    problem = filter_problem(record, system, settings.max_step)
    grid, n_x, n = problem.grid, len(system.states), len(problem.names)
    m, N = problem.valid.shape
    p: list = list(problem.p)
    for name, values in (held or {}).items():
        p[system.parameters.index(name)] = np.asarray(values, dtype=float)
    drive = problem.drive
    if held:
        drive = drive_from_record(system, p, record.input_array(system.input_names), record.time, record.hold, grid)
    z_runs = problem.z[:, :, None] if z is None else np.asarray(z, dtype=float)
    runs = max([z_runs.shape[2], *(np.size(v) for v in (held or {}).values()), 1 if start is None or start.ndim == 1 else start.shape[1]])
    first = problem.start if start is None else start
    x = np.array(np.broadcast_to(first.reshape(n, -1), (n, runs)))
    for done in range(settings.passes):
        before = x
        x_pass = np.array(np.broadcast_to(first.reshape(n, -1), (n, runs)))
        if done:
            x_pass[n_x:] = before[n_x:]
        estimate = _one_pass(problem, settings, p, drive, z_runs, x_pass, n_x, m, N, keep)
        x = estimate.mean
    return estimate


def _one_pass(problem, settings, p, drive, z, x, n_x, m, N, keep):  # type: ignore[no-untyped-def]
    system, grid, (n, runs) = problem.system, problem.grid, x.shape
    start = x.copy()
    P = np.array(np.broadcast_to(problem.covariance, (runs, n, n)))
    log_likelihood, nis = np.zeros(runs), np.zeros((N, runs))
    kept = (
        {key: np.zeros((rows, N, runs)) for key, rows in (("innovation", m), ("innovation_std", m), ("history", n), ("history_std", n))}
        if keep
        else {}
    )
    diagonal = np.arange(n)
    with np.errstate(all="ignore"):
        for k in range(N):
            if k:
                for s in range(grid.sample[k - 1], grid.sample[k]):
                    u = tuple([row[s] for row in stage] for stage in drive.stages)
                    t, dt = grid.edges[s], grid.steps[s]
                    F = np.zeros((runs, n, n))
                    F[:, :n_x] = _jacobian(lambda a, t=t, u=u: system.f(t, a[:n_x], u[0], with_free(p, problem.free, a[n_x:])), x, runs)
                    Phi, noise = settings.transition(F, problem.density, float(dt))
                    x[:n_x] = settings.step(system.f, t, list(x[:n_x]), u, with_free(p, problem.free, list(x[n_x:])), dt)
                    P = Phi @ P @ np.swapaxes(Phi, 1, 2) + noise
            channels = np.flatnonzero(problem.valid[:, k])
            if channels.size:
                t, u_now = grid.edges[grid.sample[k]], [row[grid.sample[k]] for row in drive.begin]

                def outputs(a, t=t, u_now=u_now):  # type: ignore[no-untyped-def]
                    return system.h(t, a[:n_x], u_now, with_free(p, problem.free, a[n_x:]))

                H = _jacobian(outputs, x, runs)
                predicted = [np.broadcast_to(y, runs) for y in outputs(list(x))]
                move = np.zeros_like(x)
                for i in channels:
                    row = H[:, i]
                    PH = (P @ row[:, :, None])[:, :, 0]
                    S = np.einsum("bi,bi->b", row, PH) + problem.variance[i]
                    y = z[i, k] - predicted[i] - np.einsum("bi,ib->b", row, move)
                    gain = PH / S[:, None]
                    move += gain.T * y
                    P = P - gain[:, :, None] * PH[:, None, :]
                    squared = y * y / S
                    nis[k] += squared
                    log_likelihood -= 0.5 * (squared + np.log(S) + LOG_TWO_PI)
                    if keep:
                        kept["innovation"][i, k], kept["innovation_std"][i, k] = y, np.sqrt(S)
                x = x + move
            P = 0.5 * (P + np.swapaxes(P, 1, 2))
            if keep:
                kept["history"][:, k], kept["history_std"][:, k] = x, np.sqrt(np.maximum(P[:, diagonal, diagonal].T, 0.0))
    sound = (
        np.all(np.isfinite(x), axis=0)
        & np.all(np.isfinite(P), axis=(1, 2))
        & np.isfinite(log_likelihood)
        & np.all(P[:, diagonal, diagonal] >= 0, axis=1)
    )
    x, P = np.where(sound, x, start), np.where(sound[:, None, None], P, problem.covariance)
    return BankEstimate(problem.names, x, P, np.where(sound, log_likelihood, -np.inf), np.where(sound, nis, 0.0), sound, **kept)


def _jacobian(function, x, runs):  # type: ignore[no-untyped-def]
    """Complex-step Jacobian of each run, ``(B, m, n)``, all columns in one call."""
    n = len(x)
    rows = np.array(np.broadcast_to(x[:, None, :], (n, n, runs)), dtype=complex)
    rows[np.arange(n), np.arange(n)] += 1j * COMPLEX_STEP
    out = function(list(rows))
    jacobian = np.empty((runs, len(out), n))
    for i, value in enumerate(out):
        jacobian[:, i] = np.broadcast_to(np.imag(value), (n, runs)).T / COMPLEX_STEP
    return jacobian
