"""Tolerance bands of flight-simulator qualification about a measured time history.

The tests and their sources are in ``tolerances.toml``. A user may give a file of the same form.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ident.statistics.residuals import ErrorFigures
from scenarios.files.declarations import checked, closest, read_toml_source, toml_of
from scenarios.files.sources import json_or_none
from scenarios.files.units import to_si
from scenarios.report.document import PURE, Cell, Column, Table, formatted
from scenarios.report.terminal import rows_table
from sim.errors import DeclarationError, RecordError, instant
from sim.record import Channel, Record

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pydantic import BaseModel

    from scenarios.plots.drawing import Named

SOURCE = "14 CFR part 60, appendix A, table A2A"
VALUE, PEAK = "value", "peak"


@dataclass(frozen=True)
class Tolerance:
    """A tolerance band about a measured channel.

    Attributes
    ----------
    channel : name of the channel.
    text : absolute tolerance with its unit, such as ``2 deg/s``.
    share : relative tolerance, 0 to 1; the larger of the two tolerances applies.
    of : reference of ``share``: ``VALUE``, the measured value at each sample, or ``PEAK``, the
        largest change of the measured channel from its first sample.
    """

    channel: str
    text: str
    share: float = 0.0
    of: str = VALUE

    def half_width(self, channel: Channel, where: str) -> np.ndarray:
        """Return half the width of the band at each sample, ``(N,)``, in the channel's unit.

        ``where`` is the place of the tolerance, for messages.
        """
        number, _, unit = self.text.partition(" ")
        try:
            value = float(number)
        except ValueError:
            remedy = 'write for example "2 deg/s"'
            what = f"{self.text!r} is not a number with a unit"
            raise DeclarationError(what, where=where, remedy=remedy) from None
        least = float(to_si(value, unit.strip(), channel.unit, where, DeclarationError))
        size = np.abs(channel.values)
        if self.of == PEAK:
            peak = np.max(np.abs(channel.values[channel.valid] - channel.values[channel.valid][0]))
            size = np.full(len(size), float(peak))
        return np.maximum(least, self.share * size)

    def in_own_unit(self, value: float, unit: str) -> tuple[float, str]:
        """Return a value given in ``unit`` in the unit of the tolerance, and that unit."""
        own_unit = self.text.partition(" ")[2].strip()
        return value / float(to_si(1.0, own_unit, unit, self.channel, DeclarationError)), own_unit


@dataclass(frozen=True)
class ObjectiveTest:
    """An objective test of simulator qualification.

    Attributes
    ----------
    name : name of the test for ``--tolerances``.
    title : title of the test for figures.
    entry : number of the test in the table of its source.
    source : document that defines the test.
    requirements : the test is passed if every requirement is met. A requirement is a tuple of
        alternative tolerances, and is met if one of them is kept.
    """

    name: str
    title: str
    entry: str
    source: str
    requirements: tuple[tuple[Tolerance, ...], ...]


@dataclass(frozen=True, eq=False)
class ChannelVerdict:
    """Result of a test for one channel.

    Attributes
    ----------
    tolerance : the tolerance.
    half_width : ``(N,)``, half the width of the band, in the channel's unit.
    error : ``(N,)``, predicted minus measured; NaN where a sample is missing.
    requirement : index of the requirement in the test.
    """

    tolerance: Tolerance
    half_width: np.ndarray
    error: np.ndarray
    requirement: int

    @property
    def inside(self) -> float:
        """Share of the samples within the band, 0 to 1."""
        valid = np.isfinite(self.error)
        return float(np.mean(np.abs(self.error[valid]) <= self.half_width[valid]))

    @property
    def passed(self) -> bool:
        """Whether every sample is within the band."""
        return self.inside == 1.0

    @property
    def worst(self) -> int:
        """Index of the sample with the largest error relative to the band."""
        return int(np.nanargmax(np.abs(self.error) / self.half_width))


@dataclass(frozen=True, eq=False)
class ToleranceVerdict:
    """Result of a test; ``channels`` are in the order of the requirements."""

    test: ObjectiveTest
    channels: tuple[ChannelVerdict, ...]

    @property
    def passed(self) -> bool:
        """Whether every requirement has an alternative that is kept."""
        numbers = {each.requirement for each in self.channels}
        return all(
            any(each.passed for each in self.channels if each.requirement == number)
            for number in numbers
        )


@cache
def _schema() -> type[BaseModel]:
    """Return the schema of a file of tolerances."""
    from scenarios.files.schemas import table_of

    bound: Any = table_of(
        "Bound", channel=(str, ...), tolerance=(str, ...), share=(float, 0.0), of=(str, VALUE)
    )
    test: Any = table_of(
        "Test",
        name=(str, ...),
        entry=(str, ""),
        heading=(str, ""),
        source=(str, SOURCE),
        requirements=(list[list[bound]], ...),
    )
    return table_of("Tolerances", tests=(list[test], ...))


def read_tests(names_or_path: str) -> tuple[ObjectiveTest, ...]:
    """Return the tests with these names, or all tests of a TOML file.

    Parameters
    ----------
    names_or_path : names such as ``"short-period,roll-response"``, or the path of a ``.toml`` file.

    Raises
    ------
    DeclarationError : there is no such test or file, or it has another form.
    """
    where = "--tolerances"
    if names_or_path.endswith(".toml"):
        return _tests_of(toml_of(read_toml_source(Path(names_or_path))), names_or_path)
    import tomllib

    text = files("scenarios").joinpath("tolerances.toml").read_text(encoding="utf-8")
    known = {test.name: test for test in _tests_of(tomllib.loads(text), "tolerances.toml")}
    names = [name.strip() for name in names_or_path.split(",")]
    for name in names:
        if name not in known:
            remedy = closest(name, known)
            raise DeclarationError(f"there is no test {name!r}", where=where, remedy=remedy)
    return tuple(known[name] for name in dict.fromkeys(names))


def _tests_of(content: Mapping[str, Any], where: str) -> tuple[ObjectiveTest, ...]:
    """Return the tests of a file's content; ``where`` is the file, for messages."""
    tests = []
    for test in checked(_schema(), content, where).model_dump()["tests"]:
        place = f"{where}, test {test['name']}"
        requirements = []
        for alternatives in test["requirements"]:
            for bound in alternatives:
                if bound["of"] not in (VALUE, PEAK) or not 0.0 <= bound["share"] < 1.0:
                    remedy = 'write share = 0.1 and of = "value" or "peak"'
                    what = f"no band about {bound['channel']}: share or of is wrong"
                    raise DeclarationError(what, where=place, remedy=remedy)
            requirements.append(
                tuple(
                    Tolerance(each["channel"], each["tolerance"], each["share"], each["of"])
                    for each in alternatives
                )
            )
        entry = test["entry"]
        tests.append(
            ObjectiveTest(test["name"], test["heading"], entry, test["source"], tuple(requirements))
        )
    return tuple(tests)


