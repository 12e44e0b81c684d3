"""The model that a study stores in its folder as ``model.json``, with values and effects."""

from __future__ import annotations

import importlib
import os
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, asdict, dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, get_type_hints

from ident.tracing.diagnosis import Trained
from ident.whole_record.layout import FitSettings
from scenarios.files.sources import InputFile, json_or_none, read_json, read_source
from scenarios.files.user_models import OwnModel
from scenarios.files.vehicles import AIRCRAFT, VehicleFile, read_vehicle
from scenarios.files.writing import write_json, write_text
from sim.declaration.effect import Effect
from sim.declaration.proposal import Traceable
from sim.effects.library import effect_modules
from sim.errors import DeclarationError, FlightidError

# ---- Effects as the content of a JSON file, and back

# Package of the effects of the library. Only their classes are restored by name: a file must not
# make the program import others.
EFFECTS_PACKAGE = "sim.effects."


def effect_content(effect: Traceable) -> dict[str, Any]:
    """Return name, class and fields of an effect.

    A user effect has its name only, because its class is in a file of the user.
    """
    if not type(effect).__module__.startswith(EFFECTS_PACKAGE):
        return {"name": effect.name, "own": True}
    return {"name": effect.name, **_object_content(effect)}


def effect_of(content: Mapping[str, Any], own: Sequence[Traceable], where: str) -> Traceable:
    """Return the effect of a content that ``effect_content`` returned.

    Parameters
    ----------
    content : the content.
    own : user effects, among which a user effect is found by its name.
    where : file of the content, for messages.

    Raises
    ------
    DeclarationError : a user effect is not among ``own``, or this version has no such class.
    """
    name = str(content.get("name", ""))
    if content.get("own"):
        user_effect = next((effect for effect in own if effect.name == name), None)
        if user_effect is None:
            raise DeclarationError(
                f"{name} is an effect of a file that the study was made with",
                where=where,
                remedy="name the file it came from with --effects",
            )
        return user_effect
    try:
        effect: Traceable = _object_of(content)
        if not isinstance(effect, Effect) or effect.name != name:
            raise TypeError("its class is that of another effect")
    except (AttributeError, ImportError, KeyError, TypeError, ValueError, FlightidError) as error:
        what = f"the effect {name or '?'} cannot be made again ({' '.join(str(error).split())})"
        raise DeclarationError(
            what, where=where, remedy="run the study again with this version"
        ) from None
    return effect


def _object_content(value: Any) -> dict[str, Any]:
    """Return the class of a dataclass instance, and its fields that differ from their defaults."""
    changed_fields = {
        item.name: getattr(value, item.name)
        for item in fields(value)
        if item.init and getattr(value, item.name) != _default(item)
    }
    return {
        "class": f"{type(value).__module__}:{type(value).__qualname__}",
        "fields": {name: _value_content(each) for name, each in changed_fields.items()},
    }


def _default(item: Field[Any]) -> Any:
    return item.default_factory() if item.default_factory is not MISSING else item.default


def _value_content(value: Any) -> Any:
    """Return a field's value as JSON has it; `_value_of` returns the value again."""
    if is_dataclass(value) and not isinstance(value, type):
        return _object_content(value)
    if isinstance(value, Mapping):
        return {"mapping": {str(key): _value_content(each) for key, each in value.items()}}
    if isinstance(value, tuple | list):
        return [_value_content(each) for each in value]
    if not isinstance(value, str | bool | int | float):
        raise TypeError(f"a {type(value).__name__} is no plain value")
    return value


def _object_of(content: Mapping[str, Any]) -> Any:
    """Return the instance of a library class from the content of `_object_content`."""
    module, _, name = content["class"].partition(":")
    if not module.startswith(EFFECTS_PACKAGE):
        raise ValueError(f"{module} is not of the library")
    kind = _class_of(module, name)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        raise TypeError(f"{name} is no effect")
    values = {key: _value_of(each) for key, each in content["fields"].items()}
    hints = get_type_hints(kind)
    for key, value in values.items():
        refuse_wrong_kind(value, hints[key])
    return kind(**values)


def _class_of(module: str, name: str) -> Any:
    """Return a class of the library by its module and name.

    A study of an older version may name a module that does not exist; then the class is found by
    its name alone.
    """
    try:
        return getattr(importlib.import_module(module), name)
    except ModuleNotFoundError:
        modules = [each for each in effect_modules() if hasattr(each, name)]
        if not modules:
            raise
        return getattr(modules[0], name)


def _value_of(content: Any) -> Any:
    """Return the value of a field from the content of `_value_content`."""
    if isinstance(content, Mapping):
        return (
            {key: _value_of(each) for key, each in content["mapping"].items()}
            if "mapping" in content
            else _object_of(content)
        )
    return tuple(_value_of(each) for each in content) if isinstance(content, list) else content


