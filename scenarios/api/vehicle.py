"""A vehicle in Python: from a file, from the library, or from numbers, with the keys of vehicle
files.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from scenarios.api import tables as html
from scenarios.files.declarations import read_toml_source, toml_of
from scenarios.files.sources import InputFile, Source
from sim.errors import DeclarationError
from sim.vehicles.factory import FAMILIES, MODE_CONSTANTS, mode_units
from sim.vehicles.library import VehicleData, read_parameter_set, vehicle_names

FILE_KEYS = {"omega": "frequency", "zeta": "damping", "generalized_mass": "generalized_mass"}


@dataclass(frozen=True, eq=False, repr=False)
class Vehicle:
    """Constants and starting values of one vehicle, as a vehicle file has them.

    Attributes
    ----------
    content : the keys of a vehicle file and their values; ``vehicle["mass"]`` is one of them.
    source : the file as it was read; None of one that was put together in Python.
    """

    content: Mapping[str, Any]
    source: Source | None = None

    @property
    def name(self) -> str:
        """Its name, else its file's."""
        return str(
            self.content.get(
                "name", self.source.path.stem if self.source is not None else "vehicle"
            )
        )

    @property
    def derivatives(self) -> dict[str, Any]:
        """Where the search starts."""
        return dict(self.content.get("derivatives", {}))

    def __getitem__(self, key: str) -> Any:
        for table in (self.content, self.derivatives):
            if key in table:
                return table[key]
        raise KeyError(f"there is no {key!r}: {', '.join((*self.content, *self.derivatives))}")

    def to_toml(self) -> str:
        """The text of its file."""
        return (
            self.source.content.decode("utf-8-sig")
            if self.source is not None
            else toml_text(self.content)
        )

    def save(self, path: str | PathLike[str]) -> Path:
        """Write it as a vehicle file; returns the path."""
        Path(path).write_text(self.to_toml(), encoding="utf-8", newline="\n")
        return Path(path)

    def source_for(self, model: str) -> Source:
        """What a command would read of it for a model: elastic modes go where the model has
        none.
        """
        if self.source is not None:
            return self.source
        content = dict(self.content)
        if "modes" in content and model == "rigid":
            del content["modes"]
        raw = toml_text(content).encode()
        return Source(Path(self.name), raw, InputFile(self.name, hashlib.sha256(raw).hexdigest()))

    def __repr__(self) -> str:
        derivatives = ", ".join(list(self.derivatives)[:6]) + (
            ", ..." if len(self.derivatives) > 6 else ""
        )
        return (
            f"<Vehicle {self.name}: {len(self.content)} entries, starts of "
            f"{derivatives or 'nothing'}>"
        )

    def _repr_html_(self) -> str:
        flat = [
            (key, _shown(value))
            for key, value in self.content.items()
            if not isinstance(value, Mapping | list)
        ]
        tables = [
            (name, inner) for name, inner in self.content.items() if isinstance(inner, Mapping)
        ]
        starts = [
            (f"{name}.{key}", _shown(value))
            for name, inner in tables
            for key, value in inner.items()
        ]
        return html.page(self.name, html.table(("key", "value"), [*flat, *starts]))


def vehicle(
    source: str | PathLike[str] | Mapping[str, Any] | Vehicle | None = None, /, **numbers: Any
) -> Vehicle:
    """A vehicle from a file, from the library by its name (``vehicles()`` lists them), or from
    numbers.

    ``numbers`` are keys of a vehicle file, ``mass=24200.0`` or ``mass="53352 lb"``,
    ``derivatives={"CL_alpha": 4.0, ...}``; beside a source they replace its own, key by key,
    derivatives each by itself. What a model needs is checked where the vehicle is used with it.

    Raises
    ------
    InputError : there is no such file or vehicle, or it is no TOML.
    """
    if isinstance(source, Vehicle) and not numbers:
        return source
    if source is None:
        return Vehicle(numbers)
    if isinstance(source, Vehicle | Mapping):
        content = source.content if isinstance(source, Vehicle) else source
        return Vehicle(_over(content, numbers))
    path = _path_of(source)
    if (
        isinstance(source, str)
        and not source.endswith(".toml")
        and "/" not in source
        and not path.is_file()
    ):
        return Vehicle(_over(_of_library(source), numbers))
    read = read_toml_source(path)
    content = toml_of(read)
    return Vehicle(_over(content, numbers)) if numbers else Vehicle(content, read)


def _path_of(given: Any) -> Path:
    if not isinstance(given, str | PathLike):
        remedy = "give a file's path, a name of the library, or its numbers"
        raise DeclarationError(
            f"a {type(given).__name__} is no vehicle", where="vehicle", remedy=remedy
        )
    return Path(given)