def verdicts_of(
    tests: Sequence[ObjectiveTest], record: Record, channels: Sequence[str], rows: np.ndarray
) -> tuple[ToleranceVerdict, ...]:
    """Return the results of tests of a prediction.

    Parameters
    ----------
    tests : the tests.
    record : the measured record.
    channels : names of the m predicted channels.
    rows : ``(m, N)``, the predicted channels, in the units of the record.

    Raises
    ------
    RecordError : a requirement asks for channels that were not predicted.
    """
    predicted = dict(zip(channels, rows, strict=True))
    results = []
    for test in tests:
        verdicts = []
        for number, alternatives in enumerate(test.requirements):
            predictable = [each for each in alternatives if each.channel in predicted]
            if not predictable:
                names = " or ".join(each.channel for each in alternatives)
                raise RecordError(
                    f"the test {test.name} needs {names}, which is not predicted",
                    where=record.name,
                    remedy="ask for another test, or identify with that output",
                )
            for tolerance in predictable:
                name = tolerance.channel
                channel = record[name]
                error = np.where(channel.valid, predicted[name] - channel.values, np.nan)
                half_width = tolerance.half_width(channel, f"test {test.name}, {name}")
                verdicts.append(ChannelVerdict(tolerance, half_width, error, number))
        results.append(ToleranceVerdict(test, tuple(verdicts)))
    return tuple(results)


