"""The history of a watch: a line a row, appended and flushed while the stream goes on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import IO

import numpy as np

from ident.banks.delays import likelihood_weights
from ident.banks.online import OnlineBank
from ident.banks.relinearised import joint_estimate
from scenarios.watching.rows import OUTPUTS
from scenarios.watching.session import Step
from sim.errors import FlightidError

NAME = "history.csv"
PART = "history.csv.part"


class History:
    """A file ``history.csv.part`` in the study's folder that grows; ``finish`` hands it over as a whole.

    Columns: ``time``; ``most_likely_delay``, ``weighted_delay`` (s); ``log_likelihood`` of the most likely filter, empty
    once all filters have broken down; ``weight_25ms`` and so on;
    states and parameters of the most likely filter, each ``NAME``, ``NAME_std`` as that filter has it, and ``NAME_spread``, the deviation that
    other starts and the grid of delays add; where the bank is linearised anew ``refined_NAME`` and ``refined_NAME_std`` of the parameters and
    the delay, empty until it first is; ``innovation_CHANNEL`` in standard deviations, an empty cell where nothing was measured; ``spikes``,
    how many samples of the row were left out.
    """

    def __init__(self, folder: Path) -> None:
        self._folder, self._made = folder, not folder.exists()
        self.path = folder / PART
        self._file: IO[str] | None = None
        self._bank: OnlineBank | None = None

    def __enter__(self) -> History:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        """Leave nothing behind that is not whole."""
        if self._file is not None:
            self._file.close()
            self.path.unlink(missing_ok=True)
        if kind is not None and self._made and self._folder.is_dir() and not any(self._folder.iterdir()):
            self._folder.rmdir()

    def write(self, bank: OnlineBank, steps: Sequence[Step], refine: bool = False) -> None:
        """Append a line for each step, all of them on disk when this returns; ``refine``: the bank is linearised anew on its way.

        Raises
        ------
        FlightidError : the folder cannot be written.
        """
        if not steps:
            return
        try:
            if self._file is None:
                self._folder.mkdir(parents=True, exist_ok=True)
                self._file = self.path.open("w", encoding="ascii", newline="")
                self._file.write(",".join(columns(bank, refine)) + "\n")
            self._file.write(lines(bank, steps, refine))
            self._file.flush()
        except OSError as error:
            what = f"cannot be written ({error.strerror})"
            raise FlightidError(what, where=str(self._folder), remedy="name a folder that you may write in") from None

    def finish(self) -> str:
        """The whole text."""
        if self._file is not None:
            self._file.close()
            self._file = None
            text = self.path.read_text(encoding="ascii")
            self.path.unlink()
            return text
        return ""


def columns(bank: OnlineBank, refine: bool = False) -> list[str]:
    """Names of the columns."""
    weights = [f"weight_{1000.0 * delay:g}ms" for delay in bank.delays]
    values = [name for each in bank.names for name in (each, f"{each}_std", f"{each}_spread")]
    if refine:
        values += [name for each in (*bank.names[len(bank.system.states) :], "delay") for name in (f"refined_{each}", f"refined_{each}_std")]
    head = ["time", "most_likely_delay", "weighted_delay", "log_likelihood"]
    return [*head, *weights, *values, *(f"innovation_{name}" for name in OUTPUTS), "spikes"]


def lines(bank: OnlineBank, steps: Sequence[Step], refine: bool = False) -> str:
    """A line a step, ten digits a number."""
    B, n, count = len(bank.delays), len(bank.names), len(steps)
    states = [step.state for step in steps]
    each = np.arange(count)
    log_likelihood = np.array([np.where(state.sound, state.log_likelihood, -np.inf) for state in states])
    best = log_likelihood.argmax(axis=1)
    weights = likelihood_weights(log_likelihood)
    variance = np.array([state.covariance[run].reshape(-1)[:: n + 1] for state, run in zip(states, best.tolist(), strict=True)])
    n_x = len(bank.system.states)
    table = np.full((count, 4 + B + 3 * n + (2 * (n - n_x + 1) if refine else 0)), np.nan)
    table[:, 0], table[:, 1] = [step.row[0] for step in steps], bank.delays[best]
    table[:, 2], table[:, 3] = weights @ bank.delays, log_likelihood[each, best]
    table[:, 4 : 4 + B] = weights
    last = 4 + B + 3 * n
    table[:, 4 + B : last : 3] = [state.mean[:, run] for state, run in zip(states, best.tolist(), strict=True)]
    table[:, 5 + B : last : 3] = np.sqrt(np.maximum(variance, 0.0))
    spread = np.array([step.spread for step in steps])
    table[:, 6 + B : last : 3] = np.where(np.isfinite(spread), spread, np.nan)
    for row, step in enumerate(steps):
        if refine and step.refined is not None:
            found = joint_estimate(step.refined)
            table[row, last::2], table[row, last + 1 :: 2] = found.values, found.std
    innovations = np.array([state.innovation for state in states])
    spikes = [int(np.count_nonzero(state.skipped)) for state in states]
    form = ",".join(["%.10g"] * table.shape[1] + ["%.4g"] * innovations.shape[1]) + ",%d\n"
    text = "".join(form % (*numbers, *sizes, more) for numbers, sizes, more in zip(table.tolist(), innovations.tolist(), spikes, strict=True))
    return text.replace(",-inf,", ",,").replace(",nan,", ",,").replace(",nan,", ",,")  # a match takes the comma of the next
