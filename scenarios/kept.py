"""The model of a study in its folder, with values and effects."""

from __future__ import annotations

import importlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_type_hints

from ident.tracing.diagnosis import Trained
from ident.whole_record.layout import FitSettings
from scenarios.files.sources import InputFile, json_or_none, read_json
from scenarios.files.writing import write_json
from sim.declaration.effect import Effect
from sim.declaration.proposal import Traceable
from sim.effects.library import effect_modules
from sim.errors import DeclarationError, FlightidError

# ---- Effects as plain text and back

# only effects of the library are restored by the name of their class
ROOM = "sim.effects."


def effect_content(effect: Traceable) -> dict[str, Any]:
    """Name, class and fields of an effect; of a user's own the name alone, since its class is in a
    file of the user's.
    """
    if not type(effect).__module__.startswith(ROOM):
        return {"name": effect.name, "own": True}
    return {"name": effect.name, **_object(effect)}


def effect_of(content: Mapping[str, Any], own: Sequence[Traceable], where: str) -> Traceable:
    """Return the effect that ``effect_content`` described; one of ``own`` where it was a user's.

    Raises
    ------
    DeclarationError : a user's effect that is not among ``own``, or a class that this version does
        not have.
    """
    name = str(content.get("name", ""))
    if content.get("own"):
        found = next((effect for effect in own if effect.name == name), None)
        if found is None:
            remedy = "name the file it came from with --effects"
            raise DeclarationError(
                f"{name} is an effect of a file that the study was made with",
                where=where,
                remedy=remedy,
            )
        return found
    try:
        effect: Traceable = _made(content)
        if not isinstance(effect, Effect) or effect.name != name:
            raise TypeError("its class is another's")
    except (AttributeError, ImportError, KeyError, TypeError, ValueError, FlightidError) as error:
        what = f"the effect {name or '?'} cannot be made again ({' '.join(str(error).split())})"
        raise DeclarationError(
            what, where=where, remedy="run the study again with this version"
        ) from None
    return effect


def _object(value: Any) -> dict[str, Any]:
    given = {
        item.name: getattr(value, item.name)
        for item in fields(value)
        if item.init and getattr(value, item.name) != _default(item)
    }
    return {
        "class": f"{type(value).__module__}:{type(value).__qualname__}",
        "fields": {name: _plain(each) for name, each in given.items()},
    }


def _default(item: Field[Any]) -> Any:
    return item.default_factory() if item.default_factory is not MISSING else item.default


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        return _object(value)
    if isinstance(value, Mapping):
        return {"mapping": {str(key): _plain(each) for key, each in value.items()}}
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    if not isinstance(value, str | bool | int | float):
        raise TypeError(f"a {type(value).__name__} is no plain value")
    return value


def _made(content: Mapping[str, Any]) -> Any:
    module, _, name = content["class"].partition(":")
    if not module.startswith(ROOM):
        raise ValueError(f"{module} is not of the library")
    kind = _class_of(module, name)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise TypeError(f"{name} is no effect")
    given = {key: _value(each) for key, each in content["fields"].items()}
    hints = get_type_hints(kind)
    for key, value in given.items():
        refuse_other_kind(value, hints[key])
    return kind(**given)


def _class_of(module: str, name: str) -> Any:
    """Return a class of the library by the file that had it when the study was kept, or by its name
    alone where an older version had it in another file.
    """
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError:
        homes = [each for each in effect_modules() if hasattr(each, name)]
        if not homes:
            raise
        return getattr(homes[0], name)


def _value(content: Any) -> Any:
    if isinstance(content, Mapping):
        return (
            {key: _value(each) for key, each in content["mapping"].items()}
            if "mapping" in content
            else _made(content)
        )
    return tuple(_value(each) for each in content) if isinstance(content, list) else content


def refuse_other_kind(value: Any, kind: Any) -> None:
    """Raise TypeError if a value is not of its declared type, or not finite."""
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    plain = is_dataclass(kind) and isinstance(kind, type)
    try:
        if plain and not isinstance(value, kind):
            raise TypeError(f"a {type(value).__name__} where a {kind.__name__} is due")
        if not plain:
            settings = ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False)
            TypeAdapter(kind, config=settings).validate_python(value, strict=True)
    except ValidationError as error:
        raise TypeError(f"{value!r:.40} is no {kind}: {error.errors()[0]['msg']}") from None


