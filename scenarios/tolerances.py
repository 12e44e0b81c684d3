"""Tolerance bands of flight-simulator qualification about a measured time history.

The tests and their sources stand in ``tolerances.toml``; a user's file of the same form serves as
well.
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
    """A band about a channel.

    Attributes
    ----------
    channel : its name.
    text : the tolerance with its unit, such as ``2 deg/s``.
    share : of the measured value or of its peak, where that is more; 0 none.
    of : which of them.
    """

    channel: str
    text: str
    share: float = 0.0
    of: str = VALUE

    def half_width(self, channel: Channel, where: str) -> np.ndarray:
        """Return half of the band at each sample, ``(N,)``, in the channel's unit."""
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

    def told(self, value: float, unit: str) -> tuple[float, str]:
        """Return a value of the channel, whose unit is ``unit``, in the unit of the tolerance."""
        own = self.text.partition(" ")[2].strip()
        return value / float(to_si(1.0, own, unit, self.channel, DeclarationError)), own


@dataclass(frozen=True)
class ObjectiveTest:
    """A test of a simulator.

    Attributes
    ----------
    name, title : for people.
    entry : of the table in the source.
    requirements : all have to hold; of the alternatives of each, one.
    """

    name: str
    title: str
    entry: str
    source: str
    requirements: tuple[tuple[Tolerance, ...], ...]


@dataclass(frozen=True, eq=False)
class ChannelVerdict:
    """One channel of a test.

    Attributes
    ----------
    tolerance : asked.
    half_width : of the band, ``(N,)``.
    error : ``(N,)``, predicted less measured, NaN if nothing was measured.
    requirement : number of the requirement.
    """

    tolerance: Tolerance
    half_width: np.ndarray
    error: np.ndarray
    requirement: int

    @property
    def inside(self) -> float:
        """Share of the samples within the band."""
        there = np.isfinite(self.error)
        return float(np.mean(np.abs(self.error[there]) <= self.half_width[there]))

    @property
    def passed(self) -> bool:
        """Whether every sample is within the band."""
        return self.inside == 1.0

    @property
    def worst(self) -> int:
        """The sample that is farthest out, or nearest to the edge."""
        return int(np.nanargmax(np.abs(self.error) / self.half_width))


@dataclass(frozen=True, eq=False)
class ToleranceVerdict:
    """Whether a prediction passes a test. ``channels`` in the order of the requirements."""

    test: ObjectiveTest
    channels: tuple[ChannelVerdict, ...]

    @property
    def passed(self) -> bool:
        """Whether each requirement has an alternative that holds."""
        numbers = {each.requirement for each in self.channels}
        return all(
            any(each.passed for each in self.channels if each.requirement == number)
            for number in numbers
        )


@cache
def _schema() -> type[BaseModel]:
    """Return the form of a file of tolerances."""
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


def read_tests(asked: str) -> tuple[ObjectiveTest, ...]:
    """Tests by their names, with commas between them, or all tests of a TOML file.

    Parameters
    ----------
    asked : such as ``"short-period,roll-response"``, or the path of a file ``.toml``.

    Raises
    ------
    DeclarationError : there is no such test or file, or it has another form.
    """
    where = "--tolerances"
    if asked.endswith(".toml"):
        return _tests(toml_of(read_toml_source(Path(asked))), asked)
    import tomllib

    text = files("scenarios").joinpath("tolerances.toml").read_text(encoding="utf-8")
    known = {each.name: each for each in _tests(tomllib.loads(text), "tolerances.toml")}
    names = [name.strip() for name in asked.split(",")]
    for name in names:
        if name not in known:
            remedy = closest(name, known)
            raise DeclarationError(f"there is no test {name!r}", where=where, remedy=remedy)
    return tuple(known[name] for name in dict.fromkeys(names))


def _tests(content: Mapping[str, Any], where: str) -> tuple[ObjectiveTest, ...]:
    told = checked(_schema(), content, where).model_dump()
    found = []
    for test in told["tests"]:
        place = f"{where}, test {test['name']}"
        requirements = []
        for alternatives in test["requirements"]:
            for bound in alternatives:
                if bound["of"] not in (VALUE, PEAK) or not 0.0 <= bound["share"] < 1.0:
                    remedy = 'write share = 0.1 and of = "value" or "peak"'
                    what = f"no band about {bound['channel']}"
                    raise DeclarationError(what, where=place, remedy=remedy)
            requirements.append(
                tuple(
                    Tolerance(each["channel"], each["tolerance"], each["share"], each["of"])
                    for each in alternatives
                )
            )
        entry = test["entry"]
        found.append(
            ObjectiveTest(test["name"], test["heading"], entry, test["source"], tuple(requirements))
        )
    return tuple(found)


