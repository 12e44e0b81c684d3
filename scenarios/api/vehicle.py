"""A vehicle in Python: from a file, from the library, or from numbers, with the keys of vehicle
files.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.api import tables as html
from scenarios.files.declarations import read_toml_source, toml_of
from scenarios.files.library_vehicles import (
    content_of_library,
    is_library_name,
    source_of_content,
    toml_text,
)
from scenarios.files.sources import Source
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.api.vehicle_parameters import VehicleParameters


@dataclass(eq=False, repr=False)
class Vehicle:
    """Constants and starting values of one vehicle, as a vehicle file has them.

    ``vehicle.parameters["Cm_q"]`` is fixed, bounded, tied or freed by its methods, which change
    this vehicle.

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

    @property
    def parameters(self) -> VehicleParameters:
        """What may be estimated, by name: ``vehicle.parameters["Cm_q"].fix(-28.0)``."""
        from scenarios.api.vehicle_parameters import VehicleParameters

        return VehicleParameters(self)

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
        return source_of_content(self.name, self.content, model)

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
    if is_library_name(source):
        return Vehicle(_over(content_of_library(str(source)), numbers))
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


def _over(content: Mapping[str, Any], numbers: Mapping[str, Any]) -> dict[str, Any]:
    """The content with ``numbers`` in the place of its own; tables are replaced key by key."""
    merged = {
        key: {**content[key], **value}
        if isinstance(value, Mapping) and isinstance(content.get(key), Mapping)
        else value
        for key, value in numbers.items()
    }
    return {**content, **merged}


def _shown(value: Any) -> str:
    return f"{value:.7g}" if isinstance(value, float) else str(value)
