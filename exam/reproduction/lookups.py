"""Numbers of study folders by their places, ``SCENARIO/METHOD: PATH``, and the file with those of
the page.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from sim.errors import DeclarationError

SCHEMA = "flightid/reproduction-numbers/1"
# significant ones that are kept: more than the page shows, fewer than another processor moves
DIGITS = 6
SETTLED = 2.0  # largest deviation of a settled estimate from its final value, in final sigmas


@dataclass(frozen=True)
class Found:
    """A number of a study with its standard deviation (None without one) and unit (empty if
    unknown).
    """

    value: float
    std: float | None = None
    unit: str = ""


Numbers = Callable[[str], Found]


def split(lookup: str) -> tuple[str, str, str]:
    """Return scenario, method (empty for the main one) and path of ``SCENARIO/METHOD: PATH``.
    Raises DeclarationError.
    """
    study, colon, path = lookup.partition(": ")
    scenario, _, method = study.partition("/")
    if not colon or not scenario or not path:
        raise DeclarationError(
            f"{lookup!r} is not STUDY: PATH",
            where="reproduction",
            remedy="write for example rigid: CL_alpha.true",
        )
    return scenario, method, path


def number_in(folder: Path, method: str, path: str) -> Found:
    """A number of a study folder.

    ``NAME`` is a parameter or a derived quantity with its sigma, ``NAME.true`` an entry of it,
    ``correlation.A.B`` a correlation, ``files.NAME`` 1 if the study has that file,
    ``record.CHANNEL.peak`` the largest size of a recorded channel, ``record.rate`` samples a
    second, ``history.settled`` the time after which every parameter of the filter stays within two
    final sigmas of its final value, ``truth.PATH`` a number of ``truth.json``; any other path is
    that of ``comparison.json``, entries of lists by number or by ``name=VALUE``. ``PATH^2`` is a
    number squared, without a sigma.

    Raises
    ------
    LookupError : there is no such number.
    """
    if path.endswith("^2"):
        return Found(number_in(folder, method, path.removesuffix("^2")).value ** 2)
    content = _content(folder / "comparison.json")
    base = (
        content
        if not method
        else content["plain"]
        if method == "plain"
        else _method(content["methods"], method)
    )
    first, _, rest = path.partition(".")
    if first == "files":
        return (
            Found(1.0) if rest in content["files"] and (folder / rest).is_file() else _absent(path)
        )
    if first == "truth":
        return _found(_walk(_content(folder / "truth.json"), rest))
    if first == "record":
        return _recorded(_columns(folder / "record.csv"), rest)
    if first == "history":
        return Found(settling_time(folder / "history.csv", tuple(content["parameters"])), None, "s")
    if first == "correlation":
        return Found(_correlation(base["correlation"], *rest.split(".")))
    for table in ("parameters", "derived"):
        if first in base.get(table, {}):
            entry = base[table][first]
            return (
                _found(_walk(entry, rest), entry.get("unit", ""))
                if rest
                else Found(entry["estimate"], entry.get("std"), entry.get("unit", ""))
            )
    return _found(_walk(base, path))


@cache
def _content(path: Path) -> Any:
    return json.loads(path.read_text(encoding="utf-8"))


def _method(methods: Any, name: str) -> Any:
    """Return one of a study's further methods, by name or from a list."""
    return (
        next(each for each in methods if each["name"] == name)
        if isinstance(methods, list)
        else methods[name]
    )


def _absent(path: str) -> Found:
    raise LookupError(path)


def _found(value: Any, unit: str = "") -> Found:
    if isinstance(value, dict) and "estimate" in value:
        return Found(float(value["estimate"]), value.get("std"), value.get("unit", unit))
    return Found(float(value), None, unit)


def _walk(content: Any, path: str) -> Any:
    for step in path.split("."):
        if isinstance(content, list):
            key, equals, value = step.partition("=")
            content = (
                next(each for each in content if str(each[key]) == value)
                if equals
                else content[int(step)]
            )
        else:
            content = content[step]
    return content


def _correlation(table: Mapping[str, Any], a: str, b: str) -> float:
    if "matrix" in table:
        return float(table["matrix"][table["names"].index(a)][table["names"].index(b)])
    return float(table[a][b])


def _columns(path: Path) -> dict[str, np.ndarray]:
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


def _recorded(columns: Mapping[str, np.ndarray], what: str) -> Found:
    if what == "rate":
        time = columns["time"]
        return Found((len(time) - 1) / float(time[-1] - time[0]), None, "Hz")
    channel, _, kind = what.partition(".")
    return Found(float(np.abs(columns[channel]).max())) if kind == "peak" else _absent(what)


def settling_time(path: Path, names: Iterable[str]) -> float:
    """Time (s) after which every named column of a history stays within ``SETTLED`` of its final
    sigmas of its final value.
    """
    columns, last = _columns(path), 0.0
    time = columns["time"]
    for name in names:
        if f"std_{name}" in columns:
            away = np.abs(columns[name] - columns[name][-1]) > SETTLED * columns[f"std_{name}"][-1]
            last = max(last, float(time[np.flatnonzero(away)[-1]]) if away.any() else 0.0)
    return last


def from_studies(folder_of: Callable[[str], Path]) -> Numbers:
    """Return a function of the numbers of study folders, by the folder of each scenario."""

    def of(lookup: str) -> Found:
        scenario, method, path = split(lookup)
        try:
            found = number_in(folder_of(scenario), method, path)
        except (LookupError, StopIteration, TypeError, ValueError):
            what = f"the study has no {path}{f' of {method}' if method else ''}"
            raise DeclarationError(
                what, where=scenario, remedy="see its comparison.json and files"
            ) from None
        return Found(
            _rounded(found.value), None if found.std is None else _rounded(found.std), found.unit
        )

    return of


def _rounded(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError(value)
    return float(f"{value:.{DIGITS}g}")


def from_file(path: Path) -> Numbers:
    """Return a function of the numbers in a file. Raises DeclarationError for a missing one."""
    kept = json.loads(path.read_text(encoding="utf-8"))["numbers"]

    def of(lookup: str) -> Found:
        if lookup not in kept:
            raise DeclarationError(
                f"{lookup} is not kept",
                where=str(path),
                remedy="make the page again: python -m exam papers-page",
            )
        value, std, unit = kept[lookup]
        return Found(value, std, unit)

    return of


def keeping(numbers: Numbers, kept: dict[str, Found]) -> Numbers:
    """Return the same function, which also puts each requested number into ``kept``."""

    def of(lookup: str) -> Found:
        kept[lookup] = kept[lookup] if lookup in kept else numbers(lookup)
        return kept[lookup]

    return of


def kept_text(kept: Mapping[str, Found]) -> str:
    """Return the text of the file of the page's numbers: one line each, sorted."""
    lines = [
        f"  {json.dumps(key)}: {json.dumps([kept[key].value, kept[key].std, kept[key].unit])}"
        for key in sorted(kept)
    ]
    return f'{{"schema": "{SCHEMA}", "numbers": {{\n' + ",\n".join(lines) + "\n}}\n"
