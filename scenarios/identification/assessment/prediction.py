"""Free simulations of records with parameters as estimated: what was fitted, and what was held out."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ident.tracing.diagnosis import ErrorFigures
from ident.tracing.validation.error_figures import error_figures
from ident.whole_record.gauss_newton import fit_whole_records
from ident.whole_record.layout import FitProblem, FitSettings, lay_out
from ident.whole_record.output_error import in_pieces
from ident.whole_record.output_error import put_together as of_pieces
from scenarios.identification.wild_points import same_points, wild_points, without
from scenarios.preparation.gaps import Parted, parts_of, put_together
from sim.declaration.model import System
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
    *,
    trusted: bool = False,
) -> tuple[RecordFit, ...]:
    """Each record simulated with the parameters at ``values``, those that were fitted first.

    Wild points of those that were not fitted are set aside, unless they are ``trusted``: they would
    bend the initial states and biases.
    Initial states, ``bias_*`` and the parameters ``local`` to a record are fitted to it. ``known``: simulations ``(m, N)`` that are there already.
    """

    def run(records: Sequence[Record]) -> list[np.ndarray | None]:
        return [simulated(record, system, values, settings, local) for record in records]

    rows = [*known, *run(fitted[len(known) :])]
    out = [_judged(record, system, one, held_out=False) for record, one in zip(fitted, rows, strict=True)]
    masks: list[dict[str, np.ndarray]] = [{} for _ in held_out]
    predicted, kept = run(held_out), list(held_out)
    for _ in range(0 if trusted or not held_out else 2):
        blank = [np.full((len(system.outputs), len(record)), np.nan) for record in held_out]
        finite = [one if one is not None else none for one, none in zip(predicted, blank, strict=True)]
        again = wild_points(system.output_names, finite, held_out)
        if same_points(again, masks):
            break
        masks, kept = again, [without(record, some) for record, some in zip(held_out, again, strict=True)]
        predicted = run(kept)
    return (*out, *(_judged(record, system, one, held_out=True) for record, one in zip(kept, predicted, strict=True)))


def pooled_fits(fits: Sequence[RecordFit], parted: Sequence[Parted]) -> tuple[RecordFit, ...]:
    """The fits with the parts of each record that was predicted put together: the errors are those
    of all its parts."""
    fitted, held = [fit for fit in fits if not fit.held_out], [fit for fit in fits if fit.held_out]
    return (*fitted, *(_whole(one, held[span]) for one, span in parts_of(parted, [fit.record for fit in held])))


def _whole(parted: Parted, parts: Sequence[RecordFit]) -> RecordFit:
    record, (rows,) = put_together(parted, [part.record for part in parts], [[part.simulated for part in parts]])
    if len(parts) == 1 and len(record) == len(parts[0].record):
        return replace(parts[0], record=record)
    if any(part.figures is None for part in parts):
        return replace(parts[0], record=record, simulated=np.full_like(rows, np.nan), figures=None)
    outputs = parts[0].outputs
    channels = tuple(name for name in outputs if name in record.output_names)
    masks = np.array([record[name].valid for name in channels])
    figures = error_figures([rows[[outputs.index(name) for name in channels]]], [record], [masks], channels)
    return RecordFit(record, outputs, rows, figures, parts[0].held_out)


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
    return None if fit is None else of_pieces([line.y for line in fit.lines], pieces)[0]
