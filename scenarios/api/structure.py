"""Model structure from records, and models that leave the tool, in Python."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ident.structure.coefficients import BANDWIDTH
from scenarios.api.keywords import told_in_python
from scenarios.api.records import Choices
from scenarios.api.requests import Found, Named, Source, Times, plan_from, request_of, with_parts
from scenarios.api.vehicle import Vehicle
from scenarios.structure import study as structures

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class Structure:
    """Terms of the aerodynamic coefficients that records support. ``details``: everything that the
    library knows of them.
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
        """R2 of each coefficient on maneuvers left out; on those fitted where there is one."""
        found = {}
        for axis, each in self.details.selections.items():
            left_out = each.held_out is not None and isfinite(each.held_out)
            found[axis] = float(each.held_out if left_out else each.r2)
        return found

    @property
    def predicted(self) -> dict[str, dict[str, float]]:
        """R2 by record and coefficient of the records of ``validate``."""
        return {name: dict(told) for name, told in self.details.predicted.items()}

    def summary(self) -> str:
        """What the command prints."""
        from scenarios.structure.report import structure_text

        return structure_text(self.details)

    def to_dataframe(self) -> pandas.DataFrame:
        """One row a term: coefficient, text, value and standard deviation."""
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
        """Content of ``structure.json``."""
        from scenarios.structure.report import structure_content

        return structure_content(self.details)

    def save(self, folder: str | PathLike[str], *, figures: bool = True) -> Path:
        """Write table, page, JSON and ``vehicle.toml`` as the command does; returns the folder."""
        from scenarios.report.figure_formats import formats_wanted
        from scenarios.structure.report import write_structure

        return write_structure(self.details, Path(folder), figures=formats_wanted(figures))

    def __repr__(self) -> str:
        counts = ", ".join(f"{axis} {len(terms)}" for axis, terms in self.terms.items())
        return f"<Structure of {self.details.aircraft.name}: terms {counts}>"


@told_in_python
def structure(
    records: Source | Sequence[Source],
    vehicle: str | PathLike[str] | Mapping[str, Any] | Vehicle,
    validate: Source | Sequence[Source] = (),
    *,
    method: str = structures.METHODS[0],
    degree: int = structures.DEGREE,
    splines: int = 0,
    bandwidth: float = BANDWIDTH,
    terms: str | PathLike[str] | None = None,
    baseline: bool = False,
    hierarchical: bool = False,
    channels: Choices | None = None,
    columns: str | Sequence[str] | None = None,
    start: Times = None,
    stop: Times = None,
    maneuver: Named = None,
    maneuvers: Found = None,
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
    validate : records whose coefficients are predicted, not fitted: ``predicted`` of the result.
    method : ``"stepwise"`` or ``"orthogonal"``. degree : of the products of signals offered.
    splines : knots in alpha. bandwidth : Hz, of the angular accelerations.
    terms : path of a file with the terms offered. baseline : increments to the file's terms.
    hierarchical : a product enters after the linear terms of its symmetry.
    channels, columns, start, stop, maneuver, maneuvers, hold, rate, lowpass : as in ``identify``.

    Returns
    -------
    Structure; ``save(folder)`` writes a vehicle file with the terms, for ``identify``.

    Raises
    ------
    InputError : anything in records or file that keeps them from being used, in one line.

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


@told_in_python
def export(study: str | PathLike[str], to: str, path: str | PathLike[str] | None = None) -> Path:
    """Write the model of a study for another program: ``flightid export`` in Python.

    Parameters
    ----------
    study : folder that ``identify`` or ``diagnose`` saved, or a vehicle file of model ``aircraft``.
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
    ...     study = found.save(Path(folder, "study"), figures=False)
    ...     fid.export(study, to="python", path=Path(folder, "bomber.py")).name
    'bomber.py'
    """
    from scenarios.export.targets import written_model

    return written_model(Path(study), to, None if path is None else Path(path), None)[0]
