"""Parameters, effects, responses and the page of a result."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.tracing.diagnosis import Diagnosis
from scenarios.api import tables
from scenarios.diagnosis.text import effect_heading, wording_of
from scenarios.files.declarations import TIME
from scenarios.identification.assessment import IdentificationResult, RecordFit
from scenarios.report.figure_formats import Formats, formats_wanted
from scenarios.report.quantities import determined, number_text, value_text
from scenarios.report.summary import PAGE
from sim.errors import DeclarationError

if TYPE_CHECKING:
    import pandas

    from scenarios.diagnosis.diagnose import Tracing
    from scenarios.report.document import Table


# ---- The page of a result alone, one HTML file that holds its figures


def path_given(value: Any) -> Path:
    """Return a path that a caller gave; DeclarationError if it is neither a text nor a path."""
    if isinstance(value, str | PathLike):
        return Path(value)
    what = f"a {type(value).__name__} is no path"
    raise DeclarationError(what, where=repr(value)[:60], remedy="give a text")


def file_given(value: Any) -> Path:
    """Return the path of a file to write; DeclarationError if its folder does not exist."""
    path = path_given(value)
    if path.parent.is_dir():
        return path
    remedy = "make that folder first, or give another path"
    raise DeclarationError(f"there is no folder {path.parent}", where=str(path), remedy=remedy)


def write_report(save: Callable[[Path], Any], path: str | PathLike[str]) -> Path:
    """Write the page that ``save`` puts into a study's folder; returns the path.

    Raises DeclarationError if ``save`` writes no page.
    """
    target = file_given(path)
    with TemporaryDirectory(prefix="flightid-") as scratch:
        folder = Path(scratch) / "study"
        save(folder)
        if not (folder / PAGE).is_file():
            raise DeclarationError(
                "a study of this kind has no page",
                where="report",
                remedy="save(FOLDER) writes its files",
            )
        page = (folder / PAGE).read_bytes()
    target.write_bytes(page)
    return target


class SavedResult:
    """A result that can be written as the command writes it with ``--out``."""

    def _write(self, folder: Path, figures: Formats) -> object:
        raise NotImplementedError

    def save(
        self, folder: str | PathLike[str], *, figures: bool | str | Sequence[str] = True
    ) -> Path:
        """Write the study as the command does with ``--out``; returns the folder."""
        path = path_given(folder)
        self._write(path, formats_wanted(figures))
        return path

    def report(
        self, path: str | PathLike[str], *, figures: bool | str | Sequence[str] = True
    ) -> Path:
        """Write its page alone, one HTML file that holds its figures; returns the path."""
        return write_report(lambda folder: self.save(folder, figures=figures), path)


# ---- Estimated numbers by name, each with its sigma and unit

HEADINGS = ("parameter", "unit", "value", "sigma")
IN_A_LINE = 4  # parameters that a repr names


@dataclass(frozen=True)
class Parameter:
    """An estimated number.

    Attributes
    ----------
    value, sigma, unit : the estimate, its standard deviation, and their unit.
    start : starting value; None if unknown.
    """

    name: str
    value: float
    sigma: float
    unit: str
    start: float | None = None

    @property
    def interval(self) -> tuple[float, float]:
        """Value minus and plus two sigmas."""
        return self.value - 2.0 * self.sigma, self.value + 2.0 * self.sigma

    @property
    def determined(self) -> bool:
        """Whether the record determines it."""
        return determined(self.value, self.sigma)

    def __float__(self) -> float:
        return self.value

    def __repr__(self) -> str:
        return f"{self.name} = {value_text(self.value, self.sigma, self.unit)}"


class Parameters(Mapping[str, Parameter]):
    """Parameters by name, in the order of the estimate."""

    def __init__(self, items: Iterable[Parameter]) -> None:
        self._items = {item.name: item for item in items}

    def __getitem__(self, name: str) -> Parameter:
        if name not in self._items:
            estimated = ", ".join(self._items)
            raise KeyError(
                f"there is no estimated parameter {name!r}: {estimated} (what is fixed or tied is "
                "not estimated)"
            )
        return self._items[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._items)

    def __len__(self) -> int:
        return len(self._items)

    def to_dict(self) -> dict[str, float]:
        """Return the values by name."""
        return {name: item.value for name, item in self._items.items()}

    def to_dataframe(self) -> pandas.DataFrame:
        """Return one row per parameter: ``unit``, ``value``, ``sigma``, and ``start`` if known."""
        import pandas

        index = pandas.Index(list(self._items), name="parameter")
        items = list(self._items.values())
        columns: dict[str, list[Any]] = {
            "unit": [item.unit for item in items],
            "value": [item.value for item in items],
            "sigma": [item.sigma for item in items],
        }
        if any(item.start is not None for item in items):
            columns["start"] = [math.nan if item.start is None else item.start for item in items]
        return pandas.DataFrame(columns, index=index)

    def to_markdown(self) -> str:
        """Return a Markdown table with digits by the sigmas."""
        from scenarios.report.folder import to_markdown

        return to_markdown(self._table(""))

    def to_latex(self) -> str:
        """Return a LaTeX ``tabular`` with the rules of the package ``booktabs``."""
        from scenarios.report.folder import to_latex

        return to_latex(self._table(""))

    def to_excel(self, path: str | PathLike[str]) -> Path:
        """Write an XLSX workbook with full precision; returns the path. Needs openpyxl."""
        return write_sheets(path, {"parameters": self})

    def _table(self, caption: str) -> Table:
        from scenarios.report.folder import estimates

        rows = [(item.name, item.unit, item.value, item.sigma) for item in self._items.values()]
        return estimates(caption, rows)

    def __repr__(self) -> str:
        items = list(self._items.values())
        more = f", and {len(items) - IN_A_LINE} more" if len(items) > IN_A_LINE else ""
        return f"<{', '.join(map(repr, items[:IN_A_LINE])) or 'no parameters'}{more}>"

    def html_table(self) -> str:
        """Return the HTML table alone."""
        return tables.table(HEADINGS, [row_of(item) for item in self._items.values()], left=2)

    def _repr_html_(self) -> str:
        return tables.page("parameters", self.html_table())


class WithParameters:
    """A result with ``parameters``, which are its elements and its tables."""

    @cached_property
    def parameters(self) -> Parameters:
        raise NotImplementedError

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[name]

    def to_markdown(self) -> str:
        """Return the parameters as a Markdown table, with digits by their sigmas."""
        return self.parameters.to_markdown()

    def to_latex(self) -> str:
        """The parameters as a LaTeX ``tabular`` with the rules of the package ``booktabs``."""
        return self.parameters.to_latex()


def write_sheets(path: str | PathLike[str], sheets: Mapping[str, Parameters]) -> Path:
    """Write parameters as a workbook with a sheet for each non-empty set; return the path.

    Raises
    ------
    InputError : the path does not end in .xlsx.
    """
    from scenarios.report.folder import write_workbook

    target = file_given(path)
    if target.suffix.lower() != ".xlsx":
        what = f"a workbook cannot be named {target.name}"
        raise DeclarationError(what, where=str(path), remedy="name a .xlsx file")
    return write_workbook([items._table(name) for name, items in sheets.items() if items], target)


def row_of(item: Parameter) -> tuple[str, str, str, str]:
    """Return name, unit, value and sigma with digits by the sigma."""
    unit = item.unit if item.unit != "1" else ""
    if not item.determined:
        return item.name, unit, "not determined", "-"
    return item.name, unit, number_text(item.value, item.sigma), number_text(item.sigma, item.sigma)


# ---- Measured and predicted signals, and the errors between them, as DataFrames

ERRORS = ("held_out", "rms", "fit_percent", "r2", "theil")


def errors_of(fits: Sequence[RecordFit]) -> pandas.DataFrame:
    """Return the errors of the simulation by record and channel, SI.

    A record whose simulation diverged has no rows.
    """
    import pandas

    rows = {
        (fit.record.name, name): (
            fit.held_out,
            fit.figures.rmse[name],
            fit.figures.fit_percent(name),
            fit.figures.r2[name],
            fit.figures.theil[name],
        )
        for fit in fits
        if fit.figures is not None
        for name in fit.figures.rmse
    }
    index = (
        pandas.MultiIndex.from_tuples(list(rows), names=["record", "channel"])
        if rows
        else pandas.MultiIndex.from_arrays([[], []])
    )
    return pandas.DataFrame(list(rows.values()), columns=list(ERRORS), index=index)


def response_of(found: IdentificationResult, number: int) -> pandas.DataFrame:
    """Return a record over ``time``, SI: inputs, measured and predicted outputs.

    The columns of an output are for example ``alpha`` and ``predicted_alpha``. ``number`` counts
    the records from 0, held-out ones last. A filter predicts the fitted record one sample ahead.
    """
    import pandas

    fitted = (found.record, *found.others)
    if found.estimate.history is not None and number < len(fitted):
        record, outputs = fitted[number], found.estimate.output_names
        rows = found.estimate.fitted[number]
    elif 0 <= number < len(found.fits):
        record, outputs = found.fits[number].record, found.fits[number].outputs
        rows = found.fits[number].simulated
    elif 0 <= number < len(fitted):
        record, outputs = fitted[number], found.estimate.output_names
        rows = found.estimate.fitted[number]
    else:
        raise DeclarationError(
            f"there is no record {number}",
            where="response",
            remedy=f"there are {max(len(found.fits), len(fitted))}, from 0 on",
        )
    columns: dict[str, np.ndarray] = {
        channel.name: channel.with_gaps() for channel in record.inputs
    }
    for name, row in zip(outputs, rows, strict=True):
        if name in record.output_names:
            columns |= {name: record[name].with_gaps(), f"predicted_{name}": np.asarray(row)}
    return pandas.DataFrame(columns, index=pandas.Index(record.time, name=TIME))


def prediction_of(found: Diagnosis, number: int) -> pandas.DataFrame:
    """Return a predicted record over ``time``, SI: measured, and simulated before and after.

    The columns of an output are for example ``alpha``, ``before_alpha`` and ``after_alpha``.
    """
    import pandas

    if not 0 <= number < len(found.predictions):
        raise DeclarationError(
            f"there is no record {number}",
            where="prediction",
            remedy=f"there are {len(found.predictions)}, from 0 on",
        )
    predicted = found.predictions[number]
    record = predicted.record
    columns: dict[str, np.ndarray] = {
        channel.name: channel.with_gaps() for channel in record.inputs
    }
    rows = zip(predicted.channels, predicted.before, predicted.after, strict=True)
    for name, before, after in rows:
        measured = {name: record[name].with_gaps()} if name in record.output_names else {}
        columns |= {**measured, f"before_{name}": before, f"after_{name}": after}
    return pandas.DataFrame(columns, index=pandas.Index(record.time, name=TIME))


# ---- The effects that a diagnosis names


@dataclass(frozen=True, eq=False, repr=False)
class Effect:
    """One effect of a diagnosis.

    Attributes
    ----------
    name : name in ``flightid.effects()``.
    sentence : the effect in words, with its numbers.
    parameters : its parameters by local name.
    alternatives : effects that fit these data as well.
    probability : probability of this effect and of each alternative, by name.
    """

    name: str
    sentence: str
    parameters: Parameters
    alternatives: tuple[str, ...]
    probability: dict[str, float]

    def __getitem__(self, name: str) -> Parameter:
        return self.parameters[name]

    def __repr__(self) -> str:
        return f"<Effect {self.name}: {self.parameters!r:.400}>"

    def _repr_html_(self) -> str:
        others = (
            [f"these data fit as well: {', '.join(self.alternatives)}"] if self.alternatives else []
        )
        return tables.page(
            f"{self.name}: {self.sentence}", self.parameters.html_table(), tables.sentences(others)
        )


def claimed_effects(tracing: Tracing, *, claimed: bool) -> tuple[Effect, ...]:
    """Return the effects of a diagnosis that are claimed, or those that are only hints."""
    wording = wording_of(tracing)
    return tuple(
        Effect(
            claim.name,
            effect_heading(claim, wording),
            Parameters(
                Parameter(name, quantity.value, quantity.std, quantity.unit)
                for name, quantity in claim.parameters.items()
            ),
            claim.alternatives,
            dict(claim.probability),
        )
        for claim in tracing.diagnosis.effects
        if claim.claimed is claimed
    )
