"""Design of maneuvers (`design`), model structure (`structure`) and `export` in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from ident.structure.coefficients import DERIVATIVE_BANDWIDTH
from scenarios import structure as structures
from scenarios.api import tables
from scenarios.api.identification import Saved, refuse_no_study
from scenarios.api.record import Record, record_of
from scenarios.api.records import ChannelMap
from scenarios.api.requests import (
    ManeuverNames,
    ManeuverParts,
    ModelSource,
    RecordSource,
    Times,
    model_of,
    plan_from,
    request_of,
    with_parts,
)
from scenarios.api.shown import SavedResult, path_given
from scenarios.api.tables import band_of, names_of, refuse_wrong_type, with_python_errors
from scenarios.api.vehicle import Vehicle, source_of
from scenarios.maneuver_design import design as designing
from scenarios.maneuver_design.report import design_text, maneuvers_table, peaks_of, verdict_of
from scenarios.maneuver_design.setting import TYPICAL, DesignRequest
from scenarios.report.figure_formats import Formats
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class Design(SavedResult):
    """Maneuvers compared before they are flown, the best first. ``details``: the complete internal
    result.
    """

    details: designing.DesignResult

    @property
    def best(self) -> str:
        """Kind of the best maneuver."""
        return self.details.best.kind

    @property
    def chance(self) -> float:
        """Least probability that the best maneuver separates the named effects; zero without."""
        return self.details.best.chance

    @property
    def sigmas(self) -> Mapping[str, float]:
        """Expected standard deviations with the best maneuver, by parameter, SI."""
        return self.details.best.sigmas

    @property
    def command(self) -> str:
        """The command line of the same design."""
        return self.details.request.command()

    def maneuver(self, kind: str | None = None) -> Record:
        """Return the input of a maneuver (default: the best) as a record without outputs, SI."""
        from scenarios.maneuver_design.report import input_of

        return record_of(input_of(self._maneuver(kind)))

    def _maneuver(self, kind: str | None) -> designing.DesignedManeuver:
        maneuvers = self.details.maneuvers
        return next((each for each in maneuvers if each.kind == kind), self.details.best)

    def coherence(self, output: str, input: str, kind: str | None = None) -> pandas.DataFrame:
        """Return expected coherence and random error of a response, by frequency (Hz).

        ``kind``: of the maneuver; default: the best.

        Raises InputError if no band was requested, or there is no such response.
        """
        import pandas

        found = self._maneuver(kind).responses
        if found is None:
            raise DeclarationError("no band is asked for", where="design", remedy="give band, Hz")
        for name, names in ((output, found.outputs), (input, found.inputs)):
            if name not in names:
                remedy = f"there are {', '.join(names)}"
                raise DeclarationError(f"there is no {name!r}", where="coherence", remedy=remedy)
        at = found.outputs.index(output), found.inputs.index(input)
        columns = {"coherence": found.coherence[at], "random_error": found.random_error[at]}
        return pandas.DataFrame(columns, index=pandas.Index(found.frequency, name="frequency_Hz"))

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per kind, the best first: pace (pulse width, s), peaks, geometric mean of
        sigma over value, log likelihood and chance.
        """
        import pandas

        rows = [
            {
                "maneuver": maneuver.kind,
                "pace": maneuver.pulse_width,
                **{f"peak_{name}": p for name, p in peaks_of(self.details, maneuver).items()},
                "mean_sigma": maneuver.criterion,
                "log_likelihood": maneuver.log_likelihood,
                "chance": maneuver.chance,
            }
            for maneuver in self.details.maneuvers
        ]
        return pandas.DataFrame(rows).set_index("maneuver")

    def summary(self) -> str:
        """Return the text that the command prints."""
        return design_text(self.details)

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.maneuver_design.report import write_design

        return write_design(self.details, folder, figures=figures)

    def __repr__(self) -> str:
        return f"<Design: {verdict_of(self.details)}>"

    def _repr_html_(self) -> str:
        shown = tables.of_document(maneuvers_table(self.details))
        return tables.page(verdict_of(self.details), shown)