def verdicts_of(
    tests: Sequence[ObjectiveTest], record: Record, channels: Sequence[str], rows: np.ndarray
) -> tuple[ToleranceVerdict, ...]:
    """Return whether a prediction stays within the bands.

    Parameters
    ----------
    tests : see `read_tests`.
    record : as measured.
    channels : m predicted ones.
    rows : ``(m, N)`` the prediction, in the record's units.

    Raises
    ------
    RecordError : a requirement asks for channels that were not predicted.
    """
    predicted = dict(zip(channels, rows, strict=True))
    found = []
    for test in tests:
        verdicts = []
        for number, alternatives in enumerate(test.requirements):
            there = [each for each in alternatives if each.channel in predicted]
            if not there:
                names = " or ".join(each.channel for each in alternatives)
                raise RecordError(
                    f"the test {test.name} needs {names}, which is not predicted",
                    where=record.name,
                    remedy="ask for another test, or identify with that output",
                )
            for each in there:
                channel = record[each.channel]
                error = np.where(channel.valid, predicted[each.channel] - channel.values, np.nan)
                half = each.half_width(channel, f"test {test.name}, {each.channel}")
                verdicts.append(ChannelVerdict(each, half, error, number))
        found.append(ToleranceVerdict(test, tuple(verdicts)))
    return tuple(found)


def tolerance_table(verdicts: Sequence[ToleranceVerdict], record: Record) -> Table:
    """Each test with its channels: tolerance, largest error in it, share inside, pass or fail."""
    rows: list[list[Cell]] = []
    for verdict in verdicts:
        rows.append([verdict.test.name, verdict.test.entry, "", "", "", _word(verdict.passed)])
        for each in verdict.channels:
            channel = record[each.tolerance.channel]
            error, unit = each.tolerance.told(float(each.error[each.worst]), channel.unit)
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
    from scenarios.plots.style import (
        BLUE,
        SKY,
        VERMILION,
        finish,
        make_sheet,
        time_axis,
        y_label,
    )

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


# ---- Beside the residual of the fit

COLUMNS_NOTE = (
    "fit %: 100 where the error is zero, 0 where it is as large as the motion; Theil: 0 is "
    "perfect, 1 useless"
)
AS_WELL = 1.5  # largest ratio of the error to the residual of the fit that still agrees


@dataclass(frozen=True, eq=False)
class Simulation:
    """One free simulation of the record: ``rows`` ``(m, N)`` of its channels, and their errors;
    None if it left all measure.
    """

    rows: np.ndarray
    figures: ErrorFigures | None

    def fit_percent(self, channel: str) -> float:
        """100 (1 - rms error over the spread of the measurement)."""
        assert self.figures is not None
        return 100.0 * (1.0 - self.figures.nrmse[channel])


def residuals_of(study: Path) -> dict[str, tuple[float, float]]:
    """Return the residual of the fit of an ``identify`` and the sensor noise (both 1 sigma; the
    latter zero if unknown) by channel; empty if the folder keeps none.
    """
    content = json_or_none(study / "comparison.json")
    kept, noise = (
        found if isinstance(content, dict) and isinstance(found := content.get(key), dict) else {}
        for key in ("noise_std", "sensor_noise")
    )
    return {
        name: (float(value), float(noise.get(name) or 0.0))
        for name, value in kept.items()
        if isinstance(value, int | float) and value > 0.0
    }


def carried_over(simulation: Simulation, residuals: Mapping[str, tuple[float, float]]) -> str:
    """Return a sentence that compares the errors with the residuals of the fit; empty if either is
    unknown.
    """
    errors = simulation.figures.rmse if simulation.figures is not None else {}
    ratios = {name: errors[name] / residuals[name][0] for name in errors if name in residuals}
    if not ratios:
        return ""
    worst = max(ratios, key=lambda name: ratios[name])
    size = f"the error is {'at most ' if len(ratios) > 1 else ''}{ratios[worst]:.2g} times"
    if ratios[worst] <= AS_WELL:
        return (
            f"{size} the residual of the fit ({worst}): the model predicts this record as well as "
            f"it fits its own{_lacking(residuals)}"
        )
    return (
        f"the error of {worst} is {ratios[worst]:.2g} times the residual of the fit: the model "
        "does not hold on this record"
    )


def _lacking(residuals: Mapping[str, tuple[float, float]]) -> str:
    """Return what to add if the fit itself leaves more than the noise of the sensors."""
    ratios = {name: left / noise for name, (left, noise) in residuals.items() if noise > 0.0}
    worst = max(ratios, key=lambda name: ratios[name], default="")
    if not worst or ratios[worst] <= AS_WELL:
        return ""
    return (
        f". But the residual of that fit is {ratios[worst]:.2g} times the sensor noise ({worst}), "
        "so the model lacks something"
    )
