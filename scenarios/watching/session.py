"""A watch in progress: rows go in, the bank moves on, and what was taken is kept for the end.

The first rows are only collected: the noise levels, the trim and the start of two states are read off them, then they are filtered
like all others. What the filter is given, spikes left out, is the record that a batch run would get.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ident.banks.delays import likelihood_weights
from ident.banks.online import BankState, OnlineBank, Rows, advance, begin, online_bank
from ident.estimate import Estimate, Outcome
from scenarios.files.vehicles import VehicleFile
from scenarios.identification.low_order import derived_of, filter_system, less, mean_delay, noise_levels, trim_of
from scenarios.watching.rows import OUTPUTS
from sim.declaration.system import System
from sim.errors import RecordError
from sim.record import Channel, Record

BEGINNING = 2.0  # s that are collected before the filter starts
FEWEST = 40  # rows of it
SPIKE = 30.0  # standard deviations of the innovation
_UNITS = {"alpha": "rad", "q": "rad/s", "nz": "g"}


class Step(NamedTuple):
    """A row of the stream, the bank's state after it, and how many spikes were left out by then."""

    row: np.ndarray
    state: BankState
    spikes: int


@dataclass
class Session:
    """What a watch knows so far; ``take`` and ``start`` change it.

    ``taken`` are blocks of rows ``(5, n)`` in the order time, stick, alpha, q, nz as they came, spikes NaN once the filter left them out.
    ``system``, ``bank``, ``state`` and ``offsets`` are there once the filter has started.
    """

    vehicle: VehicleFile
    name: str
    stick_unit: str
    taken: list[np.ndarray] = field(default_factory=list)
    system: System | None = None
    bank: OnlineBank | None = None
    state: BankState | None = None
    offsets: Mapping[str, float] = field(default_factory=dict)
    spikes: int = 0

    @property
    def rows(self) -> int:
        """Rows so far."""
        return sum(block.shape[1] for block in self.taken)


def take(session: Session, rows: np.ndarray) -> list[Step]:
    """Filter rows ``(5, N)``; while they are still being collected there are no steps."""
    if rows.shape[1] == 0:
        return []
    session.taken.append(np.array(rows))
    if session.bank is None:
        times = [float(block[0, column]) for block, column in ((session.taken[0], 0), (session.taken[-1], -1))]
        return start(session) if times[1] - times[0] >= BEGINNING and session.rows >= FEWEST else []
    return _filter(session, session.taken[-1])


def start(session: Session) -> list[Step]:
    """Start the filter with what has come, however little.

    Raises
    ------
    RecordError : fewer than two rows, or no number in any output.
    """
    if session.bank is not None:
        return []
    record = record_of(session)
    noise = noise_levels(record)
    session.offsets = trim_of(record, noise)
    session.system = filter_system(less(record, session.offsets), session.vehicle, noise)
    session.bank = online_bank(session.system, float(np.median(np.diff(record.time))), gate=SPIKE)
    session.taken = [np.concatenate(session.taken, axis=1)]
    return _filter(session, session.taken[0])


def record_of(session: Session) -> Record:
    """The rows so far as a record, spikes that the filter left out missing.

    Raises
    ------
    RecordError : fewer than two rows, or no number in any output.
    """
    table = np.concatenate(session.taken, axis=1) if session.taken else np.zeros((2 + len(OUTPUTS), 0))
    if table.shape[1] < 2:
        raise RecordError(f"{table.shape[1]} row(s) that can be used", where=session.name, remedy="a stream needs at least two")
    outputs = tuple(Channel.of(name, _UNITS[name], row) for name, row in zip(OUTPUTS, table[2:], strict=True) if np.isfinite(row).any())
    if not outputs:
        raise RecordError("no number in any output", where=session.name, remedy=f"stream one of {', '.join(OUTPUTS)}")
    return Record(table[0], (Channel.of("stick", session.stick_unit, table[1]),), outputs, name=session.name)


def likely_estimate(bank: OnlineBank, state: BankState) -> tuple[Estimate, np.ndarray, tuple[float, float]]:
    """The most likely filter's parameters, the likelihood weights ``(B,)``, and the weighted delay with its deviation (s)."""
    best, n_x = state.best, len(bank.system.states)
    names = bank.names[n_x:]
    P = state.covariance[best, n_x:, n_x:]
    outcome = Outcome.CONVERGED if state.sound[best] else Outcome.DIVERGED
    log_likelihood = np.where(state.sound, state.log_likelihood, -np.inf)
    weights = likelihood_weights(log_likelihood)
    std = np.sqrt(np.diag(bank.R))
    likely = float(state.log_likelihood[best])
    estimate = Estimate(
        "online", names, bank.units, state.mean[n_x:, best].copy(), 0.5 * (P + P.T), outcome, likely, bank.system.output_names, std, ()
    )
    return estimate, weights, mean_delay(bank.delays, weights)


def derived_so_far(session: Session, estimate: Estimate, delay: tuple[float, float]) -> dict[str, tuple[float, float]]:
    """Natural frequency, damping ratio and delay of an estimate of the stream."""
    return derived_of(estimate, session.vehicle, delay)


def _filter(session: Session, block: np.ndarray) -> list[Step]:
    """Move the bank over the block's rows; spikes that it leaves out become NaN in the block."""
    bank = session.bank
    assert bank is not None
    levels = np.array([0.0, *(session.offsets.get(name, 0.0) for name in ("stick", *OUTPUTS))])[:, None]
    given = block - levels
    rows = Rows(given[0], given[1:2], given[2:])
    states: list[BankState] = []
    if session.state is None:
        states.append(begin(bank, Rows(*(part[..., :1] for part in rows))))
        rows = Rows(*(part[..., 1:] for part in rows))
    states += advance(bank, states[-1] if session.state is None else session.state, rows)
    session.state = states[-1]
    steps = []
    for column, state in enumerate(states):
        if state.skipped.any():
            block[2:, column][state.skipped] = np.nan
            session.spikes += int(state.skipped.sum())
        steps.append(Step(block[:, column], state, session.spikes))
    return steps