def refuse_wrong_kind(value: Any, kind: Any) -> None:
    """Raise TypeError if a value is not of its declared type, or not finite."""
    from pydantic import ConfigDict, TypeAdapter, ValidationError

    is_class = is_dataclass(kind) and isinstance(kind, type)
    try:
        if is_class and not isinstance(value, kind):
            raise TypeError(f"a {type(value).__name__} where a {kind.__name__} is due")
        if not is_class:
            settings = ConfigDict(arbitrary_types_allowed=True, allow_inf_nan=False)
            TypeAdapter(kind, config=settings).validate_python(value, strict=True)
    except ValidationError as error:
        raise TypeError(f"{value!r:.40} is no {kind}: {error.errors()[0]['msg']}") from None


def refuse_wrong_fields(content: Mapping[str, Any], kind: type) -> None:
    """Check values that become the fields of a dataclass, by name.

    Raises
    ------
    TypeError : a value is not of the declared type of its field.
    KeyError : the dataclass has no field of a name.
    """
    hints = get_type_hints(kind)
    for key, value in content.items():
        refuse_wrong_kind(value, hints[key])


# ---- The stored model of a study

NAME = "model.json"
SCHEMA = "flightid/model/1"
IDENTIFY, DIAGNOSE = "identify", "diagnose"
# Key of ``model.json`` -> type of its value in JSON.
_KINDS = {
    **dict.fromkeys(("made_by", "model", "vehicle_text"), str),
    **dict.fromkeys(("biases", "spiked", "claimed"), list[str]),
    "reading": dict[str, Any],
    "weighed": bool,
    "after": dict[str, Any],
}
# Key of ``before`` and ``after`` -> type of its value in JSON.
_TRAINED = {
    "effects": list[dict[str, Any]],
    "outputs": list[str],
    "shared": dict[str, float],
    "own": list[dict[str, float]],
    "settings": dict[str, Any],
}


@dataclass(frozen=True)
class StoredReading:
    """How the fitted records were read and prepared.

    Attributes
    ----------
    hold : behaviour of the inputs between samples, ``"previous"`` or ``"linear"``.
    by_hand : whether the user requested ``hold``.
    weight : whether the trim lift follows a measured dynamic pressure.
    flow, attitude : whether a measured airspeed or pitch attitude is used.
    rate, lowpass, trusted : as in a ``Plan``; a rate or frequency of zero stands for none.
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
class StoredModel:
    """The stored model of a study.

    Attributes
    ----------
    made_by : command that made the study, ``"identify"`` or ``"diagnose"``.
    model : a name of ``MODELS``, or the name of a user's model.
    vehicle, vehicle_text : name and hash of the vehicle file, and its content; None and empty for a
        user's model without one.
    own_file, effects_file : name and hash of the files with a user's model and user effects, which
        are run only if the user names them again.
    reading : how the fitted records were read and prepared.
    biases : outputs with a free bias.
    spiked : inputs with corrected spikes.
    weighed : whether the weight along the flight path is included, by a measured attitude.
    before, after : declared model and model with effects of a diagnosis; an identification has
        ``after`` only.
    claimed : names of the effects that the diagnosis claims.
    """

    made_by: str
    model: str
    vehicle: InputFile | None
    vehicle_text: str
    own_file: InputFile | None
    reading: StoredReading
    biases: tuple[str, ...]
    after: Trained
    before: Trained | None = None
    effects_file: InputFile | None = None
    spiked: tuple[str, ...] = ()
    weighed: bool = False
    claimed: tuple[str, ...] = field(default=())


def write_stored_study(folder: Path, study: StoredModel) -> None:
    """Write ``model.json`` into a folder."""
    files = {
        "vehicle": study.vehicle,
        "model_file": study.own_file,
        "effects_file": study.effects_file,
    }
    write_json(
        folder / NAME,
        {
            "schema": SCHEMA,
            "made_by": study.made_by,
            "model": study.model,
            "files": {key: asdict(file) for key, file in files.items() if file is not None},
            "vehicle_text": study.vehicle_text,
            "reading": asdict(study.reading),
            "biases": list(study.biases),
            "spiked": list(study.spiked),
            "weighed": study.weighed,
            "claimed": list(study.claimed),
            "after": _trained_content(study.after),
            **({"before": _trained_content(study.before)} if study.before is not None else {}),
        },
    )


@dataclass(frozen=True, eq=False)
class StoredStudy:
    """The content of a ``model.json``.

    It names the user's files that the study used. With the effects of these files it becomes a
    ``StoredModel``.
    """

    path: Path
    content: Mapping[str, Any]

    def file(self, key: str) -> InputFile | None:
        """Return name and hash of a file that the study used; None if there was none.

        ``key`` is ``vehicle``, ``model_file`` or ``effects_file``.
        """
        entry = self.content["files"].get(key)
        return None if entry is None else InputFile(entry["name"], entry["sha256"])

    def model(self, own: Sequence[Traceable] = ()) -> StoredModel:
        """Return the model; ``own`` are the user effects.

        Raises
        ------
        DeclarationError : the content is damaged, or ``effect_of`` raises.
        """
        try:
            return self._checked_model(own)
        except (AttributeError, KeyError, TypeError, ValueError):
            raise _unreadable(self.path) from None

    def _checked_model(self, own: Sequence[Traceable]) -> StoredModel:
        content, where = self.content, str(self.path)
        for key, kind in _KINDS.items():
            refuse_wrong_kind(content[key], kind)
        refuse_wrong_fields(content["reading"], StoredReading)
        before = _trained(content["before"], own, where) if "before" in content else None
        return StoredModel(
            content["made_by"],
            content["model"],
            self.file("vehicle"),
            content["vehicle_text"],
            self.file("model_file"),
            StoredReading(**content["reading"]),
            tuple(content["biases"]),
            _trained(content["after"], own, where),
            before,
            self.file("effects_file"),
            tuple(content["spiked"]),
            content["weighed"],
            tuple(content["claimed"]),
        )


def read_stored_study(folder: str | Path) -> StoredStudy:
    """Return the content of ``model.json`` in a study folder.

    Raises
    ------
    DeclarationError : there is no such folder, no study in it, or a study without a model. The
        message has the command to run.
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
        or not _states_its_files(content)
    ):
        raise _unreadable(path)
    return StoredStudy(path, content)


