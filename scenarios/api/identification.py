"""`identify` and `predict` in Python."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from scenarios import prediction as predicting
from scenarios.api import plot, tables
from scenarios.api.record import Record, record_of
from scenarios.api.records import ChannelMap, choices_of
from scenarios.api.requests import (
    KEPT,
    ManeuverNames,
    ManeuverParts,
    ModelSource,
    RecordSource,
    Times,
    effects_of,
    file_of,
    model_of,
    plan_from,
    request_of,
    with_parts,
)
from scenarios.api.shown import (
    Parameter,
    Parameters,
    SavedResult,
    WithParameters,
    errors_of,
    path_given,
    response_of,
    write_sheets,
)
from scenarios.api.tables import band_of, in_python_words, names_of, with_python_errors
from scenarios.api.vehicle import Vehicle
from scenarios.files.declarations import TIME
from scenarios.identification.assessment import Options
from scenarios.identification.identify import Identified, identify_files
from scenarios.prediction import PredictionRequest, figures_of, predict_record
from scenarios.preparation.plan import Request
from scenarios.report.figure_formats import Formats
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import control
    import pandas

    from ident.flying_qualities.modes import StateSpace
    from sim.declaration.proposal import Traceable


# ---- identify in Python


@dataclass(frozen=True, eq=False, repr=False)
class Identification(SavedResult, WithParameters):
    """Parameters of a model from records. ``found["Cm_alpha"].value``, ``.sigma``, ``.unit``.

    Attributes
    ----------
    details : the complete internal result.
    """

    details: Identified

    @cached_property
    def parameters(self) -> Parameters:
        """Estimated parameters by name; sensors' biases are in ``biases``."""
        found = self.details.found
        starts = {
            **found.vehicle.derivatives,
            **{name: value for _, mode in found.vehicle.modes for name, value in mode.items()},
        }
        return Parameters(
            Parameter(row.name, row.estimate, row.std, row.unit, starts.get(row.name))
            for row in found.rows
        )

    @cached_property
    def biases(self) -> Parameters:
        """Biases of sensors, where the method gives them a sigma."""
        return Parameters(
            Parameter(row.name, row.estimate, row.std, row.unit)
            for row in self.details.found.biases
        )

    @property
    def derived(self) -> dict[str, tuple[float, float]]:
        """Value and sigma of derived quantities, such as natural frequency and damping, SI."""
        return dict(self.details.found.derived)

    @property
    def values(self) -> np.ndarray:
        """Estimates, in the order of ``parameters``."""
        return np.array([item.value for item in self.parameters.values()])

    @property
    def sigmas(self) -> np.ndarray:
        """Standard deviations, in the order of ``parameters``."""
        return np.array([item.sigma for item in self.parameters.values()])

    @property
    def covariance(self) -> np.ndarray:
        """Covariance of all that was estimated, ``(n, n)`` in the order of
        ``details.found.estimate.names``.
        """
        return self.details.found.estimate.covariance

    @property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """Profile-likelihood intervals, if requested; an open end is infinite."""
        return {
            interval.name: (
                -math.inf if interval.low is None else interval.low,
                math.inf if interval.high is None else interval.high,
            )
            for interval in self.details.found.intervals
        }

    @property
    def outcome(self) -> str:
        """``"converged"``, or another outcome code."""
        return self.details.found.estimate.outcome.code

    @property
    def converged(self) -> bool:
        """Whether the fit converged."""
        return self.outcome == "converged"

    @property
    def log_likelihood(self) -> float:
        """Log likelihood of the fitted records."""
        return self.details.found.estimate.log_likelihood

    @property
    def model(self) -> str:
        """The model's name."""
        return self.details.found.vehicle.model

    @property
    def method(self) -> str:
        """The method's name."""
        return self.details.found.method

    @property
    def records(self) -> tuple[Record, ...]:
        """The fitted records as they were prepared, SI."""
        return tuple(record_of(record) for record in self.details.measured)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons against the records or the result, one sentence each."""
        found = self.details.found
        reading = (found.reading.sentence,) if found.reading else ()
        return in_python_words((*found.doubts, *found.cautions, *reading, *found.look.set_aside))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on preparation and fit, one sentence each."""
        return self.details.found.notes

    def __getitem__(self, name: str) -> Parameter:
        return self.biases[name] if name in self.biases else self.parameters[name]

    def summary(self) -> str:
        """Return the text that the command prints."""
        from scenarios.identification.report import print_identification
        from scenarios.report.quantities import as_text

        return as_text(
            lambda out: print_identification(self.details.found, self.details.flown, out, KEPT)
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per parameter: ``unit``, ``value``, ``sigma``, ``start``."""
        return self.parameters.to_dataframe()

    def to_excel(self, path: str | PathLike[str]) -> Path:
        """Write parameters and biases as an XLSX workbook with full precision; returns the path.
        Needs openpyxl.
        """
        return write_sheets(path, {"parameters": self.parameters, "biases": self.biases})

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``comparison.json``."""
        from scenarios.files.measured.columns import identities
        from scenarios.identification.files import identification_content

        details = self.details
        fitted, predicted = identities(details.files), identities(details.validation)
        return identification_content(details.found, fitted, details.flown, predicted)

    def errors(self) -> pandas.DataFrame:
        """Return the errors of the simulation by record and channel, SI.

        ``held_out`` marks records that were not fitted.
        """
        return errors_of(self.details.found.fits)

    def response(self, number: int = 0) -> pandas.DataFrame:
        """Return a record over ``time``, SI; held-out records last.

        Its columns are inputs, measured outputs (``alpha``) and predicted ones
        (``predicted_alpha``).
        """
        return response_of(self.details.found, number)

    def linearised(self) -> StateSpace:
        """Return the identified model as matrices about its reference point, with units and delays.

        Raises InputError if there is no such point.
        """
        from scenarios.identification.files import state_space_of

        return state_space_of(self.details.found)

    def to_state_space(self, pade: int = 4) -> control.StateSpace:
        """Return the same for python-control, with named states, inputs and outputs.

        A delay becomes a Pade approximation of order ``pade``.
        """
        from ident.flying_qualities.modes import to_control

        return to_control(self.linearised(), pade)

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.identification.files import write_identification

        return write_identification(self.details, folder, figures=figures)

    @property
    def plot(self) -> plot.Figures:
        """Figures of this result: ``found.plot.fit()``, ``found.plot.residuals()``, ..."""
        return plot.Figures(self, plot.fit, plot.held_out, plot.correlation)

    def __repr__(self) -> str:
        return f"<Identification: {self._title}; {self.parameters!r:.600}>"

    def _repr_html_(self) -> str:
        return tables.page(
            self._title, self.parameters.html_table(), tables.sentences(self.warnings)
        )

    @property
    def _title(self) -> str:
        found = self.details.found
        records = ", ".join(record.name for record in (found.record, *found.others))
        return (
            f"{self.model} model of {found.vehicle.name} from {records:.200} by {self.method}, "
            f"{self.outcome}"
        )


@with_python_errors
def identify(
    records: RecordSource | Sequence[RecordSource],
    model: ModelSource,
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None,
    *,
    method: str = "output-error",
    validate: RecordSource | Sequence[RecordSource] = (),
    profile: bool | str | Sequence[str] | None = None,
    band: tuple[float, float] | None = None,
    engine: str | None = None,
    channels: ChannelMap | None = None,
    columns: str | Sequence[str] | None = None,
    start: Times = None,
    stop: Times = None,
    maneuver: ManeuverNames = None,
    maneuvers: ManeuverParts = None,
    hold: str | None = None,
    rate: float | None = None,
    lowpass: float | None = None,
    trust_record: bool = False,
    aircraft_class: str | None = None,
    category: str | None = None,
) -> Identification:
    """Estimate the parameters of a model from records: ``flightid identify`` in Python.

    Parameters
    ----------
    records : one record or several; each a ``Record`` or whatever ``read_record`` takes.
    model : ``"rigid"``, ... (``models()`` lists them), a model of your own (``own_model``), or the
        path of its Python file.
    vehicle : what ``vehicle`` takes: a file, a name of the library, numbers; None takes
        ``vehicle.toml`` beside the first record.
    method : output-error, filter-error, frequency-domain, equation-error, ekf, ukf.
    validate : records that are predicted with what was estimated from the others.
    profile : parameters whose profile-likelihood interval is wanted; True: of every one.
    band : Hz, for frequency-domain.
    engine : of the extended Kalman filter, filterpy or batched.
    channels : a channel map as in ``read_record``, for all records.
    columns : names of the columns of files without a header, in their order.
    start, stop : the part that is used, s; a list of each for several maneuvers.
    hold : of inputs between samples, ``"previous"`` or ``"linear"``; None: the better fit.
    rate, lowpass : Hz: all channels are resampled to this rate, or filtered below this corner.
    trust_record : warn of what the raw columns show, refuse and mask nothing.
    maneuver : maneuvers that are used instead, by number or name, one or a list.
    maneuvers : what ``find_maneuvers`` returned, or the path of its ``maneuvers.toml``; None takes
        the one beside the record.
    aircraft_class, category : for levels of flying qualities.

    Raises
    ------
    InputError : records or arguments that cannot be used; a message of one line.

    Examples
    --------
    >>> import flightid as fid
    >>> record = fid.simulate("rigid", seed=3).record
    >>> found = fid.identify(record, "rigid", "bomber_rigid")
    >>> found["Cm_alpha"]
    Cm_alpha = -1.6589 +- 0.0018 1/rad
    """
    plan = plan_from(start, stop, hold, rate, lowpass, trust_record, columns)
    request = request_of(
        records,
        model,
        vehicle,
        validate,
        channels=channels,
        plan=plan,
        aircraft_class=aircraft_class,
        category=category,
    )
    request = with_parts(request, maneuver, maneuvers)
    return Identification(
        identify_files(request, method, Options(_profiled(profile), band_of(band), engine))
    )


def _profiled(profile: bool | str | Sequence[str] | None) -> tuple[str, ...] | None:
    """Return the parameters to profile; empty for all, None for none."""
    if profile is None or profile is False:
        return None
    if profile is True or profile == "all":
        return ()
    return tuple(dict.fromkeys(names_of(profile, "parameter", "profile")))


# ---- predict in Python

ERRORS = ("model", "channel", "rms_error", "fit_percent", "r2", "theil")


class Saved(Protocol):
    """A result that keeps a model: an Identification or a Diagnosis."""

    def save(
        self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True
    ) -> Path: ...


def refuse_no_study(study: Any) -> None:
    """Raise DeclarationError for an object that cannot be saved as a study."""
    if not hasattr(study, "save"):
        raise DeclarationError(
            f"a {type(study).__name__} is no study",
            where="study",
            remedy="give what identify or diagnose returned, or the folder of a study",
        )


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(SavedResult):
    """A record predicted by a model that was not fitted to it.

    ``details``: the complete internal result.
    """

    details: predicting.PredictionResult

    @property
    def record(self) -> Record:
        """The record as it was prepared."""
        return record_of(self.details.record)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons against the records or the result, one sentence each."""
        return in_python_words(self.details.warnings)

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on preparation and fit, one sentence each."""
        return self.details.notes

    @property
    def passed(self) -> dict[str, bool]:
        """Pass or fail of each test of ``tolerances``."""
        return {each.test.name: each.passed for each in self.details.verdicts}

    def response(self) -> pandas.DataFrame:
        """Return the record over ``time``, SI.

        Its columns are inputs, measured outputs (``alpha``) and predicted ones
        (``predicted_alpha``); of a diagnosis also ``declared_alpha``, without the effects found.
        """
        import pandas

        found = self.details
        columns = {
            channel.name: channel.with_gaps()
            for channel in (*found.record.inputs, *found.record.outputs)
        }
        for model, simulation in self._simulations():
            columns |= {
                f"{model}_{name}": row
                for name, row in zip(found.channels, simulation.rows, strict=True)
            }
        return pandas.DataFrame(columns, index=pandas.Index(found.record.time, name=TIME))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return errors by model and channel, SI.

        The model is ``predicted``, of a diagnosis also ``declared``.
        """
        import pandas

        return pandas.DataFrame(self._rows(), columns=list(ERRORS)).set_index(["model", "channel"])

    def summary(self) -> str:
        """Return the text that the command prints."""
        from scenarios.prediction import prediction_text

        return prediction_text(self.details)

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.prediction import write_prediction

        return write_prediction(self.details, folder, figures=figures)

    def _rows(self) -> list[tuple[Any, ...]]:
        return [
            (model, name, *(errors[key] for key in ERRORS[2:]))
            for model, simulation in self._simulations()
            for name, errors in figures_of(simulation).items()
        ]

    def _simulations(self) -> list[tuple[str, Any]]:
        """Return the simulations by model: ``declared``, if there is one, and ``predicted``."""
        both = (("declared", self.details.before), ("predicted", self.details.after))
        return [(model, simulation) for model, simulation in both if simulation is not None]

    def __repr__(self) -> str:
        text = ", ".join(
            f"{name} {fit:.3g} %"
            for model, name, _, fit, *_ in self._rows()
            if model == "predicted"
        )
        return (
            f"<Prediction of {self.details.record.name} by the {self.details.stored.model} model: "
            f"fit {text or 'left all measure'}>"
        )

    def _repr_html_(self) -> str:
        rows = [
            [model, name, *(f"{error:.4g}" for error in errors)]
            for model, name, *errors in self._rows()
        ]
        return tables.page(
            f"{self.details.record.name} predicted",
            tables.table(ERRORS, rows, left=2),
            tables.sentences(self.warnings),
        )


@with_python_errors
def predict(
    study: str | PathLike[str] | Saved,
    record: RecordSource,
    *,
    model: ModelSource | None = None,
    effects: str | PathLike[str] | Sequence[Traceable] | None = None,
    tolerances: str | None = None,
    channels: ChannelMap | None = None,
    columns: str | Sequence[str] | None = None,
    start: Times = None,
    stop: Times = None,
    maneuver: ManeuverNames = None,
    maneuvers: ManeuverParts = None,
    rate: float | None = None,
    trust_record: bool = False,
) -> Prediction:
    """Predict another record by the model of a study: ``flightid predict`` in Python.

    Parameters
    ----------
    study : the folder of an ``identify`` or ``diagnose``, or such a result.
    record : a ``Record`` or whatever ``read_record`` takes.
    channels, columns, start, stop, maneuver, maneuvers, trust_record : as in ``identify``.
    rate : Hz, of a record without a clock; the study's reading of the others holds.
    model, effects : a model and effects of your own that the study rests on, or the paths of their
        files.
    tolerances : names of tests of simulator qualification, with commas, or of a TOML file of them.

    Raises
    ------
    InputError : the folder keeps no model, or the record cannot be used.

    Examples
    --------
    >>> import flightid as fid
    >>> flight = fid.simulate("trace-nothing")
    >>> found = fid.identify(flight.record, "rigid", flight.vehicle)
    >>> fid.predict(found, flight.validate[0]).record.name
    'validate'
    """
    declared = model_of(model) if model is not None else None
    plan = plan_from(start, stop, None, rate, None, trust_record, columns)
    prepared = with_parts(Request((file_of(record),), plan=plan), maneuver, maneuvers)
    request = PredictionRequest(
        Path(),
        prepared.records[0],
        choices_of(channels),
        prepared.plan,
        Path(declared) if isinstance(declared, str) else declared,
        effects_of(effects),
        tolerances,
    )
    if isinstance(study, str | PathLike):
        return Prediction(predict_record(replace(request, study=path_given(study))))
    refuse_no_study(study)
    with TemporaryDirectory(prefix="flightid-") as scratch:
        saved = study.save(Path(scratch) / "study", figures=False)
        found = predict_record(replace(request, study=saved))
    return Prediction(replace(found, study=Path("a result in Python")))