def source_of(given: Any, model: str) -> Source | None:
    """What a request takes for the vehicle that a caller gave; None where he gave none."""
    if given is None:
        return None
    return vehicle(given).source_for(model)


def toml_text(content: Mapping[str, Any]) -> str:
    """A vehicle file's text: plain keys first, then tables, then lists of tables. Raises
    DeclarationError for a value that TOML does not have.
    """
    plain = [
        f"{_key(key)} = {toml_value(value, key)}"
        for key, value in content.items()
        if not _is_table(value)
    ]
    out = ["\n".join(plain)]
    for key, value in content.items():
        if isinstance(value, Mapping):
            out.append(
                "\n".join(
                    [
                        f"[{_key(key)}]",
                        *(
                            f"{_key(name)} = {toml_value(each, f'{key}.{name}')}"
                            for name, each in value.items()
                        ),
                    ]
                )
            )
        elif _is_table(value):
            out += [
                "\n".join(
                    [
                        f"[[{_key(key)}]]",
                        *(
                            f"{_key(name)} = {toml_value(each, name)}"
                            for name, each in item.items()
                        ),
                    ]
                )
                for item in value
            ]
    return "\n\n".join(part for part in out if part) + "\n"


def _of_library(name: str) -> dict[str, Any]:
    if name not in vehicle_names():
        remedy = f"name a file that ends in .toml, or one of {', '.join(vehicle_names())}"
        raise DeclarationError(f"there is no vehicle {name!r}", where="vehicle", remedy=remedy)
    return content_of(read_parameter_set(name))


def content_of(data: VehicleData) -> dict[str, Any]:
    """A vehicle of the library with the keys of a vehicle file."""
    _, constants, derivatives = FAMILIES[data.equations]
    values = {number.name: number.value for number in data.numbers}
    out: dict[str, Any] = {
        "name": data.name,
        **{key: values[key] for key in constants if key in values},
    }
    if (
        "reference_airspeed" in constants
        and "reference_airspeed" not in out
        and "airspeed" in values
    ):
        out["reference_airspeed"] = values["airspeed"]
    out["derivatives"] = {key: values[key] for key in derivatives if key in values}
    if data.modes:
        out["modes"] = [_mode(values, number, data.modes) for number in range(1, data.modes + 1)]
    return out


def _mode(values: Mapping[str, float], number: int, modes: int) -> dict[str, float]:
    """The ``[[modes]]`` table of one elastic mode."""
    constants = {
        f"{local}{number}": key for local, key in FILE_KEYS.items() if local in MODE_CONSTANTS
    }
    own = [
        name
        for name, _, _ in mode_units(modes)
        if name.startswith((f"CL_eta{number}", f"CL_etadot{number}", f"Cm_eta{number}"))
    ]
    own += [
        name
        for name, _, _ in mode_units(modes)
        if name.startswith((f"Cm_etadot{number}", f"Ceta{number}_"))
    ]
    return {
        **{key: values[name] for name, key in constants.items()},
        **{name: values[name] for name in own if name in values},
    }


def _over(content: Mapping[str, Any], numbers: Mapping[str, Any]) -> dict[str, Any]:
    """The content with ``numbers`` in the place of its own; tables are replaced key by key."""
    merged = {
        key: {**content[key], **value}
        if isinstance(value, Mapping) and isinstance(content.get(key), Mapping)
        else value
        for key, value in numbers.items()
    }
    return {**content, **merged}


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list | tuple)
        and bool(value)
        and all(isinstance(item, Mapping) for item in value)
    )


def _key(key: Any) -> str:
    text = str(key)
    return (
        text
        if text.isascii() and text.replace("_", "").replace("-", "").isalnum()
        else _quoted(text)
    )


def toml_value(value: Any, key: Any) -> str:
    """A value as TOML writes it; ``key`` names it in errors."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _quoted(value)
    if isinstance(value, Mapping):
        return (
            "{"
            + ", ".join(f"{_key(name)} = {toml_value(each, name)}" for name, each in value.items())
            + "}"
        )
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(each, key) for each in value) + "]"
    if isinstance(value, int):
        return str(value)
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise DeclarationError(
            f"a {type(value).__name__} is no value",
            where=f"key {key}",
            remedy="give a number or a text",
        ) from None
    return (
        repr(number)
        if math.isfinite(number)
        else {math.inf: "inf", -math.inf: "-inf"}.get(number, "nan")
    )


def _quoted(text: str) -> str:
    """A basic string: as JSON writes it, but for one letter that JSON does not escape."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _shown(value: Any) -> str:
    return f"{value:.7g}" if isinstance(value, float) else str(value)