def _states_its_files(content: Mapping[str, Any]) -> bool:
    """Return whether the content names its model, its vehicle and its files as texts.

    These are read before the rest of the content is checked.
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
    """Return the error for a folder without a model, with the command to run.

    The command is that of the study again, or an identification of its record.
    """
    if (folder / "diagnosis.json").is_file():
        return DeclarationError(
            "this diagnosis has no stored model",
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
            "this study has no stored model",
            where=str(folder),
            remedy="run flightid identify again with this --out",
        )
    remedy = (
        f"identify its record first: flightid identify {folder / 'record.csv'} --model M --vehicle "
        "V.toml --out FIT"
    )
    return DeclarationError(
        "a study of a simulated flight stores no model to predict with",
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
        refuse_wrong_kind(content[key], kind)
    refuse_wrong_fields(content["settings"], FitSettings)
    effects = tuple(effect_of(each, own, where) for each in content["effects"])
    return Trained(
        effects,
        tuple(content["outputs"]),
        content["shared"],
        tuple(content["own"]),
        FitSettings(**content["settings"]),
    )


# ---- Files of the user that a study used


def vehicle_of_study(file: StoredStudy, model: Path | OwnModel | None) -> VehicleFile:
    """Return the vehicle of a study from its stored text.

    A study of a user's model also needs the file of the model, ``model``.
    """
    own, text = file.file("model_file"), file.content["vehicle_text"]
    chosen: str | OwnModel = file.content["model"]
    if chosen == AIRCRAFT and text:  # its equations are its vehicle file, which is not run
        own = None
    if own is not None:
        if model is None:
            what = (
                f"the study's model is in {own.name}, a user's Python file, which is run only if "
                "it is named"
            )
            raise DeclarationError(what, where="--model", remedy=f"add --model PATH/{own.name}")
        chosen = model if isinstance(model, OwnModel) else unchanged_file(model, own, "--model")
        if isinstance(model, OwnModel) and model.identity.sha256 != own.sha256:
            what = f"{model.model.name} is not the {own.name} that the study was made with"
            raise DeclarationError(
                what, where="--model", remedy="give that model as it was, or run the study again"
            )
    elif model is not None:
        raise DeclarationError(
            f"the study's model is {chosen}, which is built in",
            where="--model",
            remedy="leave it out",
        )
    if not text:
        return read_vehicle(None, chosen)
    with tempfile.TemporaryDirectory(prefix="flightid-") as folder:
        entry = file.file("vehicle")
        # A study may be untrusted: its file names must not lead outside this folder.
        named = Path(entry.name).name.lstrip(".") if entry is not None else ""
        path = Path(folder) / (named or "vehicle.toml")
        write_text(path, text)
        return read_vehicle(path, chosen)


def unchanged_file(path: Path, known: InputFile, option: str) -> str:
    """Return the path of a user's file as a text.

    Raises
    ------
    DeclarationError : its bytes are not those of the file that the study used, ``known``.
    """
    if read_source(path, DeclarationError, "a Python file").identity.sha256 != known.sha256:
        what = f"{path} is not the {known.name} that the study was made with"
        raise DeclarationError(
            what, where=option, remedy="name that file as it was, or run the study again"
        )
    return str(path)
