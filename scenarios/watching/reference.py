"""The study that a stream is compared with, and the table of the comparison."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ident.estimate import Estimate
from ident.statistics.residuals import BOUND_SIGMAS
from scenarios.files.sources import InputFile, read_json, resolved
from scenarios.files.vehicles import VehicleFile, read_vehicle, vehicle_with_file
from scenarios.identification.low_order import DERIVED, PAPER_START
from scenarios.report.document import BY_ROW, MISSING, PURE, Block, Column, Number, estimate, table
from scenarios.report.quantities import number_text
from scenarios.studies.comparison import DERIVED_UNITS, SCHEMA
from sim.closed_loop.airframe import load_x29
from sim.errors import DeclarationError
from sim.vehicles.factory import LOES_CONSTANTS

# ---- The study that a stream is compared with


@dataclass(frozen=True)
class Reference:
    """Reference values from an earlier study.

    Attributes
    ----------
    name : path of the study.
    values : estimate and standard deviation of parameters and derived quantities.
    fixed : fixed values.
    plain : estimates of a single pass of the bank of filters, as in the paper, if stored.
    """

    name: str
    values: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float] = field(default_factory=dict)
    plain: Mapping[str, float] = field(default_factory=dict)


def read_reference(path: Path, needed: Sequence[str] = tuple(PAPER_START)) -> Reference:
    """Read reference values from a study folder or its comparison.json.

    ``needed``: parameters that the study must have.

    Raises
    ------
    DeclarationError : there is no such study, or it is of another model.
    """
    file = path / "comparison.json" if path.is_dir() else path
    content = read_json(file, wanted="the folder of a study, or its comparison.json")
    if not isinstance(content, dict) or content.get("schema") != SCHEMA:
        raise DeclarationError(
            f"it is no {SCHEMA}",
            where=str(file),
            remedy="name the folder of a study that run, identify or watch wrote",
        )
    derived = _pairs(content, "derived", file)
    values = _pairs(content, "parameters", file) | {
        name: derived[name] for name in DERIVED if name in derived
    }
    fixed = _numbers(content.get("fixed"), "value")
    plain = content.get("plain")
    first_pass = _numbers(plain.get("parameters") if isinstance(plain, dict) else None, "estimate")
    missing = [name for name in needed if name not in values and name not in fixed]
    if missing:
        if missing[0] in content.get("start_dependent", ()):
            raise DeclarationError(
                f"{missing[0]} hangs on the start in it",
                where=str(file),
                remedy="name a study that was refined",
            )
        remedy = "name a study of the same model"
        raise DeclarationError(f"there is no {missing[0]} in it", where=str(file), remedy=remedy)
    return Reference(str(path), values, fixed, first_pass)


def vehicle_to_watch(vehicle: Path | None, reference: Reference | None) -> VehicleFile:
    """Return constants and starting values of the vehicle file, else the reference, else the paper.

    The estimates of a single pass come first in a reference that has them, as in the paper.
    """
    if vehicle is not None:
        vehicle_file = read_vehicle(vehicle, "loes")
        if vehicle_file.constraints:
            what = "a filter that runs along estimates every derivative"
            remedy = "leave [fixed], [bounds] and [tied] out, or use identify"
            raise DeclarationError(what, where=str(vehicle), remedy=remedy)
        return vehicle_file
    x29 = load_x29("F")
    constants = {
        "airspeed": x29.airframe.airspeed,
        "gravity": x29.airframe.gravity,
        "vane_arm": x29.telemetry.vane_arm,
    }
    if reference is None:
        return VehicleFile("x29", "loes", constants, dict(PAPER_START))
    values = {
        **reference.fixed,
        **{name: value for name, (value, _) in reference.values.items()},
        **reference.plain,
    }
    return VehicleFile(
        resolved(Path(reference.name)).name,
        "loes",
        {name: reference.fixed.get(name, constants[name]) for name in LOES_CONSTANTS},
        {name: values[name] for name in PAPER_START},
    )


def vehicle_sentence(vehicle: VehicleFile) -> str:
    """Return the sentence on the vehicle file that gave constants and starting values."""
    named = vehicle_with_file(vehicle.name, vehicle.identity)
    return f"constants and starting values: {named}"


def usual_command(name: str, model: str, vehicle: InputFile | None) -> list[str]:
    """Return the words of the command that watches a stream ``name``, if none was typed."""
    words = ["flightid", "watch", name, "--model", model]
    return [*words, *(["--vehicle", vehicle.name] if vehicle is not None else [])]


def rows_and_vehicle(
    name: str, digest: str, vehicle: InputFile | None
) -> list[tuple[str, str, str]]:
    """Return use, name and SHA-256 of the rows and of the vehicle file, if any."""
    files = [("vehicle", vehicle.name, vehicle.sha256)] if vehicle is not None else []
    return [("rows", name, digest), *files]


def _pairs(content: Mapping[str, Any], key: str, file: Path) -> dict[str, tuple[float, float]]:
    """Return estimate and standard deviation by name from a table of comparison.json.

    An entry without a standard deviation is left out. Raises DeclarationError for another form.
    """
    table = content.get(key, {})
    if not isinstance(table, dict):
        raise DeclarationError(
            "no table", where=f"{file}, key {key}", remedy="name the folder of a study"
        )
    pairs = {}
    for name, entry in table.items():
        if not isinstance(entry, dict) or not _is_number(entry.get("estimate")):
            raise DeclarationError(
                "no estimate",
                where=f"{file}, key {key}.{name}",
                remedy="name the folder of a study",
            )
        if _is_number(entry.get("std")):
            pairs[name] = (float(entry["estimate"]), float(entry["std"]))
    return pairs


def _numbers(table: Any, key: str) -> dict[str, float]:
    """Return the number under ``key`` of each entry of a table by name, if it has one."""
    entries = table.items() if isinstance(table, dict) else ()
    return {
        name: float(entry[key])
        for name, entry in entries
        if isinstance(entry, dict) and _is_number(entry.get(key))
    }


def _is_number(value: Any) -> bool:
    """Return whether a JSON value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