def refuse_other_fields(content: Mapping[str, Any], kind: type) -> None:
    """Raise TypeError if the values under the names of a dataclass's fields are not of their
    types; KeyError for a name it does not have.
    """
    hints = get_type_hints(kind)
    for key, value in content.items():
        refuse_other_kind(value, hints[key])


# ---- The stored model of a study

NAME = "model.json"
SCHEMA = "flightid/model/1"
IDENTIFY, DIAGNOSE = "identify", "diagnose"
# Types of what ``model.json`` holds, as JSON has them.
_KINDS = {
    **dict.fromkeys(("made_by", "model", "vehicle_text"), str),
    **dict.fromkeys(("biases", "spiked", "claimed"), list[str]),
    "reading": dict[str, Any],
    "weighed": bool,
    "after": dict[str, Any],
}
_TRAINED = {
    "effects": list[dict[str, Any]],
    "outputs": list[str],
    "shared": dict[str, float],
    "own": list[dict[str, float]],
    "settings": dict[str, Any],
}


@dataclass(frozen=True)
class KeptReading:
    """How the fitted records were read and prepared.

    ``hold``: of the inputs; ``by_hand``: requested by the user. ``weight``: the trim lift follows a
    measured pressure. ``flow``, ``attitude``: a measured airspeed or pitch attitude is used.
    ``rate``, ``lowpass``, ``trusted``: as in a ``Plan``; zero: none.
    """

    hold: str
    by_hand: bool = False
    weight: bool = True
    flow: bool = True
    attitude: bool = False
    rate: float = 0.0
    lowpass: float = 0.0
    trusted: bool = False


@dataclass(frozen=True, eq=False)
class KeptModel:
    """A study's model.

    Attributes
    ----------
    made_by : ``"identify"`` or ``"diagnose"``.
    model : a name of ``MODELS``, or the name of a user's model.
    vehicle, vehicle_text : name and hash of the vehicle file, and its content; None and empty for a
        user's model without one.
    own_file, effects_file : a user's model and effects, which are run only if named again.
    biases : outputs with a free bias.
    spiked : inputs with corrected spikes.
    weighed : the weight along the flight path is included, by a measured attitude.
    before, after : declared model and model with effects of a diagnosis; an identification has
        ``after`` only.
    """

    made_by: str
    model: str
    vehicle: InputFile | None
    vehicle_text: str
    own_file: InputFile | None
    reading: KeptReading
    biases: tuple[str, ...]
    after: Trained
    before: Trained | None = None
    effects_file: InputFile | None = None
    spiked: tuple[str, ...] = ()
    weighed: bool = False
    claimed: tuple[str, ...] = field(default=())


def write_kept(folder: Path, kept: KeptModel) -> None:
    """Write ``model.json`` into a folder."""
    files = {
        "vehicle": kept.vehicle,
        "model_file": kept.own_file,
        "effects_file": kept.effects_file,
    }
    write_json(
        folder / NAME,
        {
            "schema": SCHEMA,
            "made_by": kept.made_by,
            "model": kept.model,
            "files": {key: asdict(file) for key, file in files.items() if file is not None},
            "vehicle_text": kept.vehicle_text,
            "reading": asdict(kept.reading),
            "biases": list(kept.biases),
            "spiked": list(kept.spiked),
            "weighed": kept.weighed,
            "claimed": list(kept.claimed),
            "after": _trained_content(kept.after),
            **({"before": _trained_content(kept.before)} if kept.before is not None else {}),
        },
    )


