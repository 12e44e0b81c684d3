"""Library vehicles as vehicle files, so that a name can replace a file."""

from __future__ import annotations

import difflib
import hashlib
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scenarios.files.declarations import read_toml_source
from scenarios.files.sources import InputFile, Source
from sim.errors import DeclarationError
from sim.vehicles.factory import FAMILIES, MODE_CONSTANTS, mode_units
from sim.vehicles.library import VehicleData, read_parameter_set, vehicle_names

LONGEST = 60  # letters of a name of the library
FILE_KEYS = {"omega": "frequency", "zeta": "damping", "generalized_mass": "generalized_mass"}

# ---- A name or a file


def is_library_name(given: str | Path | Any) -> bool:
    """Whether a text can only be a library name: a plain word, and no existing file."""
    text = str(given)
    return text.isidentifier() and len(text) <= LONGEST and not os.path.lexists(text)


def vehicle_source(given: str | Path | Source, model: str = "") -> Source:
    """A vehicle file as it is, or the file of a library vehicle.

    Parameters
    ----------
    given : path of a vehicle file, a name of ``flightid vehicles``, or a file that was read.
    model : for which it is read; the rigid model takes no elastic modes of a vehicle.

    Raises
    ------
    DeclarationError
        There is no such file or vehicle.
    """
    if isinstance(given, Source):
        return given
    if not is_library_name(given):
        return read_toml_source(given)
    name = str(given)
    return source_of_content(name, content_of_library(name), model)


def source_of_content(name: str, content: Mapping[str, Any], model: str) -> Source:
    """A vehicle file from its content, without elastic modes if the model is rigid."""
    used = {key: value for key, value in content.items() if key != "modes" or model != "rigid"}
    raw = toml_text(used).encode()
    return Source(Path(name), raw, InputFile(name, hashlib.sha256(raw).hexdigest()))


def content_of_library(name: str) -> dict[str, Any]:
    """Content of the vehicle file of a library vehicle. Raises DeclarationError."""
    names = vehicle_names()
    if name not in names:
        near = difflib.get_close_matches(name, names, 3) or list(names)
        raise DeclarationError(
            f"there is no vehicle {name!r}",
            where="vehicle",
            remedy=f"name a file that ends in .toml, or one of the library: {', '.join(near)}",
        )
    return content_of(read_parameter_set(name))


def content_of(data: VehicleData) -> dict[str, Any]:
    """A library vehicle with the keys of a vehicle file."""
    _, constants, derivatives = FAMILIES[data.equations]
    values = {number.name: number.value for number in data.numbers}
    out: dict[str, Any] = {
        "name": data.name,
        **({"aircraft_class": data.aircraft_class} if data.aircraft_class else {}),
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


# ---- TOML


def toml_text(content: Mapping[str, Any]) -> str:
    """Text of a vehicle file: plain keys first, then tables, then lists of tables.

    Raises DeclarationError for a value that TOML does not have.
    """
    lines = [
        f"{_key(key)} = {toml_value(value, key)}"
        for key, value in content.items()
        if not _is_table(value)
    ]
    out = ["\n".join(lines)]
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