@with_python_errors
def design(
    model: ModelSource,
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None,
    *,
    limits: str | PathLike[str] | Mapping[str, Any] | None = None,
    tell: Sequence[str] = (),
    size: str | Mapping[str, float] = TYPICAL,
    value: Mapping[str, float | str] | None = None,
    noise: Mapping[str, float | str] | None = None,
    amplitude: Mapping[str, float | str] | None = None,
    duration: float | None = None,
    rate: float | None = None,
    band: tuple[float, float] | None = None,
    computer: bool = False,
) -> Design:
    """Design a maneuver of each kind and compare them: ``flightid design`` in Python.

    Parameters
    ----------
    model, vehicle : as in ``identify``.
    limits : a TOML file, or its content: ``{"nz_max": 2.5, "elevator_rate": "40 deg/s"}``.
    tell : names of effects to separate, the first from each of the others.
    size : of the first effect: ``"typical"``, ``"found"`` (barely detectable), or parameter values.
    value, noise, amplitude : derivatives, noise by output, largest deflection by input; numbers in
        SI or texts with a unit.
    duration, rate : s, samples a second.
    band : Hz; a sweep and multisines over it, compared by the frequency responses to expect
        (``coherence``).
    computer : a flight computer moves the controls; False: a pilot, who makes no quick steps and no
        multisines.

    Raises
    ------
    InputError : an argument is wrong.

    Examples
    --------
    >>> import flightid as fid
    >>> fid.design("rigid", "bomber_rigid", duration=20)
    <Design: FLY: doublet (step 0.76 s), elevator 4.82 deg>
    """
    declared = model_of(model)
    declared_limits = Path(limits) if isinstance(limits, str | PathLike) else limits
    if not isinstance(size, str):
        refuse_wrong_type("size", size, "Mapping")
    if declared_limits is not None and not isinstance(declared_limits, Path):
        refuse_wrong_type("limits", declared_limits, "Mapping")
    request = DesignRequest(
        declared,
        source_of(vehicle, declared if isinstance(declared, str) else ""),
        declared_limits,
        names_of(tell, "effect", "tell"),
        size if isinstance(size, str) else ",".join(_pairs(size)),
        _pairs(value),
        _pairs(noise),
        _pairs(amplitude),
        duration,
        rate,
        band_of(band),
        computer,
    )
    return Design(designing.design(request))


def _pairs(values: Mapping[str, Any] | None) -> tuple[str, ...]:
    """Return values by name as texts ``NAME=VALUE``."""
    return tuple(
        f"{name}={value!r}" if isinstance(value, float | int) else f"{name}={value}"
        for name, value in (values or {}).items()
    )


@dataclass(frozen=True, eq=False, repr=False)
class Structure(SavedResult):
    """Terms of the aerodynamic coefficients that records support. ``details``: the complete
    internal result.
    """

    details: structures.FoundStructure

    @property
    def terms(self) -> dict[str, dict[str, float]]:
        """Value of each chosen term by coefficient and text, per radian."""
        return {
            axis: {term.text: value for term, value in terms.items()}
            for axis, terms in self.details.aircraft.coefficients.items()
        }

    @property
    def r2(self) -> dict[str, float]:
        """R2 of each coefficient on maneuvers left out; on those fitted if there is one."""
        r2 = {}
        for axis, selection in self.details.selections.items():
            has_held_out = selection.held_out is not None and isfinite(selection.held_out)
            r2[axis] = float(selection.held_out if has_held_out else selection.r2)
        return r2

    @property
    def predicted(self) -> dict[str, dict[str, float]]:
        """R2 by record and coefficient of the records of ``validate``."""
        return {name: dict(r2) for name, r2 in self.details.predicted.items()}

    def summary(self) -> str:
        """Return the text that the command prints."""
        from scenarios.structure_report import structure_text

        return structure_text(self.details)

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per term: coefficient, text, value and standard deviation."""
        import pandas

        sigmas = self.details.sigmas
        rows = [
            {
                "parameter": name,
                "coefficient": axis,
                "term": term.text,
                "value": self.details.aircraft.coefficients[axis][term],
                "std": sigmas.get(name, float("nan")),
            }
            for name, (axis, term) in self.details.aircraft.terms.items()
        ]
        return pandas.DataFrame(rows).set_index("parameter")

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``structure.json``."""
        from scenarios.structure_report import structure_content

        return structure_content(self.details)

    def _write(self, folder: Path, figures: Formats) -> Path:
        from scenarios.structure_report import write_structure

        return write_structure(self.details, folder, figures=figures)

    def __repr__(self) -> str:
        counts = ", ".join(f"{axis} {len(terms)}" for axis, terms in self.terms.items())
        return f"<Structure of {self.details.aircraft.name}: terms {counts}>"