# ---- Table and lines of a watch

HANGING = "depends on start"
WORDS = {
    "natural_frequency": "natural frequency",
    "damping_ratio": "damping ratio",
    "delay": "delay",
}


@dataclass(frozen=True)
class CrossValidation:
    """One quantity of the stream beside its reference, in ``unit``.

    Attributes
    ----------
    value, std : estimate and its standard deviation.
    reference : value and standard deviation in the reference, or None.
    hanging : whether the estimate depends on the start.
    """

    name: str
    unit: str
    value: float
    std: float
    reference: tuple[float, float] | None = None
    hanging: bool = False

    @property
    def z(self) -> float | None:
        """Difference over its standard deviation, the root of the sum of both variances.

        None without a reference or a standard deviation, or if the estimate depends on the start.
        """
        if self.reference is None or self.hanging:
            return None
        scale = math.hypot(self.std, self.reference[1])
        return (self.value - self.reference[0]) / scale if scale > 0 else None

    @property
    def beyond(self) -> bool:
        """Whether the estimate differs from the reference by more than two sigmas."""
        return self.z is not None and abs(self.z) > BOUND_SIGMAS


@dataclass(frozen=True)
class View:
    """State of a watch at one time.

    Attributes
    ----------
    name : name of the stream.
    time : time of the last row, s.
    rows, left_out, spikes : numbers of rows, of lines that were left out, and of spikes.
    standings : quantities with their references.
    delays : delays of the filters, s.
    weights : probability of each delay if the estimate is ``refined``, else its likelihood.
    silent : time since the last row arrived, s.
    sound : whether a filter has not broken down.
    refined : whether the estimate is that of the relinearised bank.
    """

    name: str
    time: float
    rows: int
    left_out: int
    spikes: int
    standings: tuple[CrossValidation, ...]
    delays: np.ndarray
    weights: np.ndarray
    silent: float = 0.0
    sound: bool = True
    refined: bool = False