def tolerance_table(verdicts: Sequence[ToleranceVerdict], record: Record) -> Table:
    """Return a table of the tests and their channels.

    A channel has its tolerance, its worst error, its share of samples within the band, and pass or
    fail.
    """
    rows: list[list[Cell]] = []
    for verdict in verdicts:
        rows.append([verdict.test.name, verdict.test.entry, "", "", "", _word(verdict.passed)])
        for each in verdict.channels:
            channel = record[each.tolerance.channel]
            error, unit = each.tolerance.in_own_unit(float(each.error[each.worst]), channel.unit)
            share = f" or {100 * each.tolerance.share:g} %" if each.tolerance.share else ""
            rows.append(
                [
                    f"  {channel.name}",
                    "",
                    f"+-{each.tolerance.text}{share}",
                    f"{error:+.3g} {unit} at {instant(record.time[each.worst])} s",
                    formatted(100.0 * each.inside, ".1f", PURE),
                    _word(each.passed),
                ]
            )
    heads = ("test", "entry", "tolerance", "worst error", "% inside", "verdict")
    return rows_table("tolerances of simulator qualification", [Column(h) for h in heads], rows)


def _word(passed: bool) -> str:
    return "pass" if passed else "fail"


def tolerance_content(verdicts: Sequence[ToleranceVerdict], record: Record) -> list[dict[str, Any]]:
    """Return the verdicts for a JSON document, in the record's units."""
    return [
        {
            "test": verdict.test.name,
            "title": verdict.test.title,
            "entry": verdict.test.entry,
            "source": verdict.test.source,
            "passed": verdict.passed,
            "channels": [
                {
                    "channel": each.tolerance.channel,
                    "unit": record[each.tolerance.channel].unit,
                    "requirement": each.requirement + 1,
                    "tolerance": each.tolerance.text,
                    "share": each.tolerance.share,
                    "worst_error": float(each.error[each.worst]),
                    "at": float(record.time[each.worst]),
                    "inside": each.inside,
                    "passed": each.passed,
                }
                for each in verdict.channels
            ],
        }
        for verdict in verdicts
    ]


def tolerance_figures(
    verdicts: Sequence[ToleranceVerdict], record: Record, channels: Sequence[str], rows: np.ndarray
) -> Iterator[Named]:
    """Yield a figure for each test: the measured channel with its band, and the prediction."""
    predicted = dict(zip(channels, rows, strict=True))
    for verdict in verdicts:
        stem = f"tolerances_{verdict.test.name}"
        yield stem, partial(_figure, verdict, record, predicted)


def _figure(
    verdict: ToleranceVerdict, record: Record, predicted: Mapping[str, np.ndarray]
) -> Figure:
    from scenarios.plots.display import axis_label, display_unit
    from scenarios.plots.style import BLUE, SKY, VERMILION, finish, make_sheet, time_axis, y_label

    sheet = make_sheet([1.5] * len(verdict.channels))
    for panel, each in zip(sheet.panels, verdict.channels, strict=True):
        channel = record[each.tolerance.channel]
        unit = display_unit(channel.unit)
        measured = unit.factor * channel.with_gaps()
        half = unit.factor * each.half_width
        line = unit.factor * predicted[channel.name]
        panel.fill_between(
            record.time, measured - half, measured + half, color=SKY, alpha=0.35, lw=0, label="band"
        )
        panel.plot(record.time, line, color=BLUE, lw=1.2, label="predicted")
        out = np.where(np.abs(each.error) > each.half_width, line, np.nan)
        if np.any(np.isfinite(out)):
            panel.plot(record.time, out, ".", color=VERMILION, ms=3, label="outside")
        y_label(panel, axis_label(channel.name, unit))
    time_axis(sheet.panels[-1])
    test = verdict.test
    title = f"{test.title} ({test.entry}): {_word(verdict.passed)}\n{record.name}, {test.source}"
    return finish(sheet, title)


