"""Free simulations of records with parameters as estimated: what was fitted, and what was held out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.tracing.diagnosis import ErrorFigures
from ident.tracing.validation.error_figures import error_figures
from ident.whole_record.best_start import in_pieces, put_together
from ident.whole_record.fit_problem import FitProblem
from ident.whole_record.gauss_newton import fit_whole_records
from ident.whole_record.layout import FitSettings, lay_out
from sim.declaration.system import System
from sim.record import Record


@dataclass(frozen=True, eq=False)
class RecordFit:
    """One record and its free simulation ``simulated (m, N)`` of ``outputs``; only initial state and biases were fitted to it.

    ``figures`` of the outputs that it has; None where the simulation left all measure. ``held_out``: it took no part in the estimate.
    """

    record: Record
    outputs: tuple[str, ...]
    simulated: np.ndarray
    figures: ErrorFigures | None
    held_out: bool

    def fit_percent(self, channel: str) -> float:
        """100 (1 - rms error over the spread of the measurement)."""
        assert self.figures is not None
        return 100.0 * (1.0 - self.figures.nrmse[channel])


def record_fits(
    fitted: Sequence[Record],
    held_out: Sequence[Record],
    system: System,
    values: Mapping[str, float],
    settings: FitSettings,
    local: Collection[str] = (),
    known: Sequence[np.ndarray] = (),
) -> tuple[RecordFit, ...]:
    """Each record simulated with the parameters at ``values``, those that were fitted first.

    Initial states, ``bias_*`` and the parameters ``local`` to a record are fitted to it. ``known``: simulations ``(m, N)`` that are there already.
    """
    out = []
    for number, record in enumerate([*fitted, *held_out]):
        rows = known[number] if number < len(known) else simulated(record, system, values, settings, local)
        out.append(_judged(record, system, rows, held_out=number >= len(fitted)))
    return tuple(out)


def _judged(record: Record, system: System, rows: np.ndarray | None, *, held_out: bool) -> RecordFit:
    channels = tuple(name for name in system.output_names if name in record.output_names)
    if rows is None:
        blank = np.full((len(system.outputs), len(record)), np.nan)
        return RecordFit(record, system.output_names, blank, None, held_out)
    at = [system.output_names.index(name) for name in channels]
    masks = np.array([record[name].valid for name in channels])
    return RecordFit(record, system.output_names, rows, error_figures([rows[at]], [record], [masks], channels), held_out)


def simulated(record: Record, system: System, values: Mapping[str, float], settings: FitSettings, local: Collection[str] = ()) -> np.ndarray | None:
    """Outputs ``(m, N)`` of a free simulation; None where it is not finite. A motion that grows is followed in pieces, as in a fit."""
    known = {name: value for name, value in values.items() if name in system.parameters and not name.startswith("bias_") and name not in local}
    started = replace(system, parameters=system.parameters.with_values(known))
    own = [name for name in system.parameters.free_names if name.startswith("bias_") or name in local]
    frozen = replace(started, parameters=started.parameters.only_free(own))
    pieces = in_pieces([record], started, settings, local)
    fit = fit_whole_records(FitProblem(lay_out(pieces[0], frozen, replace(settings, use_priors=False), local=local)))
    return None if fit is None else put_together([line.y for line in fit.lines], pieces)[0]
