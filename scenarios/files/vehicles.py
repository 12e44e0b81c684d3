"""Vehicle files: constants and starting values of one vehicle for one model, in SI units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from sim.errors import DeclarationError

_MODAL_START = re.compile(r"(?:C[Lm]_eta(?:dot)?(\d+)|Ceta(\d+)_\w+)")


@dataclass(frozen=True)
class VehicleFile:
    """What a vehicle file says.

    Attributes
    ----------
    name : the vehicle's name; the file's where it gives none.
    model : the model it was read for.
    constants : held values in SI. rigid and flexible: ``mass``, ``wing_area``, ``chord``, ``pitch_inertia``, ``airspeed``,
        ``air_density``; loes: ``airspeed``, ``gravity`` and, if given, ``vane_arm`` (m, ahead of the c.g.);
        ballistic: ``air_density_reference``, ``density_scale_height``, ``gravity``.
    derivatives : starting values in SI, per radian (loes: per unit of the stick).
    modes : for flexible, (number from 1, values) with ``frequency`` rad/s, ``damping``, ``generalized_mass`` kg m2 and the
        starts ``CL_eta1 CL_etadot1 Cm_eta1 Cm_etadot1 Ceta1_alpha Ceta1_q Ceta1_de Ceta1_eta1 Ceta1_etadot1`` of that mode, and
        the couplings ``Ceta1_eta2 ...`` that the file gives.
    """

    name: str
    model: str
    constants: Mapping[str, float]
    derivatives: Mapping[str, float]
    modes: tuple[tuple[int, dict[str, float]], ...] = field(default=())


def read_vehicle(path: str | Path, model: str) -> VehicleFile:
    """A vehicle file for one of the models ``rigid``, ``flexible``, ``loes``, ``ballistic``.

    A value is a number in SI units or a text with a unit, ``"24200 lb"``. The starts of an elastic mode stand in its
    ``[[modes]]`` table; under ``[derivatives]`` they serve as well.

    Raises
    ------
    DeclarationError : one line with file, key and remedy: no such file, not TOML, an unknown or missing key, a value of
        the wrong kind, unit or sign.
    """
    from scenarios.files.declarations import checked, read_toml
    from scenarios.files.vehicles_schema import MODELS, mode_schema

    if model not in MODELS:
        raise DeclarationError(f"there is no model {model!r}", where=str(path), remedy=f"use one of {', '.join(MODELS)}")
    content = read_toml(path)
    tables: list[dict[str, Any]] = []
    if model == "flexible":
        tables = _mode_tables(content, path)
        content = {**content, "modes": tables}
    vehicle = checked(MODELS[model], content, path).model_dump(exclude_none=True)
    modes = []
    for number, table in enumerate(tables, start=1):
        values = checked(mode_schema(number, len(tables)), table, path, f"modes[{number}]").model_dump(exclude_none=True)
        modes.append((number, values))
    constants = {key: value for key, value in vehicle.items() if key not in ("name", "derivatives", "modes")}
    return VehicleFile(vehicle.get("name", Path(path).stem), model, constants, vehicle["derivatives"], tuple(modes))


def _mode_tables(content: dict[str, Any], path: str | Path) -> list[dict[str, Any]]:
    """The ``[[modes]]`` tables, with the modal starts that stand under ``[derivatives]`` moved into them."""
    modes = content.get("modes")
    if not isinstance(modes, list) or not modes or not all(isinstance(mode, dict) for mode in modes):
        raise DeclarationError("no elastic mode", where=f"{path}, key modes", remedy="add a [[modes]] table for each mode, or use the rigid model")
    tables = [dict(mode) for mode in modes]
    derivatives = content.get("derivatives")
    if isinstance(derivatives, dict):
        kept = {}
        for key, value in derivatives.items():
            found = _MODAL_START.fullmatch(key)
            number = int(found[1] or found[2]) if found else 0
            if not 1 <= number <= len(tables):
                kept[key] = value
                continue
            if key in tables[number - 1]:
                raise DeclarationError(
                    f"given twice, also under modes[{number}]", where=f"{path}, key derivatives.{key}", remedy="keep one of the two"
                )
            tables[number - 1][key] = value
        content["derivatives"] = kept
    return tables