# ---- Errors of a prediction against the residual of the fit

COLUMNS_NOTE = (
    "fit %: 100 where the error is zero, 0 where it is as large as the motion; Theil: 0 is "
    "perfect, 1 useless"
)
LARGEST_RATIO = 1.5  # largest ratio of an error to the residual of the fit that agrees with it


@dataclass(frozen=True, eq=False)
class Simulation:
    """A free simulation of a record.

    Attributes
    ----------
    rows : ``(m, N)``, the simulated channels.
    figures : their errors; None if the simulation diverged.
    """

    rows: np.ndarray
    figures: ErrorFigures | None


def residuals_of(study: Path) -> dict[str, tuple[float, float]]:
    """Return the residuals of an ``identify`` study by channel; empty if the folder has none.

    Each pair is the residual of the fit and the sensor noise, both as 1 sigma in the unit of the
    channel. An unknown sensor noise is zero.
    """
    content = json_or_none(study / "comparison.json")
    residuals, noise = (
        table if isinstance(content, dict) and isinstance(table := content.get(key), dict) else {}
        for key in ("noise_std", "sensor_noise")
    )
    return {
        name: (float(value), float(noise.get(name) or 0.0))
        for name, value in residuals.items()
        if isinstance(value, int | float) and value > 0.0
    }


def sensor_noise_of(study: Path) -> dict[str, float]:
    """Return the sensor noise that a study estimated, by channel, 1 sigma in the channel's unit;
    empty if the folder has none.
    """
    identified, diagnosed = (
        json_or_none(study / name) for name in ("comparison.json", "diagnosis.json")
    )
    noise: Any = identified.get("sensor_noise") if isinstance(identified, dict) else None
    if noise is None and isinstance(diagnosed, dict):
        error = diagnosed.get("error")
        noise = error.get("noise_floor") if isinstance(error, dict) else None
    if not isinstance(noise, dict):
        return {}
    return {
        name: float(value)
        for name, value in noise.items()
        if isinstance(value, int | float) and value > 0.0
    }


def error_against_fit(simulation: Simulation, residuals: Mapping[str, tuple[float, float]]) -> str:
    """Return a sentence that compares the errors of a prediction with the residuals of the fit.

    The sentence is empty if either is unknown. ``residuals`` are those of `residuals_of`.
    """
    errors = simulation.figures.rmse if simulation.figures is not None else {}
    ratios = {name: errors[name] / residuals[name][0] for name in errors if name in residuals}
    if not ratios:
        return ""
    worst = max(ratios, key=lambda name: ratios[name])
    size = f"the error is {'at most ' if len(ratios) > 1 else ''}{ratios[worst]:.2g} times"
    if ratios[worst] <= LARGEST_RATIO:
        return (
            f"{size} the residual of the fit ({worst}): the model predicts this record as well as "
            f"the records of its fit{_misfit_clause(residuals)}"
        )
    return (
        f"the error of {worst} is {ratios[worst]:.2g} times the residual of the fit: the model "
        "does not hold on this record"
    )


def _misfit_clause(residuals: Mapping[str, tuple[float, float]]) -> str:
    """Return a clause if a residual of the fit exceeds the sensor noise; empty if none does."""
    ratios = {
        name: residual / noise for name, (residual, noise) in residuals.items() if noise > 0.0
    }
    worst = max(ratios, key=lambda name: ratios[name], default="")
    if not worst or ratios[worst] <= LARGEST_RATIO:
        return ""
    return (
        f". But the residual of that fit is {ratios[worst]:.2g} times the sensor noise ({worst}), "
        "so the model lacks something"
    )
