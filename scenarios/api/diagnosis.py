"""`diagnose` and `survey` in Python: what a model lacks, in one flight and in many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any

from scenarios.api import plot, tables
from scenarios.api.record import Record, record_of
from scenarios.api.records import ChannelMap
from scenarios.api.requests import (
    KEPT,
    ManeuverNames,
    ManeuverParts,
    ModelSource,
    Progress,
    RecordSource,
    Times,
    no_progress,
    plan_from,
    request_of,
    with_parts,
)
from scenarios.api.shown import (
    Effect,
    Parameter,
    Parameters,
    SavedResult,
    WithParameters,
    claimed_effects,
    path_given,
    prediction_of,
    write_sheets,
)
from scenarios.api.tables import in_python_words, with_python_errors
from scenarios.api.vehicle import Vehicle
from scenarios.diagnosis.diagnose import Tracing, diagnose_files
from scenarios.report.figure_formats import Formats, formats_wanted
from scenarios.survey import survey as surveying
from scenarios.survey.files import write_survey
from scenarios.survey.report import (
    derivatives_table,
    drift_phrases,
    effects_table,
    outlying,
    survey_text,
    verdict_of,
)
from scenarios.tasks.processes import available_cores

if TYPE_CHECKING:
    import control
    import pandas

    from ident.tracing.diagnosis import Quantity
    from sim.declaration.proposal import Traceable


# ---- diagnose in Python


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(SavedResult, WithParameters):
    """What a model lacks, as the records show it.

    Attributes
    ----------
    details : the complete internal result.
    """

    details: Tracing

    @property
    def verdict(self) -> str:
        """``"consistent"``, ``"traced"``, ``"partial"``, ``"ambiguous"`` or ``"unexplained"``."""
        return self.details.diagnosis.verdict.value

    @property
    def sentence(self) -> str:
        """Meaning of the verdict, in one sentence."""
        return self.details.diagnosis.verdict.sentence

    @property
    def headline(self) -> str:
        """The finding in one sentence."""
        from scenarios.diagnosis.text import headline

        return headline(self.details)

    @cached_property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that are claimed."""
        return claimed_effects(self.details, claimed=True)

    @cached_property
    def hints(self) -> tuple[Effect, ...]:
        """Effects that are supported, but not claimed."""
        return claimed_effects(self.details, claimed=False)

    @cached_property
    def before(self) -> Parameters:
        """Parameters of the declared model alone."""
        return _parameters(self.details.diagnosis.before)

    @cached_property
    def parameters(self) -> Parameters:
        """Parameters of the declared model, fitted together with the claimed effects."""
        return _parameters(self.details.diagnosis.after)

    @property
    def error_before(self) -> dict[str, float]:
        """Root mean square error of the declared model by channel, on ``predicted``, SI."""
        return dict(self.details.diagnosis.error_before.rmse)

    @property
    def error_after(self) -> dict[str, float]:
        """The same with the claimed effects."""
        return dict(self.details.diagnosis.error_after.rmse)

    @property
    def one_step(self) -> dict[str, dict[str, float]]:
        """Root mean square errors of predictions one step ahead of held-out records by channel, SI,
        under ``before`` and ``after``, both with the model discrepancy; empty where there is none.
        """
        found = self.details.diagnosis.one_step
        if found is None:
            return {}
        return {"before": dict(found.before.rmse), "after": dict(found.after.rmse)}

    @property
    def noise_floor(self) -> dict[str, float]:
        """The error that noise alone would leave, by channel, SI."""
        return dict(self.details.diagnosis.noise_floor)

    @property
    def records(self) -> tuple[Record, ...]:
        """Fitted records, as they were prepared."""
        return tuple(record_of(record) for record in self.details.records)

    @property
    def predicted(self) -> tuple[Record, ...]:
        """Records that were predicted and not fitted."""
        return tuple(record_of(record) for record in self.details.validation)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Reasons against the records or the result, one sentence each."""
        from scenarios.diagnosis.evidence import warnings_of

        return in_python_words((*self.details.doubts, *warnings_of(self.details)))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes on the preparation of the records, one sentence each."""
        return self.details.notes

    def summary(self) -> str:
        """Return the text that the command prints."""
        from scenarios.diagnosis.text import diagnosis_text

        return diagnosis_text(self.details, details=KEPT)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per parameter: ``unit``, value and sigma before and after.

        ``before`` is the declared model alone, ``after`` that with the effects.
        """
        import pandas

        before, after = self.before.to_dataframe(), self.parameters.to_dataframe()
        frame = pandas.concat(
            {"before": before.drop(columns="unit"), "after": after.drop(columns="unit")}, axis=1
        )
        frame.columns = [f"{name}_{when}" for when, name in frame.columns]
        frame.insert(0, "unit", after["unit"].combine_first(before["unit"]))
        return frame.rename_axis("parameter")

    def prediction(self, number: int = 0) -> pandas.DataFrame:
        """Return a predicted record over ``time``, SI.

        Its columns are measured outputs (``alpha``), and outputs simulated by the declared model
        (``before_alpha``) and with the effects (``after_alpha``).
        """
        return prediction_of(self.details.diagnosis, number)

    def candidates(self) -> pandas.DataFrame:
        """Return every candidate of every round of the search.

        Columns: gain of the log evidence, the same with its prior odds, whether it was fitted.
        """
        import pandas

        keys = ["round", "within", "name", "gain", "weight", "fitted"]
        candidates = self.details.diagnosis.candidates
        rows = [[getattr(candidate, key) for key in keys] for candidate in candidates]
        return pandas.DataFrame(rows, columns=keys)

    def to_excel(self, path: str | PathLike[str]) -> Path:
        """Write the parameters, before and after, as an XLSX workbook with full precision.

        Returns the path. Needs openpyxl.
        """
        return write_sheets(path, {"after": self.parameters, "before": self.before})

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``diagnosis.json``."""
        from datetime import UTC, datetime

        from scenarios.diagnosis.text import diagnosis_content

        return diagnosis_content(self.details, datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"))

    def to_state_space(self, pade: int = 4) -> control.StateSpace:
        """Return the declared model with ``parameters`` for python-control, without the effects."""
        from ident.flying_qualities.modes import to_control
        from scenarios.identification.files import linearised
        from sim.declaration.compile import compile_model

        traced, values = self.details, self.parameters.to_dict()
        return to_control(
            linearised(compile_model(traced.model), values, traced.records[0], traced.vehicle.own),
            pade,
        )

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.diagnosis.files import write_diagnosis

        return write_diagnosis(self.details, folder, figures=figures)

    @property
    def plot(self) -> plot.Figures:
        """Figures of this result: ``found.plot.residuals()``, ``found.plot.prediction()``, ..."""
        return plot.Figures(
            self,
            plot.residuals,
            plot.spectra,
            plot.prediction,
            plot.evidence,
            plot.derivatives,
            plot.replication,
        )

    def __repr__(self) -> str:
        named = ", ".join(effect.name for effect in self.effects) or "no effect claimed"
        return f"<Diagnosis: {self.verdict}; {named}; {self.parameters!r:.500}>"

    def _repr_html_(self) -> str:
        sentences = [f"{effect.name}: {effect.sentence}" for effect in self.effects]
        return tables.page(
            f"{self.verdict.upper()}: {self.headline}",
            tables.sentences(sentences),
            self.parameters.html_table(),
            tables.sentences(self.warnings),
        )


@with_python_errors
def diagnose(
    records: RecordSource | Sequence[RecordSource],
    model: ModelSource,
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None,
    *,
    validate: RecordSource | Sequence[RecordSource] = (),
    effects: str | PathLike[str] | Sequence[Traceable] | None = None,
    effort: str = "normal",
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
    progress: Progress | None = None,
) -> Diagnosis:
    """Find the physical effects that the model lacks, add them, fit again and compare: ``flightid
    diagnose`` in Python.

    Parameters
    ----------
    records, model, vehicle, channels, columns, start, stop, maneuver, maneuvers : as in
        ``identify``.
    hold, rate, lowpass, trust_record, aircraft_class, category : as in ``identify``.
    validate : records that are predicted; else the last of several is held out, or the last part of
        one.
    effects : effects of your own, or the path of a Python file with them.
    effort : ``"normal"`` or ``"thorough"``.
    progress : called with the stage and the share done, 0 to 1.

    Raises
    ------
    InputError : records or arguments that cannot be used; a message of one line.

    Examples
    --------
    >>> import flightid as fid
    >>> flight = fid.simulate("trace-delay")
    >>> found = fid.diagnose(flight.record, "rigid", flight.vehicle, validate=flight.validate)
    >>> found.verdict, [effect.name for effect in found.effects]
    ('traced', ['input-delay'])
    >>> print(f"{found.effects[0].parameters['delay'].value:.3f} s")
    0.060 s
    """
    plan = plan_from(start, stop, hold, rate, lowpass, trust_record, columns)
    request = request_of(
        records,
        model,
        vehicle,
        validate,
        effects=effects,
        channels=channels,
        plan=plan,
        effort=effort,
        aircraft_class=aircraft_class,
        category=category,
    )
    return Diagnosis(
        diagnose_files(with_parts(request, maneuver, maneuvers), progress or no_progress)
    )


def _parameters(quantities: Mapping[str, Quantity]) -> Parameters:
    return Parameters(
        Parameter(name, quantity.value, quantity.std, quantity.unit)
        for name, quantity in quantities.items()
    )


# ---- survey in Python: many flights of one aircraft, and what recurs


@dataclass(frozen=True, eq=False, repr=False)
class Survey(SavedResult):
    """Effects and trends over many flights of one aircraft.

    Attributes
    ----------
    details : the complete internal result.
    folder : folder with the results of the flights.
    """

    details: surveying.SurveyResult
    folder: Path

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that recur, the strongest first."""
        return tuple(each.name for each in self.details.recurs)

    @property
    def flights(self) -> tuple[str, ...]:
        """Names of the flights that could be used, in the order of the file."""
        return tuple(self.details.survey_files.diagnoses)

    @property
    def computed(self) -> tuple[str, ...]:
        """Flights that were diagnosed in this call; results of the others were already there."""
        return self.details.survey_files.computed

    @property
    def failed(self) -> dict[str, str]:
        """Flights that could not be used, with the reason."""
        return dict(self.details.survey_files.failed)

    @property
    def trends(self) -> tuple[str, ...]:
        """Derivatives that change with a flight condition, one sentence each."""
        return tuple(drift_phrases(self.details))

    @property
    def standing_out(self) -> tuple[tuple[str, str, float], ...]:
        """Outlying flights: flight, derivative, deviation in standard deviations."""
        return tuple(outlying(self.details))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the derivatives and the flight conditions, one row per flight, SI.

        Each derivative has the columns of its value (``Cm_alpha``) and sigma (``Cm_alpha_std``).
        """
        import pandas

        rows: dict[str, dict[str, float]] = {name: {} for name in self.flights}
        for name, by_flight in self.details.conditions.items():
            for flight, value in by_flight.items():
                rows[flight][name] = value
        for item in self.details.derivatives:
            for flight, value, sigma in zip(item.flights, item.values, item.sigmas, strict=True):
                rows[flight] |= {item.name: float(value), f"{item.name}_std": float(sigma)}
        return pandas.DataFrame.from_dict(rows, orient="index").rename_axis("flight")

    def recurring(self) -> pandas.DataFrame:
        """Return the effects, one row per flight: the probability that it has each."""
        import pandas

        return pandas.DataFrame(
            {
                e.name: dict(zip(e.flights, e.recurrence.probability, strict=True))
                for e in self.details.recurs
            }
        ).rename_axis("flight")

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``survey.json``."""
        from scenarios.report.document import now
        from scenarios.survey.report import survey_content

        return survey_content(self.details, now())

    def summary(self) -> str:
        """Return the text that the command prints."""
        return survey_text(self.details, details=KEPT)

    def _write(self, folder: Path, figures: Formats) -> Path:
        return write_survey(self.details, folder, figures=figures)

    def __repr__(self) -> str:
        return repr(self.details)

    def _repr_html_(self) -> str:
        word, rest = verdict_of(self.details)
        return tables.page(
            f"{word}: {rest}",
            tables.of_document(effects_table(self.details)),
            tables.of_document(derivatives_table(self.details)),
        )


@with_python_errors
def survey(
    flights: str | PathLike[str],
    folder: str | PathLike[str] | None = None,
    *,
    jobs: int | None = None,
    figures: bool | str | Sequence[str] = False,
    progress: Progress | None = None,
    cluster: str | None = None,
) -> Survey:
    """Diagnose many flights of one aircraft, and find the effects that recur: ``flightid survey``
    in Python.

    Parameters
    ----------
    flights : the file that names model, vehicle and records.
    folder : folder for the results of the flights, so that the next survey computes only new
        flights; None: a new temporary folder.
    jobs : number of processes; None: all cores.
    figures : formats of the figures on the flights' pages.
    progress : called with the stage and the share done, 0 to 1.
    cluster : address of a Dask scheduler, whose workers replace the processes.

    Raises
    ------
    InputError : an error in the file. Flights that cannot be used are in ``failed``.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import mkdtemp
    >>> import flightid as fid
    >>> flight, folder = fid.simulate("trace-delay"), Path(mkdtemp())
    >>> _ = flight.vehicle.save(folder / "bomber.toml")
    >>> for name, record in (("first", flight.record), ("second", *flight.validate)):
    ...     record.to_pandas().to_csv(folder / f"{name}.csv")
    >>> content = 'model = "rigid"\\nvehicle = "bomber.toml"\\nrecords = "*.csv"'
    >>> _ = (folder / "flights.toml").write_text(content)
    >>> fid.survey(folder / "flights.toml", jobs=1)
    <Survey of 2 flights: input-delay>
    """
    kept = path_given(folder) if folder is not None else Path(mkdtemp(prefix="flightid-survey-"))
    found = surveying.survey_flights(
        path_given(flights),
        kept,
        jobs or available_cores(),
        formats_wanted(figures),
        progress or no_progress,
        cluster,
    )
    return Survey(found, kept)