def comparisons(
    estimate: Estimate,
    derived: Mapping[str, tuple[float, float]],
    reference: Reference | None,
    hanging: Collection[str] = (),
) -> tuple[CrossValidation, ...]:
    """Return derived quantities and then parameters, each with its reference if there is one.

    Parameters
    ----------
    derived : value and standard deviation by name.
    hanging : names of the quantities that depend on the start.
    """
    parameters = zip(
        estimate.names, estimate.units, estimate.values.tolist(), estimate.std.tolist(), strict=True
    )
    quantities = [
        *((name, DERIVED_UNITS[name], value, std) for name, (value, std) in derived.items()),
        *(parameter for parameter in parameters if parameter[0] not in derived),
    ]
    references = {} if reference is None else reference.values
    return tuple(
        CrossValidation(name, unit, value, std, references.get(name), name in hanging)
        for name, unit, value, std in quantities
    )


def live_table(view: View) -> Group:
    """Return heading, table of quantities and weights of the delays for a terminal.

    The table has no frame, so that 80 columns suffice for all numbers.
    """
    table = Table(box=box.SIMPLE_HEAD, padding=0)
    compared = any(item.reference is not None for item in view.standings)
    hanging = any(item.hanging for item in view.standings)
    headings = [
        "quantity",
        "unit",
        "estimate",
        "+- sigma",
        *(("reference", "+- sigma", "off,\nsigmas") if compared else ()),
    ]
    for heading in [*headings, *([""] if compared or hanging else [])]:
        table.add_column(
            heading,
            justify="left" if heading in ("quantity", "unit", "") else "right",
            no_wrap=True,
        )
    for item in view.standings:
        cells = [_word(item.name), item.unit]
        cells += (
            ["-", "-"]
            if item.hanging
            else [number_text(item.value, item.std), number_text(item.std, item.std)]
        )
        if item.reference is not None:
            value, std = item.reference
            off = "-" if item.z is None else f"{item.z:+.1f}"
            cells += [number_text(value, std), number_text(std, std), off]
        elif compared:
            cells += [""] * 3
        if compared or hanging:
            cells.append(HANGING if item.hanging else "outside" if item.beyond else "")
        table.add_row(*cells, style="bold red" if item.beyond else None)
    return Group(Text(_heading(view)), table, Text(_weights(view)))


def line(view: View) -> str:
    """Return the view in one line, for a log."""
    by_name = {item.name: item for item in view.standings}
    shown = []
    for name, word in WORDS.items():
        if name in by_name:
            item = by_name[name]
            text = (
                f"{number_text(item.value, item.std)} +- {number_text(item.std, item.std)} "
                f"{item.unit}"
            ).removesuffix(" 1")
            shown.append(f"{word} {HANGING if item.hanging else text}")
    best = int(np.argmax(view.weights))
    shown.append(f"most likely {view.delays[best]:g} s (weight {view.weights[best]:.2f})")
    outside = [_word(item.name) for item in view.standings if item.beyond]
    return (
        f"{_heading(view)}: "
        + ", ".join(shown)
        + (f"; outside the reference: {', '.join(outside)}" if outside else "")
    )


def against(outside: Sequence[str], compared: int, name: str, hanging: Sequence[str] = ()) -> str:
    """Return a sentence on the agreement of a stream with its reference.

    Parameters
    ----------
    outside : quantities that differ by more than two sigmas.
    compared : number of quantities that were compared.
    name : name of the reference.
    hanging : quantities that depend on the start, and were not compared.
    """
    left = (
        f"; not compared, as they depend on the start: {', '.join(map(_word, hanging))}"
        if hanging
        else ""
    )
    if outside:
        verb = "quantities is" if len(outside) == 1 else "quantities are"
        names = ", ".join(map(_word, outside))
        return (
            f"{len(outside)} of {compared} {verb} more than two sigmas from {name}: {names}{left}"
        )
    if not compared:
        return f"no quantity could be compared with {name}{left}"
    return f"all {compared} compared quantities agree with {name} within two sigmas{left}"


def against_items(items: Sequence[CrossValidation], name: str) -> str:
    """Return a sentence on the agreement of quantities with the reference ``name``."""
    return against(
        [item.name for item in items if item.beyond],
        sum(item.z is not None for item in items),
        name,
        [item.name for item in items if item.hanging],
    )


