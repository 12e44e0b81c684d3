"""The catalogue of scenarios, one TOML file each; users' scenario files by their paths."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scenarios.files.declarations import read_toml, refuse_unknown
from scenarios.files.sources import DocumentError, toml_value
from sim.errors import DeclarationError

if TYPE_CHECKING:
    from scenarios.studies.declaration import Scenario

IDENTIFICATION = "identification"
KINDS = (IDENTIFICATION, "trace", "x29", "sweep", "jsbsim")
# Scenario names of earlier versions -> what replaces them in `exam`, which is not installed.
EXAMINATIONS = {
    "false-alarms": "false-alarms",
    "clean-models": "clean",
    "weak-effects": "weak-effects",
    "random-papers": "random",
    "every-effect": "every-effect",
}
SURROGATE = "standin"  # kind and prefix of surrogate flights in earlier versions
FOLDER = files("scenarios").joinpath("catalog")


def scenario_names(kind: str | None = None) -> tuple[str, ...]:
    """Return the names of the built-in scenarios, sorted: all, or those of one kind."""
    file_names = (entry.name for entry in FOLDER.iterdir())
    names = sorted(name.removesuffix(".toml") for name in file_names if name.endswith(".toml"))
    return tuple(name for name in names if kind is None or scenario_kind(name) == kind)


def scenario_kind(name: str) -> str:
    """Return the kind of a scenario, from the key ``kind`` of its file: ``IDENTIFICATION`` without
    the key. ``name``: a name or a path as in ``load_document``.
    """
    document, _, where = load_document(name)
    kind = str(document.get("kind", IDENTIFICATION))
    if kind == SURROGATE:
        raise moved(f"a scenario of kind {kind!r}", "surrogate", where)
    refuse_unknown("kind", kind, KINDS, f"{where}, key kind")
    return kind


def scenario_title(name: str) -> str:
    """Return the one line that describes a built-in scenario."""
    return str(tomllib.loads(_catalogue_text(name))["title"])


def scenario_text(name: str) -> str:
    """Return the text of a built-in scenario's file. Raises DeclarationError if there is none."""
    if name in EXAMINATIONS:
        raise moved(name, EXAMINATIONS[name])
    if name.startswith(f"{SURROGATE}-"):
        raise moved(name, f"surrogate {name.replace(SURROGATE, 'surrogate', 1)}")
    refuse_unknown("scenario", name, scenario_names(), "flightid")
    return _catalogue_text(name)


def _catalogue_text(name: str) -> str:
    return FOLDER.joinpath(f"{name}.toml").read_text(encoding="utf-8")


def scenario_file(name: str) -> str:
    """Return the name of a scenario's file in messages: the user's path, or NAME.toml."""
    return name if name.endswith(".toml") else f"{name}.toml"


def load_scenario(name: str, changes: Sequence[str] = ()) -> Scenario:
    """Return a built-in scenario by its name, or a user's by the path of its TOML file.

    Parameters
    ----------
    name : ``"rigid"`` or ``"my_study.toml"``.
    changes : ``"key=value"`` texts that replace entries of the file, e.g. ``"flight.rate=50"``.

    Raises
    ------
    DeclarationError : there is no such scenario, or a key or value in it is wrong; file and key are
        named.
    """
    from scenarios.studies.reading import scenario_of

    document, short, where = load_document(name, changes)
    if document.get("kind", IDENTIFICATION) != IDENTIFICATION:
        what = f"{short} is a scenario of kind {document['kind']!r}, this is for identification"
        raise DeclarationError(what, where=where, remedy="use flightid run, or another scenario")
    return scenario_of(
        {key: value for key, value in document.items() if key != "kind"}, short, where
    )


def load_document(name: str, changes: Sequence[str] = ()) -> tuple[dict[str, Any], str, str]:
    """Return the content of a scenario's file with the changes made, its short name, and its name
    in messages. Errors as ``load_scenario``.
    """
    if name.endswith(".toml"):
        document, folder, short = read_toml(name), Path(name).parent, Path(name).stem
    else:
        document, folder, short = tomllib.loads(scenario_text(name)), Path(str(FOLDER)), name
    document = _with_model_paths(document, folder)
    return with_changes(document, changes), short, scenario_file(name)


def _with_model_paths(document: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the document with the paths of user model files relative to ``folder`` resolved."""
    from scenarios.files.user_models import is_model_file

    def resolved(table: Any, key: str) -> Any:
        path = table.get(key) if isinstance(table, dict) else None
        if isinstance(path, str) and is_model_file(path):
            return {**table, key: str(folder / path)}
        return table

    out = dict(document)
    for table, key in (("flight", "vehicle"), ("estimate", "model")):
        if table in document:
            out[table] = resolved(document[table], key)
    if isinstance(document.get("methods"), list):
        out["methods"] = [resolved(method, "model") for method in document["methods"]]
    return out


def moved(what: str, examination: str, where: str = "flightid") -> DeclarationError:
    """Return the error for a study that is now in `exam`, which is not installed."""
    remedy = f"in a checkout of the source: python -m exam {examination} --help"
    return DeclarationError(f"{what} examines the tracing loop", where=where, remedy=remedy)


def with_changes(document: dict[str, Any], changes: Sequence[str]) -> dict[str, Any]:
    """Return a scenario's content with all changes; see ``with_change``."""
    for change in changes:
        document = with_change(document, change)
    return document


def with_change(document: dict[str, Any], change: str) -> dict[str, Any]:
    """Return a scenario's content with one ``"key=value"`` replaced. Raises DeclarationError."""
    from scenarios.studies.declaration import methods_without_removed, without_removed

    key, equals, text = change.partition("=")
    if not equals or not key.strip():
        raise DeclarationError(
            f"{change!r} is not key=value", where="--set", remedy="write for example flight.rate=50"
        )
    try:
        value: Any = toml_value(f"value = {text}")["value"]
    except DocumentError:
        value = text
    path = key.strip().split(".")
    changed: dict[str, Any] = _put(document, path, value, key.strip())
    if isinstance(document.get("own"), dict) and path[0] != "own":
        changed["own"] = without_removed(document["own"], document, changed)
    if path[0] in ("estimate", "methods"):
        return methods_without_removed(document, changed)
    return changed


def _put(table: Any, path: list[str], value: Any, key: str) -> Any:
    """Return a table with the entry at ``path`` replaced; list entries are numbered from 1.

    ``key``: the path as the user wrote it.
    """
    first, *rest = path
    if isinstance(table, list):
        if not (first.isascii() and first.isdigit()) or not 1 <= int(first) <= len(table):
            raise DeclarationError(
                f"{key}: there is no entry {first!r}",
                where="--set",
                remedy=f"use a number from 1 to {len(table)}",
            )
        at = int(first) - 1
        return [
            *table[:at],
            value if not rest else _put(table[at], rest, value, key),
            *table[at + 1 :],
        ]
    if not isinstance(table, dict):
        raise DeclarationError(
            f"{key}: {first!r} is no table",
            where="--set",
            remedy="name a key of the scenario's file",
        )
    return {**table, first: value if not rest else _put(table.get(first, {}), rest, value, key)}
