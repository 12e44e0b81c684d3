"""`predict` in Python: the model of a study, or of a result, on a record that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol

from scenarios.api.asking import Declared, Found, Named, Source, Times, effects_of, file_of, model_of, plan_from, with_parts
from scenarios.api.records.opening import Choices, choices_of
from scenarios.api.records.record import Record, record_of
from scenarios.api.shown import html
from scenarios.api.shown.report import write_report
from scenarios.files.channel_names import TIME
from scenarios.plots.formats import formats_wanted
from scenarios.prediction import predict as predicting
from scenarios.prediction.predict import Asked, figures_of, predict_record
from scenarios.preparation.request import Request

if TYPE_CHECKING:
    import pandas

    from sim.declaration.proposal import Traceable

ERRORS = ("model", "channel", "rms_error", "fit_percent", "r2", "theil")


class Saved(Protocol):
    """A result that keeps a model: an Identification or a Diagnosis."""

    def save(self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True) -> Path: ...


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """A record predicted by a model that was not fitted to it. ``details``: everything that the library knows of it."""

    details: predicting.Prediction

    @property
    def record(self) -> Record:
        """The record as it was prepared."""
        return record_of(self.details.record)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What speaks against the record, one sentence each."""
        return self.details.warnings

    @property
    def notes(self) -> tuple[str, ...]:
        """How the record was prepared, one sentence each."""
        return self.details.notes

    def response(self) -> pandas.DataFrame:
        """The record over ``time``, SI: inputs, measured outputs (``alpha``) and the model's (``predicted_alpha``); of a diagnosis also
        ``declared_alpha``, without the effects found."""
        import pandas

        found = self.details
        columns = {channel.name: channel.with_gaps() for channel in (*found.record.inputs, *found.record.outputs)}
        for word, simulation in (("declared", found.before), ("predicted", found.after)):
            if simulation is not None:
                columns |= {f"{word}_{name}": row for name, row in zip(found.channels, simulation.rows, strict=True)}
        return pandas.DataFrame(columns, index=pandas.Index(found.record.time, name=TIME))

    def to_dataframe(self) -> pandas.DataFrame:
        """Errors by model (``predicted``, of a diagnosis also ``declared``) and channel, SI."""
        import pandas

        return pandas.DataFrame(self._rows(), columns=list(ERRORS)).set_index(["model", "channel"])

    def summary(self) -> str:
        """What the command prints."""
        from scenarios.prediction.words import prediction_text

        return prediction_text(self.details)

    def save(self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True) -> Path:
        """Write the prediction as the command does with ``--out``; returns the folder."""
        from scenarios.prediction.files import write_prediction

        return write_prediction(self.details, Path(folder), figures=formats_wanted(figures))

    def _rows(self) -> list[tuple[Any, ...]]:
        both = (("declared", self.details.before), ("predicted", self.details.after))
        return [
            (word, name, *(errors[key] for key in ERRORS[2:]))
            for word, simulation in both
            if simulation is not None
            for name, errors in figures_of(simulation).items()
        ]

    def report(self, path: str | PathLike[str]) -> Path:
        """Write its page alone, one HTML file that holds its figures; returns the path."""
        return write_report(self.save, path)

    def __repr__(self) -> str:
        told = ", ".join(f"{name} {fit:.3g} %" for word, name, _, fit, *_ in self._rows() if word == "predicted")
        return f"<Prediction of {self.details.record.name} by the {self.details.kept.model} model: fit {told or 'left all measure'}>"

    def _repr_html_(self) -> str:
        rows = [[word, name, *(f"{each:.4g}" for each in errors)] for word, name, *errors in self._rows()]
        return html.page(f"{self.details.record.name} predicted", html.table(ERRORS, rows, left=2), html.sentences(self.warnings))


def predict(
    study: str | PathLike[str] | Saved,
    record: Source,
    *,
    model: Declared | None = None,
    effects: str | PathLike[str] | Sequence[Traceable] | None = None,
    channels: Choices | None = None,
    columns: str | Sequence[str] | None = None,
    start: Times = None,
    stop: Times = None,
    maneuver: Named = None,
    maneuvers: Found = None,
    rate: float | None = None,
    trust_record: bool = False,
) -> Prediction:
    """The model that a study keeps on another record: ``flightid predict`` in Python.

    Parameters
    ----------
    study : the folder of an ``identify`` or ``diagnose``, or such a result.
    record : a ``Record`` or whatever ``read_record`` takes. channels, columns, start, stop,
        maneuver, maneuvers, trust_record : as in
        ``identify``.
    rate : Hz, of a record without a clock; the study's reading of the others holds.
    model, effects : a model and effects of your own that the study rests on, or the paths of their files.

    Raises
    ------
    InputError : the folder keeps no model, or the record cannot be used, in one line.
    """
    own = model_of(model) if model is not None else None
    plan = plan_from(start, stop, None, rate, None, trust_record, columns)
    asked_of = with_parts(Request((file_of(record),), plan=plan), maneuver, maneuvers)
    own_model = Path(own) if isinstance(own, str) else own
    asked = Asked(Path(), asked_of.records[0], choices_of(channels), asked_of.plan, own_model, effects_of(effects))
    if isinstance(study, str | PathLike):
        return Prediction(predict_record(replace(asked, study=Path(study))))
    with TemporaryDirectory(prefix="flightid-") as scratch:
        found = predict_record(replace(asked, study=study.save(Path(scratch) / "study", figures=False)))
    return Prediction(replace(found, study=Path("a result in Python")))