@with_python_errors
def structure(
    records: RecordSource | Sequence[RecordSource],
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle,
    validate: RecordSource | Sequence[RecordSource] = (),
    *,
    method: str = structures.METHODS[0],
    degree: int = structures.DEFAULT_DEGREE,
    splines: int = 0,
    bandwidth: float = DERIVATIVE_BANDWIDTH,
    terms: str | PathLike[str] | None = None,
    baseline: bool = False,
    hierarchical: bool = False,
    channels: ChannelMap | None = None,
    columns: str | Sequence[str] | None = None,
    start: Times = None,
    stop: Times = None,
    maneuver: ManeuverNames = None,
    maneuvers: ManeuverParts = None,
    hold: str | None = None,
    rate: float | None = None,
    lowpass: float | None = None,
) -> Structure:
    """Find the terms of aerodynamic coefficients: ``flightid structure`` in Python.

    Parameters
    ----------
    records : one a maneuver, each a ``Record`` or whatever ``read_record`` takes; airspeed, alpha,
        beta, p, q, r, ax, ay, az and the surfaces of the file.
    vehicle : file of model ``aircraft``; its terms are a baseline or are not used.
    validate : records that are predicted, not fitted; see ``predicted`` of the result.
    method : ``"stepwise"`` or ``"orthogonal"``.
    degree : of the products of signals offered.
    splines : knots in alpha.
    bandwidth : Hz, of the angular accelerations.
    terms : path of a file with the terms offered.
    baseline : increments to the file's terms.
    hierarchical : a product enters after the linear terms of its symmetry.
    channels, columns, start, stop, maneuver, maneuvers, hold, rate, lowpass : as in ``identify``.

    Returns
    -------
    Structure; ``save(folder)`` writes a vehicle file with the terms, for ``identify``.

    Raises
    ------
    InputError : records or file that cannot be used.

    References
    ----------
    V. Klein and E. A. Morelli, Aircraft System Identification, AIAA 2006, chapter 5.

    Examples
    --------
    >>> from importlib.resources import files
    >>> import flightid as fid
    >>> airliner = files("scenarios") / "catalog" / "aircraft" / "airliner.toml"
    >>> found = fid.structure(fid.simulate("aircraft-airliner").record, airliner)
    >>> sorted(found.terms["Cm"])
    ['1', 'alpha', 'elevator', 'q']
    """
    plan = plan_from(start, stop, hold, rate, lowpass, False, columns)
    request = with_parts(
        request_of(records, "aircraft", vehicle, validate, channels=channels, plan=plan),
        maneuver,
        maneuvers,
    )
    file = None if terms is None else Path(terms)
    options = structures.StructureOptions(
        method, bandwidth, degree, splines, file, baseline, hierarchical
    )
    return Structure(structures.structure_of_files(request, options))


@with_python_errors
def export(
    study: str | PathLike[str] | Saved, to: str, path: str | PathLike[str] | None = None
) -> Path:
    """Write the model of a study for another program: ``flightid export`` in Python.

    Parameters
    ----------
    study : what ``identify`` or ``diagnose`` returned, the folder that they saved, or a vehicle
        file of model ``aircraft``.
    to : ``"python"``, ``"fmu"``, ``"jsbsim"`` or ``"dave-ml"``.
    path : of the file; one named after the vehicle in the current folder when None.

    Returns
    -------
    Path of the file.

    Raises
    ------
    InputError : no study, no such target, or a model that the target cannot hold.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> import flightid as fid
    >>> flight = fid.simulate("trace-nothing")
    >>> found = fid.identify(flight.record, "rigid", flight.vehicle)
    >>> with TemporaryDirectory() as folder:
    ...     fid.export(found, to="python", path=Path(folder, "bomber.py")).name
    'bomber.py'
    """
    from scenarios.export.targets import written_model

    target = None if path is None else path_given(path)
    if isinstance(study, str | PathLike):
        return written_model(path_given(study), to, target, None)[0]
    refuse_no_study(study)
    with TemporaryDirectory() as scratch:
        saved = study.save(Path(scratch) / "study", figures=False)
        return written_model(saved, to, target, None)[0]