@dataclass(frozen=True, eq=False)
class KeptFile:
    """A ``model.json`` that was read: which files of the user's it rests on; with these it becomes
    a ``KeptModel``.
    """

    path: Path
    content: Mapping[str, Any]

    def file(self, key: str) -> InputFile | None:
        """Name and hash of a file, by ``vehicle``, ``model_file`` or ``effects_file``; None if
        there was none.
        """
        entry = self.content["files"].get(key)
        return None if entry is None else InputFile(entry["name"], entry["sha256"])

    def model(self, own: Sequence[Traceable] = ()) -> KeptModel:
        """Return the model; ``own`` are the user's effects. Raises DeclarationError if it cannot
        be made again.
        """
        try:
            return self._made(own)
        except (AttributeError, KeyError, TypeError, ValueError):
            raise _unreadable(self.path) from None

    def _made(self, own: Sequence[Traceable]) -> KeptModel:
        c, where = self.content, str(self.path)
        for key, kind in _KINDS.items():
            refuse_other_kind(c[key], kind)
        refuse_other_fields(c["reading"], KeptReading)
        before = _trained(c["before"], own, where) if "before" in c else None
        return KeptModel(
            c["made_by"],
            c["model"],
            self.file("vehicle"),
            c["vehicle_text"],
            self.file("model_file"),
            KeptReading(**c["reading"]),
            tuple(c["biases"]),
            _trained(c["after"], own, where),
            before,
            self.file("effects_file"),
            tuple(c["spiked"]),
            c["weighed"],
            tuple(c["claimed"]),
        )


def read_kept(folder: str | Path) -> KeptFile:
    """Return the model that a study folder keeps.

    Raises
    ------
    DeclarationError : no such folder, no study in it, or one that keeps no model; the line says
        what to run.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = (
            "this is a file, not a study folder" if folder.exists() else "there is no such folder"
        )
        raise DeclarationError(
            what, where=str(folder), remedy="name the --out folder of identify or diagnose"
        )
    path = folder / NAME
    if not os.path.lexists(path):
        raise _no_model(folder)
    content = read_json(path, wanted="the --out folder of identify or diagnose")
    if (
        not isinstance(content, dict)
        or content.get("schema") != SCHEMA
        or not _says_its_files(content)
    ):
        raise _unreadable(path)
    return KeptFile(path, content)


def _says_its_files(content: Mapping[str, Any]) -> bool:
    """Return whether a model says what it was declared with, in texts: this is read before its
    parameters are.
    """
    files = content.get("files")
    if not isinstance(files, dict) or not all(
        isinstance(content.get(key), str) for key in ("made_by", "model", "vehicle_text")
    ):
        return False
    return all(
        isinstance(each, dict) and all(isinstance(each.get(key), str) for key in ("name", "sha256"))
        for each in files.values()
    )


def _unreadable(path: Path) -> DeclarationError:
    return DeclarationError(
        "this is no model that can be read here", where=str(path), remedy="run the study again"
    )


def _no_model(folder: Path) -> DeclarationError:
    """Return the error for a folder without a model, with the command to run: the study again, or
    an identification of its record.
    """
    if (folder / "diagnosis.json").is_file():
        return DeclarationError(
            "this diagnosis keeps no model",
            where=str(folder),
            remedy="run flightid diagnose again with this --out",
        )
    comparison = json_or_none(folder / "comparison.json")
    scenario = comparison.get("scenario") if isinstance(comparison, dict) else None
    if not isinstance(comparison, dict):
        return DeclarationError(
            "there is no study in this folder",
            where=str(folder),
            remedy="name the --out folder of identify or diagnose",
        )
    if scenario == IDENTIFY:
        return DeclarationError(
            "this study keeps no model",
            where=str(folder),
            remedy="run flightid identify again with this --out",
        )
    remedy = (
        f"identify its record first: flightid identify {folder / 'record.csv'} --model M --vehicle "
        "V.toml --out FIT"
    )
    return DeclarationError(
        "a study of a simulated flight keeps no model to predict with",
        where=str(folder),
        remedy=remedy,
    )


def _trained_content(trained: Trained) -> dict[str, Any]:
    return {
        "effects": [effect_content(effect) for effect in trained.effects],
        "outputs": list(trained.outputs),
        "shared": dict(trained.shared),
        "own": [dict(each) for each in trained.own],
        "settings": asdict(trained.settings),
    }


def _trained(content: Mapping[str, Any], own: Sequence[Traceable], where: str) -> Trained:
    for key, kind in _TRAINED.items():
        refuse_other_kind(content[key], kind)
    refuse_other_fields(content["settings"], FitSettings)
    effects = tuple(effect_of(each, own, where) for each in content["effects"])
    return Trained(
        effects,
        tuple(content["outputs"]),
        content["shared"],
        tuple(content["own"]),
        FitSettings(**content["settings"]),
    )