def _word(name: str) -> str:
    return WORDS.get(name, name)


def _heading(view: View) -> str:
    """Return name and time of the stream, counts of rows, and remarks."""
    counts = [f"{view.rows} rows"]
    for number, word in ((view.left_out, "line"), (view.spikes, "spike")):
        counts += [f"{number} {word}{'s' * (number != 1)} left out"] if number else []
    counts += [] if view.sound else ["all filters broke down, the last sound values stand"]
    counts += [f"nothing new for {view.silent:.0f} s"] if view.silent >= 1.0 else []
    return f"{view.name}, {view.time:.2f} s, {', '.join(counts)}"


def _weights(view: View) -> str:
    """Return the delays with a weight that is not negligible."""
    cells = [
        f"{1000.0 * delay:g}: {weight:.2f}"
        for delay, weight in zip(view.delays, view.weights, strict=True)
        if weight >= 0.005
    ]
    return f"{'probability' if view.refined else 'likelihood'} by delay, ms: " + ", ".join(cells)


# ---- The comparison as a table and as content of comparison.json


def differences_table(content: Mapping[str, Any]) -> Block | None:
    """Return a table of the last estimate beside the reference, with the differences; None without
    a reference. ``content`` is the content of ``comparison.json``.
    """
    reference = content.get("reference")
    if reference is None:
        return None
    rows = reference["differences"]
    estimated = {**content.get("parameters", {}), **content.get("derived", {})}
    return table(
        f"The last estimate against {reference['study']}",
        (Column("quantity"), [_word(row["name"]) for row in rows]),
        (
            Column("estimate ± σ", BY_ROW),
            [
                estimate(entry["estimate"], entry["std"]) if entry else MISSING
                for entry in (estimated.get(row["name"]) for row in rows)
            ],
        ),
        (
            Column("reference ± σ", BY_ROW),
            [estimate(row["reference"], row["reference_std"]) for row in rows],
        ),
        (Column("difference", "σ"), [Number(row["sigmas"], digits=1, signed=True) for row in rows]),
        (Column("remark"), ["outside" if row["outside"] else "" for row in rows]),
        units=[row["unit"] for row in rows],
    )


def reference_content(reference: Reference, items: Sequence[CrossValidation]) -> dict[str, Any]:
    """Return the reference and the quantities that differ from it, for ``comparison.json``."""
    differences = [
        {
            "name": item.name,
            "unit": item.unit,
            "reference": item.reference[0],
            "reference_std": item.reference[1],
            "sigmas": item.z,
            "outside": item.beyond,
        }
        for item in items
        if item.reference is not None and item.z is not None
    ]
    return {
        "study": resolved(Path(reference.name)).name,
        "differences": differences,
        "outside": [row["name"] for row in differences if row["outside"]],
    }


# ---- The delays of the bank

REFINED_DELAYS = (
    "Probability of each delay by the refined estimate, as the terminal prints it: that the delay "
    "is nearest to this one"
)
BANK_DELAYS = (
    "Before the refinement: likelihood of each delay by the filters of the bank, which is not that "
    "of the refined estimate"
)
BANK_ALONE = "Likelihood of each delay by the filters of the bank"


def delay_tables(content: Mapping[str, Any]) -> list[Block]:
    """Return the table of the refined estimate's delays, if there is one, and that of the bank."""
    bank = content["bank"]
    if "refined" not in bank:
        return [_delay_table(BANK_ALONE, "likelihood", bank["delays"], bank["weights"])]
    return [
        _delay_table(REFINED_DELAYS, "probability", bank["delays"], bank["refined"]),
        _delay_table(BANK_DELAYS, "likelihood", bank["delays"], bank["weights"]),
    ]


def _delay_table(
    caption: str, what: str, delays: Sequence[float], weights: Sequence[float]
) -> Block:
    """Return a table with the weight of each delay, ms, with the digits of the terminal."""
    ms = [1000.0 * float(delay) for delay in delays]
    return table(
        caption,
        (Column("delay", "ms"), [Number(each, shown=f"{each:g}") for each in ms]),
        (Column(what, PURE), [Number(float(w), shown=f"{w:.2f}") for w in weights]),
    )
