"""The model of a study as its folder keeps it: declared how, records read how, with which values and effects it predicts another record."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from ident.tracing.diagnosis import Trained
from ident.whole_record.layout import FitSettings
from scenarios.files.documents import found_json, read_json
from scenarios.files.sources import InputFile
from scenarios.files.writing import write_json
from scenarios.kept.effects_text import effect_content, effect_of, refuse_other_fields, refuse_other_kind
from sim.declaration.proposal import Traceable
from sim.errors import DeclarationError

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

    ``hold`` of the inputs, ``by_hand`` where it was asked for; ``weight``: the lift that carries the weight follows a measured pressure; ``flow``,
    ``attitude``: a measured airspeed or pitch attitude is used. ``rate``, ``lowpass``, ``trusted`` as in a ``Plan``; zero: none.
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
    made_by : ``"identify"`` or ``"diagnose"``. model : a name of ``MODELS``, or what a user's own model calls itself.
    vehicle : name and hash of the vehicle file, ``vehicle_text`` its content; None and empty where an own model went without one.
    own_file, effects_file : a user's model and effects, which are run only when they are named again.
    biases : outputs with a free bias. spiked : inputs whose isolated wrong samples are mended.
    weighed : the weight along the flight path acts, by a measured attitude.
    before, after : of a diagnosis the declared model, and that with the effects found; of an identification ``after`` alone, without effects.
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
    files = {"vehicle": kept.vehicle, "model_file": kept.own_file, "effects_file": kept.effects_file}
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
    """A ``model.json`` that was read: which files of the user's it rests on; with these it becomes a ``KeptModel``."""

    path: Path
    content: Mapping[str, Any]

    def file(self, key: str) -> InputFile | None:
        """Name and hash of a file, by ``vehicle``, ``model_file`` or ``effects_file``; None where there was none."""
        entry = self.content["files"].get(key)
        return None if entry is None else InputFile(entry["name"], entry["sha256"])

    def model(self, own: Sequence[Traceable] = ()) -> KeptModel:
        """The model; ``own`` are the user's effects. Raises DeclarationError where it cannot be made again."""
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
    """The model that a study folder keeps.

    Raises
    ------
    DeclarationError : no such folder, no study in it, or one that keeps no model; the line says what to run.
    """
    folder = Path(folder)
    if not folder.is_dir():
        what = "this is a file, not a study folder" if folder.exists() else "there is no such folder"
        raise DeclarationError(what, where=str(folder), remedy="name the --out folder of identify or diagnose")
    path = folder / NAME
    if not os.path.lexists(path):
        raise _no_model(folder)
    content = read_json(path, wanted="the --out folder of identify or diagnose")
    if not isinstance(content, dict) or content.get("schema") != SCHEMA or not _says_its_files(content):
        raise _unreadable(path)
    return KeptFile(path, content)


def _says_its_files(content: Mapping[str, Any]) -> bool:
    """Whether a model says what it was declared with, in texts: this is read before its parameters are."""
    files = content.get("files")
    if not isinstance(files, dict) or not all(isinstance(content.get(key), str) for key in ("made_by", "model", "vehicle_text")):
        return False
    return all(isinstance(each, dict) and all(isinstance(each.get(key), str) for key in ("name", "sha256")) for each in files.values())


def _unreadable(path: Path) -> DeclarationError:
    return DeclarationError("this is no model that can be read here", where=str(path), remedy="run the study again")


def _no_model(folder: Path) -> DeclarationError:
    """What to run where a folder keeps no model: the study again, or an identification of its record."""
    if (folder / "diagnosis.json").is_file():
        return DeclarationError("this diagnosis keeps no model", where=str(folder), remedy="run flightid diagnose again with this --out")
    comparison = found_json(folder / "comparison.json")
    scenario = comparison.get("scenario") if isinstance(comparison, dict) else None
    if not isinstance(comparison, dict):
        return DeclarationError("there is no study in this folder", where=str(folder), remedy="name the --out folder of identify or diagnose")
    if scenario == IDENTIFY:
        return DeclarationError("this study keeps no model", where=str(folder), remedy="run flightid identify again with this --out")
    remedy = f"identify its record first: flightid identify {folder / 'record.csv'} --model M --vehicle V.toml --out FIT"
    return DeclarationError("a study of a simulated flight keeps no model to predict with", where=str(folder), remedy=remedy)


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
    return Trained(effects, tuple(content["outputs"]), content["shared"], tuple(content["own"]), FitSettings(**content["settings"]))
