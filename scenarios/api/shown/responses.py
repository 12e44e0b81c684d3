"""Signals over time beside a model's, and the errors between them, as DataFrames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ident.tracing.diagnosis import Diagnosis
from scenarios.files.channel_names import TIME
from scenarios.identification.assessment.prediction import RecordFit
from scenarios.identification.result import Identification
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import pandas

ERRORS = ("held_out", "rms", "fit_percent", "r2", "theil")


def errors_of(fits: Sequence[RecordFit]) -> pandas.DataFrame:
    """Errors of the free simulation of each record, by record and channel, SI; a record whose simulation left all measure has no rows."""
    import pandas

    rows = {
        (fit.record.name, name): (fit.held_out, fit.figures.rmse[name], fit.fit_percent(name), fit.figures.r2[name], fit.figures.theil[name])
        for fit in fits
        if fit.figures is not None
        for name in fit.figures.rmse
    }
    index = pandas.MultiIndex.from_tuples(list(rows), names=["record", "channel"]) if rows else pandas.MultiIndex.from_arrays([[], []])
    return pandas.DataFrame(list(rows.values()), columns=list(ERRORS), index=index)


def response_of(found: Identification, number: int) -> pandas.DataFrame:
    """A record over ``time``, SI: the inputs, and of each output what was measured (``alpha``) and what the model says (``predicted_alpha``).

    ``number`` counts the records from 0, those that were not fitted last. Of a filter the fitted record's predictions are one sample ahead.
    """
    import pandas

    fitted = (found.record, *found.others)
    if found.estimate.history is not None and number < len(fitted):
        record, outputs, rows = fitted[number], found.estimate.output_names, found.estimate.fitted[number]
    elif 0 <= number < len(found.fits):
        record, outputs, rows = found.fits[number].record, found.fits[number].outputs, found.fits[number].simulated
    elif 0 <= number < len(fitted):
        record, outputs, rows = fitted[number], found.estimate.output_names, found.estimate.fitted[number]
    else:
        raise DeclarationError(f"there is no record {number}", where="response", remedy=f"there are {max(len(found.fits), len(fitted))}, from 0 on")
    columns: dict[str, np.ndarray] = {channel.name: channel.with_gaps() for channel in record.inputs}
    for name, row in zip(outputs, rows, strict=True):
        if name in record.output_names:
            columns |= {name: record[name].with_gaps(), f"predicted_{name}": np.asarray(row)}
    return pandas.DataFrame(columns, index=pandas.Index(record.time, name=TIME))


def prediction_of(found: Diagnosis, number: int) -> pandas.DataFrame:
    """A predicted record over ``time``, SI: what was measured, and the free simulation before and after (``before_alpha``, ``after_alpha``)."""
    import pandas

    if not 0 <= number < len(found.predictions):
        raise DeclarationError(f"there is no record {number}", where="prediction", remedy=f"there are {len(found.predictions)}, from 0 on")
    one = found.predictions[number]
    columns: dict[str, np.ndarray] = {channel.name: channel.with_gaps() for channel in one.record.inputs}
    for name, before, after in zip(one.channels, one.before, one.after, strict=True):
        measured = {name: one.record[name].with_gaps()} if name in one.record.output_names else {}
        columns |= {**measured, f"before_{name}": before, f"after_{name}": after}
    return pandas.DataFrame(columns, index=pandas.Index(one.record.time, name=TIME))
